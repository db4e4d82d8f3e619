"""Section 4.6, appendices F to H and the MATLAB script's dynamics as printed.

The faults are data: every function takes the names of those it is to have (`FAULTS`), none of them giving the right
equations. The faults add up: what a slip changes does not depend on whether the rule is wrong too.

Postures are arrays of numpy, or of jax, also traced; so are the results.
"""

from collections.abc import Callable, Collection
from functools import cache
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from humanoid_mjx.thesis import leg as thesis
from humanoid_mjx.types import FloatScalar

FAULTS = {
    "M33": "d55 for d53 in the last term of the script's M33",
    "rule": "d(d_pk)/dq_p for d(d_pj)/dq_k in the velocity coefficients, (4.29), (4.32) and appendix G",
    "slips": "the script's slips in six velocity coefficients (`SLIPS`)",
    "speeds": "h_i31 times the square of speed 1, for speed 3 times speed 1, in the script's H1 to H5",
}
ALL = tuple(FAULTS)

JOINTS = range(1, 6)

Array = Any
"""An array of numpy or jax."""

Q = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]])
"""The derivative of a rotation about z, which comes after it."""


SLIPS = {
    (1, 1, 2): (5, "A1 Q2 A2 A3 A4 Q5 I5 d51'"),
    (1, 3, 3): (3, "A1 A3 Q3 Q3 A3 I3 d31'"),
    (3, 1, 2): (5, "A1 Q2 A3 A4 Q5 A5 I5 d53'"),
    (3, 2, 3): (3, "A1 A2 Q3 Q3 I3 d33'"),
    (3, 2, 5): (5, "A1 A2 Q3 A3 A4 Q5 A5 I5 d53'"),
    (3, 4, 5): (5, "A1 A2 A3 A4 Q5 Q5 A5 d53'"),
}
"""Terms of velocity coefficients in which the script differs from its own rule, by i, j and k with j < k or equal: the
index p of the term, and the factors of its trace as printed. The coefficient with j and k exchanged is set to the
same."""


class Model(NamedTuple):
    """Parameters of the formulas."""

    lengths: tuple[FloatScalar, ...]
    """l1 to l5, m"""
    inertia: Array
    """(5, 4, 4) pseudo-inertias in the links' frames, kg m^2, kg m and kg"""
    centroids: Array
    """(5, 3) the r of the gravity terms, m"""
    gravity: tuple[FloatScalar, FloatScalar, FloatScalar] = (0.0, 0.0, -thesis.GRAVITY)
    """m/s^2 in frame 0"""


def script_centroids(lengths: tuple[float, ...]) -> np.ndarray:
    """(5, 3) The script's and appendix H's r1 to r5, m."""
    l1, l2, l3, l4, l5 = lengths
    return np.array([(0, l1, 0), (0, 0, l2), (0, 0, l3), (0, 0, l4), (0, 0, l5)]) / 2


class Factors:
    """The factors of the script's products at postures q, (5, n) rad."""

    def __init__(self, model: Model, q: Array):
        self.inertia = model.inertia
        self._xp: Any = q.__array_namespace__()
        self._links = [_link(model.lengths, joint, q[joint - 1]) for joint in JOINTS]
        self._known: dict[tuple[int, ...], Array] = {}

    def derivative(self, link: int, *turned: int) -> Array:
        """(n, 4, 4) The derivative of A1 ... A_link with respect to these joints: d_pj, or d d_pj / d q_k."""
        key = (link, *sorted(turned))
        if key not in self._known:
            words = [
                word for joint in range(1, link + 1) for word in [f"Q{joint}"] * turned.count(joint) + [f"A{joint}"]
            ]
            self._known[key] = self.product(words)
        return self._known[key]

    def product(self, words: Collection[str]) -> Array:
        """(n, 4, 4) The product of factors as the script names them: A1, Q1, I1 and d11', the transpose of d11."""
        value = np.eye(4)
        for word in words:
            value = value @ self._factor(word)
        return value

    def trace(self, term: str) -> Array:
        return self._xp.trace(self.product(term.split()), axis1=-2, axis2=-1)

    def inner(self, link: int, left: tuple[int, ...], right: tuple[int, ...]) -> Array:
        """(n,) Tr(D I D^T) of two derivatives of one link's transformation."""
        moved = self.derivative(link, *left) @ self.inertia[link - 1]
        return (moved * self.derivative(link, *right)).sum(axis=(-2, -1))

    def _factor(self, word: str) -> Array:
        kind, index = word[0], int(word[1])
        if kind == "d":
            return self._xp.matrix_transpose(self.derivative(index, int(word[2])))
        return {"A": self._links[index - 1], "Q": Q, "I": self.inertia[index - 1]}[kind]


def mass_matrix(model: Model, q: Array, faults: Collection[str] = ALL) -> Array:
    """(5, 5, n) Appendix F and the script's M, kg m^2, at q, (5, n) rad."""
    factors = Factors(model, q)

    def element(i: int, j: int) -> Array:
        value = sum(factors.inner(p, (j,), (i,)) for p in range(max(i, j), 6))
        if "M33" in faults and i == j == 3:
            value += factors.inner(5, (5,), (3,)) - factors.inner(5, (3,), (3,))
        return value

    return _stacked(element, 2, q)


def velocity_coefficients(model: Model, q: Array, faults: Collection[str] = ALL) -> Array:
    """(5, 5, 5, n) Appendix G and the script's h_ijk, kg m^2, at q, (5, n) rad."""
    factors = Factors(model, q)

    @cache
    def upper(i: int, j: int, k: int) -> Array:
        value = 0.0
        for p in range(max(i, k), 6):
            turned = (k, p) if "rule" in faults else (j, k)
            value += factors.inner(p, turned, (i,))
        if "slips" in faults and (i, j, k) in SLIPS:
            p, printed = SLIPS[i, j, k]
            value += factors.trace(printed) - factors.inner(p, (k, p), (i,))
        return value

    return _stacked(lambda i, j, k: upper(i, min(j, k), max(j, k)), 3, q)


def coriolis(model: Model, q: Array, qd: Array, faults: Collection[str] = ALL) -> Array:
    """(5, n) The script's H, N m, at q and qd, (5, n) rad and rad/s."""

    def speeds(j: int, k: int) -> Array:
        return qd[0] * qd[0] if "speeds" in faults and (j, k) == (3, 1) else qd[j - 1] * qd[k - 1]

    return (velocity_coefficients(model, q, faults) * _stacked(speeds, 2, q)).sum(axis=(1, 2))


def gravity(model: Model, q: Array) -> Array:
    """(5, n) Appendix H and the script's G, N m, at q, (5, n) rad. Its faults are those of the model."""
    factors = Factors(model, q)
    xp: Any = q.__array_namespace__()
    g, ones = xp.asarray([*model.gravity, 1.0]), np.ones((5, 1))
    moments = model.inertia[:, 3, 3, None] * xp.concat([xp.asarray(model.centroids), ones], axis=1)
    return _stacked(lambda i: -sum(g @ factors.derivative(p, i) @ moments[p - 1] for p in range(i, 6)), 1, q)


def inverse_dynamics(model: Model, q: Array, qd: Array, qdd: Array, faults: Collection[str] = ALL) -> Array:
    """(5, n) The script's torques, N m, of a motion, (5, n) each: rad, rad/s and rad/s^2."""
    inertial = (mass_matrix(model, q, faults) * qdd).sum(axis=1)
    return inertial + coriolis(model, q, qd, faults) + gravity(model, q)


def _stacked(element: Callable[..., Array], indices: int, like: Array) -> Array:
    """(5, ..., 5, n) `element` of so many indices from 1 to 5, each of them (n,), in the namespace of `like`."""
    values = like.__array_namespace__().stack([element(*at) for at in product(JOINTS, repeat=indices)])
    return values.reshape((5,) * indices + values.shape[1:])


def _link(lengths: tuple[FloatScalar, ...], joint: int, angle: Array) -> Array:
    """(n, 4, 4) The script's A1 to A5."""
    xp = angle.__array_namespace__()
    c, s, zero, one = xp.cos(angle), xp.sin(angle), 0 * angle, 0 * angle + 1
    length = lengths[joint - 1] * one
    rows = {
        1: ((c, zero, s, zero), (s, zero, -c, zero), (zero, one, zero, length)),
        2: ((-s, zero, -c, zero), (c, zero, -s, zero), (zero, -one, zero, length)),
        3: ((s, zero, -c, length * s), (-c, zero, -s, -length * c), (zero, one, zero, zero)),
    }.get(joint, ((c, -s, zero, length * c), (s, c, zero, length * s), (zero, zero, one, zero)))
    return xp.moveaxis(xp.stack([xp.stack(row) for row in (*rows, (zero, zero, zero, one))]), -1, 0)
