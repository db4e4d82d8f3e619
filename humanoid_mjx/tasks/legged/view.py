"""The view that observations, rewards and terminations are functions of: the body as it is and as it appears."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from humanoid_mjx.mechanics.rotations import rotation_matrix
from humanoid_mjx.mechanics.terrain import Terrain
from humanoid_mjx.physics.base import Sensed
from humanoid_mjx.robot import Robot
from humanoid_mjx.tasks.legged.commands import Velocity
from humanoid_mjx.tasks.legged.episode import Episode
from humanoid_mjx.tasks.legged.gait import Gait, steps_under
from humanoid_mjx.types import BoolScalar, FloatScalar

TOUCHING = 0.006
"""Force on a corner from which it counts as touching, as a share of the weight."""


class Feet(NamedTuple):
    """The feet in the robot's order, in the world. Before the first step of an episode everything is 0, including the
    contacts."""

    robot: Robot
    position: Float[Array, "feet 3"]
    """Positions of the ankles, m."""
    velocity: Float[Array, "feet 3"]
    """m/s"""
    rotation: Float[Array, "feet 3 3"]
    corners: Float[Array, "feet corners 3"]
    """The lowest points of the soles' corners, m."""
    corner_velocity: Float[Array, "feet corners 3"]
    """m/s"""
    corner_force: Float[Array, "feet corners"]
    """Force with which the ground pushes each corner up, N."""
    terrain: Terrain | None = None

    @property
    def height(self) -> Float[Array, " feet"]:
        """Height of each foot's lowest corner above the ground, m."""
        return (self.terrain.above(self.corners) if self.terrain else self.corners[..., 2]).min(axis=-1)

    @property
    def load(self) -> Float[Array, " feet"]:
        """Force with which the ground pushes each foot up, N."""
        return self.corner_force.sum(axis=-1)

    @property
    def touching(self) -> Bool[Array, "feet corners"]:
        """Mask of the corners that touch the ground."""
        return self.corner_force > self.robot.force(TOUCHING)


def feet_of(sensed: Sensed, body_names: tuple[str, ...], robot: Robot, terrain: Terrain | None) -> Feet:
    """Pick the feet out of all bodies."""
    rows = np.array([body_names.index(foot) for foot in robot.feet])
    bodies = sensed.poses.position[rows], sensed.velocities.linear[rows], sensed.poses.rotation[rows]
    corners = [part.reshape(len(robot.feet), robot.points, *part.shape[1:]) for part in sensed.contacts]
    return Feet(robot, *bodies, *corners, terrain=terrain)


def unknown_feet(robot: Robot, terrain: Terrain | None = None) -> Feet:
    """The feet before the first step: all 0."""
    feet = len(robot.feet)
    each, corners = jnp.zeros((feet, 3)), jnp.zeros((feet, robot.points, 3))
    return Feet(robot, each, each, jnp.zeros((feet, 3, 3)), corners, corners, corners[..., 0], terrain)


class View(NamedTuple):
    """One moment of an episode."""

    robot: Robot
    commands: Velocity | None
    gait: Gait | None
    episode: Episode
    """The true state of the world, the readings of the sensors, and what the task remembers."""
    feet: Feet
    """The true state of the feet at the beginning of the last time step."""
    torque: Float[Array, " joints"]
    """Torques that acted in the last time step, N m."""
    last_offsets: Float[Array, " joints"]
    """Offsets of the decision before."""

    @property
    def command(self) -> Float[Array, "3"]:
        """Velocity forward and to the left, m/s, and turn rate to the left, rad/s, that the body is to follow."""
        return self.episode.followed(self.commands)

    @property
    def moving(self) -> BoolScalar:
        """True if the feet are to step."""
        return steps_under(self.episode.command, self.robot)

    @property
    def swing(self) -> Float[Array, " feet"]:
        """Commanded height of each foot as a share of the largest, 0 to 1, by the gait's clock; 0 in stance."""
        if self.gait is None:
            return jnp.zeros(len(self.robot.feet))
        return self.gait.swing(self.episode.phase, self.robot) * self.moving

    @property
    def rotation(self) -> Float[Array, "3 3"]:
        """From the torso's frame to the world."""
        return rotation_matrix(self.episode.world.qpos[3:7])

    @property
    def up(self) -> Float[Array, "3"]:
        """The direction against gravity in the torso's frame."""
        return self.episode.terrain.up() @ self.rotation if self.episode.terrain else self.rotation[2]

    @property
    def lean(self) -> FloatScalar:
        """Lean of the torso from upright, rad."""
        return jnp.arccos(jnp.clip(self.up[2], -1.0, 1.0))

    @property
    def height(self) -> FloatScalar:
        """Height of the hips above the ground, m."""
        hips, terrain = self.episode.world.qpos[:3], self.episode.terrain
        return terrain.above(hips) if terrain else hips[2]

    @property
    def velocity(self) -> Float[Array, "3"]:
        """Mean velocity of the hips in the last decision: forward, to the left and up, m/s."""
        return self.episode.motion.velocity

    @property
    def turn_rate(self) -> FloatScalar:
        """Mean turn rate of the torso about the vertical in the last decision, to the left, rad/s."""
        return self.episode.motion.turn_rate
