"""Quintic trajectories between two postures (section 4.7)."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from humanoid_mjx.thesis import leg as thesis
from humanoid_mjx.types import FloatScalar


class Motion(NamedTuple):
    """Joint angles and their first two derivatives at one time: rad, rad/s, rad/s^2; any shape, all the same."""

    position: Array
    velocity: Array
    acceleration: Array


class Quintic(NamedTuple):
    """A polynomial of fifth order in time for every joint, from time 0 to `duration`."""

    coefficients: Float[Array, "6 ..."]
    """Coefficients of t^0 to t^5 for each joint, rad and s."""
    duration: FloatScalar
    """s"""

    def at(self, t: FloatScalar) -> Motion:
        """The motion at time t, s. Before the start and after the end the joints rest where they start and end."""
        inside = (t >= 0) & (t <= self.duration)
        t = jnp.clip(t, 0.0, self.duration)
        position = jnp.polyval(self.coefficients[::-1], t)
        velocity = jnp.polyval(_derivative(self.coefficients)[::-1], t)
        acceleration = jnp.polyval(_derivative(_derivative(self.coefficients))[::-1], t)
        return Motion(position, jnp.where(inside, velocity, 0.0), jnp.where(inside, acceleration, 0.0))


def rest_to_rest(start: Any, end: Any, duration: FloatScalar) -> Quintic:
    """The polynomials between two postures, rad, with no velocity and no acceleration at either end, in `duration`, s,
    which is positive."""
    start, end = jnp.asarray(start, float), jnp.asarray(end, float)
    still, time = jnp.zeros_like(start), jnp.asarray(duration, start.dtype)
    high = [factor * (end - start) / time**power for power, factor in ((3, 10.0), (4, -15.0), (5, 6.0))]
    return Quintic(jnp.stack([start, still, still, *high]), duration)


def thesis_quintics() -> Quintic:
    """The planned trajectories of the five joints, equations 4.35 to 4.39, rad and s."""
    start, end = np.radians(thesis.QUINTIC_RANGES).T
    return rest_to_rest(start, end, thesis.QUINTIC_S)


def _derivative(coefficients: Array) -> Array:
    powers = jnp.arange(1, len(coefficients), dtype=coefficients.dtype)
    return coefficients[1:] * powers.reshape((-1,) + (1,) * (coefficients.ndim - 1))
