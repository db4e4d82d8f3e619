"""The gaits of Tables 4.5 and 4.6 as periodic motions of both legs."""

from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.interpolate import CubicSpline

from humanoid_mjx.mechanics.trajectories import Motion
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


def gait(name: str, kind: Literal["spline", "linear"] = "spline") -> Gait:
    """The gait `straight_walk` (Table 4.5) or `sudden_turn` (Table 4.6), as a spline, twice continuously differentiable
    through the table's points, or linear between them."""
    knots, angles = np.array(thesis.GAIT_TIMES_S), np.zeros((len(thesis.GAIT_TIMES_S), 5))
    for joint, degrees in TABLES[name].items():
        angles[:, thesis.JOINT_NAMES.index(joint)] = np.radians(degrees)
    coefficients = np.zeros((4, len(knots) - 1, 5))
    if kind == "spline":
        coefficients[:] = CubicSpline(knots, angles, bc_type="periodic").c[::-1]
    else:
        coefficients[:2] = angles[:-1], np.diff(angles, axis=0) / np.diff(knots)[:, None]
    return Gait(jnp.array(knots), jnp.array(coefficients.swapaxes(0, 1)))
