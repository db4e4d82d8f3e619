"""Arrays of one world: vectors, matrices and spatial vectors, and loops over them.

The last two axes of an array are those of the lanes, 1 where all lanes agree, and of the world. Those of components
are before them: a vector is (..., 3, lanes, 1), a rotation (..., 3, 3, lanes, 1), a number (..., lanes, 1).

A spatial vector is a motion or a force about one origin, in axes of the world, (..., 6, lanes, 1). Of a motion: the
velocity of the body's point at the origin, and its angular velocity. Of a force: the force, and its moment.
"""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from humanoid_mjx.mechanics.tree.structure import Table, Tree

FEW_PAIRS = 8
"""Above so many pairs, pairs are looked at in a loop. The lower body has 5."""

EYE = np.eye(3)[..., None, None]

Thing = TypeVar("Thing")


def numbers(values: Any, behind: tuple[int, ...] = (1,)) -> np.ndarray:
    """Nested tuples of numbers and tables as an array; `behind`: axes behind those of a table."""
    if isinstance(values, Table):
        return np.reshape(values.values, (*values.shape, *behind)).astype(jnp.result_type(float))
    if isinstance(values, tuple):
        return np.stack(np.broadcast_arrays(*(numbers(value, behind) for value in values)))
    return np.full((1, 1), values, jnp.result_type(float))


def column(parts: Sequence[Any]) -> Any:
    """A vector of its components."""
    return jnp.stack(jnp.broadcast_arrays(*parts), axis=-3)


def stacked(parts: Sequence[Any]) -> Any:
    """Arrays with a first axis that counts them."""
    return jnp.stack(jnp.broadcast_arrays(*parts))


def dot(a: Any, b: Any) -> Any:
    """The scalar product of two vectors, or of a motion and a force."""
    return _sum(a * b, -3)


def cross(a: Any, b: Any) -> Any:
    """The vector product."""
    return _next(a * _next(b) - _next(a) * b)


def scale(factor: Any, v: Any) -> Any:
    """Numbers times vectors."""
    return _with_axis(factor, -3) * v


def turn(matrix: Any, v: Any) -> Any:
    """The product of a matrix and a vector."""
    return _sum(matrix * _with_axis(v, -4), -3)


def compose(a: Any, b: Any) -> Any:
    """The product of two matrices."""
    return _sum(_with_axis(a, -3) * _with_axis(b, -5), -4)


def _next(v: Any) -> Any:
    """The components y, z, x."""
    if isinstance(v, np.ndarray):
        return np.roll(v, -1, axis=-3)
    axis = v.ndim - 3
    return lax.concatenate([lax.slice_in_dim(v, 1, 3, axis=axis), lax.slice_in_dim(v, 0, 1, axis=axis)], axis)


def _with_axis(x: Any, axis: int) -> Any:
    # A third of the time that `x[..., None]` takes to trace.
    return np.expand_dims(x, axis) if isinstance(x, np.ndarray) else lax.expand_dims(x, (x.ndim + 1 + axis,))


def _sum(x: Any, axis: int) -> Any:
    return x.sum(axis=axis) if isinstance(x, np.ndarray) else lax.reduce_sum(x, (x.ndim + axis,))


def transposed(matrix: Any) -> Any:
    """The matrix with rows and columns exchanged; of a rotation its inverse."""
    return matrix.swapaxes(-4, -3)


def symmetric(matrix: Any) -> Any:
    """A symmetric matrix of its lower triangle, so that no kernel computes the other."""
    size = matrix.shape[-3]
    return jnp.where(np.tri(size, dtype=bool)[..., None, None], matrix, transposed(matrix))


def joined(*parts: Any) -> Any:
    """Vectors one after another, as the two of a spatial vector."""
    whole = jnp.broadcast_shapes(*(part.shape[-2:] for part in parts))
    return jnp.concatenate([jnp.broadcast_to(part, (*part.shape[:-2], *whole)) for part in parts], axis=-3)


def block(a: Any, b: Any, c: Any, d: Any) -> Any:
    """The 6x6 matrix of the blocks `a b` above `c d`."""
    a, b, c, d = jnp.broadcast_arrays(a, b, c, d)
    rows = [jnp.concatenate(row, axis=-3) for row in ((a, b), (c, d))]
    return jnp.concatenate(rows, axis=-4)


def velocity_at(motion: Any, point: Any) -> Any:
    """The velocity of a body's point at `point`, which is given against the origin."""
    linear, angular = motion[..., :3, :, :], motion[..., 3:, :, :]
    return linear + cross(angular, point)


def force_at(force: Any, point: Any) -> Any:
    """A force that acts at `point`, about the origin."""
    return joined(force, cross(point, force))


def in_lane(thing: Thing, index: int) -> Thing:
    """A pytree of arrays in one lane."""
    return jax.tree.map(lambda v: v[..., index : index + 1, :] if v.shape[-2] > 1 else v, thing)


def folded(array: Any, places: Sequence[tuple[int, ...]]) -> list[Any]:
    """The tree's coordinates or degrees of freedom, those of lanes together, from `qpos` or `qvel`: (count, 1, 1)."""
    each = jnp.unstack(array)
    return [jnp.concatenate([each[index] for index in lanes]) for lanes in places]


def unfolded(things: Sequence[Any], places: Sequence[tuple[int, ...]]) -> list[Any]:
    """Each lane's own in the order of `places`, which `folded` has put together; also of pytrees."""
    found = {index: in_lane(thing, i) for thing, at in zip(things, places, strict=True) for i, index in enumerate(at)}
    return [found[index] for index in range(len(found))]


def over_lanes(tree: Tree, array: Any) -> Any:
    """The sums over the lanes."""
    return array.sum(axis=-2, keepdims=True) if array.shape[-2] == tree.lanes else array * float(tree.lanes)


def entry_at(values: Any, index: Any) -> Any:
    """The entry of the first axis at an index."""
    # Of indices that may be negative, each look-up would be traced at length.
    return jax.lax.dynamic_index_in_dim(values, index.astype(jnp.uint32), keepdims=False)


def with_entry(values: Any, index: Any, new: Any) -> Any:
    """The array with another entry at an index of the first axis."""
    return jax.lax.dynamic_update_index_in_dim(values, new, index.astype(jnp.uint32), 0)


def filled(row: Callable[[Any], Thing], size: Any, count: Any) -> tuple[Any, Thing]:
    """Return the number of filled rows, and `row` of each of the first `count` indices as a pytree of arrays of this
    size, which are else 0: a loop's code stays in the cache of instructions."""

    def further(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        each = zip(carry[1], jax.tree.leaves(row(carry[0])), strict=True)
        return carry[0] + 1, [with_entry(array, carry[0], new) for array, new in each]

    leaves, structure = jax.tree.flatten(jax.eval_shape(row, jnp.int32(0)))
    start = jnp.int32(0), [jnp.zeros((size, *leaf.shape), leaf.dtype) for leaf in leaves]
    filled, found = jax.lax.while_loop(lambda carry: carry[0] < count, further, start)
    return filled, structure.unflatten(found)
