"""Printed formulas beside the right ones, texts of `errata.yaml`, and their values at states of the leg."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from humanoid_mjx.reproduction.printed import dynamics
from humanoid_mjx.thesis import leg as thesis

TEXTS = yaml.safe_load(Path(__file__).with_name("errata.yaml").read_text(encoding="utf-8"))


class States(NamedTuple):
    """The states that formulas are compared at, in columns: angles unpack as `q1, q2, q3, q4, q5 = states.q`."""

    q: np.ndarray
    """(5, n) rad"""
    lengths: tuple[float, float, float, float, float]
    """l1 to l5, m"""
    true: Mapping[str, np.ndarray]
    """Verified quantities by their names in formulas, states last: the toe's pose `T` (4, 4, n), the links' poses `A`
    (5, 4, 4, n), the Jacobian `J` (6, 5, n), the mass matrix `mass` (5, 5, n), the velocity coefficients `h`
    (5, 5, 5, n), the torques `upright_gravity` and `sideways_gravity` (5, n) against gravity along the leg and
    along -z0."""
    qd: np.ndarray = np.zeros((5, 0))
    """(5, n) rad/s"""
    qdd: np.ndarray = np.zeros((5, 0))
    """(5, n) rad/s^2"""
    inertia: np.ndarray = np.zeros((5, 4, 4))
    """The links' pseudo-inertias in their frames, kg m^2, kg m and kg."""

    @property
    def model(self) -> dynamics.Model:
        """The leg of the printed dynamics, with its true centroids."""
        return dynamics.Model(self.lengths, self.inertia, self.inertia[:, :3, 3] / self.inertia[:, 3, 3, None])


@dataclass(frozen=True)
class Erratum:
    """A printed formula beside the right one; each is a text or, for a matrix, a list of them."""

    place: str
    """Place where it is printed."""
    printed: Any
    right: Any
    fault: str = "none"
    fix: str = ""
    """The correction."""
    unit: str = ""
    in_range: bool = False
    """True if it is compared only where the joints are in the ranges of Table 3.2."""

    def errors(self, states: States) -> np.ndarray:
        """(n,) Error of the printed formula at each state; whole turns of an angle do not count."""
        with np.errstate(all="ignore"):
            difference = evaluate(self.printed, states) - evaluate(self.right, states)
        difference = _turned(difference) if self.unit == "rad" else difference
        return np.abs(difference).reshape(-1, states.q.shape[1]).max(axis=0)


def evaluate(formula: Any, states: States, **others: Any) -> np.ndarray:
    """The value of a formula, states last, with other values in the place of these names."""
    if not isinstance(formula, str):
        return np.stack([evaluate(part, states, **others) for part in formula])
    value = np.asarray(eval(formula, {}, _Names(_names_at(states) | others)))
    return value if value.ndim else np.full(states.q.shape[1], value)


class _Names(dict[str, Any]):
    """Values of names. One that the texts define is computed when a formula first asks for it."""

    def __missing__(self, name: str) -> Any:
        self[name] = eval(TEXTS["names"][name], {}, self)
        return self[name]


def _names_at(states: States) -> dict[str, Any]:
    """Names that formulas use and no text defines."""
    names: dict[str, Any] = {name: getattr(np, name) for name in MATHEMATICS}
    for i, (angle, length) in enumerate(zip(states.q, states.lengths, strict=True), start=1):
        names |= {f"theta{i}": angle, f"c{i}": np.cos(angle), f"s{i}": np.sin(angle), f"l{i}": length}
    names |= {"q": states.q, "rate": states.qd, "qacc": states.qdd, **states.true}
    if "T" in names:
        names |= dict(zip("noap", names["T"][:3].swapaxes(0, 1), strict=True))
    names |= {"KP": thesis.KP, "PSEUDO_INERTIAS": thesis.PSEUDO_INERTIAS}
    names |= {"script_centroids": dynamics.script_centroids(states.lengths)}
    names |= {"determinant": lambda matrix: np.linalg.det(np.moveaxis(matrix, -1, 0))}
    names |= {"least_eigenvalue": lambda matrix: np.linalg.eigvalsh(np.moveaxis(matrix, -1, 0))[:, 0]}
    return names | {name: partial(function, states) for name, function in FUNCTIONS.items()}


def better_sign(states: States, name: str, true: np.ndarray) -> np.ndarray:
    """Of the two values of an angle, by the sign of a root, the one nearer to the true angle."""
    both = np.array([evaluate(name, states, sign=sign) for sign in (1.0, -1.0)])
    return np.take_along_axis(both, np.abs(_turned(both - true)).argmin(axis=0)[None], axis=0)[0]


def solved(states: States) -> np.ndarray:
    """(3, n) Where the toe is at the printed solution with the signs that serve best, given the true theta 5."""
    target = evaluate("p", states)
    best = np.full_like(target, np.inf)
    for sign4, sign2 in product((1.0, -1.0), repeat=2):
        q4 = evaluate("path_theta4", states, sign=sign4)
        given = {"theta45": q4 + states.q[4], "sign": sign2}
        q1, q2, q3 = evaluate(["path_theta1", "path_theta2", "path_theta3"], states, **given)
        there = states._replace(q=np.array([q1, q2, q3, q4, states.q[4]]))
        place = evaluate(["toe_x", "toe_y", "toe_z"], there)
        best = np.where(np.linalg.norm(place - target, axis=0) < np.linalg.norm(best - target, axis=0), place, best)
    return best


def derivative(states: States, i: int, j: int) -> np.ndarray:
    """d_ij = A_1 .. A_(j-1) Q A_j .. A_i without its last row, (3, 4, n)."""
    links = np.moveaxis(states.true["A"], -1, 0)
    pose = np.eye(4)
    for link in range(1, i + 1):
        pose = pose @ (dynamics.Q @ links[:, link - 1] if link == j else links[:, link - 1])
    return np.moveaxis(pose[:, :3], 0, -1)


def kinetic_energy(states: States) -> np.ndarray:
    """The first term of (4.27): j runs from i to i."""
    factors, qd = dynamics.Factors(states.model, states.q), states.qd
    pairs = [(i, k) for i in dynamics.JOINTS for k in range(1, i + 1)]
    return np.sum([factors.inner(i, (i,), (k,)) * qd[i - 1] * qd[k - 1] for i, k in pairs], axis=0) / 2


def planned_acceleration(states: States, power: int) -> np.ndarray:
    """The planned accelerations, degrees/s^2, with this power of time in the last term; times in place of states."""
    t = np.linspace(0, thesis.QUINTIC_S, states.q.shape[1])
    a3, a4, a5 = np.array(thesis.QUINTIC_COEFFICIENTS)[:, 1:, None].swapaxes(0, 1)
    return 6 * a3 * t + 12 * a4 * t**2 + 20 * a5 * t**power


def stretched(states: States, joint: int, low: float, high: float) -> np.ndarray:
    """Values of a symbol from low to high, as a joint's angles lie on the circle."""
    return low + (high - low) * (states.q[joint - 1] + np.pi) / (2 * np.pi)


MATHEMATICS = ("sqrt", "exp", "sin", "cos", "arctan", "arctan2", "einsum")
FUNCTIONS = {
    **{f.__name__: f for f in (better_sign, solved, derivative, kinetic_energy, planned_acceleration, stretched)},
    "mass_matrix": lambda states, *faults: dynamics.mass_matrix(states.model, states.q, faults),
    "coefficients": lambda states, *faults: dynamics.velocity_coefficients(states.model, states.q, faults),
    "velocity_term": lambda states, *faults: dynamics.coriolis(states.model, states.q, states.qd, faults),
    "gravity": lambda states, **changes: dynamics.gravity(states.model._replace(**changes), states.q),
}
"""Functions of formulas, which are given the states first."""


def _turned(angle: np.ndarray) -> np.ndarray:
    """The same angles in [-pi, pi), rad."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


ENTRIES = tuple(Erratum(**entry) for entry in TEXTS["errata"])
