"""Flags as bits of words."""

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx.mechanics.tree.bits import BITS, pack, unpack


def test_flags_come_back_from_their_words() -> None:
    rng = np.random.default_rng(0)
    shapes = [(2, 1)] * (BITS + 3) + [(BITS, 1, 1)] + [(3, 4, 2, 1)]
    order = rng.permutation(len(shapes))
    one, two = ({"a": flags[:20], "b": tuple(flags[20:])} for flags in _drawn(rng, [shapes[i] for i in order]))
    for flags in one, two:
        words = pack(flags)
        assert sorted(word.shape for word in words) == [(1, 1, 1), (2, 2, 1)]
        jax.tree.map(np.testing.assert_array_equal, unpack(words, one), flags)
    differ = [(a != b).any() for a, b in zip(pack(one), pack(two), strict=True)]
    assert all(differ)


def _drawn(rng: np.random.Generator, shapes: list[tuple[int, ...]]) -> list[list[jax.Array]]:
    return [[jnp.asarray(rng.random(shape) < 0.5) for shape in shapes] for _ in range(2)]
