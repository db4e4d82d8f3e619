"""Scatter-add that stays one scatter with flat indices under `jax.vmap`.

By default `jax.vmap` of `array.at[index].add(values)` makes indices of two numbers, run and row, with which XLA is half
as fast on a CPU.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Float, Int

from humanoid_mjx.compute.ways import ways


@custom_vmap
def add_at(array: Float[Array, "rows ..."], index: Int[Array, "..."], values: Float[Array, "..."]) -> Array:
    """`array.at[index].add(values)`, of one row or several. All must be there."""
    return array.at[index].add(values, mode="promise_in_bounds", wrap_negative_indices=False)


@add_at.def_vmap
def _(runs: int, batched: list[bool], *args: Any) -> tuple[Array, bool]:
    array, index, values = (
        jnp.asarray(x) if flag else jnp.broadcast_to(x, (runs, *jnp.shape(x)))
        for x, flag in zip(args, batched, strict=True)
    )
    rows = array.shape[1]
    if index.ndim > 1 or runs * rows > np.iinfo(np.int32).max:
        return jax.vmap(add_at.fun)(array, index, values), True
    place = jnp.arange(runs, dtype=jnp.int32) * rows + index
    if ways().additions_apart:
        place, values = jax.lax.optimization_barrier((place, values))
    flat = array.reshape(runs * rows, *array.shape[2:])
    flat = flat.at[place].add(values, mode="promise_in_bounds", unique_indices=True, wrap_negative_indices=False)
    return flat.reshape(array.shape), True
