"""The state of a robot as a control law may ask for it, and the points by which it touches the ground."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from humanoid_mjx.types import AnyArray, MassFactor


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


@dataclass(frozen=True)
class Stages:
    """Stages of the dynamics of one state. A stage that the controller does not ask for is not even traced.

    In the absence of contacts `matrix @ acceleration + bias = torque`, with zeros for the torque of the torso.
    """

    qpos: Float[AnyArray, "*worlds joints"]
    """Angles of the actuated joints, rad."""
    qvel: Float[AnyArray, "*worlds joints"]
    """rad/s"""
    dynamics: Callable[[], tuple[Any, Any]]
    """() -> the mass matrix of all degrees of freedom, whose last rows and columns are the joints'; and the bias:
    velocity term, gravity and the joints' damping."""
    contacts: Callable[[], Contacts]
    """() -> the corners of the feet that can touch the ground; no points where there is none."""
    model_for: Callable[[MassFactor], tuple[Float[Array, "nv nv"], Float[Array, " nv"]]]
    """(a model's mass factor) -> the mass matrix and the bias of that model."""
    joints: slice | Int[np.ndarray, " joints"]
    """Places of the actuated joints among the degrees of freedom."""
    inverse_dynamics: Callable[[Any, MassFactor], Any] | None = None
    """The same as `torque_for`, of physics that need no matrix for it."""

    def torque_for(self, qacc: Float[Array, " joints"], mass: MassFactor) -> Float[Array, " joints"]:
        """Return the torques that a model asks for, N m, for accelerations of the joints, rad/s^2, a free torso taken
        as fixed and contacts ignored. `mass` is the model's mass factor: a number, or one for each joint's link."""
        if self.inverse_dynamics:
            return self.inverse_dynamics(qacc, mass)
        matrix, bias = self.model_for(mass)
        return matrix[self.joints][:, self.joints] @ qacc + bias[self.joints]
