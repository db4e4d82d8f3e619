"""Functions of many worlds, whose axis is the last, as functions of one world.

A scalar of many worlds is then contiguous whatever axes of lanes or contacts it has before, which `jax.vmap` by itself
would put behind.
"""

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap


@lru_cache
def worlds_last(function: Callable[..., Any], *static: Any) -> Callable[..., Any]:
    """`function`, with `static` for its first arguments, as one of a single world.

    Under `jax.vmap` it gets all worlds at once, in the last axis of what differs by world.
    It takes and gives pytrees of arrays, and must not mix worlds. What it gives may lack the axis where all agree.
    Derivatives are those of one world after another. It is traced once for each number of worlds, whatever programs
    use it.
    """
    function = jax.jit(partial(function, *static))

    def single(*args: Any) -> Any:
        found = function(*jax.tree.map(lambda x: jnp.asarray(x)[..., None], args))
        return jax.tree.map(lambda x: x[..., 0] if jnp.ndim(x) else jnp.asarray(x), found)

    def rule(worlds: int, batched: Any, *args: Any) -> tuple[Any, Any]:
        flags = jax.tree.leaves(batched)
        leaves, structure = jax.tree.flatten(args)
        leaves = [jnp.moveaxis(x, 0, -1) if flag else x for x, flag in zip(leaves, flags, strict=True)]
        found = function(*structure.unflatten(leaves))
        found = jax.tree.map(lambda x: jnp.moveaxis(jnp.broadcast_to(x, (*jnp.shape(x)[:-1], worlds)), -1, 0), found)
        return found, jax.tree.map(lambda _: True, found)

    batched = custom_vmap(single)
    batched.def_vmap(rule)

    @jax.custom_jvp
    def call(*args: Any) -> Any:
        return batched(*args)

    @call.defjvp
    def _(primals: Any, tangents: Any) -> tuple[Any, Any]:
        return jax.jvp(single, primals, tangents)

    return call
