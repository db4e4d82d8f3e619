"""Quintic trajectories between two states of motion (section 4.7)."""

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
        position = _polynomial(self.coefficients, t)
        velocity = _polynomial(_derivative(self.coefficients), t)
        acceleration = _polynomial(_derivative(_derivative(self.coefficients)), t)
        return Motion(position, jnp.where(inside, velocity, 0.0), jnp.where(inside, acceleration, 0.0))


def quintic(start: Motion, end: Motion, duration: FloatScalar) -> Quintic:
    """The polynomials that lead from one state of motion to another in `duration`, s, which is positive."""
    time = duration
    base = jnp.stack([start.position, start.velocity, start.acceleration / 2])
    left = jnp.stack(
        [
            end.position - _polynomial(base, time),
            (end.velocity - _polynomial(_derivative(base), time)) * time,
            (end.acceleration - _polynomial(_derivative(_derivative(base)), time)) * time**2,
        ]
    )
    # What is left at the end for t^3 to t^5 to make up, and the inverse of their values and derivatives there.
    solve = jnp.array([[10.0, -4.0, 0.5], [-15.0, 7.0, -1.0], [6.0, -3.0, 0.5]], left.dtype)
    high = jnp.tensordot(solve, left, axes=1, precision="highest")
    powers = jnp.stack([jnp.asarray(time, left.dtype) ** k for k in (3, 4, 5)])
    return Quintic(jnp.concatenate([base, high / powers.reshape((3,) + (1,) * (left.ndim - 1))]), time)


def rest_to_rest(start: Any, end: Any, duration: FloatScalar) -> Quintic:
    """The polynomials between two postures, rad, with no velocity and no acceleration at either end."""
    start, end = jnp.asarray(start, float), jnp.asarray(end, float)
    still = jnp.zeros_like(start)
    return quintic(Motion(start, still, still), Motion(end, still, still), duration)


def thesis_quintics() -> Quintic:
    """The planned trajectories of the five joints, equations 4.35 to 4.39, rad and s."""
    start, end = np.radians(thesis.QUINTIC_RANGES).T
    return rest_to_rest(start, end, thesis.QUINTIC_S)


def _polynomial(coefficients: Array, t: FloatScalar) -> Array:
    value = coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        value = value * t + coefficient
    return value


def _derivative(coefficients: Array) -> Array:
    powers = jnp.arange(1, len(coefficients), dtype=coefficients.dtype)
    return coefficients[1:] * powers.reshape((-1,) + (1,) * (coefficients.ndim - 1))
