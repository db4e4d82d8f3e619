"""Exploring: epsilon with the thesis's decay, and a spread of epsilons over environments. Tables decay their own."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from humanoid_mjx.types import AnyArray


def epsilons(schedule: Any, episode: Int[Array, " envs"]) -> Float[Array, " envs"]:
    """Epsilon of each environment, `max(epsilon_min, epsilon * epsilon_decay**k) ** power`, k being its own episode.

    The power rises from 1 to 1 + epsilon_spread over the environments, so that some explore while others follow the
    greedy policy closely (D. Horgan et al., "Distributed Prioritized Experience Replay", 2018,
    section 4).
    """
    epsilon = jnp.maximum(schedule.epsilon_min, schedule.epsilon * schedule.epsilon_decay**episode)
    return epsilon ** (1.0 + schedule.epsilon_spread * jnp.linspace(0.0, 1.0, len(episode)))


def greedy(
    q: Float[Array, "*batch joints bins"], allowed: Bool[AnyArray, "joints bins"], key: Key[Array, ""]
) -> Int[Array, "*batch joints"]:
    """The best choice of each joint; one at random among equally good ones."""
    q = jnp.where(allowed, q, -jnp.inf)
    ties = jax.random.uniform(key, q.shape)
    return _largest(jnp.where(q == q.max(axis=-1, keepdims=True), ties, -1.0))


def explore(
    best: Int[Array, "envs joints"],
    allowed: Bool[AnyArray, "joints bins"],
    epsilon: Float[Array, " envs"],
    key: Key[Array, ""],
) -> Int[Array, "envs joints"]:
    """Epsilon-greedy actions: each joint independently takes a random choice with probability epsilon."""
    explore_key, action_key = jax.random.split(key)
    explores = jax.random.uniform(explore_key, best.shape) < epsilon[:, None]
    draws = jax.random.uniform(action_key, (len(best), *allowed.shape))
    return jnp.where(explores, _largest(jnp.where(allowed, draws, -1.0)), best)


def _largest(values: Float[Array, "*batch bins"]) -> Int[Array, "*batch"]:
    """Return the index of the largest value, the first of equal ones: `jnp.argmax` for finite numbers.

    `jnp.argmax` is a reduction with two results, on which XLA aborts if it fuses several of them
    (`compute.options.XLA_FLAGS`).
    """
    count = values.shape[-1]
    place = jax.lax.broadcasted_iota(jnp.int32, values.shape, values.ndim - 1)
    return jnp.min(jnp.where(values == values.max(axis=-1, keepdims=True), place, count), axis=-1)
