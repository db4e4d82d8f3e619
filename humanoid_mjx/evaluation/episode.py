# pyright: reportAttributeAccessIssue=false
"""Look at what was learned: the motion of the robot in a greedy episode, and its film with words and pushes."""

import math
from collections.abc import Callable, Mapping
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from humanoid_mjx.compute import compiler_options
from humanoid_mjx.evaluation.evaluate import held_out_key
from humanoid_mjx.evaluation.policy import StoredPolicy
from humanoid_mjx.learners import Learner
from humanoid_mjx.learners.rollout import MAX_EPISODE_STEPS, decide, decision_keys, greedy, start
from humanoid_mjx.mechanics.terrain import Terrain
from humanoid_mjx.physics.base import Controller, Physics, World
from humanoid_mjx.robot import Robot
from humanoid_mjx.spec import InputError
from humanoid_mjx.tasks.base import Task
from humanoid_mjx.tasks.continuous import State
from humanoid_mjx.tasks.finite import FiniteTask
from humanoid_mjx.training.progress import Reporter
from humanoid_mjx.types import AnyArray, FloatScalar, IntScalar

HOLD_S = 1.0
"""Time for which the last set-point is held after an episode, s: only then it shows that a posture is kept."""

SMOOTH_S = 0.05
"""Decisions that take longer are shown time step by time step, where their task has `drive`: between them a robot does
not move evenly."""


class Played(NamedTuple):
    """A greedy episode, decision by decision."""

    states: list[Any]
    """The task's data before each decision and after the last."""
    actions: list[Array]
    """Actions as carried out: choices of the joints, or commands in [-1, 1]."""
    success: bool
    episode_return: float
    pushes: Float[np.ndarray, "decisions 3"]
    """Force on the torso during each decision, N, in the world."""
    told: list[dict[str, float]]
    """Command to the robot at each decision, from its task's `told`."""


class Motion(NamedTuple):
    """A motion of the legs, a row for each time step of the physics."""

    qpos: Float[AnyArray, "steps joints"]
    """Joint angles after the step, rad."""
    qvel: Float[AnyArray, "steps joints"]
    torque: Float[AnyArray, "steps joints"]
    """Torques that acted during the step, N m."""


def robot_of(trained: StoredPolicy) -> mujoco.MjModel:
    """The robot that a policy moves.

    Raises:
      InputError: its task has no `simulator`, which is a physics of a robot that is known, or no `period`.
    """
    task: Any = trained.learner.task
    simulator = getattr(task, "simulator", None)
    if isinstance(simulator, Physics) and isinstance(getattr(task, "period", None), float):
        model = getattr(simulator, "model", None)
        if isinstance(model, mujoco.MjModel):
            return model
        if isinstance(robot := getattr(simulator, "robot", None), Robot):
            return robot.model
    raise InputError(
        f"{trained.name}: its task {trained.config.task['name']} moves no robot: it has no `simulator` and `period`, "
        "as posture_switch does."
    )


def world_of(data: Any) -> World:
    """The world in the data of a task's state, wherever it is.

    Raises:
      InputError: there is none.
    """
    leaves = jax.tree.leaves(data, is_leaf=lambda leaf: isinstance(leaf, World))
    worlds = [leaf for leaf in leaves if isinstance(leaf, World)]
    if not worlds:
        raise InputError("play: the task's states hold no World of its physics, so there is nothing to show.")
    return worlds[0]


def play(
    trained: StoredPolicy,
    episode: int = 0,
    tell: Callable[[int], None] = lambda decisions: None,
    told: Mapping[str, float] | None = None,
    most: int = MAX_EPISODE_STEPS,
) -> Played:
    """One of the episodes that an evaluation counts; 0 is the first.

    Args:
      tell: called after each decision with how many there were.
      told: a command that holds throughout in place of the task's own, by the names of its `told_ranges`.
      most: decisions after which the episode is left.
    """
    learner, policy, number = trained.learner, trained.policy, jnp.int32(episode)
    command = {name: jnp.float32(value) for name, value in (told or {}).items()}
    state, total = single(begun)(learner, number), 0.0
    states, actions, pushes, commands = [state], [], [], []
    while not state.done and len(actions) < most:
        steps = jnp.int32(len(actions))
        state, action, push, words = single(decided)(learner, policy, number, state, steps, command)
        states.append(state)
        actions.append(action if state.executed is None else state.executed)
        pushes.append(np.asarray(push))
        commands.append({name: float(value) for name, value in words.items()})
        total += float(state.reward)
        tell(len(actions))
    data = [own_data(learner.task, state) for state in states]
    forces = np.array(pushes, np.float64).reshape(-1, 3)
    return Played(data, actions, bool(state.success), total, forces, commands)


@lru_cache
def single(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of one world, compiled soon rather than to be fast."""
    return jax.jit(function, compiler_options=compiler_options("arrays", "single"))


def begun(learner: Learner, episode: IntScalar) -> State:
    """The first state of a held-out episode."""
    return start(learner.env, held_out_key(episode))


def decided(
    learner: Learner, policy: Any, episode: IntScalar, state: State, steps: IntScalar, told: dict[str, FloatScalar]
) -> tuple[State, Array, Any, Any]:
    """Decision number `steps` of a held-out episode, under the command `told` if any: the state that it leads to, the
    action, the push during it, and the command that the task tells before it."""
    key, task = held_out_key(episode), learner.task
    if told:
        state = state._replace(data=task.steered(state.data, told))
    data, (_, step_key) = own_data(task, state), decision_keys(key, steps)
    if isinstance(task, FiniteTask):
        step_key = jax.random.split(step_key, 3)[2]
    after, action = decide(learner.env, greedy(learner, policy), key, state, steps)
    return after, action, task.push_on(data, step_key), task.told(data)


def own_data(task: Task, state: State) -> Any:
    """The data of a task's state without what makes a finite task a continuous one."""
    return state.data[0] if isinstance(task, FiniteTask) else state.data


def rows_of(trained: StoredPolicy, played: Played) -> tuple[Float[np.ndarray, "rows nq"], float]:
    """`qpos` in rows, and the time from one to the next, s: one for each time step of the physics and `HOLD_S` more
    where decisions are longer than `SMOOTH_S` and the task has `drive`; else one for each decision."""
    task: Any = trained.learner.task
    if task.period > SMOOTH_S and type(task).drive is not Task.drive:
        return np.asarray(motion_of(trained, played).qpos), task.simulator.step_s
    return np.stack([np.asarray(world_of(data).qpos) for data in played.states]), task.period


def motion_of(trained: StoredPolicy, played: Played) -> Motion:
    """The motion of a played episode of a task that has `drive`, and `HOLD_S` more under its last controller."""
    task: Any = trained.learner.task
    world, data, action, motions = world_of(played.states[-1]), played.states[0], None, []
    for data, action in zip(played.states[:-1], played.actions, strict=True):
        motions.append(single(driven)(task, world_of(data), data, action)[1])
    for _ in range(math.ceil(HOLD_S / task.period) if motions else 0):
        world, motion = single(driven)(task, world, data, action)
        motions.append(motion)
    return Motion(*(np.concatenate(columns) for columns in zip(*motions, strict=True)))


def driven(task: Any, world: World, data: Any, action: Array) -> tuple[World, Motion]:
    """Let a task drive the robot, wherever it is, as in the decision with this data and action."""
    plant, controller = task.drive(data, action)
    step = lambda world, _: stepped(plant, world, controller)  # noqa: E731
    return jax.lax.scan(step, world, length=task.simulator.substeps(task.period))


def stepped(plant: Physics, world: World, controller: Controller) -> tuple[World, Motion]:
    """A time step, and its row of the motion."""
    world, torque = plant.step(world, controller)
    return world, Motion(world.qpos, world.qvel, torque)


SHORT_S = 0.25
"""Length, s, below which a push is described by its impulse, and from which by its force."""

SHOWN_S = 0.5
"""A push is shown for at least so long, s."""

DRIVEN = 0.6
"""Share of the largest command under which a robot is shown."""


class Push(NamedTuple):
    """A force on the torso."""

    start: float
    """s"""
    seconds: float
    force: Float[np.ndarray, "3"]
    """N, world."""

    @property
    def shown(self) -> float:
        """Time for which it is shown, s: most pushes last shorter than the eye takes to see them."""
        return max(self.seconds, SHOWN_S)

    @property
    def words(self) -> str:
        """Size of the push, in words."""
        size = float(np.linalg.norm(self.force))
        return f"push {size * self.seconds:.2g} N s" if self.seconds < SHORT_S else f"push {size:.2g} N"


class Film(NamedTuple):
    """A motion, its rows `step_s` apart, and what goes with it."""

    model: mujoco.MjModel
    qpos: Float[AnyArray, "rows nq"]
    step_s: float
    title: str = ""
    told: tuple[tuple[float, str], ...] = ()
    """Commands to the robot: the time from which each holds, s, and its words."""
    pushes: tuple[Push, ...] = ()
    terrain: Terrain | None = None
    """The shape of the ground, in a world whose z axis points against gravity; none: a level plane."""

    def at(self, fps: float) -> tuple[Float[np.ndarray, "frames nq"], Float[np.ndarray, " frames"]]:
        """Postures at the motion's own speed, so many a second, and their times, s; interpolated linearly between
        rows."""
        rows = np.arange(0.0, len(self.qpos) - 0.999, 1.0 / (fps * self.step_s))
        columns = np.asarray(self.qpos, np.float64).T
        places = np.arange(len(self.qpos))
        return np.stack([np.interp(rows, places, column) for column in columns], axis=1), rows * self.step_s

    def asked(self, seconds: float) -> str:
        """The command to the robot at a time, in words."""
        return next((words for start, words in reversed(self.told) if start <= seconds + 1e-9), "")


def film_of(trained: StoredPolicy, played: Played, title: str) -> Film:
    """The film of a played episode.

    Raises:
      InputError: the policy's task moves no robot, or its states hold no World.
    """
    model, (qpos, step_s) = robot_of(trained), rows_of(trained, played)
    period: float = trained.learner.task.period
    words = pairwise(["", *map(in_words, played.told)])
    told = [(number * period, now) for number, (before, now) in enumerate(words) if now != before]
    film = Film(model, qpos, step_s, title, tuple(told), tuple(merged(played.pushes, period)))
    terrain = getattr(played.states[0], "terrain", None)
    return film if terrain is None else _level(film, jax.tree.map(float, terrain), trained)


def _level(film: Film, terrain: Terrain, trained: StoredPolicy) -> Film:
    """The film of a body on a terrain, turned so that the z axis points against gravity; its model has no ground but a
    plane."""
    turn, qpos = np.empty(4), np.array(film.qpos, np.float64)
    mujoco.mju_quatZ2Vec(turn, terrain.up(np) * [-1.0, -1.0, 1.0])
    for row in qpos:
        mujoco.mju_rotVecQuat(row[:3], row[:3].copy(), turn)
        mujoco.mju_mulQuat(row[3:7], turn, row[3:7].copy())
    for push in film.pushes:
        mujoco.mju_rotVecQuat(push.force, push.force.copy(), turn)
    return film._replace(qpos=qpos, terrain=terrain, model=trained.learner.task.robot.model)


def show(trained: StoredPolicy, reporter: Reporter, episode: int = 0) -> tuple[Film, str]:
    """Play a policy's held-out episode of this number; 0 is the first. Return its film, and its end in a sentence.

    Raises:
      InputError: the policy's task moves no robot.
    """
    robot_of(trained)
    period: float = trained.learner.task.period
    reporter.phase("compiling")
    played = play(trained, episode, lambda decisions: reporter.phase("simulating"))
    which = f", episode {episode}" * (episode > 0)
    film = film_of(trained, played, f"{trained.title}, point {trained.point}, seed {trained.seed}{which}")
    decisions = len(played.actions)
    outcome = "succeeds" if played.success else "does not succeed"
    return film, (
        f"point {trained.point}, seed {trained.seed}: {outcome} in {decisions} decisions, {decisions * period:g} s; "
        f"return {played.episode_return:.4g}"
    )


def driven_films(trained: StoredPolicy, seconds: float) -> list[Film]:
    """Films of a policy under a constant command: for each part of the command one film at `DRIVEN` of each end of its
    range that is not 0."""
    task: Any = trained.learner.task
    driven = trained._replace(learner=trained.learner.replace(task=task.for_driving()))
    films = []
    for name, ends in task.told_ranges.items():
        for end in sorted({end for end in ends if end}, reverse=True):
            told = dict.fromkeys(task.told_ranges, 0.0) | {name: DRIVEN * end}
            played = play(driven, told=told, most=round(seconds / task.period))
            films.append(film_of(driven, played, in_words({name: DRIVEN * end})))
    return films


def in_words(values: Mapping[str, float]) -> str:
    """Format a command: `{"forward, m/s": 0.3}` becomes `forward 0.30 m/s`. Negative values to the left are shown as
    positive ones to the right; semicolons separate several parts."""
    parts = []
    for key, value in values.items():
        name, _, unit = key.partition(", ")
        if "left" in name.split() and value < 0:
            name, value = name.replace("left", "right"), -value
        parts.append(f"{name} {value:.2f} {unit}".rstrip())
    return "; ".join(parts)


def merged(forces: Float[np.ndarray, "decisions 3"], period: float) -> list[Push]:
    """Pushes from the force during each decision; one that stays the same is one push."""
    pushes: list[Push] = []
    for number, force in enumerate(forces):
        if not force.any():
            continue
        last, start = (pushes[-1] if pushes else None), number * period
        if last and np.isclose(last.start + last.seconds, start) and np.allclose(last.force, force):
            pushes[-1] = last._replace(seconds=last.seconds + period)
        else:
            pushes.append(Push(start, period, force))
    return pushes
