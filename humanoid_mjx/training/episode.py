# pyright: reportAttributeAccessIssue=false
"""Look at what was learned: the motion of the robot in a greedy episode."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from humanoid_mjx.control.computed_torque import Reference
from humanoid_mjx.learners import Learner
from humanoid_mjx.physics.base import Physics, World
from humanoid_mjx.physics.model import MujocoPhysics
from humanoid_mjx.robot import ROBOTS, robot_spec
from humanoid_mjx.spec import InputError
from humanoid_mjx.tasks.continuous import State, Tabulated
from humanoid_mjx.tasks.finite import FiniteTask
from humanoid_mjx.tasks.posture_switch import PostureSwitch
from humanoid_mjx.training.evaluation import held_out_keys
from humanoid_mjx.training.policy import Trained
from humanoid_mjx.training.rollout import MAX_EPISODE_STEPS, decide, greedy, start
from humanoid_mjx.types import AnyArray

HOLD_S = 1.0
"""How long the last set-point is held after an episode, s: whether a posture is kept shows only then."""


class Played(NamedTuple):
    """A greedy episode, decision by decision."""

    states: list[Any]
    """The task's own, before each decision and after the last."""
    actions: list[Array]
    success: bool
    episode_return: float


class Motion(NamedTuple):
    """What the legs did, a row for each time step of the physics."""

    qpos: Float[AnyArray, "steps joints"]
    """After the step, rad."""
    qvel: Float[AnyArray, "steps joints"]
    torque: Float[AnyArray, "steps joints"]
    """That acted during the step, N m."""


def robot_of(trained: Trained) -> mujoco.MjModel:
    """The robot that a policy moves.

    Raises:
      InputError: its task has no `simulator`, which is a physics of a robot that is known.
    """
    simulator: Any = getattr(trained.learner.task, "simulator", None)
    if isinstance(simulator, MujocoPhysics):
        return simulator.model
    if isinstance(simulator, Physics) and getattr(simulator, "robot", None) in ROBOTS:
        return robot_spec(simulator.robot).compile()
    name = trained.config.task["name"]
    raise InputError(f"{trained.name}: its task {name} moves no robot; posture_switch is one that does.")


def play(trained: Trained, episode: int = 0) -> Played:
    """One of the episodes that an evaluation counts; 0 is the first."""
    learner, policy, key = trained.learner, trained.policy, held_out_keys(episode + 1)[episode]
    state, total = jax.jit(lambda learner: start(learner.env, key))(learner), 0.0
    states, actions = [state], []
    while not state.done and len(actions) < MAX_EPISODE_STEPS:
        state, action = _decide(learner, policy, key, state, jnp.int32(len(actions)))
        states.append(state)
        actions.append(action)
        total += float(state.reward)
    finite = isinstance(learner.task, FiniteTask)
    return Played([s.data[0] if finite else s.data for s in states], actions, bool(state.success), total)


@jax.jit
def _decide(learner: Learner, policy: Any, key: Any, state: State, steps: Any) -> tuple[State, Array]:
    return decide(learner.env, greedy(learner, policy), key, state, steps)


def rows_of(trained: Trained, played: Played) -> tuple[Float[np.ndarray, "rows nq"], float]:
    """`qpos` in rows, and the time from one to the next, s: one for each time step of the physics where the task is
    posture switching; else one for each decision, of a task with a `period` whose states have a `world`."""
    task: Any = trained.learner.task
    if isinstance(task, PostureSwitch):
        return np.asarray(motion_of(trained, played).qpos), task.timestep
    return np.stack([np.asarray(state.world.qpos) for state in played.states]), task.period


def motion_of(trained: Trained, played: Played) -> Motion:
    """The motion of a played episode of `PostureSwitch`, and `HOLD_S` more in which its last set-point is held."""
    task: Any = trained.learner.task
    steps = task.simulator.substeps(task.period)
    world, reference, motions = played.states[-1].world, at_rest(task.whole_body(task.grid[:, 0]), steps), []
    setpoint, number = jax.jit(task.setpoint), Tabulated(finite=task).flat_action
    for state, action in zip(played.states[:-1], played.actions, strict=True):
        reference = at_rest(setpoint(state, number(action)), steps)
        motions.append(follow(task, state.world, reference)[1])
    for _ in range(math.ceil(HOLD_S / task.period)):
        world, motion = follow(task, world, reference)
        motions.append(motion)
    return joined(motions)


@jax.jit
def follow(task: PostureSwitch, world: World, reference: Reference) -> tuple[World, Motion]:
    """Let the task's controller follow a reference with a row for each time step; the world after it, and the motion.

    One compilation serves all references of the same length.
    """

    def step(world: World, wanted: Reference) -> tuple[World, Motion]:
        world, torque = task.plant.step(world, task.controller(*wanted))
        return world, Motion(world.qpos, world.qvel, torque)

    return jax.lax.scan(step, world, reference)


def at_rest(setpoint: Float[Array, " joints"], steps: int) -> Reference:
    """The reference that stays at a set-point for so many time steps."""
    still = jnp.zeros((steps, len(setpoint)))
    return Reference(still + setpoint, still, still)


def joined(motions: Sequence[Motion]) -> Motion:
    """Motions one after another as one."""
    return Motion(*(np.concatenate(columns) for columns in zip(*motions, strict=True)))
