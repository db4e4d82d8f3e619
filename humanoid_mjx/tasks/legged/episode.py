"""An episode of a legged task under way, and the attitude that is estimated in it.

The direction of gravity is the gyroscope's, corrected by the accelerometer (R. Mahony et al., "Nonlinear Complementary
Filters on the Special Orthogonal Group", 2008, for that direction alone).
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from humanoid_mjx.mechanics.rotations import unit
from humanoid_mjx.physics.base import Readings, World
from humanoid_mjx.physics.sensors import Sensors, SensorState
from humanoid_mjx.tasks.legged.body import Plant
from humanoid_mjx.types import FloatScalar, IntScalar

FILTER_GAIN = 0.02
"""The share of the accelerometer in each new estimate of the direction of gravity; the gyroscope gives the rest."""


class Episode(NamedTuple):
    """The `data` of a state."""

    world: World
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
    phase: FloatScalar
    """Phase of the gait; 0 in a task without one."""
    plant: Plant | None
    """Values of this episode's world under randomisation."""

    def sense(self, sensors: Sensors, world: World, true: Readings, period: float, key: Key[Array, ""]) -> "Episode":
        """The episode in its new world, `period` seconds later, with the sensors' readings of it."""
        state, readings = sensors.read(self.sensors, true, key)
        rates = (readings.encoders - self.readings.encoders) / period
        turned = self.down + period * jnp.cross(self.down, readings.gyroscope)
        down = unit(unit(turned) - FILTER_GAIN * unit(readings.accelerometer))
        return self._replace(world=world, sensors=state, readings=readings, rates=rates, down=down)
