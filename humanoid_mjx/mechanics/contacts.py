"""The points by which a robot touches the ground, and how they move with its joints."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from humanoid_mjx.types import AnyArray


class Contacts(NamedTuple):
    """Points of the feet that the ground can push, in the world.

    Each that touches removes three degrees of freedom, but those of one foot are not independent, as it is rigid: four
    or three corners remove six, the two of an edge five (the foot can tip over it), one removes three.
    """

    position: Float[AnyArray, "*worlds points 3"]
    """m"""
    jacobian: Float[AnyArray, "*worlds points 3 nv"]
    """Jacobian: from velocities of the robot to those of the points."""
    drift: Float[AnyArray, "*worlds points 3"]
    """Acceleration of the points where the robot's accelerations are 0, m/s^2."""
    touching: Bool[AnyArray, "*worlds points"]
    """True for points at the ground's height or below, where the ground pushes."""


def no_contacts(nv: int) -> Contacts:
    """The contacts of a robot without ground: no points."""
    none = jnp.zeros((0, 3))
    return Contacts(none, jnp.zeros((0, 3, nv)), none, jnp.zeros(0, bool))


def jacobian_of(
    position: Float[Array, "points 3"],
    moved_by: Bool[AnyArray, "points nv"],
    motion: Float[Array, "nv 6"],
    origin: Float[AnyArray, "3"],
) -> Float[Array, "points 3 nv"]:
    """Jacobian of points of the bodies, m, world. `moved_by`: which degrees of freedom move a point's body. `motion`:
    by degree of freedom, angular then linear, of a body's point at `origin`, m, world (MuJoCo's `cdof`)."""
    columns = motion[:, 3:] + jnp.cross(motion[:, :3], (position - origin)[:, None])
    return jnp.swapaxes(jnp.where(moved_by[..., None], columns, 0.0), -1, -2)
