"""Terminations: conditions that end an episode of a legged task before its time."""

import jax.numpy as jnp

from humanoid_mjx.spec import Spec, traced
from humanoid_mjx.tasks.legged.view import View
from humanoid_mjx.types import BoolScalar


class Fall(Spec):
    """Limits beyond which a body has fallen: it lies, or is about to."""

    tilt: float = traced(45.0, gt=0, le=180, description="lean of the torso, degrees")
    height: float = traced(0.6234, ge=0, le=2, description="of the hips, as a share of that at home")

    def fallen(self, view: View) -> BoolScalar:
        """Return whether the torso leans farther or the hips are lower than these."""
        return (view.up[2] < jnp.cos(jnp.radians(self.tilt))) | (view.height < self.height * view.robot.leg_length)
