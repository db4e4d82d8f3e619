"""A central pattern generator for both legs (section 4.7 names one and prints no equations).

Each leg has a phase oscillator. The two pull each other into antiphase,

    theta_right' = 2 pi f + k sin(theta_left - theta_right - pi),    theta_left' the same with the legs exchanged,

and the gait, read at a leg's phase, gives its joints. Frequency and amplitude follow their commands as critically
damped systems of second order, so that the joints' velocities stay continuous when a command jumps. All of this has a
closed solution while the commands stand, which `step` uses: steps of any length are exact.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from humanoid_mjx.mechanics.gaits import Gait
from humanoid_mjx.types import FloatScalar

IN_STEP = jnp.pi
"""By how much the left leg's phase leads the right one's, rad."""


class Params(NamedTuple):
    """The commands and constants of the generator. All values may be traced and may change between steps."""

    gait: Gait
    frequency: FloatScalar
    """Command: periods per second."""
    amplitude: FloatScalar = 1.0
    """Command: 1 is the gait as in its table, 0 its mean posture."""
    coupling: FloatScalar = 4.0
    """k, 1/s."""
    response: FloatScalar = 8.0
    """Rate at which frequency and amplitude follow their commands: the double pole's distance from 0, 1/s."""


class Follower(NamedTuple):
    """A quantity on its way to a command."""

    value: Float[Array, ""]
    rate: Float[Array, ""]


class State(NamedTuple):
    """State of the generator: the phases of its two oscillators, and the followers of its commands."""

    phase: Float[Array, "2"]
    """Phases of the right and the left leg, rad in [0, 2 pi)."""
    frequency: Follower
    amplitude: Follower


def init(params: Params, phase: FloatScalar = 0.0, lead: FloatScalar = IN_STEP) -> State:
    """Return the state at the commanded frequency in the mean posture, the right leg at `phase`, the left leg `lead`
    ahead of it, rad.
    """
    dtype = params.gait.coefficients.dtype
    still = jnp.zeros((), dtype)
    return State(
        phase=jnp.mod(jnp.stack([jnp.asarray(phase, dtype), jnp.asarray(phase + lead, dtype)]), 2 * jnp.pi),
        frequency=Follower(jnp.asarray(params.frequency, dtype), still),
        amplitude=Follower(still, still),
    )


def step(params: Params, state: State, dt: FloatScalar) -> State:
    """The state `dt` seconds later, the commands standing."""
    frequency, turns = _follow(state.frequency, params.frequency, params.response, dt)
    amplitude, _ = _follow(state.amplitude, params.amplitude, params.response, dt)
    off = state.phase[1] - state.phase[0] - IN_STEP
    before = jnp.arctan2(jnp.sin(off), jnp.cos(off))  # the left leg's distance from antiphase, rad in [-pi, pi]
    after = 2 * jnp.arctan2(jnp.sin(before / 2) * jnp.exp(-2 * params.coupling * dt), jnp.cos(before / 2))
    right = state.phase[0] + 2 * jnp.pi * turns + (before - after) / 2
    phase = jnp.mod(jnp.stack([right, right + IN_STEP + after]), 2 * jnp.pi)
    return State(phase, frequency, amplitude)


def posture(params: Params, state: State) -> Float[Array, "2 5"]:
    """The joints of the right and the left leg in a state, rad."""
    gait, middle = params.gait, mean_posture(params.gait)
    per_radian = gait.period / (2 * jnp.pi)
    legs = jnp.stack([gait.at(phase * per_radian).position for phase in state.phase])
    return middle + state.amplitude.value * (legs - middle)


def mean_posture(gait: Gait) -> Float[Array, "5"]:
    """The joints' averages over a period, rad."""
    spans = jnp.diff(gait.knots)
    powers = spans[:, None] ** jnp.arange(1, 5, dtype=spans.dtype) / jnp.arange(1, 5, dtype=spans.dtype)
    return jnp.einsum("sk,skj->j", powers, gait.coefficients, precision="highest") / gait.period


def _follow(
    state: Follower, command: FloatScalar, response: FloatScalar, dt: FloatScalar
) -> tuple[Follower, Float[Array, ""]]:
    """A critically damped follower `dt` later, and its integral over that time."""
    error, decay = state.value - command, jnp.exp(-response * dt)
    drift = state.rate + response * error
    later, rate = (error + drift * dt) * decay, (state.rate - response * drift * dt) * decay
    integral = command * dt - ((rate - state.rate) / response + 2 * (later - error)) / response
    return Follower(command + later, rate), integral
