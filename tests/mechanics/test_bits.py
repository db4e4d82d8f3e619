"""Flags as bits of words."""

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx.mechanics.tree.bits import BITS, Bits


def test_flags_come_back_from_their_words() -> None:
    rng = np.random.default_rng(0)
    shapes = [(2, 5)] * (BITS + 3) + [(5,)] * BITS + [(3, 2, 5)]
    order = rng.permutation(len(shapes))
    one, two = ({"a": flags[:40], "b": tuple(flags[40:])} for flags in _drawn(rng, [shapes[i] for i in order]))
    bits = Bits.of(one)
    for flags in one, two:
        words = bits.pack(flags)
        assert sorted(word.shape for word in words) == sorted([(2, 5), (2, 5), (5,), (3, 2, 5)])
        jax.tree.map(np.testing.assert_array_equal, bits.unpack(words), flags)
    differ = [(a != b).any() for a, b in zip(bits.pack(one), bits.pack(two), strict=True)]
    assert all(differ)


def _drawn(rng: np.random.Generator, shapes: list[tuple[int, ...]]) -> list[list[jax.Array]]:
    return [[jnp.asarray(rng.random(shape) < 0.5) for shape in shapes] for _ in range(2)]
