"""The nearest points of two segments, as MuJoCo finds them for capsules."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from humanoid_mjx.mechanics.tree.algebra import dot, numbers, stacked, turn
from humanoid_mjx.mechanics.tree.kinematics import Kinematics
from humanoid_mjx.mechanics.tree.structure import Capsule

POINT = 1e-15
"""Half length of a ball's segment, m: balls are capsules so short."""


Segment = tuple[Any, Any]
"""The middle, and the way from there to an end."""


def capsules(shapes: Sequence[Capsule], kinematics: Kinematics) -> tuple[Segment, np.ndarray]:
    """The segments of capsules, one after another, against the origin, m, and their radii, m."""

    def placed(shape: Capsule) -> Segment:
        position, axes = kinematics.of_lane(shape.body, shape.lane)
        half = max(shape.half_length, POINT) * turn(axes, numbers(shape.axis))
        return position + turn(axes, numbers(shape.center)), half

    made = {shape: placed(shape) for shape in dict.fromkeys(shapes)}
    one, two = (stacked([made[shape][part] for shape in shapes]) for part in range(2))
    return (one, two), np.stack([numbers(shape.radius) for shape in shapes])


def nearest_shares(a: Any, b: Any, apart: Any) -> tuple[Any, Any]:
    """Nearest points of two segments, as shares from -1 to 1 of `a` and `b`, which lead from middles to ends.

    `apart` leads from the second middle to the first. The unbounded minimum, then one share clipped and the other
    anew, and again.
    """
    aa, ab, bb = dot(a, a), dot(a, b), dot(b, b)
    u, v = -dot(a, apart), dot(b, apart)
    # Parallel segments have many nearest points; the second's middle stands for them.
    determinant = aa * bb - ab * ab
    parallel = determinant <= 4.0 * jnp.finfo(jnp.result_type(float)).eps * (aa * bb)
    whole = jnp.where(parallel, 1.0, determinant)
    free_x, free_y = (bb * u + ab * v) / whole, (aa * v + ab * u) / whole
    x = jnp.clip(jnp.where(parallel, u / aa, free_x), -1.0, 1.0)
    y = jnp.where((jnp.abs(free_x) > 1.0) | parallel, (v + x * ab) / bb, free_y)
    y, inside = jnp.clip(y, -1.0, 1.0), jnp.abs(y) <= 1.0
    again = jnp.clip((u + y * ab) / aa, -1.0, 1.0)
    return jnp.where(inside, x, again), y
