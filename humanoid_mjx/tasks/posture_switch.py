"""Switch the legs from one posture to another (thesis sections 6.4 and 7 H): Q-learning decides, computed torque acts.

There are two rates, like those of a master and its joint controllers. Every `period` the learner chooses for the hip
pitch, the knee and the ankle to go a place up, to stay, or to go a place down, on a grid from start to goal; every time
step of the physics a control law, by default computed torque, drives both legs to the set-point. The left leg takes the
opposite values (6.4). The learner knows the joints only by the encoders of the right leg.
"""

from typing import Any, ClassVar, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key
from pydantic import Field, model_validator

from humanoid_mjx.control import Control, at_rest
from humanoid_mjx.control.laws import ComputedTorqueLaw
from humanoid_mjx.physics import kept_physics
from humanoid_mjx.physics.base import Controller, Physics, World
from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.finite import FiniteTask
from humanoid_mjx.thesis import leg as leg_thesis
from humanoid_mjx.thesis import q_learning as thesis
from humanoid_mjx.types import BoolScalar, FloatScalar, IntScalar

MOVED = (0, 3, 4)
"""Hip pitch, knee and ankle among the joints of a leg."""

LEFT_SIGN = -1.0
"""The left leg takes the right's values with the opposite sign."""

REST = 0.2
"""Largest speed of the moved joints of a body at rest, rad/s."""


class Body(NamedTuple):
    """The state of a robot between two decisions."""

    world: World
    encoders: Float[Array, "3"]
    """Readings of the right hip pitch, knee and ankle, rad."""
    diverged: IntScalar
    """Number of times that the simulation broke down in this episode, or the body fell, and was started anew."""
    rising: Any = None
    """Boolean scalar: true on the way back, in tasks that have one."""


class PostureSwitch(FiniteTask):
    """Bring hip pitch, knee and ankle of both legs from start to goal, all within `tolerance` and at rest.

    A decision costs `step_reward`, the goal earns `bonus`.
    """

    num_actions: ClassVar[int] = 3 ** len(MOVED)
    observation_size: ClassVar[int] = len(MOVED)
    action_bins: ClassVar[tuple[int, ...]] = (3,) * len(MOVED)

    physics: str = Field("chain", description="chain, mjx-jax, mjx-warp, mujoco, or your own as package.module:Class")
    control: Control = Field(ComputedTorqueLaw(), description="the law that drives the joints to their set-points")
    posture: Literal["6.4", "7H"] = Field("6.4", description="the section that gives start and goal")
    places: int = Field(5, ge=2, le=50, description="points of the grid from start to goal, for each joint")
    period: float = Field(0.2, gt=0, le=10, description="s between decisions")
    timestep: float = Field(0.005, gt=0, le=0.02, description="s of physics and controller")
    mass: float = traced(1.0, gt=0, le=10, description="of the robot, as a multiple of its own in the thesis")
    encoder_noise: float = traced(0.0, ge=0, le=90, description="standard deviation, degrees")
    tolerance: float = traced(2.0, gt=0, le=90, description="largest error that succeeds, degrees")
    step_reward: float = traced(-1.0, description="reward of every step")
    bonus: float = traced(100.0, description="reward for reaching the goal")
    max_episode_steps: int = traced(60, ge=1, le=10_000_000, description="steps after which an episode is truncated")

    @model_validator(mode="after")
    def _period_must_fit(self) -> "PostureSwitch":
        self.simulator.substeps(self.period)
        return self

    @property
    def num_states(self) -> int:
        return self.places ** len(MOVED)

    @property
    def simulator(self) -> Physics:
        """The physics that moves the legs."""
        return kept_physics(self.physics, robot="legs", timestep=self.timestep)

    @property
    def grid(self) -> Float[np.ndarray, "3 places"]:
        """The places of each moved joint from start to goal, rad."""
        start, goal = thesis.POSTURES[self.posture]
        return np.radians(np.linspace(start, goal, self.places)).T

    def reset(self, key: Key[Array, ""]) -> Body:
        world = self.plant.start(*self._start)
        return Body(world, self._encoders(world, key), jnp.int32(0))

    def step(self, state: Body, action: IntScalar, key: Key[Array, ""]) -> tuple[Body, FloatScalar, BoolScalar]:
        controller = self.controller(self.setpoint(state, action))
        cycles = self.simulator.substeps(self.period)
        world = self.plant.run(state.world, controller, cycles)
        return self.outcome(state, world, key)

    def outcome(self, state: Body, world: World, key: Key[Array, ""]) -> tuple[Body, FloatScalar, BoolScalar]:
        """The result of `step` where a decision in `state` led to `world`."""
        broken = world.diverged
        world = self.plant.reset(world, broken, *self._start)
        after = Body(world, self._encoders(world, key), state.diverged + broken)
        arrived = ~broken & self.near(world, self.grid[:, -1])
        return after, self.step_reward + jnp.where(arrived, self.bonus, 0.0), arrived

    def state_index(self, state: Body) -> IntScalar:
        places = self._places(state.encoders)
        return jnp.sum(places * self.places ** np.arange(len(MOVED)), dtype=jnp.int32)

    def observe(self, state: Body) -> Float[Array, "3"]:
        """Return the encoders' places between start, 0, and goal, 1."""
        return jnp.clip(self._way(state.encoders), 0.0, 1.0).astype(jnp.float32)

    def drive(self, data: Body, action: Int[Array, "3"]) -> tuple[Physics, Controller]:
        number = jnp.sum(action * 3 ** np.arange(len(MOVED)), dtype=jnp.int32)
        return self.plant, self.controller(self.setpoint(data, number))

    def near(self, world: World, place: Float[np.ndarray, "3"]) -> BoolScalar:
        """Return whether both legs are in a posture, rad, and at rest."""
        legs = self._legs(world)
        near = jnp.abs(legs.qpos - self.whole_body(place)) <= self.tolerance * (np.pi / 180)
        return near.all() & (jnp.abs(legs.qvel) <= REST).all()

    def whole_body(self, moved: Float[Array, "3"] | Float[np.ndarray, "3"]) -> Float[Array, "10"]:
        """The joints of both legs from the three of the right that move, rad."""
        joints = range(len(leg_thesis.JOINT_NAMES))
        right = jnp.stack([moved[MOVED.index(joint)] if joint in MOVED else 0.0 for joint in joints])
        return jnp.concatenate([right, LEFT_SIGN * right])

    def setpoint(self, state: Body, action: IntScalar) -> Float[Array, "10"]:
        """Return the set-points of both legs' joints under `action`, rad."""
        choice = action // 3 ** np.arange(len(MOVED)) % 3 - 1
        target = jnp.clip(self._places(state.encoders) + choice, 0, self.places - 1)
        rows = zip(jnp.asarray(self.grid, float), target, strict=True)
        return self.whole_body(jnp.stack([row[place] for row, place in rows]))

    def controller(self, setpoint: Float[Array, "10"]) -> Controller:
        """The controller that drives both legs towards a posture at rest."""
        return self.control.follow(at_rest(setpoint))

    @property
    def plant(self) -> Physics:
        """The physics with the robot's own mass."""
        return self.simulator.replace(mass=self.mass)

    def _encoders(self, world: World, key: Key[Array, ""]) -> Float[Array, "3"]:
        noise = self.encoder_noise * (np.pi / 180) * jax.random.normal(key, (len(MOVED),))
        qpos = self._legs(world).qpos
        return jnp.stack([qpos[joint] for joint in MOVED]) + noise

    @property
    def _start(self) -> tuple[Float[Array, " nq"], Float[Array, " nv"]]:
        """`qpos` and `qvel` at the start of an episode."""
        qpos = self.whole_body(self.grid[:, 0])
        return qpos, jnp.zeros(len(qpos))

    def _legs(self, world: World) -> World:
        """The world of the legs' joints alone."""
        return world

    def _way(self, encoders: Float[Array, "3"]) -> Float[Array, "3"]:
        """Places of the moved joints: start is 0, goal 1."""
        first, last = self.grid[:, 0], self.grid[:, -1]
        return (encoders - first) / (last - first)

    def _places(self, encoders: Float[Array, "3"]) -> Int[Array, "3"]:
        """The nearest place of each moved joint."""
        return jnp.clip(jnp.round(self._way(encoders) * (self.places - 1)), 0, self.places - 1).astype(jnp.int32)
