"""Everything that depends on the kind of device, apart from kernels and XLA's options: a table for each kind, and an
addition that the kinds do in two ways."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Float, Int


class Ways(NamedTuple):
    """Choices between two ways to compute the same, by speed, and sizes of batches; the defaults are those of a GPU."""

    worlds: int = 32_768
    """Largest number of worlds to move side by side: more gain nothing, and fewer report sooner."""
    steps_unrolled: bool = True
    """The time steps of a decision follow each other in one pass of a loop."""
    resets_apart: bool = False
    """The episodes that end begin anew by themselves, and not all with a choice."""
    additions_apart: bool = True
    """Additions to an array are a kernel of their own: in one with what they add, the array would be copied first."""
    short_numbers: bool = True
    """Products of matrices take bfloat16 where they may."""
    columns_filled: bool = True
    """Matrices are filled up to a number of columns that the device likes."""
    loss_by_parts: bool = True
    """The loss of a batch is that of its parts, side by side."""
    draws_ahead: bool = False
    """Random numbers are drawn before it is known which of two is needed: one waits for the other no longer."""
    devices_share_runs: bool = False
    """Several devices may train one run, where there are fewer runs."""
    width_rounds: bool = False
    """True if the number of networks side by side changes their last bits, so that a plan fixes it."""


CPU = Ways(
    worlds=1024,
    steps_unrolled=False,
    resets_apart=True,
    additions_apart=False,
    short_numbers=False,
    columns_filled=False,
    loss_by_parts=False,
    draws_ahead=True,
    devices_share_runs=True,
    width_rounds=True,
)


def ways() -> Ways:
    """Return the ways of jax's default backend."""
    return CPU if jax.default_backend() == "cpu" else Ways()


@custom_vmap
def add_at(array: Float[Array, "rows ..."], index: Int[Array, "..."], values: Float[Array, "..."]) -> Array:
    """`array.at[index].add(values)`, of one row or several. All must be there.

    Under `jax.vmap` it stays one scatter with flat indices. By default `jax.vmap` makes indices of two numbers, run and
    row, with which XLA is half as fast on a CPU.
    """
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
