"""Flags of worlds as bits of words.

A loop carries words rather than flags: a GPU's thread has room for seven flags and packs others one by one, and XLA:CPU
keeps a byte for each.
"""

from collections import Counter
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int32

BITS = 31
"""Flags in a word, whose sign stays 0."""


class Bits(NamedTuple):
    """The places of a pytree's flags. Flags of one shape share words of that shape."""

    structure: Any
    places: list[tuple[Any, int]]
    """Keys of words, and bits."""

    @classmethod
    def of(cls, flags: Any) -> "Bits":
        """The places of these flags, and of others like them."""
        leaves, structure = jax.tree.flatten(flags)
        places, count = [], Counter[tuple[int, ...]]()
        for leaf in leaves:
            word, bit = divmod(count[leaf.shape], BITS)
            places.append(((leaf.shape, word), bit))
            count[leaf.shape] += 1
        return cls(structure, places)

    def pack(self, flags: Any) -> list[Int32[Array, "..."]]:
        """The words of these flags."""
        words: dict[Any, Any] = {}
        for (key, bit), flag in zip(self.places, jax.tree.leaves(flags), strict=True):
            value = jnp.where(flag, np.int32(1 << bit), np.int32(0))
            words[key] = words[key] | value if key in words else value
        return list(words.values())

    def unpack(self, words: list[Int32[Array, "..."]]) -> Any:
        """The flags of these words."""
        found = dict(zip(dict.fromkeys(key for key, _ in self.places), words, strict=True))
        return self.structure.unflatten([found[key] & np.int32(1 << bit) != 0 for key, bit in self.places])
