"""Keep standing on the ground while pushed, from what the sensors say.

Every `period` the learner chooses how far each joint's set-point is from the standing posture's; every time step of the
physics a servo drives the joint to it. From time to time the torso is pushed from a random side. With `observe:
sensors` the learner sees encoders, gyroscope, accelerometer and foot contacts, and an attitude estimated from them (R.
Mahony et al., "Nonlinear Complementary Filters on the Special Orthogonal Group", 2008, for the direction of gravity
alone); with `privileged` also how the torso really lies and moves. What the difference costs is the price of partial
observation.
"""

from functools import lru_cache
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key
from pydantic import Field, model_validator

from humanoid_mjx.physics import make_physics
from humanoid_mjx.physics.base import Physics, Readings, Stages, World
from humanoid_mjx.physics.sensors import Sensors, SensorState
from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.continuous import ContinuousTask, State, begin
from humanoid_mjx.thesis.leg import GRAVITY
from humanoid_mjx.types import BoolScalar, FloatScalar, IntScalar

JOINTS = 10

POSTURE = np.radians([15.0, 0.0, 0.0, 30.0, -15.0] * 2)
"""rad. Knees bent a little, so that legs can give way and stretch; the feet are flat under the hips."""

STIFFNESS, DAMPING = 3.0, 0.1
"""Of the servo, N m/rad and N m s/rad: as soft as gravity, so that posture alone does not keep the body up. With 6 N m/
rad and 0.2 N m s/rad most bodies that do nothing withstand the pushes of 0.2 N s, and there is little to learn."""

FALLEN_TILT, FALLEN_HEIGHT = np.radians(45.0), 0.13
"""A body has fallen whose torso leans farther, or whose hips are lower than so many metres."""

UPRIGHT, STILL = np.radians(10.0), 0.2
"""rad and m/s: the lean and the speed at which parts of the reward have dropped to 1 / e."""

FILTER_GAIN = 0.02
"""The share of the accelerometer in each new estimate of the direction of gravity; the gyroscope gives the rest."""

SPEED, TURN, FORCE = 5.0, 3.0, 10.0
"""rad/s of a joint, rad/s of the torso, N on a foot: where an observation is 1."""

START_HEIGHT, START_SPREAD = 0.210, 0.03
"""m of the hips above the ground, a few millimetres above what the posture has; rad, by which every joint and the
torso's lean differ from it at most."""

OBSERVATIONS = {"encoders": 10, "rates": 10, "gyroscope": 3, "accelerometer": 3, "down": 3, "contact": 2, "offsets": 10}
"""And how many numbers each is: encoders about the posture, their rates of change, the torso's gyroscope and
accelerometer, the direction of gravity as estimated, foot contacts, the set-points' offsets."""

PRIVILEGED = {"true_down": 3, "velocity": 3, "height": 1}
"""Direction of gravity and velocity in the torso's frame, height of the hips."""

TERMS = ("alive", "upright", "still", "calm")
"""Of the reward."""


class Body(NamedTuple):
    """An episode under way."""

    world: World
    sensors: SensorState
    readings: Readings
    """The last."""
    rates: Float[Array, " joints"]
    """Change of the encoders since the readings before, rad/s."""
    down: Float[Array, "3"]
    """The estimated direction of gravity in the torso's frame."""
    offsets: Float[Array, " joints"]
    """Of the set-points from the posture, -1 to 1."""
    first_push: FloatScalar
    """s"""
    decisions: IntScalar


class Stand(ContinuousTask):
    """Keep the torso upright for `duration` seconds.

    A step earns `alive` 0.4, and up to 0.3 for an `upright` torso, 0.2 for one that is `still`, 0.1 for `calm`
    set-points near the posture. A body that falls, or whose simulation breaks down, terminates with the reward 0. An
    episode succeeds if it lasts to its end.
    """

    physics: Literal["mjx-jax", "mjx-warp", "mujoco"] = "mjx-jax"
    observe: Literal["sensors", "privileged"] = "sensors"
    sensors: Sensors = Field(Sensors.model_validate({}), description="errors of the sensors")
    choices: Literal[3, 5, 9] = Field(3, description="values of a joint's offset, evenly from -1 to 1 times it")
    offset: float = traced(20.0, gt=0, le=90, description="largest offset of a set-point from the posture, degrees")
    stiffness: float = traced(STIFFNESS, gt=0, le=200, description="of the servo, N m/rad")
    damping: float = traced(DAMPING, ge=0, le=10, description="of the servo, N m s/rad")
    period: float = Field(0.02, gt=0, le=1, description="s between decisions")
    timestep: float = Field(0.004, gt=0, le=0.02, description="s of physics and servo")
    duration: float = traced(10.0, gt=0, le=1000, description="s of an episode")
    push: float = traced(0.2, ge=0, description="N s of an impulse on the torso, which takes one period")
    push_every: float = traced(2.0, gt=0, description="s")

    @model_validator(mode="after")
    def _period_must_fit(self) -> "Stand":
        self.simulator.substeps(self.period)
        return self

    @property
    def observation_size(self) -> int:
        return sum(OBSERVATIONS.values()) + (sum(PRIVILEGED.values()) if self.observe == "privileged" else 0)

    @property
    def action_choices(self) -> tuple[int, ...]:
        return (self.choices,) * JOINTS

    @property
    def simulator(self) -> Physics:
        """What moves the body."""
        return _simulator(self.physics, self.timestep)

    def reset(self, key: Key[Array, ""]) -> State:
        joint_key, tilt_key, turn_key, push_key, sensor_key = jax.random.split(key, 5)
        spread = START_SPREAD * jax.random.uniform(joint_key, (JOINTS,), minval=-1.0)
        lean = START_SPREAD * jax.random.uniform(tilt_key, (2,), minval=-1.0)
        heading = jax.random.uniform(turn_key, (), maxval=2 * np.pi)
        still = jnp.zeros(3)
        qpos = jnp.concatenate([still.at[2].set(START_HEIGHT), _quaternion(heading, lean), POSTURE + spread])
        simulator = self.simulator
        world = simulator.start(qpos, jnp.zeros(len(qpos) - 1))
        true = Readings(qpos[7:], still, -GRAVITY * _down(qpos), jnp.zeros(2))
        sensors = self.sensors.start(true, sensor_key)
        sensors, readings = self.sensors.read(sensors, true, jax.random.fold_in(sensor_key, 1))
        down = _unit(-readings.accelerometer)
        none = jnp.zeros(JOINTS)
        first_push = self.push_every * jax.random.uniform(push_key)
        body = Body(world, sensors, readings, none, down, none, first_push, jnp.int32(0))
        return begin(body, self.observation(body), TERMS)

    def step(self, state: State, action: Int[Array, " joints"], key: Key[Array, ""]) -> State:
        return self.step_continuous(state, 2.0 * action / (self.choices - 1) - 1.0, key)

    def step_continuous(self, state: State, command: Float[Array, " joints"], key: Key[Array, ""]) -> State:
        """A step whose offsets are any parts of `offset`, from -1 to 1."""
        _, sensor_key = jax.random.split(key)
        body: Body = state.data
        offsets = jnp.clip(command, -1.0, 1.0)
        servo = self.servo(jnp.radians(self.offset) * offsets + POSTURE)
        plant = self.simulator.replace(push=self.push_on(body, key))
        world, true = plant.run_sensed(body.world, servo, self.simulator.substeps(self.period))
        body = self._sense(body, world, true, sensor_key)
        body = body._replace(offsets=offsets, decisions=body.decisions + 1)
        fallen = self.fallen(world) | world.diverged
        terms = {name: jnp.where(fallen, 0.0, term) for name, term in self.reward_terms(body).items()}
        over = body.decisions * self.period >= self.duration - self.period / 2
        obs = self.observation(body)
        return State(
            data=body,
            obs=obs,
            reward=jnp.asarray(sum(terms.values())),
            terminated=fallen,
            truncated=over & ~fallen,
            success=~fallen,
            final_obs=obs,
            metrics=terms,
        )

    def servo(self, setpoint: Float[Array, " joints"]) -> Any:
        """Torque in proportion to the error, and against the velocity, of each joint."""

        def control(stages: Stages) -> Float[Array, " joints"]:
            return self.stiffness * (setpoint - stages.qpos) - self.damping * stages.qvel

        return control

    def observation(self, body: Body) -> Float[Array, " observation_size"]:
        """`OBSERVATIONS`, then `PRIVILEGED` where asked for, scaled to about -1 to 1."""
        readings, world = body.readings, body.world
        parts = [
            readings.encoders - POSTURE,
            body.rates / SPEED,
            readings.gyroscope / TURN,
            readings.accelerometer / GRAVITY,
            body.down,
            readings.foot_contact / FORCE,
            body.offsets,
        ]
        if self.observe == "privileged":
            inwards = _rotation(world.qpos).T
            parts += [_down(world.qpos), inwards @ world.qvel[:3], world.qpos[2:3] / START_HEIGHT]
        return jnp.clip(jnp.concatenate(parts), -5.0, 5.0).astype(jnp.float32)

    def reward_terms(self, body: Body) -> dict[str, FloatScalar]:
        """The parts of the reward by name."""
        world = body.world
        lean = jnp.arccos(jnp.clip(-_down(world.qpos)[2], -1.0, 1.0))
        terms = (
            jnp.float32(0.4),
            0.3 * jnp.exp(-((lean / UPRIGHT) ** 2)),
            0.2 * jnp.exp(-jnp.sum(world.qvel[:3] ** 2) / STILL**2),
            0.1 * (1.0 - jnp.mean(body.offsets**2)),
        )
        return {name: jnp.asarray(term, jnp.float32) for name, term in zip(TERMS, terms, strict=True)}

    def fallen(self, world: World) -> BoolScalar:
        """Whether the body lies, or is about to."""
        return (-_down(world.qpos)[2] < np.cos(FALLEN_TILT)) | (world.qpos[2] < FALLEN_HEIGHT)

    def push_on(self, data: Body, key: Key[Array, ""]) -> Float[Array, "3"]:
        since = data.decisions * self.period - data.first_push
        due = (since >= 0) & (jnp.mod(since, self.push_every) < self.period)
        side = jax.random.uniform(jax.random.split(key)[0], (), maxval=2 * np.pi)
        force = self.push / self.period * jnp.stack([jnp.cos(side), jnp.sin(side), 0.0 * side])
        return jnp.where(due, force, 0.0)

    def _sense(self, body: Body, world: World, true: Readings, key: Key[Array, ""]) -> Body:
        """The body in its new world, with what the sensors say of it."""
        sensors, readings = self.sensors.read(body.sensors, true, key)
        rates = (readings.encoders - body.readings.encoders) / self.period
        turned = body.down + self.period * jnp.cross(body.down, readings.gyroscope)
        down = _unit(_unit(turned) - FILTER_GAIN * _unit(readings.accelerometer))
        return body._replace(world=world, sensors=sensors, readings=readings, rates=rates, down=down)


def _rotation(qpos: Float[Array, " nq"]) -> Float[Array, "3 3"]:
    """From the torso's frame to the world."""
    w, x, y, z = qpos[3:7]
    return jnp.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _down(qpos: Float[Array, " nq"]) -> Float[Array, "3"]:
    """The direction of gravity in the torso's frame."""
    return -_rotation(qpos)[2]


def _quaternion(heading: FloatScalar, lean: Float[Array, "2"]) -> Float[Array, "4"]:
    """Lean a little about the torso's x and y, then turn about the vertical."""
    x, y = lean / 2
    half = jnp.stack([jnp.cos(heading / 2), jnp.sin(heading / 2)])
    return _unit(jnp.stack([half[0], half[0] * x - half[1] * y, half[0] * y + half[1] * x, half[1]]))


def _unit(x: Float[Array, " n"]) -> Float[Array, " n"]:
    return x / (jnp.linalg.norm(x) + 1e-9)


@lru_cache
def _simulator(name: str, timestep: float) -> Physics:
    return make_physics(name, robot="lower_body", torso="free", ranges="human", timestep=timestep)
