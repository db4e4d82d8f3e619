"""Commands to a walking body."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from humanoid_mjx.spec import Spec, traced
from humanoid_mjx.types import BoolScalar, FloatScalar

Range = tuple[float, float]

MAX_HEADING_ERROR = 0.5
"""Largest heading error that accumulates, rad: a body that cannot follow a turn need not make up for it later."""

MAX_CORRECTION = 1.0
"""Largest correction of the turn rate for a heading error, rad/s."""


def moves(command: Float[Array, "3"]) -> BoolScalar:
    """Return whether a command is to move, and not to stand."""
    return (command != 0).any()


class Velocity(Spec):
    """A velocity and a turn rate, or a heading to turn to at once, uniform in ranges, drawn anew from time to time.

    Each part of a command is 0 in a share of the cases, and all of it in another. A range of one value is that value:
    `forward: [0.3, 0.3]`.
    """

    forward: Range = traced((0.0, 0.5), strict=False, description="range of the speed, m/s")
    sideways: Range = traced((-0.1, 0.1), strict=False, description="range of the speed to the left, m/s")
    turn: Range = traced((-1.0, 1.0), strict=False, description="range of the turn rate to the left, rad/s")
    standing: float = traced(0.1, ge=0, le=1, description="probability of a command to stand still")
    zero: float = traced(0.2, ge=0, le=1, description="probability that a part is 0, for each part independently")
    every: float = traced(4.0, gt=0, description="mean time between commands, s")
    sudden: float = traced(0.0, ge=0, le=1, description="probability of a command to turn at once by an angle")
    angle: Range = traced((-60.0, 60.0), strict=False, description="range of sudden turns to the left, degrees")
    heading_gain: float = traced(0.0, ge=0, le=20, description="turn rate for an error of the heading, 1/s")

    def draw(self, key: Key[Array, ""]) -> Float[Array, "3"]:
        """A command: forward, to the left, turn to the left."""
        value_key, part_key, stand_key = jax.random.split(key, 3)
        low, high = self.ranges.T
        command = low + (high - low) * jax.random.uniform(value_key, (3,))
        command = jnp.where(jax.random.uniform(part_key, (3,)) < self.zero, 0.0, command)
        return jnp.where(jax.random.uniform(stand_key) < self.standing, 0.0, command)

    def following(
        self, command: Float[Array, "3"], key: Key[Array, ""], period: FloatScalar
    ) -> tuple[Float[Array, "3"], FloatScalar]:
        """Return the command after `period` seconds, mostly the same, and the angle of a sudden turn, rad, mostly 0."""
        when_key, key = jax.random.split(key)
        anew = jax.random.uniform(when_key) < period / self.every
        sudden_key, angle_key = jax.random.split(jax.random.fold_in(key, 1))
        sudden = jax.random.uniform(sudden_key) < self.sudden
        drawn = self.draw(key)
        ahead = drawn.at[2].set(0.0)
        low, high = jnp.radians(jnp.stack([jnp.asarray(bound, float) for bound in self.angle]))
        angle = low + (high - low) * jax.random.uniform(angle_key)
        angle = jnp.where(anew & sudden & moves(ahead), angle, 0.0)
        return jnp.where(anew, jnp.where(sudden, ahead, drawn), command), angle

    def held(self, command: Float[Array, "3"], heading_error: FloatScalar) -> Float[Array, "3"]:
        """Return the command with its turn rate corrected for the heading error; a command to stand is unchanged."""
        rate = command[2] + jnp.clip(self.heading_gain * heading_error, -MAX_CORRECTION, MAX_CORRECTION)
        return jnp.where(moves(command), command.at[2].set(rate), command)

    @property
    def ranges(self) -> Float[Array, "3 2"]:
        """Lowest and highest of each part."""
        parts = self.forward, self.sideways, self.turn
        return jnp.stack([jnp.asarray(bound, float) for part in parts for bound in part]).reshape(3, 2)
