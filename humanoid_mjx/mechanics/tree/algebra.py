"""Additions to `mechanics.scalars` for trees: pytrees of scalars, 3x3 matrices, spatial vectors."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx.mechanics.scalars import NULL, ONE, ZERO, Scalar, Symmetric, Vector, add, cross, dot, scale
from humanoid_mjx.mechanics.tree import structure
from humanoid_mjx.mechanics.tree.structure import Axes, Table

FEW_PAIRS = 8
"""Above so many pairs, equal bodies' scalars are shared (`each_of`), and pairs are looked at in a loop. The lower body
has 5."""


def _flatten(scalar: Scalar) -> tuple[tuple[Any, ...], float | None]:
    return ((), scalar.value) if isinstance(scalar.value, float) else ((scalar.value,), None)


jax.tree_util.register_pytree_node(
    Scalar, _flatten, lambda known, children: Scalar(*children if children else (known,))
)
"""Numbers that are known while tracing are structure, those that are traced are leaves."""

WORLD = (1,)
"""The shape of a traced scalar: one world, in the last axis. Axes of contacts and of lanes are before it."""

Tree = TypeVar("Tree")

Rotation = tuple[Vector, Vector, Vector]
"""The axes of a frame in the world: the columns of its rotation matrix."""

UNTURNED: Rotation = (Vector(ONE, ZERO, ZERO), Vector(ZERO, ONE, ZERO), Vector(ZERO, ZERO, ONE))


class Spatial(NamedTuple):
    """A motion or a force about one origin, in axes of the world.

    Of a motion: the velocity of the body's point at the origin, and its angular velocity. Of a force: the force, and
    its moment about the origin.
    """

    linear: Vector
    angular: Vector


NOWHERE = Spatial(NULL, NULL)


def isotropic(value: Scalar) -> Symmetric:
    """`value` times the identity."""
    return Symmetric(xx=value, yy=value, zz=value)


def outer(factor: Scalar, v: Vector) -> Symmetric:
    """`factor v v^T`."""
    scaled = scale(factor, v)
    return Symmetric(scaled.x * v.x, scaled.x * v.y, scaled.x * v.z, scaled.y * v.y, scaled.y * v.z, scaled.z * v.z)


def subtract(a: Vector, b: Vector) -> Vector:
    """The difference of two vectors."""
    return Vector(a.x - b.x, a.y - b.y, a.z - b.z)


def vector(values: Any) -> Vector:
    """From three numbers, or an array of them."""
    return Vector(*(number(value) for value in values))


def number(value: Any) -> Scalar:
    """A scalar of a number, known while tracing, of a table, or of a traced value."""
    if isinstance(value, Table):
        return known(np.asarray(value.values).reshape(value.shape))
    return Scalar(float(value)) if isinstance(value, float | int) else Scalar(value)


def known(values: Any) -> Scalar:
    """A scalar of an array that is known while tracing, with `WORLD` behind; a number if all agree."""
    values = np.asarray(values, np.float64)
    if (values == values.flat[0]).all():
        return Scalar(float(values.flat[0]))
    return Scalar(values[..., None].astype(jnp.result_type(float)))


def in_lanes(scalars: Sequence[Scalar]) -> Scalar:
    """One scalar of each lane as one; a single one stays as it is."""
    if len(scalars) == 1:
        return scalars[0]
    if all(isinstance(scalar.value, float) for scalar in scalars):
        return known([scalar.value for scalar in scalars])
    values = [jnp.asarray(scalar.value, float) for scalar in scalars]
    return Scalar(jnp.stack(jnp.broadcast_arrays(*(v if v.ndim else v[None] for v in values))))


def in_order(scalars: Sequence[Scalar]) -> Scalar:
    """Scalars with an axis that counts them."""
    if all(isinstance(scalar.value, float) for scalar in scalars):
        return known([scalar.value for scalar in scalars])
    return in_lanes(scalars) if len(scalars) > 1 else Scalar(jnp.atleast_1d(scalars[0].value)[None])


def stacked(scalars: Sequence[Scalar]) -> Any:
    """An array of scalars without lanes, with a first axis that counts them."""
    values = [jnp.broadcast_to(jnp.asarray(scalar.value, float), WORLD) for scalar in scalars]
    return jnp.stack(values) if values else jnp.zeros((0, *WORLD))


def lane(scalar: Scalar, index: int) -> Scalar:
    """Value of a laned body's scalar in one lane."""
    return scalar if jnp.ndim(scalar.value) < 2 else Scalar(scalar.value[..., index, :])


def in_lane(thing: Tree, index: int) -> Tree:
    """A pytree of scalars of a laned body in one lane."""
    return jax.tree.map(lambda part: lane(part, index), thing, is_leaf=lambda part: isinstance(part, Scalar))


def folded(scalars: Sequence[Scalar], places: Sequence[tuple[int, ...]]) -> list[Scalar]:
    """The tree's coordinates or degrees of freedom, those of lanes together, from `qpos` or `qvel`."""
    return [in_lanes([scalars[index] for index in lanes]) for lanes in places]


def unfolded(things: Sequence[Any], places: Sequence[tuple[int, ...]]) -> list[Any]:
    """The inverse of `folded`; also of pytrees of scalars, such as those of bodies."""
    found = {index: in_lane(s, i) for s, lanes in zip(things, places, strict=True) for i, index in enumerate(lanes)}
    return [found[index] for index in range(len(found))]


def each_of(things: Sequence[Any], make: Callable[[Any], Any]) -> list[Any]:
    """Return what is made of each thing; of more than `FEW_PAIRS` things equal ones share it.

    Sharing makes a program smaller. It makes the lower body's slower by a fifth: XLA then stores what it would have
    computed again within each loop.
    """
    if len(things) <= FEW_PAIRS:
        return [make(thing) for thing in things]
    made = {thing: make(thing) for thing in dict.fromkeys(things)}
    return [made[thing] for thing in things]


def entry_at(values: Any, index: Any) -> Any:
    """The entry of the first axis at an index."""
    # Of indices that may be negative, each look-up would be traced at length.
    return jax.lax.dynamic_index_in_dim(values, index.astype(jnp.uint32), keepdims=False)


def with_entry(values: Any, index: Any, new: Any) -> Any:
    """The array with another entry at an index of the first axis."""
    return jax.lax.dynamic_update_index_in_dim(values, new, index.astype(jnp.uint32), 0)


def in_turn(function: Callable[..., Tree], *rows: Any, count: Any) -> Tree:
    """`function` of pytrees of scalars with an axis of rows, which it does not mix.

    The first `count` rows are taken in turn, and what others give is 0: a loop's code stays in the cache of
    instructions.
    """
    leaves, structure = jax.tree.flatten(rows)
    size, _ = jnp.broadcast_shapes(*(leaf.shape for leaf in leaves))
    leaves = [jnp.broadcast_to(leaf, (size, 1)) for leaf in leaves]

    def some(index: Any) -> Tree:
        return function(*structure.unflatten([entry_at(leaf, index) for leaf in leaves]))

    return filled(some, size, count)[1]


def filled(row: Callable[[Any], Tree], size: Any, count: Any) -> tuple[Any, Tree]:
    """How many rows are filled, and `row` of each of the first `count` indices as a pytree of arrays of this size,
    which are else 0."""

    def further(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        each = zip(carry[1], jax.tree.leaves(row(carry[0])), strict=True)
        return carry[0] + 1, [with_entry(array, carry[0], new) for array, new in each]

    leaves, structure = jax.tree.flatten(jax.eval_shape(row, jnp.int32(0)))
    start = jnp.int32(0), [jnp.zeros((size, *leaf.shape), leaf.dtype) for leaf in leaves]
    filled, found = jax.lax.while_loop(lambda carry: carry[0] < count, further, start)
    return filled, structure.unflatten(found)


def over_lanes(tree: structure.Tree, scalars: Sequence[Scalar]) -> list[Scalar]:
    """The sums over the lanes; a scalar without the axis is the same in all lanes."""

    def one(scalar: Scalar) -> Scalar:
        value = scalar.value
        if jnp.ndim(value) < 2:
            return scalar * Scalar(float(tree.lanes))
        if value.shape[-2] == tree.lanes:
            return Scalar(value.sum(axis=-2))
        return Scalar(value[..., 0, :]) * Scalar(float(tree.lanes))

    return [one(scalar) for scalar in scalars]


def summed(thing: Tree, sums: Callable[[Sequence[Scalar]], list[Scalar]]) -> Tree:
    """A pytree of scalars, by a function of all of them."""
    scalars, structure = jax.tree.flatten(thing, is_leaf=lambda part: isinstance(part, Scalar))
    return structure.unflatten(sums(scalars))


def known_axes(axes: Axes) -> Rotation:
    """Axes of numbers that are known while tracing."""
    x, y, z = (vector(axis) for axis in axes)
    return x, y, z


def combine(axes: Rotation, v: Vector) -> Vector:
    """A vector of a frame in the world: the sum of the frame's axes times its components."""
    return Vector(*(dot((axes[0][i], axes[1][i], axes[2][i]), v) for i in range(3)))


def resolve(axes: Rotation, v: Vector) -> Vector:
    """A vector of the world in a frame: its components along the frame's axes."""
    return Vector(*(dot(axis, v) for axis in axes))


def compose(axes: Rotation, other: Rotation) -> Rotation:
    """The axes, in the world, of a frame that is turned by `other` against the frame of `axes`."""
    one, two, three = (combine(axes, axis) for axis in other)
    return one, two, three


def total(motions: Sequence[Spatial]) -> Spatial:
    """The sum of spatial vectors."""
    linear = angular = NULL
    for motion in motions:
        linear, angular = add(linear, motion.linear), add(angular, motion.angular)
    return Spatial(linear, angular)


def times(factor: Scalar, s: Spatial) -> Spatial:
    """A number times a spatial vector."""
    return Spatial(scale(factor, s.linear), scale(factor, s.angular))


def power(motion: Spatial, force: Spatial) -> Scalar:
    """The scalar product of a motion and a force."""
    return dot(motion.linear, force.linear) + dot(motion.angular, force.angular)


def velocity_at(motion: Spatial, point: Vector) -> Vector:
    """The velocity of a body's point at `point`, which is given against the origin."""
    return add(motion.linear, cross(motion.angular, point))


def force_at(force: Vector, point: Vector) -> Spatial:
    """A force that acts at `point`, about the origin."""
    return Spatial(force, cross(point, force))


def root(value: Scalar) -> Scalar:
    """The square root."""
    return Scalar(jnp.sqrt(value.value))


def root_over(value: Scalar) -> Scalar:
    """The square root's inverse."""
    return Scalar(jax.lax.rsqrt(value.value))
