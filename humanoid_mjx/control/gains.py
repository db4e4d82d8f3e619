"""Gains of servos (thesis 5.5 and 5.6), and the step response of a second-order system (5.2), as it should read."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from humanoid_mjx.types import FloatScalar

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
    """The largest proportional gain that leaves the links' oscillations alone (5.36, 5.37): those of omega_0, rad/s,
    measured at the inertia I_0, kg m^2. `max_inertia` is the largest that the actuator sees."""
    resonance = structural_frequency * jnp.sqrt(jnp.asarray(inertia) / max_inertia)
    return (RESONANCE_SHARE * resonance) ** 2


NEAR_CRITICAL = 1e-3
"""|1 - damping ratio| within which a series takes the place of a quotient of two vanishing numbers."""


def step_response(
    time: Float[Array, "*times"], natural_frequency: FloatScalar, damping_ratio: FloatScalar
) -> Float[Array, "*times"]:
    """The response of `y'' + 2 zeta omega y' + omega^2 y = omega^2` from rest (5.4 to 5.6, corrected), 1 being its end;
    `time` in s, omega in rad/s, zeta at least 0.

    All three cases are one formula, smooth through zeta = 1:
    `y = 1 - exp(-zeta omega t) (C + zeta omega t S)` with C and S the cosine and sine-over-argument of
    `omega t sqrt(1 - zeta^2)`, hyperbolic ones beyond zeta = 1.
    """
    phase = natural_frequency * time
    square = (1.0 - damping_ratio**2) * phase**2
    decay = -damping_ratio * phase
    small = (jnp.abs(1.0 - damping_ratio) < NEAR_CRITICAL) | (square == 0.0)
    root = jnp.sqrt(jnp.where(small, 1.0, jnp.abs(square)))
    # Overdamped: exp(decay) cosh(root) overflows as a product of its factors, so it is a sum of two exponentials.
    slow, fast = jnp.exp(decay + root) / 2, jnp.exp(decay - root) / 2
    under = jnp.exp(decay) * jnp.cos(root), jnp.exp(decay) * jnp.sin(root) / root
    over = slow + fast, (slow - fast) / root
    series = (
        jnp.exp(decay) * (1 - square / 2 + square**2 / 24 - square**3 / 720),
        jnp.exp(decay) * (1 - square / 6 + square**2 / 120 - square**3 / 5040),
    )
    cosine, sine = (
        jnp.where(small, s, jnp.where(square > 0, u, o)) for s, u, o in zip(series, under, over, strict=True)
    )
    return 1.0 - cosine + decay * sine
