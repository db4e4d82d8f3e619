"""The body of a legged task: a robot in a physics, its posture, its joints' law, the values of its world."""

from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pydantic
from jaxtyping import Array, Float, Key
from pydantic import Field, model_validator

from humanoid_mjx.control import Control, at_rest
from humanoid_mjx.control.drives import Drives, Ideal
from humanoid_mjx.control.laws import RobotServoLaw, ServoLaw
from humanoid_mjx.control.stages import Stages
from humanoid_mjx.mechanics.rotations import leaning_quaternion, product, rotate, unit
from humanoid_mjx.mechanics.terrain import Terrain
from humanoid_mjx.physics import kept_physics
from humanoid_mjx.physics.base import Sensed, World
from humanoid_mjx.physics.model import MujocoPhysics
from humanoid_mjx.robot import Robot, RobotKey, make_robot
from humanoid_mjx.robot.mjcf import TURNED
from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.continuous import ContinuousTask
from humanoid_mjx.types import FloatScalar

START_SPREAD = 0.03
"""Largest difference of every joint and of the torso's lean from the posture at the start, rad."""

SERVO = ServoLaw(stiffness=3.0, damping=0.1)
"""Gains of a servo as soft as gravity, so that posture alone does not keep the body up. With 6 N m/rad and 0.2 N m
s/rad most bodies that do nothing withstand the pushes, and there is little to learn."""

START_AREA = 2.0
"""Largest distance from the origin of the world, along x and along y, at which an episode on a terrain begins, m."""


class Plant(NamedTuple):
    """Values of the world that a body lives in; under randomisation each episode has its own."""

    mass: FloatScalar
    friction: FloatScalar
    joint_damping: FloatScalar
    torque_limit: FloatScalar
    terrain: Terrain | None = None


class LeggedBody(ContinuousTask):
    """The part of legged tasks that concerns the robot; derive from `LeggedTask`."""

    robot: RobotKey = Field(make_robot("lower_body", ranges="human"), description="the robot that stands")
    physics: str = Field("tree", description="tree, mjx-jax, mjx-warp, mujoco, unmodified, or package.module:Class")
    control: Control = Field(SERVO, description="the law that drives the joints")
    actuator: Drives = Field(Ideal(), description="actuator model: ideal or dc_motor")
    bins: Literal[3, 5, 9] = Field(3, description="values of a joint's offset, evenly from -1 to 1 times it")
    action_scale: float = traced(
        20.0, gt=0, le=90, description="largest offset of a set-point from the posture, degrees"
    )
    action_shares: tuple[float, ...] = traced(
        (), strict=False, description="factors on action_scale by kind of joint; empty: 1"
    )
    smoothing: float = traced(
        0.0, ge=0, lt=1, description="exponential smoothing of the offsets: weight of the last one"
    )
    period: float = Field(0.02, gt=0, le=1, description="s between decisions")
    timestep: float = Field(0.004, ge=1e-6, le=0.02, description="s of physics and control law")
    mass: float = traced(1.0, gt=0, le=10, description="factor on links' mass and inertia; contacts stay as soft")
    friction: float = traced(
        1.0, ge=0, le=10, description="factor on that of the feet on the ground; below 0.05 float32 misses contacts"
    )
    joint_damping: float = traced(1.0, ge=0, le=100, description="factor on that of the joints")
    torque_limit: float = traced(1.0, gt=0, le=1000, description="factor on that of each motor")

    @model_validator(mode="before")
    @classmethod
    def _a_robot_brings_its_servo(cls, data: Any) -> Any:
        """A robot that has a servo of its own is driven by it, unless another law is asked for."""
        written = isinstance(data, dict) and isinstance(data.get("robot"), (str, dict, Robot))
        if written and "control" not in data:
            robot = pydantic.TypeAdapter(RobotKey).validate_python(data["robot"])
            data = data | {"robot": robot} | ({"control": RobotServoLaw()} if robot.servo else {})
        return data

    @model_validator(mode="after")
    def _period_must_fit(self) -> "LeggedBody":
        self.simulator.substeps(self.period)
        self.control.of(self.robot)
        self.actuator.check(self.robot, self.timestep)
        if not self.simulator.free:
            raise ValueError("robot: this one hangs from its base; name one that stands, such as lower_body")
        if np.linalg.norm(self.simulator.qpos0[4:7]) > TURNED:
            raise ValueError("robot: the frame of the free body must be upright, x forward; turn the bodies below it")
        if self.action_shares and len(self.action_shares) != len(set(self.robot.kinds.tolist())):
            raise ValueError(f"action_shares must hold one number for each kind of joint, got {self.action_shares}")
        return self

    @property
    def shares(self) -> tuple[FloatScalar, ...]:
        """Shares of the offset by kind of joint; none: all 1."""
        return self.action_shares

    @property
    def action_bins(self) -> tuple[int, ...]:
        return (self.bins,) * len(self.robot.joints)

    @property
    def simulator(self) -> MujocoPhysics:
        """The physics of the body, with the robot's own values."""
        return kept_physics(self.physics, MujocoPhysics, robot=self.robot, timestep=self.timestep)

    @property
    def plant(self) -> Plant:
        """The values of the world as the task declares them."""
        return Plant(self.mass, self.friction, self.joint_damping, self.torque_limit)

    def start(self, keys: Key[Array, "3"]) -> World:
        """The body at rest near its posture, in any direction, about to touch the ground."""
        spread = START_SPREAD * jax.random.uniform(keys[0], self.robot.posture.shape, minval=-1.0)
        lean = START_SPREAD * jax.random.uniform(keys[1], (2,), minval=-1.0)
        heading = jax.random.uniform(keys[2], (), maxval=2 * np.pi)
        place = jnp.zeros(3).at[2].set(self.robot.start_height)
        free = jnp.concatenate([place, leaning_quaternion(heading, lean)])
        qpos = jnp.asarray(self.simulator.qpos0, float).at[:7].set(free)
        qpos = qpos.at[self.simulator.joint_qpos].set(self.robot.posture + spread)
        return self.simulator.start(qpos, jnp.zeros(self.robot.model.nv))

    def on_terrain(self, world: World, terrain: Terrain, key: Key[Array, ""]) -> World:
        """A world of `start` somewhere on this terrain: upright, a foot about to touch the ground."""
        up, margin = terrain.up(), self.robot.start_height + self.robot.soles[:, 2].min()
        turned = product(unit(jnp.stack([1.0 + up[2], -up[1], up[0], 0.0 * up[0]])), world.qpos[3:7])
        place = jax.random.uniform(key, (3,), minval=-START_AREA, maxval=START_AREA).at[2].set(0.0)
        soles = place + jax.vmap(lambda sole: rotate(turned, sole))(jnp.asarray(self.robot.soles, float))
        place = place.at[2].set(margin - terrain.above(soles).min())
        return world._replace(qpos=world.qpos.at[:7].set(jnp.concatenate([place, turned])))

    def setpoint(
        self, offsets: Float[Array, " joints"], reference: Float[Array, " joints"] | float = 0.0
    ) -> Float[Array, " joints"]:
        """Return the set-points of the joints, rad: the posture, a motion about it and the learner's offsets, within
        the limits of the robot's actuators."""
        setpoint = self.moved(offsets) + (reference + self.robot.posture)
        limits = self.robot.setpoint_limits
        return jnp.clip(setpoint, *limits.astype(np.float32)) if np.isfinite(limits).any() else setpoint

    def moved(self, offsets: Float[Array, " joints"]) -> Float[Array, " joints"]:
        """Return by how much offsets from -1 to 1 move the set-points, rad."""
        if self.shares:
            offsets = jnp.stack([jnp.asarray(share, float) for share in self.shares])[self.robot.kinds] * offsets
        return jnp.radians(self.action_scale) * offsets

    def advance(
        self,
        world: World,
        setpoint: Float[Array, " joints"],
        plant: Plant,
        force: Float[Array, "3"],
        watched: bool = False,
    ) -> tuple[World, Sensed]:
        """Carry out one decision while `force`, N, pushes the torso; the control law acts at every time step.

        Returns:
          the world after the decision, and everything sensed at the beginning of its last time step; if `watched`, of
          every time step, on a leading axis.
        """
        values = {"mass": plant.mass, "friction": plant.friction, "torque_limit": plant.torque_limit}
        physics = self.simulator.replace(**values, damping=plant.joint_damping, push=force, setpoint=setpoint)
        physics = physics.replace(terrain=plant.terrain) if plant.terrain else physics
        law = self.control.of(self.robot).follow(at_rest(setpoint))

        def controller(state: Stages) -> Float[Array, " joints"]:
            return self.actuator(law(state), state.qvel)

        cycles = self.simulator.substeps(self.period)
        if not watched:
            return physics.run_sensed(world, controller, cycles)
        return jax.lax.scan(lambda world, _: physics.run_sensed(world, controller, 1), world, length=cycles)
