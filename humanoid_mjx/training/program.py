"""The compiled programs of a group of sweep points: a learner, vmapped over runs and spread over the devices."""

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from humanoid_mjx import rng
from humanoid_mjx.learners import Learner
from humanoid_mjx.training.evaluation import greedy_episode

CHUNK_STEPS = 512
"""Training steps between two looks at the progress."""


class Program(NamedTuple):
    """Functions over a block of runs; every array has a leading axis of runs, a multiple of the number of devices."""

    init: Callable[..., Any]
    """(hyper, run keys' (seed, seed number), policies or None) -> training states."""
    train: Callable[[Any, Any], tuple[Any, Any]]
    """(hyper, training states) -> training states CHUNK_STEPS later, and progress. The old states are given up."""
    finish: Callable[..., dict[str, Any]]
    """(hyper, training states, (seed, seed number)) -> curves, final scores, policies."""


@lru_cache(maxsize=64)
def compile_program(learner: Learner) -> Program:
    """The programs for one structure of learner (`Spec.structure`)."""
    runs = PartitionSpec("runs")
    mesh = Mesh(np.array(jax.devices()), ("runs",))
    spread = partial(jax.shard_map, mesh=mesh, in_specs=runs, out_specs=runs, check_vma=False)

    def init(hyper, seeds, policy):
        return learner.init(hyper, run_key(*seeds), policy)

    def train(hyper, carry):
        carry, metrics = learner.train_chunk(hyper, carry, CHUNK_STEPS)
        return carry, metrics["progress"]

    def finish(hyper, carry, seeds):
        policy = learner.policy(carry)
        final = greedy_episode(learner, hyper, policy, jax.random.fold_in(run_key(*seeds), 1))
        finite = jnp.stack([jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(policy)]).all()
        return {"curve": learner.curve(hyper, carry), "final": final | {"diverged": ~finite}, "policy": policy}

    return Program(
        init=jax.jit(spread(jax.vmap(init))),
        train=jax.jit(spread(jax.vmap(train)), donate_argnums=1),
        finish=jax.jit(spread(jax.vmap(finish))),
    )


def run_key(seed: jax.Array, number: jax.Array) -> jax.Array:
    """The key of a run: of the config's seed and the run's seed number alone, so that a point trains as it would alone."""
    return jax.random.fold_in(rng.key(seed), number)
