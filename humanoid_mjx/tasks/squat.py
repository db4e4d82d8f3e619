"""Upright, down and up again: the thesis's last experiment with both feet on the ground and the torso free.

As in `posture_switch`, Q-learning decides where hip pitch, knee and ankle go, and a control law drives the joints
there; here both legs do the same, and the law keeps within what the contacts of the feet allow.
"""

from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key
from pydantic import Field

from humanoid_mjx.control import Control
from humanoid_mjx.control.laws import GroundedLaw
from humanoid_mjx.mechanics.rotations import rotation_matrix
from humanoid_mjx.physics import kept_physics
from humanoid_mjx.physics.base import World
from humanoid_mjx.physics.model import MujocoPhysics
from humanoid_mjx.robot import make_robot
from humanoid_mjx.robot.lower_body import SHORTENED
from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.posture_switch import MOVED, Body, PostureSwitch
from humanoid_mjx.thesis.leg import JOINT_NAMES
from humanoid_mjx.types import BoolScalar, FloatScalar, IntScalar

FALLEN_TILT, FALLEN_HEIGHT = 45.0, 0.6
"""Lean of the torso, degrees, and height of the hips as a share of the leg's length, at which a body has fallen."""


class Squat(PostureSwitch):
    """Go from upright to the lowest posture and back, both within `tolerance` and at rest, on both feet.

    A decision costs `step_reward`, standing upright again earns `bonus` and ends the episode. A body that falls costs
    `fall_reward` and begins anew.
    """

    physics: str = Field("tree", description="tree, mjx-jax, mjx-warp, mujoco, or your own as package.module:Class")
    control: Control = GroundedLaw(natural_frequency=20.0)
    posture: Literal["squat"] = Field("squat", description="upright, down and up again")
    places: int = Field(3, ge=2, le=50, description="points of the grid from upright to down, for each joint")
    timestep: float = Field(0.004, gt=0, le=0.02, description="s of physics and controller")
    fall_reward: float = traced(-2.0, le=0, description="reward of a fall; where it is large, networks learn to stay")

    @property
    def num_states(self) -> int:
        return 2 * super().num_states

    @property
    def simulator(self) -> MujocoPhysics:
        return kept_physics(self.physics, MujocoPhysics, robot=ROBOT, timestep=self.timestep)

    @property
    def grid(self) -> Float[np.ndarray, "3 places"]:
        return np.linspace(np.zeros(len(MOVED)), DOWN, self.places).T

    def reset(self, key: Key[Array, ""]) -> Body:
        return super().reset(key)._replace(rising=jnp.bool_(False))

    def outcome(self, state: Body, world: World, key: Key[Array, ""]) -> tuple[Body, FloatScalar, BoolScalar]:
        fell = world.diverged | self.fallen(world)
        world = self.plant.reset(world, fell, *self._start)
        down, upright = (self.near(world, self.grid[:, end]) for end in (-1, 0))
        done = ~fell & state.rising & upright
        reward = self.step_reward + jnp.where(fell, self.fall_reward, 0.0) + jnp.where(done, self.bonus, 0.0)
        after = Body(world, self._encoders(world, key), state.diverged + fell, ~fell & (state.rising | down))
        return after, reward, done

    def state_index(self, state: Body) -> IntScalar:
        return super().state_index(state) + super().num_states * state.rising

    @property
    def observation_size(self) -> int:
        return len(MOVED) + 1

    def observe(self, state: Body) -> Float[Array, "4"]:
        """Return the encoders' places between upright, 0, and down, 1, and 1 while the body rises."""
        return jnp.append(super().observe(state), state.rising)

    def fallen(self, world: World) -> BoolScalar:
        """True if the torso leans too far or the hips are too low."""
        upright = rotation_matrix(world.qpos[3:7])[2, 2]
        return (upright < np.cos(np.radians(FALLEN_TILT))) | (world.qpos[2] < FALLEN_HEIGHT * ROBOT.leg_length)

    def whole_body(self, moved: Float[Array, "3"] | Float[np.ndarray, "3"]) -> Float[Array, "10"]:
        """The joints of both legs from the three of either that move, rad."""
        legs = jnp.zeros((2, len(JOINT_NAMES))).at[:, jnp.array(MOVED)].set(moved)
        return legs.reshape(-1)

    @property
    def _start(self) -> tuple[Float[Array, " nq"], Float[Array, " nv"]]:
        return jnp.asarray(self.simulator.qpos0, float), jnp.zeros(self.simulator.model.nv)

    def _legs(self, world: World) -> World:
        qpos, qvel = self.simulator.joint_qpos, self.simulator.joint_dofs
        return world._replace(qpos=world.qpos[qpos], qvel=world.qvel[qvel])


ROBOT = make_robot("lower_body", ranges="human")

DOWN = -ROBOT.ranges_rad[JOINT_NAMES.index("ankle_pitch"), 0] * SHORTENED[list(MOVED)]
"""Hip pitch, knee and ankle of the lowest posture, rad: the soles stay flat below an upright torso, and the ankle is at
the end of its range. The hips are 11 mm lower."""
