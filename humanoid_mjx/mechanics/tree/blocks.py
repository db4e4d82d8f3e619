"""The search of many worlds on a CPU, block by block."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from humanoid_mjx.mechanics.tree.problem import Problem, worlds_of
from humanoid_mjx.mechanics.tree.search import search
from humanoid_mjx.mechanics.tree.structure import Tree

MOST_STEPS = 20
"""Newton steps before a world is given up. From cold the worst of 10,000 random states of the lower body needs 8."""

BLOCK = 128
"""Worlds that are searched together on a CPU."""

FIRST_STEPS = 3
"""Newton steps of all worlds of a block, before those that are left are gathered into others."""


def search_blocks(tree: Tree, problem: Problem, start: list[Any]) -> tuple[list[Any], Any]:
    """`search`; of more worlds than a block holds, on a CPU, block by block and in two passes.

    Worlds of a block wait for the slowest of them. So after `FIRST_STEPS` those that are not settled, and those where
    bodies are close, are gathered into blocks of their own, of which only the first compute pairs.
    """
    worlds = worlds_of(problem, start)
    if worlds <= (BLOCK,) or jax.default_backend() != "cpu":
        return search(tree, problem, start, MOST_STEPS)

    def part(things: Any, pick: Callable[[Any], Any]) -> Any:
        return jax.tree.map(lambda v: pick(v) if jnp.shape(v)[-1:] == worlds else v, things)

    def first(begin: Any) -> tuple[list[Any], Any]:
        own, before = part((problem._replace(pairs=[]), start), lambda v: _block(v, begin))
        return search(tree, own, before, FIRST_STEPS)

    close = [flag for touch in problem.pairs for flag in touch.close]
    near = functools.reduce(jnp.logical_or, close, jnp.zeros(worlds, bool))
    nothing = [jnp.zeros((*jnp.shape(v)[:-1], *worlds), v.dtype) for v in start], near
    x, settled = _by_blocks(first, -(-worlds[0] // BLOCK), nothing)
    left = near | ~settled
    # Of indices that may be negative, each look-up would be traced at length.
    order = jnp.argsort(jnp.where(near, 0, jnp.where(left, 1, 2))).astype(jnp.uint32)

    def second(begin: Any) -> tuple[list[Any], Any]:
        at = _block(order, begin)
        own, before = part((problem, x), lambda v: v[..., at])
        return search(tree, own, before, MOST_STEPS)

    found = _by_blocks(second, (left.sum() + (BLOCK - 1)) // BLOCK, (x, settled))
    back = jnp.argsort(order).astype(jnp.uint32)
    return jax.tree.map(lambda new, old: jnp.where(left, new[..., back], old), found, (x, settled))


def _by_blocks(search: Callable[[Any], Any], blocks: Any, found: Any) -> Any:
    """Write what `search` gives for blocks, by their first worlds, over `found`; the last may overlap another."""

    def block(index: Any, found: Any) -> Any:
        begin = index * BLOCK

        def write(whole: Any, part: Any) -> Any:
            return jax.lax.dynamic_update_slice_in_dim(whole, part, begin, axis=-1)

        return jax.tree.map(write, found, search(begin))

    return jax.lax.fori_loop(0, blocks, block, found)


def _block(value: Any, begin: Any) -> Any:
    return jax.lax.dynamic_slice_in_dim(value, begin, BLOCK, axis=-1)
