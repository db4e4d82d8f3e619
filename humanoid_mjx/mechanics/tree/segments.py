"""The nearest points of two segments, as MuJoCo finds them for capsules."""

import jax.numpy as jnp

from humanoid_mjx.mechanics.scalars import Scalar, Vector, add, dot, scale
from humanoid_mjx.mechanics.tree.algebra import subtract
from humanoid_mjx.mechanics.tree.kinematics import Kinematics
from humanoid_mjx.mechanics.tree.structure import Capsule, Pair


def nearest_points(pair: Pair, kinematics: Kinematics) -> tuple[Vector, Vector]:
    """Of the segments of two capsules, against the origin; a ball's is its centre."""
    (one, along_one), (two, along_two) = (_segment(shape, kinematics) for shape in (pair.one, pair.two))
    apart = subtract(one, two)
    if pair.one.half_length and pair.two.half_length:
        x, y = _both(along_one, along_two, apart)
        return add(one, scale(x, along_one)), add(two, scale(y, along_two))
    if pair.one.half_length:
        return add(one, scale(_clipped(-dot(along_one, apart), dot(along_one, along_one)), along_one)), two
    if pair.two.half_length:
        return one, add(two, scale(_clipped(dot(along_two, apart), dot(along_two, along_two)), along_two))
    return one, two


def _segment(shape: Capsule, kinematics: Kinematics) -> tuple[Vector, Vector]:
    """The middle, and from there to the end."""
    axis = kinematics.direction(shape.body, shape.axis)
    return kinematics.place(shape.body, shape.center), scale(Scalar(shape.half_length), axis)


def _both(a: Vector, b: Vector, apart: Vector) -> tuple[Scalar, Scalar]:
    """Where on each: from -1 to 1. The unbounded minimum, then one clipped and the other anew, and again."""
    aa, ab, bb = dot(a, a), dot(a, b), dot(b, b)
    u, v = -dot(a, apart), dot(b, apart)
    # Parallel segments have many nearest points; the second's middle stands for them.
    determinant = aa * bb - ab * ab
    parallel = determinant.value <= 4.0 * jnp.finfo(determinant.value.dtype).eps * (aa * bb).value
    free_x = (bb * u + ab * v).value / jnp.where(parallel, 1.0, determinant.value)
    free_y = (aa * v + ab * u).value / jnp.where(parallel, 1.0, determinant.value)
    x = jnp.clip(jnp.where(parallel, (u / aa).value, free_x), -1.0, 1.0)
    y = jnp.where((jnp.abs(free_x) > 1.0) | parallel, (v.value + x * ab.value) / bb.value, free_y)
    y, inside = jnp.clip(y, -1.0, 1.0), jnp.abs(y) <= 1.0
    again = jnp.clip((u.value + y * ab.value) / aa.value, -1.0, 1.0)
    return Scalar(jnp.where(inside, x, again)), Scalar(y)


def _clipped(numerator: Scalar, denominator: Scalar) -> Scalar:
    return Scalar(jnp.clip((numerator / denominator).value, -1.0, 1.0))
