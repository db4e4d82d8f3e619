"""An entry of the errata: a printed formula beside the right one. Formulas are text, letter by letter as printed."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

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

SHORT = {
    "X": "c3*s1 - c1*s2*s3",
    "Y": "c1*c3 + s1*s2*s3",
    "U": "s1*s3 + c1*c3*s2",
    "V": "c1*s3 - c3*s1*s2",
    "W": "s2*s4 - c2*c4*s3",
    "Z": "c4*s2 + c2*s3*s4",
    "K": "c4*Y + c2*s1*s4",
    "M": "s4*Y - c2*c4*s1",
    "N": "c4*X - c1*c2*s4",
    "O": "s4*X + c1*c2*c4",
}
"""Sums that the source writes out again and again, and what they stand for."""


TRUE = {"T": "pose", "A": "links", "J": "jacobian"}
"""Names of verified quantities in formulas."""


def evaluate(text: str, states: States, **others: Any) -> np.ndarray:
    """The value of a formula, states last.

    `c1` and `s1` are cosine and sine of joint 1, `l1` is a length, `theta1` an angle; `n`, `o`, `a` and `p` are columns
    of the toe's true pose `T`, `A` the true transformations of the links and `J` the true Jacobian, all counted from 0.
    """
    names: dict[str, Any] = {name: getattr(np, name) for name in ("sqrt", "exp", "sin", "cos", "arctan", "arctan2")}
    for i, (angle, length) in enumerate(zip(states.q, states.lengths, strict=True), start=1):
        names |= {f"theta{i}": angle, f"c{i}": np.cos(angle), f"s{i}": np.sin(angle), f"l{i}": length}
    for name, meaning in SHORT.items():
        names[name] = eval(meaning, names)
    if states.true:
        names |= {name: np.moveaxis(states.true[of], 0, -1) for name, of in TRUE.items()}
        names |= dict(zip("noap", names["T"][:3].swapaxes(0, 1), strict=True))
    value = np.asarray(eval(text, names | others))
    return value if value.ndim else np.full(states.q.shape[1], value)


def formula(*texts: str) -> Formula:
    """A formula of one text, or the stack of several."""

    def values(states: States) -> np.ndarray:
        found = [evaluate(text, states) for text in texts]
        return found[0] if len(found) == 1 else np.stack(found)

    return values


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
