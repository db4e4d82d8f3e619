"""Rotations: unit quaternions (w x y z) and matrices, both from a body's frame to the world."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from humanoid_mjx.types import FloatScalar


def rotation_matrix(quaternion: Float[Array, "4"]) -> Float[Array, "3 3"]:
    """The matrix of a unit quaternion; its last row is the vertical, seen from the body."""
    w, x, y, z = quaternion
    return jnp.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def rotate(quaternion: Float[Array, "4"], vector: Float[Array, "3"]) -> Float[Array, "3"]:
    """A vector of the body in the world."""
    scalar, axis = quaternion[0], quaternion[1:]
    across = 2.0 * jnp.cross(axis, vector)
    return vector + scalar * across + jnp.cross(axis, across)


def product(one: Float[Array, "4"], other: Float[Array, "4"]) -> Float[Array, "4"]:
    """The unit quaternion of the rotation `other`, followed by `one`."""
    axis = one[0] * other[1:] + other[0] * one[1:] + jnp.cross(one[1:], other[1:])
    return jnp.concatenate([(one[0] * other[0] - one[1:] @ other[1:])[None], axis])


def turned_by(before: Float[Array, "4"], after: Float[Array, "4"]) -> Float[Array, "3"]:
    """The rotation between two unit quaternions as a vector along its axis, in the body, as long as its angle, rad."""
    scalar = before @ after
    axis = before[0] * after[1:] - after[0] * before[1:] - jnp.cross(before[1:], after[1:])
    axis = jnp.where(scalar < 0, -axis, axis)
    sine = jnp.sqrt(axis @ axis + 1e-30)
    return 2.0 * jnp.arctan2(sine, jnp.abs(scalar)) / sine * axis


def leaning_quaternion(heading: FloatScalar, lean: Float[Array, "2"]) -> Float[Array, "4"]:
    """Lean by small angles about the body's x and y, rad, then turn by `heading` about the vertical."""
    x, y = lean / 2
    half = jnp.stack([jnp.cos(heading / 2), jnp.sin(heading / 2)])
    return unit(jnp.stack([half[0], half[0] * x - half[1] * y, half[0] * y + half[1] * x, half[1]]))


def heading_frame(rotation: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """From the world to a frame that is upright and looks where the body's x axis points: forward, left and up."""
    forward = rotation[:2, 0] / (jnp.linalg.norm(rotation[:2, 0]) + 1e-9)
    cosine, sine, none = forward[0], forward[1], jnp.zeros_like(forward[0])
    return jnp.array([[cosine, sine, none], [-sine, cosine, none], [none, none, none + 1]])


def angular_velocity(
    rotation: Float[Array, "*bodies 3 3"], rate: Float[Array, "*bodies 3 3"]
) -> Float[Array, "*bodies 3"]:
    """Angular velocity in the world, rad/s, of a rotation that changes at `rate`: `rate rotation^T` is the cross
    product with it."""
    spin = jnp.einsum("...ij,...kj->...ik", rate, rotation)
    return jnp.stack([spin[..., 2, 1], spin[..., 0, 2], spin[..., 1, 0]], axis=-1)


def unit(vector: Float[Array, " n"]) -> Float[Array, " n"]:
    """The vector scaled to length 1; a zero vector stays zero."""
    return vector / (jnp.linalg.norm(vector) + 1e-9)
