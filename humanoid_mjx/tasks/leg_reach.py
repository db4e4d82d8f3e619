"""Bring all five joints of a leg from any posture to any other, under a controller with a wrong model.

Every `period` the learner moves the set-point of each joint by a part of `increment`; every time step of the physics a
control law, by default computed torque, drives the leg to it (thesis 5.7, 6.4). Starts and goals are uniform in the
joints' ranges, and each link of the leg weighs up to `model_error` more or less than in the controller's model, so that
gravity keeps the leg away from a set-point that equals the goal.
"""

from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key
from pydantic import Field, model_validator

from humanoid_mjx.control import Control, at_rest
from humanoid_mjx.control.laws import ComputedTorqueLaw
from humanoid_mjx.physics import kept_physics
from humanoid_mjx.physics.base import Controller, Physics, World
from humanoid_mjx.robot import make_robot
from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.continuous import ContinuousTask, State, begin
from humanoid_mjx.types import FloatScalar, IntScalar

REST = 0.1
"""Largest joint speed of a leg at rest, rad/s."""

LEAD = np.radians(20.0)
"""Largest distance of a set-point from its joint, rad."""

SPEED = 5.0
"""Velocity whose observation is 1, rad/s."""

NEAR, FAR = np.radians(5.0), np.radians(40.0)
"""Errors at which the two halves of the reward's first term have dropped to 1 / e, rad."""

OBSERVATIONS = ("error", "near_error", "lead", "velocity", "place")
"""Each joint: the way to the goal as a share of the joint's range, and again with `LEAD` as the unit; the
set-point's lead over the joint; velocity; place in the range."""

TERMS = ("near", "settled")
"""Names of the reward's terms."""


class Body(NamedTuple):
    """An episode under way."""

    world: World
    setpoint: Float[Array, " joints"]
    """rad"""
    goal: Float[Array, " joints"]
    """rad"""
    mass: Float[Array, " joints"]
    """Masses of the links as multiples of those in the controller's model."""
    decisions: IntScalar


class LegReach(ContinuousTask):
    """Reach a posture and stay there until the time is up.

    A step's reward has two terms, each at most one half: `near`, which grows as the joints' errors vanish, and
    `settled`, the share of joints that are within `tolerance` of their goals and at rest. An episode succeeds if all
    joints are so at its end; one whose simulation breaks down terminates with the reward -1.
    """

    physics: str = Field("chain", description="chain, mjx-jax, mujoco, or your own as package.module:Class")
    control: Control = Field(ComputedTorqueLaw(), description="the law that drives the joints to their set-points")
    ranges: Literal["proposed", "human"] = Field("proposed", description="column of Table 3.2")
    bins: Literal[3, 5, 9] = Field(9, description="values of a joint's increment, evenly from -1 to 1 times it")
    increment: float = traced(8.0, gt=0, le=90, description="largest move of a set-point in a decision, degrees")
    period: float = Field(0.1, gt=0, le=10, description="s between decisions")
    timestep: float = Field(0.005, gt=0, le=0.02, description="s of physics and controller")
    duration: float = traced(3.0, gt=0, le=1000, description="s of an episode")
    model_error: float = traced(0.2, ge=0, lt=1, description="largest share by which a link's mass is off")
    tolerance: float = traced(2.0, gt=0, le=90, description="largest error that succeeds, degrees")

    @model_validator(mode="after")
    def _period_must_fit(self) -> "LegReach":
        self.simulator.substeps(self.period)
        return self

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.simulator.joint_names)

    @property
    def observation_size(self) -> int:
        return len(OBSERVATIONS) * self.joints

    @property
    def observation_families(self) -> tuple[tuple[tuple[int, ...], ...], ...]:
        """Families of each joint alone: both errors and the place, each with the lead and the velocity.

        Computed torque removes most coupling between joints.
        """
        own = np.arange(self.observation_size).reshape(-1, self.joints).T.tolist()
        return tuple(
            ((error, lead, velocity), (near_error, lead, velocity), (lead, velocity, place))
            for error, near_error, lead, velocity, place in own
        )

    @property
    def action_bins(self) -> tuple[int, ...]:
        return (self.bins,) * self.joints

    @property
    def simulator(self) -> Physics:
        """Physics of the leg."""
        return kept_physics(self.physics, robot=make_robot("leg", ranges=self.ranges), timestep=self.timestep)

    def reset(self, key: Key[Array, ""]) -> State:
        low, high = self.simulator.robot.ranges_rad.T
        start_key, goal_key, mass_key = jax.random.split(key, 3)
        start, goal = (jax.random.uniform(key, low.shape, minval=low, maxval=high) for key in (start_key, goal_key))
        mass = 1.0 + self.model_error * jax.random.uniform(mass_key, low.shape, minval=-1.0)
        world = self._plant(mass).start(start, jnp.zeros(low.shape))
        body = Body(world, start, goal, mass, jnp.int32(0))
        return begin(body, self.observe(body), TERMS)

    def step(self, state: State, action: Int[Array, " joints"], key: Key[Array, ""]) -> State:
        return self.step_continuous(state, self.as_numbers(action), key)

    def step_continuous(self, state: State, command: Float[Array, " joints"], key: Key[Array, ""]) -> State:
        """A step whose moves are any parts of `increment`, from -1 to 1."""
        body: Body = state.data
        setpoint = self.setpoint_after(body, command)
        cycles = self.simulator.substeps(self.period)
        world = self._plant(body.mass).run(body.world, self.controller(setpoint), cycles)
        body = body._replace(world=world, setpoint=setpoint, decisions=body.decisions + 1)
        terms = self.reward_terms(body)
        broken = world.diverged
        over = body.decisions * self.period >= self.duration - self.period / 2
        obs, reward = self.observe(body), jnp.where(broken, -1.0, sum(terms.values()))
        success = self.settled(body).all() & ~broken
        return State(body, obs, reward, broken, over & ~broken, success, final_obs=obs, metrics=terms)

    def drive(self, data: Body, action: Array) -> tuple[Physics, Controller]:
        return self._plant(data.mass), self.controller(self.setpoint_after(data, self.as_numbers(action)))

    def setpoint_after(self, body: Body, command: Float[Array, " joints"]) -> Float[Array, " joints"]:
        """Return the set-point after moves of `command` times `increment`, rad."""
        qpos = body.world.qpos
        moved = body.setpoint + jnp.radians(self.increment) * jnp.clip(command, -1.0, 1.0)
        low, high = self.simulator.robot.ranges_rad.T
        return jnp.clip(jnp.clip(moved, qpos - LEAD, qpos + LEAD), low - LEAD, high + LEAD)

    def observe(self, body: Body) -> Float[Array, " observation_size"]:
        """`OBSERVATIONS`, of each joint, within -1 to 1."""
        low, high = self.simulator.robot.ranges_rad.T
        qpos, qvel = body.world.qpos, body.world.qvel
        error = body.goal - qpos
        lead = body.setpoint - qpos
        place = (2.0 * qpos - low - high) / (high - low)
        parts = error / (high - low), error / LEAD, lead / LEAD, qvel / SPEED, place
        return jnp.clip(jnp.concatenate(parts), -1.0, 1.0).astype(jnp.float32)

    def reward_terms(self, body: Body) -> dict[str, FloatScalar]:
        """The parts of the reward by name."""
        error = jnp.abs(body.goal - body.world.qpos)
        near = 0.25 * jnp.exp(-error / NEAR) + 0.25 * jnp.exp(-error / FAR)
        terms = near.mean(), 0.5 * self.settled(body).mean()
        return {name: jnp.asarray(term, jnp.float32) for name, term in zip(TERMS, terms, strict=True)}

    def settled(self, body: Body) -> Bool[Array, " joints"]:
        """Mask of the joints that are at their goals and at rest."""
        near = jnp.abs(body.goal - body.world.qpos) <= jnp.radians(self.tolerance)
        return near & (jnp.abs(body.world.qvel) <= REST)

    def controller(self, setpoint: Float[Array, " joints"]) -> Controller:
        """The controller that drives the leg towards a posture at rest; its model does not have the leg's mass
        factors."""
        return self.control.follow(at_rest(setpoint))

    def _plant(self, mass: Float[Array, " joints"]) -> Physics:
        """The physics with the leg's own masses."""
        return self.simulator.replace(mass=mass)
