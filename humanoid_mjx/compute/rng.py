"""A cheap random number generator behind the standard `jax.random` functions.

`jax.random`'s own generator (threefry, 20 rounds) costs more than everything else in a step of tabular Q-learning.
`key(seed)` makes a key of a lighter, counter-based generator instead: word `i` drawn from the 64-bit key `(k0, k1)` is
`mix(mix(k0 + i * G) ^ (k1 + stream))`, where `mix` is a 32-bit finaliser found by automated search for low bias (C.
Wellons, "Prospecting for hash functions", 2018: constants 7feb352d, 846ca68b) and `G` is the odd number nearest 2**32 /
golden ratio. Streams keep draws, splits and folds apart. It is not a cryptographic generator; its tests of uniformity
and independence across agents and steps are in `tests/compute/test_rng.py`.
"""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.random import define_prng_impl
from jaxtyping import Array, Float, Key, UInt32

from humanoid_mjx.spec import InputError, shown

_GOLDEN = np.uint32(0x9E3779B9)
_DRAW, _SPLIT, _FOLD = np.uint32(0), np.uint32(0x632BE5AB), np.uint32(0xC2B2AE35)


def _mix(x: UInt32[Array, "..."]) -> UInt32[Array, "..."]:
    x = (x ^ (x >> 16)) * np.uint32(0x7FEB352D)
    x = (x ^ (x >> 15)) * np.uint32(0x846CA68B)
    return x ^ (x >> 16)


def _words(key: UInt32[Array, "2"], counter: UInt32[Array, "..."], stream: np.uint32) -> UInt32[Array, "..."]:
    return _mix(_mix(key[0] + counter * _GOLDEN) ^ (key[1] + stream))


def _counter(shape: tuple[int, ...]) -> UInt32[Array, "..."]:
    return jax.lax.iota(jnp.uint32, math.prod(shape)).reshape(shape)


def _random_bits(key: UInt32[Array, "2"], bit_width: int, shape: tuple[int, ...]) -> Array:
    if bit_width == 64:
        high, low = _words(key, _counter((2, *shape)), _DRAW).astype(jnp.uint64)
        return (high << 32) | low
    return _words(key, _counter(shape), _DRAW).astype(f"uint{bit_width}")


def _split(key: UInt32[Array, "2"], shape: tuple[int, ...]) -> UInt32[Array, "... 2"]:
    return _words(key, _counter((*shape, 2)), _SPLIT)


def _fold_in(key: UInt32[Array, "2"], data: Any) -> UInt32[Array, "2"]:
    counter = jnp.asarray(data).astype(jnp.uint32)
    return jnp.stack([_words(key, counter, _FOLD), _words(key, counter, _FOLD + np.uint32(1))])


def _seed(seed: Array) -> UInt32[Array, "2"]:
    return _split(jnp.stack([seed.astype(jnp.uint32), jnp.uint32(0)]), ())


FAST = define_prng_impl(
    key_shape=(2,), seed=_seed, split=_split, random_bits=_random_bits, fold_in=_fold_in, name="fast", tag="fast"
)


def key(seed: int | Array) -> Key[Array, ""]:
    """A key of the cheap generator, for every function of `jax.random`. InputError: no 32-bit integer."""
    number = isinstance(seed, (int, np.integer))
    if not (-(2**31) <= seed < 2**32 if number else jnp.issubdtype(getattr(seed, "dtype", float), np.integer)):
        raise InputError(f"key: the seed must be an integer from -2**31 to 2**32 - 1, got {shown(seed)}.")
    return jax.random.key(seed, impl=FAST)


def check_key(what: str, key: Any) -> None:
    """Raise an InputError unless this is one key, of `jax.random.key` or `jax.random.PRNGKey`."""
    dtype = getattr(key, "dtype", np.dtype(float))
    if dtype != np.uint32 and not jnp.issubdtype(dtype, jax.dtypes.prng_key):
        seed = key if isinstance(key, int) else 0
        raise InputError(f"{what}: the last argument must be a key of jax.random, got {shown(key)}; pass key({seed}).")
    if len(key.shape) != (dtype == np.uint32):
        raise InputError(f"{what}: there must be one key, got keys of shape {key.shape}; map over them by jax.vmap.")


def uniform(key: Key[Array, ""], number: UInt32[Array, ""]) -> Float[Array, ""]:
    """The uniform number in [0, 1) that stands at place `number` in `jax.random.uniform(key, (n,))`, for a key of this
    generator. Scalars compile to fewer and faster loops than an array."""
    word = _words(jax.random.key_data(key), number, _DRAW)
    return jax.lax.bitcast_convert_type((word >> 9) | np.uint32(0x3F800000), jnp.float32) - 1.0
