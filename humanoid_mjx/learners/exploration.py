"""Exploring: epsilon and temperature with the thesis's decay and a spread over environments, choices of joints and in a
table's row."""

from functools import reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from humanoid_mjx.spec import LARGEST, SMALLEST
from humanoid_mjx.types import AnyArray, FloatScalar, IntScalar

QRow = tuple[FloatScalar, ...]
"""The values of one row of a table."""


def amounts(schedule: Any, episode: Int[Array, " envs"]) -> Float[Array, " envs"]:
    """Epsilon of each environment, `max(epsilon_min, epsilon * epsilon_decay**k) ** power`, k being its own episode, or
    so its temperature.

    The power rises from 1 to 1 + epsilon_spread over the environments, so that some explore while others follow the
    greedy policy closely (D. Horgan et al., "Distributed Prioritized Experience Replay", 2018, section 4).
    """
    start = schedule.temperature if schedule.exploration == "boltzmann" else schedule.epsilon
    amount = jnp.maximum(schedule.epsilon_min, start * schedule.epsilon_decay**episode)
    return amount ** (1.0 + schedule.epsilon_spread * jnp.linspace(0.0, 1.0, len(episode)))


def chances(
    learner: Any, q: Float[Array, "*batch joints bins"], amount: Float[Array, "*batch"]
) -> Float[Array, "*batch joints bins"]:
    """The probability of each choice of each joint: epsilon-greedy, or that of an action in proportion to
    exp(Q / temperature). Q is the mean of the joints' values, so that each joint chooses by itself."""
    q, amount = jnp.where(learner.allowed, q, -jnp.inf), amount[..., None, None]
    if learner.exploration == "boltzmann":
        return jax.nn.softmax(q / (q.shape[-2] * jnp.maximum(amount, SMALLEST)))
    best = q == q.max(axis=-1, keepdims=True)
    greedy, random = (x / x.sum(axis=-1, keepdims=True) for x in (best, learner.allowed))
    return (1.0 - amount) * greedy + amount * random


def drawn_choices(chances: Float[Array, "*batch joints bins"], key: Key[Array, ""]) -> Int[Array, "*batch joints"]:
    """A choice of each joint by its probabilities."""
    return _largest(jnp.log(chances) + jax.random.gumbel(key, chances.shape))


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


def entry(row: tuple[Array, ...], index: IntScalar) -> Array:
    """The entry of a row at an index, by comparisons: an array would be a slow loop."""
    found = row[0]
    for place, x in enumerate(row[1:], start=1):
        found = jnp.where(index == place, x, found)
    return found


def softmax(values: QRow, temperature: FloatScalar) -> QRow:
    """The odds of each action in a row, 1 for the best. Kernels and XLA round a power alike, but no exponential."""
    best, temperature = reduce(jnp.maximum, values), jnp.maximum(temperature, SMALLEST)
    return tuple(np.float32(np.e) ** ((value - best) / temperature) for value in values)


def drawn(odds: QRow, draw: FloatScalar) -> IntScalar:
    """The action that a uniform number in [0, 1) draws by these odds."""
    mark, passed, action = draw * sum(odds), odds[0], jnp.int32(0)
    for each in odds[1:]:
        action, passed = action + (mark >= passed), passed + each
    return action


def upper_bounds(values: QRow, visits: QRow, confidence: FloatScalar) -> QRow:
    """`Q + confidence * sqrt(log(sum of visits) / visits)`, the largest number where there are none (P. Auer et al.,
    "Finite-time Analysis of the Multiarmed Bandit Problem", 2002)."""
    log = _log(jnp.maximum(sum(visits), 1.0))
    bonuses = [confidence * jnp.sqrt(log / jnp.maximum(n, 1.0)) for n in visits]
    return tuple(jnp.where(n > 0, q + bonus, LARGEST) for q, n, bonus in zip(values, visits, bonuses, strict=True))


def _log(x: FloatScalar) -> FloatScalar:
    """The natural logarithm of x >= 1 with a relative error of 1e-5, in operations that kernels and XLA round alike."""
    word = jax.lax.bitcast_convert_type(x, jnp.int32)
    part = jax.lax.bitcast_convert_type((word & 0x7FFFFF) | 0x3F800000, jnp.float32)  # x = part * 2**exponent
    exponent = ((word >> 23) - 127).astype(jnp.float32)
    ratio = (part - 1.0) / (part + 1.0)  # log(part) = 2 artanh(ratio)
    square = ratio * ratio
    series = 1.0 + square * (1 / 3 + square * (1 / 5 + square * (1 / 7 + square / 9)))
    return exponent * np.float32(np.log(2)) + 2.0 * ratio * series
