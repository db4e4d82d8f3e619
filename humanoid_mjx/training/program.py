"""The compiled programs of a group of sweep points: a learner, vmapped over runs."""

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from humanoid_mjx import rng, runtime
from humanoid_mjx.learners import Learner


class Program(NamedTuple):
    """Functions over runs side by side; every array has a leading axis of runs."""

    start: Callable[..., Any]
    """(fresh (bool), hyper, seeds, training states, policies) -> training states, new where fresh."""
    train: Callable[[Any, Any, Any], tuple[Any, jax.Array]]
    """(hyper, training states, steps) -> training states so many steps later, and progress. Gives up the old ones."""
    finish: Callable[..., dict[str, Any]]
    """(hyper, training states, seeds) -> curves, final scores and policies."""


@lru_cache(maxsize=64)
def program_of(learner: Learner) -> Program:
    """The programs of one structure of learner (`Spec.structure`). `seeds` is (the config's seed, the seed number)."""

    def start(fresh, hyper, seeds, old, policy):
        new = learner.init(hyper, run_key(*seeds), policy)
        return jax.tree.map(partial(jnp.where, fresh), new, old)

    def train(hyper, carry, steps):
        carry, metrics = learner.train_chunk(hyper, carry, steps)
        return carry, metrics["progress"]

    options = runtime.on_every_device(learner.compiler_options)
    return Program(
        start=jax.jit(jax.vmap(start), donate_argnums=3, compiler_options=options),
        train=jax.jit(jax.vmap(train, in_axes=(0, 0, None)), donate_argnums=1, compiler_options=options),
        finish=jax.jit(jax.vmap(partial(outcome, learner)), compiler_options=options),
    )


def outcome(learner: Learner, hyper: Any, carry: Any, seeds: tuple[jax.Array, jax.Array]) -> dict[str, Any]:
    """What is kept of a run that is over: its curve, final scores and policy."""
    curve, final = learner.results(hyper, carry, jax.random.fold_in(run_key(*seeds), 1))
    return {"curve": curve, "final": final | {"diverged": learner.diverged(carry)}, "policy": learner.policy(carry)}


def run_key(seed: jax.Array, number: jax.Array) -> jax.Array:
    """The key of a run: of the config's seed and the run's number alone, so that a point trains as it would alone."""
    return jax.random.fold_in(rng.key(seed), number)
