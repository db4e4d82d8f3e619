"""An entry of the errata: a printed formula beside the right one."""

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
    """Verified quantities by name, states first: `pose` (n, 4, 4), `links` (n, 5, 4, 4), `jacobian` (n, 6, 5),
    `mass_matrix` (n, 5, 5), `velocity_coefficients` (n, 5, 5, 5), and `gravity` and `sideways_gravity` (n, 5): the
    torques against gravity along the leg and along -z0."""
    qd: np.ndarray = np.zeros((5, 0))
    """(5, n) rad/s"""
    qdd: np.ndarray = np.zeros((5, 0))
    """(5, n) rad/s^2"""
    inertia: np.ndarray = np.zeros((5, 4, 4))
    """The links' pseudo-inertias in their frames, kg m^2, kg m and kg."""


Formula = Callable[[States], np.ndarray]


@dataclass(frozen=True)
class Erratum:
    """A printed formula beside the right one."""

    place: str
    """Place where it is printed."""
    fault: str
    """The fault, or "none"."""
    fix: str
    """The correction."""
    printed: Formula
    right: Formula
    unit: str = ""
    angle: bool = False
    """True if whole turns do not count."""
    in_range: bool = False
    """True if it is compared only where the joints are in the ranges of Table 3.2."""

    def errors(self, states: States) -> np.ndarray:
        """(n,) Error of the printed formula at each state."""
        with np.errstate(all="ignore"):
            difference = np.asarray(self.printed(states)) - np.asarray(self.right(states))
        if self.angle:
            difference = (difference + np.pi) % (2 * np.pi) - np.pi
        return np.abs(difference).reshape(-1, states.q.shape[1]).max(axis=0)
