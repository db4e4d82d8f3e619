"""Servo gains: natural frequency, damping, and what the structure's resonance allows (thesis 5.5 and 5.6)."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from humanoid_mjx.spec import InputError

RESONANCE_SHARE = 0.5
"""Largest natural frequency as a share of the lowest resonance (5.37)."""


def damping_ratio(kp: Float[Array, "*joints"], kd: Float[Array, "*joints"]) -> Float[Array, "*joints"]:
    """zeta = kd / (2 sqrt(kp)) (5.34)."""
    return kd / (2.0 * jnp.sqrt(kp))


def critical_kd(kp: Float[Array, "*joints"]) -> Float[Array, "*joints"]:
    """The derivative gain of critical damping, 2 sqrt(kp) (5.35, 5.49)."""
    return 2.0 * jnp.sqrt(kp)


def poles(kp: Float[Array, "*joints"], kd: Float[Array, "*joints"]) -> Float[Array, "2 ..."]:
    """The two real roots of s^2 + kd s + kp, the slow one first (5.3); NaN where they are complex."""
    root = jnp.sqrt(kd**2 - 4.0 * kp)
    # The slow root as a quotient: the difference of two nearly equal numbers would lose its digits.
    return jnp.stack([-2.0 * kp / (kd + root), -(kd + root) / 2.0])


def max_kp(structural_frequency: Any, inertia: Any, max_inertia: Any) -> Float[Array, "*joints"]:
    """The largest proportional gain that leaves the links' oscillations alone (5.36, 5.37).

    Args:
      structural_frequency: omega_0 of the links, rad/s, measured at
      inertia: I_0, kg m^2.
      max_inertia: the largest inertia that the actuator sees, kg m^2.

    Raises:
      InputError: a value that is not positive.
    """
    values = {"structural_frequency": structural_frequency, "inertia": inertia, "max_inertia": max_inertia}
    for name, value in values.items():
        array = np.asarray(value, np.float64)
        if not (np.isfinite(array) & (array > 0)).all():
            raise InputError(f"{name} must be finite and greater than 0, got {array.tolist()}.")
    resonance = structural_frequency * jnp.sqrt(jnp.asarray(inertia) / max_inertia)
    return (RESONANCE_SHARE * resonance) ** 2
