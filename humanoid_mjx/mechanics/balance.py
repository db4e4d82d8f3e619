"""Balance on level ground: centre of mass, zero-moment point, support polygon (sections 4.5 and 4.8).

The thesis asks that the zero-moment point stay in the polygon of the feet and prints no formula. These are the standard
ones (Vukobratovic and Borovac, International Journal of Humanoid Robotics 1, 2004): the ground must give the wrench
that the links' weights and accelerations require, and the zero-moment point is where this wrench has no moment about a
level axis. As long as the feet can give it, the point is the centre of pressure of the contact forces and lies in their
convex hull.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from humanoid_mjx.thesis.leg import GRAVITY
from humanoid_mjx.types import AnyArray, FloatScalar


class LinkMotion(NamedTuple):
    """Rigid bodies and how they move, in the world, z up."""

    mass: Float[AnyArray, "*batch links"]
    """kg"""
    inertia: Float[AnyArray, "*batch links 3 3"]
    """Inertia of each link about its centre of mass, kg m^2."""
    position: Float[AnyArray, "*batch links 3"]
    """Position of each link's centre of mass, m."""
    acceleration: Float[AnyArray, "*batch links 3"]
    """Acceleration of each link's centre of mass, m/s^2."""
    angular_velocity: Float[AnyArray, "*batch links 3"]
    """rad/s"""
    angular_acceleration: Float[AnyArray, "*batch links 3"]
    """rad/s^2"""


def center_of_mass(mass: Float[AnyArray, "*batch links"], position: Float[AnyArray, "*batch links 3"]) -> Array:
    """The common centre of mass, (*batch, 3), m."""
    share = mass / jnp.sum(mass, axis=-1, keepdims=True)
    return jnp.sum(share[..., None] * position, axis=-2)


def ground_wrench(motion: LinkMotion, gravity: float = GRAVITY) -> tuple[Array, Array]:
    """What the ground must give for this motion: force, N, and moment about the world's origin, N m; (*batch, 3) each.

    `f = sum m (a + g z)` and `n = sum c x m (a + g z) + I alpha + omega x I omega`.
    """
    mass, inertia, position, acceleration, omega, alpha = (jnp.asarray(x) for x in motion)
    forces = mass[..., None] * (acceleration + jnp.array([0.0, 0.0, gravity]))
    spin = jnp.einsum("...ij,...j->...i", inertia, omega, precision="highest")
    turning = jnp.einsum("...ij,...j->...i", inertia, alpha, precision="highest") + jnp.cross(omega, spin)
    return forces.sum(axis=-2), (jnp.cross(position, forces) + turning).sum(axis=-2)


def zero_moment_point(force: Float[AnyArray, "*batch 3"], moment: Float[AnyArray, "*batch 3"]) -> Array:
    """Where on the plane z = 0 a wrench has no moment about x and y, (*batch, 2), m.

    Args:
      force: force, N, in the world's frame, z up.
      moment: moment about the world's origin, N m.

    Returns:
      x and y; NaN where the force does not push the ground, as in flight.
    """
    up = force[..., 2]
    pushes = up > 0
    point = jnp.stack([-moment[..., 1], moment[..., 0]], axis=-1) / jnp.where(pushes, up, 1.0)[..., None]
    return jnp.where(pushes[..., None], point, jnp.nan)


def support_margin(
    point: Float[AnyArray, "2"], corners: Float[AnyArray, "corners 2"], touching: Bool[AnyArray, " corners"]
) -> FloatScalar:
    """How far a point is inside the support polygon, the convex hull of the corners that touch, m.

    Negative outside it: the distance to the polygon. With less than three corners it is an edge or a point, which has
    no inside; with none the margin is minus infinity.
    """
    corners = jnp.asarray(corners)
    pair = touching[:, None] & touching
    along = corners - corners[:, None]
    length = jnp.linalg.norm(along, axis=-1)
    proper = pair & (length > 0)
    unit = along / jnp.where(proper, length, 1.0)[..., None]
    # Seen from corner i towards corner j: how far along the line, and how far to its left.
    place = jnp.clip(_dot(point - corners[:, None], unit), 0.0, length)
    to_point = _left(unit, point - corners[:, None])
    to_corners = _left(unit[:, :, None], corners - corners[:, None, None])
    edge = proper & ((to_corners > -1e-7) | ~touching).all(axis=-1)
    has_area = (proper[..., None] & touching & (jnp.abs(to_corners) > 1e-7)).any()
    inside = jnp.min(jnp.where(edge, to_point, jnp.inf))
    nearest = corners[:, None] + place[..., None] * unit
    outside = jnp.min(jnp.where(pair, jnp.linalg.norm(point - nearest, axis=-1), jnp.inf))
    return jnp.where(has_area & (inside >= 0), inside, -outside)


def support_polygon(corners: Float[np.ndarray, "corners 2"]) -> Float[np.ndarray, "hull 2"]:
    """The convex hull of corners that touch, anticlockwise, outside jax (Andrew's monotone chain)."""
    ordered = sorted(set(map(tuple, np.asarray(corners, float).tolist())))
    if len(ordered) < 3:
        return np.array(ordered).reshape(-1, 2)
    hull: list[tuple[float, float]] = []
    for way in (ordered, ordered[::-1]):
        start = len(hull)
        for corner in way:
            while len(hull) - start > 1 and _turn(hull[-2], hull[-1], corner) <= 0:
                hull.pop()
            hull.append(corner)
        hull.pop()
    return np.array(hull)


def _dot(a: Array, b: Array) -> Array:
    return jnp.sum(a * b, axis=-1)


def _left(unit: Array, arm: Array) -> Array:
    return unit[..., 0] * arm[..., 1] - unit[..., 1] * arm[..., 0]


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
