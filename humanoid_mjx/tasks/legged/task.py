"""Reset and step of a legged task, from its declared parts.

Every `period` the learner chooses how far each joint's set-point is from the posture's, or from an open-loop motion
about it; every time step of the physics a control law drives the joints there. The learner sees the sensors' readings,
with their errors, and an attitude estimated from them; with `observe: privileged` also the true attitude and motion of
the torso.
"""

from functools import lru_cache
from typing import ClassVar, Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key
from pydantic import Field, model_validator

from humanoid_mjx.mechanics.rotations import rotation_matrix, unit
from humanoid_mjx.mechanics.terrain import Terrain
from humanoid_mjx.physics import make_physics
from humanoid_mjx.physics.base import Readings, Sensed
from humanoid_mjx.physics.model import MujocoPhysics
from humanoid_mjx.physics.sensors import Sensors
from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.continuous import State, begin
from humanoid_mjx.tasks.legged.body import LeggedBody
from humanoid_mjx.tasks.legged.commands import Velocity
from humanoid_mjx.tasks.legged.episode import Episode, MeanMotion
from humanoid_mjx.tasks.legged.events import Fall, Push, Randomise
from humanoid_mjx.tasks.legged.gait import Clock, Gaits
from humanoid_mjx.tasks.legged.observations import PRIVILEGED, PROPRIOCEPTION, Observation, Observed, swapped
from humanoid_mjx.tasks.legged.rewards import Rewards
from humanoid_mjx.tasks.legged.view import View, feet_of, unknown_feet
from humanoid_mjx.thesis.leg import GRAVITY
from humanoid_mjx.types import FloatScalar

COMMANDED = "forward, m/s", "left, m/s", "turn left, rad/s"
"""The parts of a command."""


class LeggedTask(LeggedBody):
    """Base of legged tasks: declare `rewards` and whatever else differs. A fall ends an episode with the reward 0."""

    observations: ClassVar[tuple[str | Observation, ...]] = PROPRIOCEPTION
    privileged: ClassVar[tuple[str | Observation, ...]] = PRIVILEGED

    observe: Literal["sensors", "privileged"] = Field(
        "sensors", description="readings alone, or also the torso's true attitude and motion"
    )
    history: int = Field(1, ge=1, le=50, description="decisions whose observations the learner sees")
    sensors: Sensors = Field(Sensors.model_validate({}), description="errors of the sensors")
    rewards: Rewards = Field(description="weights of the reward's terms")
    fall: Fall = Field(Fall(), description="what ends an episode")
    push: Push = Field(Push(), description="what disturbs the body")
    randomise: Randomise | None = Field(None, description="by how much worlds differ; none: all are as declared")
    terrain: Terrain | None = Field(None, description="shape of the ground; none: a level plane")
    command: Velocity | None = Field(None, description="commanded velocity and turn rate")
    gait: Gaits | None = Field(None, description="clock and open-loop steps")
    symmetric: bool = Field(False, description="show the gait's second half as the mirror image of its first")
    duration: float = traced(10.0, gt=0, le=1000, description="s of an episode")

    @model_validator(mode="after")
    def _robot_must_fit(self) -> "LeggedTask":
        if self.gait:
            self.gait.check(self.robot)
        if self.terrain:
            make_physics(self.physics, MujocoPhysics, robot=self.robot, terrain=self.terrain)
            if self.terrain.shaped and self.control.name == "grounded":
                raise ValueError("terrain: control grounded assumes a plane; take a slope without waves and stairs")
        if self.symmetric and not self.robot.alternates:
            cause = "the feet do not swing half a period after their mirror images"
            raise ValueError(f"symmetric: {cause}; write false, or mirror and turns into the robot's YAML")
        return self

    @property
    def observed(self) -> Observed:
        """Observations of one decision."""
        names = *self.observations, *(self.privileged if self.observe == "privileged" else ())
        return _observed(names, self.robot)

    @property
    def observation_size(self) -> int:
        return self.history * self.observed.size

    def reset(self, key: Key[Array, ""]) -> State:
        *start_keys, push_key, sensor_key = jax.random.split(key, 5)
        command_key, phase_key, plant_key = jax.random.split(jax.random.fold_in(key, 1), 3)
        world, plant = self.start(jnp.stack(start_keys)), self.plant
        if self.randomise:
            plant = self.randomise.draw(plant, plant_key)
        if self.terrain:
            draw_key, place_key = jax.random.split(jax.random.fold_in(key, 2))
            plant = jax.tree.map(lambda x: jnp.asarray(x, float), plant)._replace(terrain=self.terrain.draw(draw_key))
            world = self.on_terrain(world, plant.terrain, place_key)
        rotation, still = rotation_matrix(world.qpos[3:7]), jnp.zeros(3)
        down = -(plant.terrain.up() @ rotation if plant.terrain else rotation[2])
        true = Readings(world.qpos[self.simulator.joint_qpos], still, -GRAVITY * down, jnp.zeros(len(self.robot.feet)))
        sensors = self.sensors.start(true, sensor_key)
        sensors, readings = self.sensors.read(sensors, true, jax.random.fold_in(sensor_key, 1))
        none = jnp.zeros(len(self.robot.joints))
        episode = Episode(
            world,
            MeanMotion(still, jnp.float32(0), still, true.accelerometer),
            sensors,
            readings,
            rates=none,
            down=unit(-readings.accelerometer),
            offsets=none,
            first_push=self.push.first(push_key),
            decisions=jnp.int32(0),
            command=self.command.draw(command_key) if self.command else still,
            heading_error=jnp.float32(0),
            tracking_error=still,
            clock=self.gait.start(jax.random.uniform(phase_key), self.robot) if self.gait else Clock(jnp.float32(0)),
            plant=plant if self.randomise or self.terrain else None,
            past=None,
        )
        view = self.view(episode, None, none)
        if self.history > 1:
            first = self.observed(view)
            view = view._replace(episode=episode._replace(past=jnp.tile(first, (self.history, 1))))
        return begin(view.episode, self.seen(view), tuple(self.rewards.terms(view)))

    def step(self, state: State, action: Int[Array, " joints"], key: Key[Array, ""]) -> State:
        return self.step_continuous(state, self.as_numbers(action), key)

    def step_continuous(self, state: State, command: Float[Array, " joints"], key: Key[Array, ""]) -> State:
        """A step whose offsets are any parts of `action_scale`, from -1 to 1."""
        return self.step_watched(state, command, key, watched=False)[0]

    def commanded(self, state: State, view: View, command: Float[Array, "3"]) -> State:
        """Replace the command in a state and recompute its observation; `view` is the state's view."""
        view = view._replace(episode=state.data.under(command, 0.0))
        return state._replace(data=self.remembered(view), obs=self.seen(view))

    def step_watched(
        self, state: State, command: Float[Array, " joints"], key: Key[Array, ""], watched: bool = True
    ) -> tuple[State, View, Sensed]:
        """Return the result of `step_continuous`, its view, and everything sensed at the beginning of the last time
        step; if `watched`, of every time step, on a leading axis."""
        _, sensor_key = jax.random.split(key)
        before: Episode = state.data
        offsets = self.offsets(before, command)
        force = self.push_on(before, key)
        setpoint = self.setpoint(offsets, self.reference(before))
        world, seen = self.advance(before.world, setpoint, before.plant or self.plant, force, watched)
        sensed = jax.tree.map(lambda part: part[-1], seen) if watched else seen
        after = before.sense(self.sensors, world, sensed.readings, self.period, sensor_key)
        if self.command:
            after = after.compared(before.followed(self.command), self.period)
        past = None if before.past is None else jnp.concatenate([before.past[:1], before.past[:-1]])
        after = after._replace(offsets=offsets, decisions=before.decisions + 1, past=past)
        view = self.view(after, sensed, before.offsets)
        fallen = self.fall.fallen(view) | world.diverged
        terms = {name: jnp.where(fallen, 0.0, term) for name, term in self.rewards.weighted(view).items()}
        command_key = jax.random.fold_in(key, 1)
        if self.gait:
            after = after._replace(clock=self.gait.after(after.clock, after.command, self.period, self.robot))
        if self.command:
            told, angle = self.command.following(after.command, command_key, self.period)
            after = after.under(told, self.period, angle)
        over = after.decisions * self.period >= self.duration - self.period / 2
        next_view = view._replace(episode=after)
        data, obs, reward = self.remembered(next_view), self.seen(next_view), jnp.asarray(sum(terms.values()))
        state = State(data, obs, reward, fallen, over & ~fallen, success=~fallen, final_obs=obs, metrics=terms)
        return state, view, seen

    def offsets(self, before: Episode, command: Float[Array, " joints"]) -> Float[Array, " joints"]:
        """Return the smoothed offsets of the robot's own joints, -1 to 1, for a learner's `command`."""
        offsets = jnp.clip(command, -1.0, 1.0)
        if self.symmetric:
            offsets = jnp.where(self.mirrored(before.phase), swapped(offsets, self.robot), offsets)
        return offsets + self.smoothing * (before.offsets - offsets)

    def push_on(self, data: Episode, key: Key[Array, ""]) -> Float[Array, "3"]:
        since = data.decisions * self.period - data.first_push
        return self.push.force(since, self.period, jax.random.split(key)[0]) * self.robot.momentum

    def told(self, data: Episode) -> dict[str, FloatScalar]:
        return dict(zip(COMMANDED, data.command, strict=True)) if self.command else {}

    @property
    def told_ranges(self) -> dict[str, tuple[float, float]]:
        if not self.command:
            return {}
        parts = self.command.forward, self.command.sideways, self.command.turn
        return {name: (float(low), float(high)) for name, (low, high) in zip(COMMANDED, parts, strict=True)}

    def steered(self, data: Episode, told: dict[str, FloatScalar]) -> Episode:
        return data.under(jnp.stack([told[name] for name in COMMANDED]), 0.0)

    def for_driving(self) -> "LeggedTask":
        calm = self.replace(push=self.push.replace(impulse=0.0), duration=1e9, terrain=None)
        return calm.replace(command=self.command.replace(every=1e9)) if self.command else calm

    def reference(self, episode: Episode) -> Float[Array, " joints"] | float:
        """The motion about the posture that the offsets correct, rad."""
        return self.gait.reference(episode.clock, episode.followed(self.command), self.robot) if self.gait else 0.0

    def view(self, episode: Episode, sensed: Sensed | None, last_offsets: Float[Array, " joints"]) -> View:
        """The view that the parts of the task take; `sensed` is None at the beginning of an episode."""
        robot, terrain, names = self.robot, episode.terrain, self.simulator.body_names
        feet = feet_of(sensed, names, robot, terrain) if sensed else unknown_feet(robot, terrain)
        torque = sensed.torque if sensed else jnp.zeros(len(self.robot.joints))
        return View(self.robot, self.command, self.gait, episode, feet, torque, last_offsets)

    def seen(self, view: View) -> Float[Array, " observation_size"]:
        """Return the learner's observation: those of the last `history` decisions, the latest first."""
        rows = self._rows(view)
        if self.symmetric:
            rows = jnp.where(self.mirrored(view.episode.phase), jax.vmap(self.observed.mirrored)(rows), rows)
        return rows.reshape(-1)

    def _rows(self, view: View) -> Float[Array, "history size"]:
        """The observations of the last `history` decisions, the latest first, as on the robot's own sides."""
        now = self.observed(view)[None]
        return now if view.episode.past is None else jnp.concatenate([now, view.episode.past[1:]])

    def remembered(self, view: View) -> Episode:
        """The view's episode with what is observed now."""
        return view.episode._replace(past=self._rows(view)) if self.history > 1 else view.episode

    def mirrored(self, phase: FloatScalar) -> Bool[Array, ""]:
        """Return whether a `symmetric` task shows the body's mirror image, and takes the offsets for its joints.

        A policy then treats both sides alike, whatever it learned from either.
        """
        return jnp.asarray(phase) >= 0.5


_observed = lru_cache(Observed)
