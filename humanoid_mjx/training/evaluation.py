"""How well a policy does on episodes that no training has seen, beside an agent that does nothing and one of chance.

The key of evaluation is the key of seed 0 with 2**32 - 1 folded in. Training folds the numbers of its runs, all below a
million, into the key of its own seed, so that it draws no episode of these. Episode i has the key of evaluation with i
folded in: all policies and agents start from the same states.
"""

import json
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from humanoid_mjx import rng
from humanoid_mjx.learners import Learner
from humanoid_mjx.learners.evaluation import MAX_EVALUATION_STEPS
from humanoid_mjx.results.evaluations import Evaluation, estimated
from humanoid_mjx.tasks.continuous import ContinuousTask, State, Tabulated
from humanoid_mjx.tasks.finite import FiniteTask
from humanoid_mjx.training.plan import resolved
from humanoid_mjx.training.policy import Trained
from humanoid_mjx.types import BoolScalar, FloatScalar, IntScalar

HELD_OUT = 2**32 - 1
"""What is folded into the key of seed 0."""

HELD_OUT_WORDS = "seed 0, fold 2**32 - 1: no run of a training has this key"

AGENTS = ("greedy", "zero", "random")
"""The policy; the middle choice of every joint (of a finite task: action 0); any choice with equal probability."""

GREEDY = AGENTS.index("greedy")

BLOCK = 1024
"""Episodes side by side."""

MEASURES = ("success", "return", "steps")


def held_out_keys(episodes: int) -> Key[Array, " episodes"]:
    """A key for each episode."""
    key = jax.random.fold_in(rng.key(0), np.uint32(HELD_OUT))
    return jax.vmap(jax.random.fold_in, in_axes=(None, 0))(key, jnp.arange(episodes))


def play_out(trained: Trained, agent: str, episodes: int) -> dict[str, np.ndarray]:
    """`MEASURES` of so many episodes, (episodes,) each, in which one of `AGENTS` decides."""
    block = min(episodes, BLOCK)
    keys = held_out_keys(-(-episodes // block) * block)
    run, number = _program(trained.learner), jnp.int32(AGENTS.index(agent))  # pyright: ignore[reportArgumentType]
    parts = [
        jax.device_get(run(trained.hyper, trained.policy, number, keys[first : first + block]))
        for first in range(0, len(keys), block)
    ]
    return {name: np.concatenate([part[name] for part in parts])[:episodes] for name in MEASURES}


def evaluate_all(policies: Sequence[Trained], episodes: int) -> list[Evaluation]:
    """Each policy, and the zero and the random agent once for each task among them."""
    found: list[Evaluation] = []
    tasks: dict[str, list[Trained]] = {}
    for trained in policies:
        tasks.setdefault(json.dumps(resolved(trained.config)["task"], sort_keys=True), []).append(trained)
    for same in tasks.values():
        name = same[0].config.task["name"] if len(tasks) == 1 else same[0].name
        found += [estimated(trained.name, "greedy", play_out(trained, "greedy", episodes)) for trained in same]
        found += [estimated(name, agent, play_out(same[0], agent, episodes)) for agent in AGENTS[1:]]
    return found


def world_of(learner: Learner) -> ContinuousTask:
    """A learner's task as a continuous one."""
    task = learner.task
    return Tabulated(finite=task) if isinstance(task, FiniteTask) else task  # pyright: ignore[reportReturnType]


def act(learner: Learner, hyper: Any, policy: Any, agent: IntScalar, state: State, key: Key[Array, ""]) -> Array:
    """The action of one of `AGENTS`, given by its number: a choice of each joint, or a command where learners command.

    Learners that have a `world` see observations, the others see the rows of a finite task.
    """
    task, world = learner.task, world_of(learner)
    seen = state.obs
    if isinstance(task, FiniteTask) and not hasattr(learner, "world"):
        seen = task.row(hyper.task, state.data[0])
    greedy = learner.act(hyper, policy, seen, key)
    if not jnp.ndim(greedy):  # a table's number of the action
        greedy = world.choices_of(greedy)
    counts = np.array(world.action_choices)
    draws = jax.random.uniform(jax.random.fold_in(key, 1), counts.shape)
    random = jnp.minimum(jnp.floor(draws * counts), counts - 1)
    zero = jnp.zeros(counts.shape) if isinstance(task, FiniteTask) else jnp.asarray((counts - 1) // 2)
    others = zero, random
    if jnp.issubdtype(greedy.dtype, jnp.floating):
        others = tuple(2.0 * choice / np.maximum(counts - 1, 1) - 1.0 for choice in others)
    zero, random = (other.astype(greedy.dtype) for other in others)
    return jnp.where(agent == 0, greedy, jnp.where(agent == 1, zero, random))


def carry_out(world: ContinuousTask, params: Any, state: State, action: Array, key: Key[Array, ""]) -> State:
    """The step of a task that goes with what `act` gave."""
    command = jnp.issubdtype(action.dtype, jnp.floating)
    return (world.step_continuous if command else world.step)(params, state, action, key)


@lru_cache(maxsize=64)
def _program(learner: Learner) -> Callable[..., dict[str, Array]]:
    world = world_of(learner)

    def episode(hyper: Any, policy: Any, agent: IntScalar, key: Key[Array, ""]) -> dict[str, Array]:
        reset_key, key = jax.random.split(key)

        def running(loop: tuple[State, FloatScalar, IntScalar]) -> BoolScalar:
            state, _, steps = loop
            return ~state.over & (steps < MAX_EVALUATION_STEPS)

        def step(loop: tuple[State, FloatScalar, IntScalar]) -> tuple[State, FloatScalar, IntScalar]:
            state, total, steps = loop
            act_key, step_key = jax.random.split(jax.random.fold_in(key, steps))
            action = act(learner, hyper, policy, agent, state, act_key)
            state = carry_out(world, hyper.task, state, action, step_key)
            return state, total + state.reward, steps + 1

        first = world.reset(hyper.task, reset_key), jnp.float32(0), jnp.int32(0)
        state, total, steps = jax.lax.while_loop(running, step, first)
        return {"success": state.success, "return": total, "steps": steps}

    options = dict(learner.compiler_options)
    return jax.jit(jax.vmap(episode, in_axes=(None, None, None, 0)), compiler_options=options)
