"""The nearest points of two segments, as MuJoCo finds them for capsules."""

from collections.abc import Sequence

import jax.numpy as jnp

from humanoid_mjx.mechanics.scalars import Scalar, Vector, add, dot, scale
from humanoid_mjx.mechanics.tree.algebra import combine, each_of, in_order, subtract, vector
from humanoid_mjx.mechanics.tree.kinematics import Kinematics
from humanoid_mjx.mechanics.tree.structure import Capsule

POINT = 1e-15
"""Half length of a ball's segment, m: balls are capsules so short."""


Segment = tuple[Vector, Vector]
"""The middle, and the way from there to an end."""


def nearest_points(first: Segment, second: Segment) -> tuple[Vector, Vector]:
    """The nearest points of two segments."""
    (one, along_one), (two, along_two) = first, second
    x, y = nearest_shares(along_one, along_two, subtract(one, two))
    return add(one, scale(x, along_one)), add(two, scale(y, along_two))


def segments(shapes: Sequence[Capsule], kinematics: Kinematics) -> Segment:
    """The segments of capsules, one after another, against the origin, m."""

    def placed(shape: Capsule) -> Segment:
        position, axes = kinematics.of_lane(shape.body, shape.lane)
        half = scale(Scalar(max(shape.half_length, POINT)), combine(axes, vector(shape.axis)))
        return add(position, combine(axes, vector(shape.center))), half

    found = each_of(shapes, placed)
    one, two = (Vector(*(in_order([segment[part][i] for segment in found]) for i in range(3))) for part in range(2))
    return one, two


def nearest_shares(a: Vector, b: Vector, apart: Vector) -> tuple[Scalar, Scalar]:
    """Nearest points of two segments, as shares from -1 to 1 of `a` and `b`, which lead from middles to ends.

    `apart` leads from the second middle to the first. The unbounded minimum, then one share clipped and the other
    anew, and again.
    """
    aa, ab, bb = dot(a, a), dot(a, b), dot(b, b)
    u, v = -dot(a, apart), dot(b, apart)
    # Parallel segments have many nearest points; the second's middle stands for them.
    determinant = aa * bb - ab * ab
    parallel = determinant.value <= 4.0 * jnp.finfo(jnp.result_type(float)).eps * (aa * bb).value
    free_x = (bb * u + ab * v).value / jnp.where(parallel, 1.0, determinant.value)
    free_y = (aa * v + ab * u).value / jnp.where(parallel, 1.0, determinant.value)
    x = jnp.clip(jnp.where(parallel, (u / aa).value, free_x), -1.0, 1.0)
    y = jnp.where((jnp.abs(free_x) > 1.0) | parallel, (v.value + x * ab.value) / bb.value, free_y)
    y, inside = jnp.clip(y, -1.0, 1.0), jnp.abs(y) <= 1.0
    again = jnp.clip((u.value + y * ab.value) / aa.value, -1.0, 1.0)
    return Scalar(jnp.where(inside, x, again)), Scalar(y)
