"""Flags of worlds as bits of words.

A loop carries words rather than flags: a GPU's thread has room for seven flags and packs others one by one, and XLA:CPU
keeps a byte for each.
"""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

BITS = 31
"""Flags in a word, whose sign stays 0."""

WEIGHTS = np.left_shift(1, np.arange(BITS, dtype=np.int32))[:, None, None]


def pack(flags: Any) -> list[Any]:
    """The words of a pytree of flags (..., lanes, 1), of which those of one number of lanes share words. Behind them
    come its arrays that are no flags, as they are."""
    found = []
    for own in _by_lanes(flags).values():
        each = jnp.concatenate([flag.reshape(-1, *flag.shape[-2:]) for flag in own])
        parts = (each[first : first + BITS] for first in range(0, len(each), BITS))
        found.append(
            jnp.stack([jnp.where(part, WEIGHTS[: len(part)], 0).sum(axis=0, dtype=np.int32) for part in parts])
        )
    return [*found, *(leaf for leaf in jax.tree.leaves(flags) if leaf.dtype != bool)]


def unpack(words: list[Any], like: Any) -> Any:
    """The flags of these words; `like`: flags of the same shapes."""
    leaves, structure = jax.tree.flatten(like)
    groups, parts = _by_lanes(like), {}
    for (lanes, own), each in zip(groups.items(), words, strict=False):
        flags = ((each[:, None] & WEIGHTS) != 0).reshape(-1, lanes, 1)
        parts[lanes] = iter(jnp.split(flags, np.cumsum([math.prod(flag.shape[:-2]) for flag in own])))
    others = iter(words[len(groups) :])
    found = (next(parts[leaf.shape[-2]]).reshape(leaf.shape) if leaf.dtype == bool else next(others) for leaf in leaves)
    return structure.unflatten(found)


def _by_lanes(flags: Any) -> dict[int, list[Any]]:
    found: dict[int, list[Any]] = {}
    for flag in (leaf for leaf in jax.tree.leaves(flags) if leaf.dtype == bool):
        found.setdefault(flag.shape[-2], []).append(flag)
    return found
