"""Exploring: epsilon with the thesis's decay, a spread of epsilons over environments, random actions that are held."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from humanoid_mjx.types import FloatScalar


class Holding(NamedTuple):
    """The random choices that each environment still carries out."""

    steps_left: Int[Array, "envs joints"]
    action: Int[Array, "envs joints"]


def no_holding(envs: int, joints: int) -> Holding:
    """No random choice under way in any environment."""
    return Holding(*jnp.zeros((2, envs, joints), jnp.int32))


def opened(choices: Sequence[int], progress: FloatScalar | None) -> Bool[Array, "joints bins"]:
    """The choices that exist; with a `progress`, those that are open at this share of the training: 3, 5, 9 ..."""
    counts = np.array(choices)[:, None]
    place = np.arange(max(choices))
    exist = jnp.asarray(place < counts)
    if progress is None:
        return exist
    stages = np.ceil(np.log2(np.maximum(counts - 1, 2))).astype(int)
    stage = jnp.minimum(jnp.floor(progress * stages), stages - 1).astype(jnp.int32)
    stride = jnp.maximum((counts - 1) >> (1 + stage), 1)
    return exist & (place % stride == 0)


def epsilons(schedule: Any, episode: Int[Array, " envs"]) -> Float[Array, " envs"]:
    """Epsilon of each environment: `max(epsilon_min, epsilon * epsilon_decay**k)` in its own episode k, to a power.

    The power rises from 1 to 1 + epsilon_spread over the environments, so that some explore while others follow the
    greedy policy closely (D. Horgan et al., "Distributed Prioritized Experience Replay", 2018,
    section 4).
    """
    epsilon = jnp.maximum(schedule.epsilon_min, schedule.epsilon * schedule.epsilon_decay**episode)
    return epsilon ** (1.0 + schedule.epsilon_spread * jnp.linspace(0.0, 1.0, len(episode)))


def greedy(
    q: Float[Array, "*batch joints bins"], allowed: Bool[Array, "joints bins"], key: Key[Array, ""]
) -> Int[Array, "*batch joints"]:
    """The best choice of each joint; one at random among equally good ones."""
    q = jnp.where(allowed, q, -jnp.inf)
    ties = jax.random.uniform(key, q.shape)
    return _largest(jnp.where(q == q.max(axis=-1, keepdims=True), ties, -1.0))


def explore(
    best: Int[Array, "envs joints"],
    allowed: Bool[Array, "joints bins"],
    epsilon: Float[Array, " envs"],
    action_repeat: int,
    holding: Holding,
    key: Key[Array, ""],
) -> tuple[Int[Array, "envs joints"], Holding]:
    """Epsilon-greedy actions: each joint by itself takes a random choice with probability epsilon.

    It is held for 1 to `action_repeat` steps, drawn evenly (W. Dabney et al., "Temporally-Extended epsilon-Greedy
    Exploration", 2021, with another distribution of lengths).
    """
    start_key, action_key, length_key = jax.random.split(key, 3)
    starts = (holding.steps_left == 0) & (jax.random.uniform(start_key, best.shape) < epsilon[:, None])
    draws = jax.random.uniform(action_key, (len(best), *allowed.shape))
    random = _largest(jnp.where(allowed, draws, -1.0))
    length = jax.random.randint(length_key, best.shape, 1, action_repeat + 1)
    steps_left = jnp.where(starts, length, holding.steps_left)
    held = jnp.where(starts, random, holding.action)
    return jnp.where(steps_left > 0, held, best), Holding(jnp.maximum(steps_left - 1, 0), held)


def _largest(values: Float[Array, "*batch bins"]) -> Int[Array, "*batch"]:
    """Where the largest value stands, of equal ones the first: `jnp.argmax` of numbers that are all finite.

    That is one sum with two results, on which XLA aborts where it computes it in one kernel with others
    (`compute.options.XLA_FLAGS`).
    """
    count = values.shape[-1]
    place = jax.lax.broadcasted_iota(jnp.int32, values.shape, values.ndim - 1)
    return jnp.min(jnp.where(values == values.max(axis=-1, keepdims=True), place, count), axis=-1)
