# pyright: reportAttributeAccessIssue=false
"""Look at what was learned: the motion of the robot in a greedy episode."""

import math
from collections.abc import Callable, Mapping
from functools import lru_cache
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
from humanoid_mjx.physics.base import Controller, Physics, World, worlds_in
from humanoid_mjx.physics.model import MujocoPhysics
from humanoid_mjx.spec import InputError
from humanoid_mjx.tasks.base import Task
from humanoid_mjx.tasks.continuous import State
from humanoid_mjx.tasks.finite import FiniteTask
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
        return simulator.model if isinstance(simulator, MujocoPhysics) else simulator.robot.model
    raise InputError(
        f"{trained.name}: its task {trained.config.task['name']} moves no robot: it has no `simulator` and `period`, "
        "as posture_switch does."
    )


def world_of(data: Any) -> World:
    """The world in the data of a task's state, wherever it is.

    Raises:
      InputError: there is none.
    """
    if not (worlds := worlds_in(data)):
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
