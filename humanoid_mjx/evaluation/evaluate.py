"""Evaluate on held-out episodes, beside zero and random agents.

The key of evaluation is the key of seed 0 with 2**32 - 1 folded in. Training folds the numbers of its runs, all below a
million, into the key of its own seed, so that it never draws these episodes. Episode i has the key of evaluation with i
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

from humanoid_mjx.compute import Arithmetic, Program, jitted, rng
from humanoid_mjx.evaluation.policy import StoredPolicy
from humanoid_mjx.learners import Learner
from humanoid_mjx.learners.rollout import AGENTS, Episode, agent, score
from humanoid_mjx.runs.statistics import Evaluation, estimated
from humanoid_mjx.training.plan import resolved
from humanoid_mjx.types import IntScalar

HELD_OUT = 2**32 - 1
"""Number folded into the key of seed 0."""

HELD_OUT_WORDS = "seed 0, fold 2**32 - 1: no run of a training has this key"

BLOCK = 1024
"""Episodes side by side."""


def held_out_key(episode: IntScalar) -> Key[Array, ""]:
    """The key of one episode, by its number."""
    return jax.random.fold_in(jax.random.fold_in(rng.key(0), np.uint32(HELD_OUT)), episode)


def held_out_keys(episodes: int) -> Key[Array, " episodes"]:
    """A key for each episode."""
    return jax.vmap(held_out_key)(jnp.arange(episodes))


def play_out(trained: StoredPolicy, name: str, episodes: int) -> dict[str, np.ndarray]:
    """`success`, `return`, `steps`, `discounted_return` and `lost` of held-out episodes, (episodes,) each, in which
    one of `AGENTS` decides."""
    block = min(episodes, BLOCK)
    keys = held_out_keys(-(-episodes // block) * block)
    learner = trained.learner
    run, number = _program(learner.task.arithmetic, learner.program), jnp.int32(AGENTS.index(name))
    shares = (keys[first : first + block] for first in range(0, len(keys), block))
    parts = [jax.device_get(run(learner, trained.policy, number, share)) for share in shares]
    columns = (np.concatenate(column)[:episodes] for column in zip(*parts, strict=True))
    return dict(zip(("success", "return", "steps", "discounted_return", "lost"), columns, strict=True))


def evaluate_all(policies: Sequence[StoredPolicy], episodes: int) -> list[Evaluation]:
    """Each policy, and the zero and the random agent once for each task among them."""
    found: list[Evaluation] = []
    tasks: dict[str, list[StoredPolicy]] = {}
    for trained in policies:
        tasks.setdefault(json.dumps(resolved(trained.config)["task"], sort_keys=True), []).append(trained)
    for same in tasks.values():
        name = same[0].config.task["name"] if len(tasks) == 1 else same[0].name
        found += [estimated(trained.name, "greedy", play_out(trained, "greedy", episodes)) for trained in same]
        found += [estimated(name, other, play_out(same[0], other, episodes)) for other in AGENTS[1:]]
    return found


@lru_cache
def _program(arithmetic: Arithmetic, program: Program) -> Callable[..., Episode]:
    def episode(learner: Learner, policy: Any, number: IntScalar, key: Key[Array, ""]) -> Episode:
        discount = getattr(learner, "discount", getattr(learner, "discounting", 1.0))
        return score(learner, agent(learner, policy, number), key, discount)

    many = jax.vmap(episode, in_axes=(None, None, None, 0))
    return jitted(many, arithmetic, program)
