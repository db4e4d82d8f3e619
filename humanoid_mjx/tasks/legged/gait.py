"""The clock of a gait, and open-loop stepping on the spot as a motion for a learner to correct."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from humanoid_mjx.spec import Spec, traced
from humanoid_mjx.types import BoolScalar, FloatScalar

LEGS_APART = np.array([0.0, 0.5])
"""Where in the period the right and the left foot's turns begin."""

SHORTENED = np.array([1.0, 0.0, 0.0, 2.0, -1.0])
"""Hip pitch, yaw, roll, knee and ankle of a leg that becomes shorter under the hip while its foot stays level."""


class Gait(Spec):
    """Both feet swing once in a period, the left half a period after the right one.

    `reference` is a motion about the posture that steps on the spot; with `lift` and `sway` 0 there is none, and only
    the clock is left. Derive from it for another. The defaults are for a learner to correct: under the soft servo of
    `walk` nobody stays up by them alone. Under one of 20 N m/rad and 0.45 N m s/rad a period of 0.32 s with a stance of
    0.62, a lift of 9 degrees and a sway of -2 steps by itself: of 64 bodies 59 are up after 6 s. There the hips roll
    against the shift of weight, which lags half a cycle behind them at this pace.
    """

    period: float = traced(0.5, gt=0.05, le=5, description="s of a step with each foot")
    stance: float = traced(0.6, ge=0.5, lt=1, description="share of the period in which a foot is to stand")
    lift: float = traced(12.0, ge=0, le=60, description="of the hip's pitch in mid-swing, degrees")
    sway: float = traced(0.0, ge=-30, le=30, description="of the hips' roll towards the standing foot, degrees")

    def after(self, phase: FloatScalar, moving: BoolScalar, seconds: FloatScalar) -> FloatScalar:
        """The phase, 0 to 1, so much later; it waits at 0 while the body stands."""
        return jnp.where(moving, jnp.mod(phase + seconds / self.period, 1.0), 0.0)

    def swing(self, phase: FloatScalar) -> Float[Array, "2"]:
        """How far up each foot should be: half a sine in its turn, otherwise 0."""
        share = jnp.mod(phase - LEGS_APART, 1.0) / (1.0 - self.stance)
        return jnp.where(share < 1.0, jnp.sin(jnp.pi * jnp.minimum(share, 1.0)), 0.0)

    def reference(self, phase: FloatScalar, moving: BoolScalar) -> Float[Array, " joints"]:
        """The motion about the posture, rad; 0 while the body stands."""
        lifted = self.lift * self.swing(phase)[:, None] * SHORTENED
        roll = self.sway * jnp.sin(2 * jnp.pi * phase) * np.array([[1.0], [-1.0]]) * (np.arange(5) == 2)
        return jnp.where(moving, jnp.radians(lifted + roll).reshape(-1), 0.0)
