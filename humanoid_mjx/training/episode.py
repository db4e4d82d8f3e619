"""Look at what was learned: the motion of the legs in a greedy episode of a stored run."""

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from humanoid_mjx.config import parse
from humanoid_mjx.control.computed_torque import Reference
from humanoid_mjx.learners import Learner
from humanoid_mjx.physics.base import World
from humanoid_mjx.results.store import read_config
from humanoid_mjx.results.tables import finished_runs
from humanoid_mjx.spec import InputError
from humanoid_mjx.tasks.posture_switch import Body, PostureSwitch
from humanoid_mjx.training.plan import make_plan, one_run
from humanoid_mjx.training.state import from_arrays
from humanoid_mjx.types import AnyArray

HOLD_S = 1.0
"""How long the last set-point is held after an episode, s: whether a posture is kept shows only then."""


class Trained(NamedTuple):
    """What one run of a sweep learned."""

    learner: Learner
    hyper: Any
    policy: Any
    point: int
    seed: int


class Motion(NamedTuple):
    """What the legs did, a row for each time step of the physics."""

    qpos: Float[AnyArray, "steps joints"]
    """After the step, rad."""
    qvel: Float[AnyArray, "steps joints"]
    torque: Float[AnyArray, "steps joints"]
    """That acted during the step, N m."""


class Episode(NamedTuple):
    """A greedy episode, and `HOLD_S` more in which its last set-point is held."""

    motion: Motion
    decisions: int
    arrived: bool


def best_policy(path: Path) -> Trained:
    """The best run of a run folder's best point: most often at the goal, and among equals the quickest.

    Raises:
      InputError: this is no run folder, nothing in it is finished, or its files are damaged.
    """
    plan = make_plan(parse(read_config(path), str(path / "config.yaml")))
    arrays = finished_runs(path, ("point", "seed", "policy", "final.greedy_"))
    if not arrays:
        raise InputError(f"{path}: holds no finished run; --resume it first.")
    success, steps = arrays["final.greedy_success"], arrays["final.greedy_steps"]
    points = np.unique(arrays["point"])
    members = [arrays["point"] == point for point in points]
    ranks = [(-round(float(success[rows].mean()), 3), float(steps[rows].mean())) for rows in members]
    rows = np.flatnonzero(members[ranks.index(min(ranks))])
    row = rows[np.lexsort((steps[rows], -success[rows]))[0]]
    point = int(arrays["point"][row])
    (group,) = (group for group in plan.groups if point in group.points)
    place = int(np.searchsorted(group.points, point))
    hyper = jax.tree.map(lambda leaf: jnp.asarray(leaf[place]), group.hyper)
    like = jax.eval_shape(group.learner.policy, one_run(group))
    stored = {name: array[row] for name, array in arrays.items() if name.startswith("policy")}
    policy = jax.tree.map(jnp.asarray, from_arrays(like, stored, "policy", str(path)))
    return Trained(group.learner.structure(), hyper, policy, point, int(arrays["seed"][row]))


def posture_task(trained: Trained, where: str) -> PostureSwitch:
    """The task of what was learned, if it moves a robot.

    Raises:
      InputError: it does not.
    """
    task = trained.learner.task
    if not isinstance(task, PostureSwitch):
        raise InputError(f"{where}: its task {type(task).__name__} moves no robot; of the tasks posture_switch does.")
    return task


def greedy_episode(trained: Trained, seed: int = 0) -> Episode:
    """One greedy episode of what was learned on `PostureSwitch`."""
    learner, hyper, policy = trained[:3]
    task, params = posture_task(trained, "the policy"), hyper.task
    steps = task.simulator.substeps(task.period)

    @jax.jit
    def choose(state: Body, key: Any) -> Array:
        return task.setpoint(state, learner.act(hyper, policy, task.row(params, state), key))

    outcome = jax.jit(task.outcome)
    start_key, key = jax.random.split(jax.random.key(seed))
    state, motions, arrived = task.reset(params, start_key), [], False
    reference = at_rest(task.whole_body(task.grid[:, 0]), steps)
    while not arrived and len(motions) < int(params.max_episode_steps):
        act_key, step_key = jax.random.split(jax.random.fold_in(key, len(motions)))
        reference = at_rest(choose(state, act_key), steps)
        world, motion = follow(task, params, state.world, reference)
        state, _, arrived = outcome(params, state, world, step_key)
        motions.append(motion)
    decisions, world = len(motions), state.world
    for _ in range(math.ceil(HOLD_S / task.period)):
        world, motion = follow(task, params, world, reference)
        motions.append(motion)
    return Episode(joined(motions), decisions, bool(arrived))


@partial(jax.jit, static_argnames="task")
def follow(task: PostureSwitch, params: Any, world: World, reference: Reference) -> tuple[World, Motion]:
    """Let the task's controller follow a reference with a row for each time step; the world after it, and the motion.

    One compilation serves all references of the same length.
    """

    def step(world: World, wanted: Reference) -> tuple[World, Motion]:
        controller = task.controller(params, *wanted)
        world, torque = task.simulator.step(task.plant(params), world, controller)
        return world, Motion(world.qpos, world.qvel, torque)

    return jax.lax.scan(step, world, reference)


def at_rest(setpoint: Float[Array, " joints"], steps: int) -> Reference:
    """The reference that stays at a set-point for so many time steps."""
    still = jnp.zeros((steps, len(setpoint)))
    return Reference(still + setpoint, still, still)


def joined(motions: Sequence[Motion]) -> Motion:
    """Motions one after another as one."""
    return Motion(*(np.concatenate(columns) for columns in zip(*motions, strict=True)))
