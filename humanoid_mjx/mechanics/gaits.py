"""The gaits of Tables 4.5 and 4.6 as periodic motions of both legs."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from humanoid_mjx.mechanics.trajectories import Motion
from humanoid_mjx.spec import InputError, known
from humanoid_mjx.thesis import leg as thesis
from humanoid_mjx.types import FloatScalar

TABLES = {"straight_walk": thesis.STRAIGHT_WALK, "sudden_turn": thesis.SUDDEN_TURN}
"""Tables 4.5 and 4.6. Their "hip" is the hip's pitch. Joints that they do not name stay at 0."""


class Gait(NamedTuple):
    """A periodic motion of one leg: a polynomial of third order for each joint between the times of a table."""

    knots: Float[Array, " knots"]
    """s, from 0 to the period."""
    coefficients: Float[Array, "spans 4 5"]
    """Coefficients of (t - knot)^0 to (t - knot)^3 for each span and joint, rad and s."""

    @property
    def period(self) -> Float[Array, ""]:
        """s"""
        return self.knots[-1]

    def at(self, t: FloatScalar) -> Motion:
        """The motion of the five joints at time t, s, of any sign."""
        t = jnp.mod(t, self.period)
        span = jnp.clip(jnp.searchsorted(self.knots, t, side="right") - 1, 0, len(self.coefficients) - 1)
        x = t - self.knots[span]
        c0, c1, c2, c3 = self.coefficients[span]
        return Motion(c0 + x * (c1 + x * (c2 + x * c3)), c1 + x * (2 * c2 + x * 3 * c3), 2 * c2 + x * 6 * c3)

    def both_legs(self, t: FloatScalar) -> Motion:
        """The motions of the right and the left leg, (2, 5): the left does the same half a period later."""
        legs = self.at(t), self.at(t - self.period / 2)
        return Motion(*(jnp.stack(pair) for pair in zip(*legs, strict=True)))


def gait(name: str, kind: str = "spline") -> Gait:
    """The gait `straight_walk` (Table 4.5) or `sudden_turn` (Table 4.6).

    Args:
      name: which table.
      kind: `spline`, twice continuously differentiable through the table's points, or `linear` between them.

    Raises:
      InputError: an unknown name or kind.
    """
    if name not in TABLES:
        raise InputError(f"gait: unknown name {name!r}; {known(name, TABLES)}.")
    return from_table(thesis.GAIT_TIMES_S, TABLES[name], kind)


def from_table(times: Sequence[float], degrees: Mapping[str, Sequence[float]], kind: str = "spline") -> Gait:
    """A gait through the points of a table.

    Args:
      times: s, from 0 to the period.
      degrees: the angles at these times by joint name; the last equals the first. Joints not named stay at 0.
      kind: as for `gait`.

    Raises:
      InputError: an unknown joint or kind, times that do not rise from 0, angles that are no period.
    """
    if odd := [joint for joint in degrees if joint not in thesis.JOINT_NAMES]:
        raise InputError(f"gait: unknown joint {odd[0]!r}; {known(odd[0], thesis.JOINT_NAMES)}.")
    if kind not in ("spline", "linear"):
        raise InputError(f"gait: kind must be 'spline' or 'linear', got {kind!r}.")
    knots = np.asarray(times, float)
    if len(knots) < 4 or knots[0] != 0 or not (np.diff(knots) > 0).all():
        raise InputError(f"gait: times must rise from 0 and be at least four, got {list(times)}.")
    angles = np.zeros((len(knots), 5))
    for joint, column in degrees.items():
        if len(column) != len(knots) or column[0] != column[-1]:
            raise InputError(f"gait: {joint} must have {len(knots)} angles, the last equal to the first.")
        angles[:, thesis.JOINT_NAMES.index(joint)] = np.radians(column)
    slopes = _spline_slopes(knots, angles) if kind == "spline" else None
    return Gait(jnp.array(knots), jnp.array(_cubics(knots, angles, slopes)))


def _spline_slopes(knots: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(knots, joints) The slopes at the knots that make a periodic cubic spline's second derivative continuous."""
    h = np.diff(knots)
    n = len(h)
    secants = np.diff(values, axis=0) / h[:, None]
    matrix, right = np.zeros((n, n)), np.zeros_like(secants)
    for i in range(n):
        matrix[i, i - 1] += h[i]
        matrix[i, i] += 2 * (h[i - 1] + h[i])
        matrix[i, (i + 1) % n] += h[i - 1]
        right[i] = 3 * (h[i] * secants[i - 1] + h[i - 1] * secants[i])
    slopes = np.linalg.solve(matrix, right)
    return np.concatenate([slopes, slopes[:1]])


def _cubics(knots: np.ndarray, values: np.ndarray, slopes: np.ndarray | None) -> np.ndarray:
    """(spans, 4, joints) The cubics with these slopes at the knots, or straight lines."""
    h = np.diff(knots)[:, None]
    secant = np.diff(values, axis=0) / h
    if slopes is None:
        return np.stack([values[:-1], secant, 0 * secant, 0 * secant], axis=1)
    first, second = slopes[:-1], slopes[1:]
    quadratic = (3 * secant - 2 * first - second) / h
    return np.stack([values[:-1], first, quadratic, (first + second - 2 * secant) / h**2], axis=1)
