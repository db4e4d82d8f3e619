"""An episode of a legged task under way, and the attitude that is estimated in it.

The direction of gravity is the gyroscope's, corrected by the accelerometer (R. Mahony et al., "Nonlinear Complementary
Filters on the Special Orthogonal Group", 2008, for that direction alone).
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from humanoid_mjx.mechanics.rotations import heading_frame, rotation_matrix, turned_by, unit
from humanoid_mjx.mechanics.terrain import Terrain
from humanoid_mjx.physics.base import Readings, World
from humanoid_mjx.physics.sensors import Sensors, SensorState
from humanoid_mjx.tasks.legged.body import Plant
from humanoid_mjx.tasks.legged.commands import MAX_HEADING_ERROR, Velocity, moves
from humanoid_mjx.tasks.legged.gait import Clock
from humanoid_mjx.thesis.leg import GRAVITY
from humanoid_mjx.types import FloatScalar, IntScalar

FILTER_GAIN = 0.02
"""The share of the accelerometer in each new estimate of the direction of gravity; the gyroscope gives the rest."""

ERROR_WINDOW_S = 0.4
"""Time constant of `tracking_error`, s: about a gait cycle, within which the body sways."""


class MeanMotion(NamedTuple):
    """Mean motion of the torso in a decision: a moment's rates shake with each set-point and each footfall."""

    velocity: Float[Array, "3"]
    """Of the hips: forward, to the left and up, m/s."""
    turn_rate: FloatScalar
    """About the vertical, to the left, rad/s."""
    spin: Float[Array, "3"]
    """Angular velocity in the torso's frame, rad/s."""
    force: Float[Array, "3"]
    """Acceleration less that of gravity, in the torso's frame, m/s^2."""


def mean_motion(before: World, after: World, period: float, terrain: Terrain | None) -> MeanMotion:
    """Return the mean motion between two worlds that are `period` seconds apart."""
    first, last = before.qpos[3:7], after.qpos[3:7]
    rotation = rotation_matrix(unit(first + jnp.where(first @ last < 0, -last, last)))
    spin = turned_by(first, last) / period
    velocity = heading_frame(rotation) @ (after.qpos[:3] - before.qpos[:3]) / period
    weight = GRAVITY * terrain.up() if terrain else jnp.array([0.0, 0.0, GRAVITY])
    force = (after.qvel[:3] - before.qvel[:3]) / period + weight
    return MeanMotion(velocity, rotation[2] @ spin, spin, rotation.T @ force)


class Episode(NamedTuple):
    """The `data` of a state."""

    world: World
    motion: MeanMotion
    sensors: SensorState
    readings: Readings
    """The last readings of the sensors."""
    rates: Float[Array, " joints"]
    """Change of the encoders since the readings before, rad/s."""
    down: Float[Array, "3"]
    """The estimated direction of gravity in the torso's frame."""
    offsets: Float[Array, " joints"]
    """Offsets of the set-points from the posture, -1 to 1."""
    first_push: FloatScalar
    """s"""
    decisions: IntScalar
    command: Float[Array, "3"]
    """Commanded velocity forward and to the left, m/s, and turn rate to the left, rad/s; 0 in a task without
    commands."""
    heading_error: FloatScalar
    """Commanded less measured heading, rad, positive to the left, since the last change of the commanded turn rate. The
    gyroscope measures it."""
    tracking_error: Float[Array, "3"]
    """Running mean of measured less commanded velocity, forward and to the left, m/s, and turn rate to the left, rad/s;
    0 in a task without commands."""
    clock: Clock
    """State of the gait; at 0 in a task without one."""
    plant: Plant | None
    """Values of this episode's world under randomisation or on a terrain."""
    past: Float[Array, "history size"] | None
    """Observations of the last decisions, the latest first, as on the robot's own sides; None if `history` is 1."""

    @property
    def phase(self) -> Float[Array, "*batch"]:
        """Phase of the gait, 0 to 1."""
        return jnp.asarray(self.clock.phase)

    @property
    def terrain(self) -> Terrain | None:
        """The ground of this episode; None: a level plane."""
        return self.plant.terrain if self.plant else None

    def followed(self, commands: Velocity | None) -> Float[Array, "3"]:
        """The command that the body is to follow now: the one that it was told, its heading held."""
        return commands.held(self.command, self.heading_error) if commands else self.command

    def sense(self, sensors: Sensors, world: World, true: Readings, period: float, key: Key[Array, ""]) -> "Episode":
        """The episode in its new world, `period` seconds later, with the sensors' readings of it."""
        motion = mean_motion(self.world, world, period, self.terrain)
        if sensors.averages:
            true = true._replace(gyroscope=motion.spin, accelerometer=motion.force)
        state, readings = sensors.read(self.sensors, true, key)
        return self.felt(readings, period)._replace(world=world, motion=motion, sensors=state)

    def felt(self, readings: Readings, period: float) -> "Episode":
        """The episode with these readings of the sensors, `period` seconds after the last, and what follows from them:
        `rates` and `down`."""
        rates = (readings.encoders - self.readings.encoders) / period
        turned = self.down + period * jnp.cross(self.down, readings.gyroscope)
        down = unit(unit(turned) - FILTER_GAIN * unit(readings.accelerometer))
        return self._replace(readings=readings, rates=rates, down=down)

    def compared(self, command: Float[Array, "3"], period: float) -> "Episode":
        """Return the episode with `tracking_error` updated after a decision under this command."""
        error = jnp.append(self.motion.velocity[:2], self.motion.turn_rate) - command
        mean = self.tracking_error + min(period / ERROR_WINDOW_S, 1.0) * (error - self.tracking_error)
        return self._replace(tracking_error=mean)

    def under(self, command: Float[Array, "3"], period: float, angle: FloatScalar = 0.0) -> "Episode":
        """Return the episode with the command of the next decision, `period` seconds after the last one.

        While the commanded turn rate stays the same, `heading_error` accumulates commanded less measured rotation. A
        new turn rate or a command to stand resets it. `angle`, rad, is then added.
        """
        turned = -period * (self.down @ self.readings.gyroscope)
        most = jnp.maximum(jnp.abs(self.heading_error), MAX_HEADING_ERROR)
        error = jnp.clip(self.heading_error + period * self.command[2] - turned, -most, most)
        kept = (command[2] == self.command[2]) & moves(command)
        return self._replace(command=command, heading_error=jnp.where(kept, error, 0.0) + angle)
