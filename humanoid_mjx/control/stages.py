"""The state of a robot as a control law may ask for it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Array, Float, Int

from humanoid_mjx.mechanics.contacts import Contacts
from humanoid_mjx.types import AnyArray, MassFactor


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
