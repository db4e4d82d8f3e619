"""What an entry of the errata is."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


class States(NamedTuple):
    """The states that formulas are compared at, in columns: angles unpack as `q1, q2, q3, q4, q5 = states.q`."""

    q: np.ndarray
    """(5, n) rad"""
    lengths: tuple[float, float, float, float, float]
    """l1 to l5, m"""
    true: Mapping[str, np.ndarray]
    """Verified quantities by name, states first: `pose` (n, 4, 4), `links` (n, 5, 4, 4), `jacobian` (n, 6, 5)."""


Formula = Callable[[States], np.ndarray]


@dataclass(frozen=True)
class Erratum:
    """A printed formula beside the right one."""

    place: str
    """Where it is printed."""
    fault: str
    """What is wrong with it, or "none"."""
    fix: str
    """What it should be."""
    printed: Formula
    right: Formula
    unit: str = ""
    angle: bool = False
    """Whether whole turns do not count."""
    in_range: bool = False
    """Whether to compare only where the joints are in the ranges of Table 3.2."""

    def errors(self, states: States) -> np.ndarray:
        """(n,) How far the printed formula is off at each state."""
        with np.errstate(all="ignore"):
            difference = np.asarray(self.printed(states)) - np.asarray(self.right(states))
        if self.angle:
            difference = (difference + np.pi) % (2 * np.pi) - np.pi
        return np.abs(difference).reshape(-1, states.q.shape[1]).max(axis=0)
