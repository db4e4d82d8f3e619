"""Chapter 5's formulas as printed: responses of second order, the geared joint, the rate of the servo error.

No values are printed for most of their symbols. Each is compared at values that are drawn with the postures.
"""

import numpy as np

from humanoid_mjx.reproduction.printed.erratum import Erratum, Formula, States
from humanoid_mjx.thesis import leg as thesis

LONGEST_S = 1.0
"""Longest time of the responses, s."""


def _between(low: float, high: float, angles: np.ndarray) -> np.ndarray:
    """Random values of a range: angles of the full circle, stretched over it."""
    return low + (high - low) * (angles + np.pi) / (2 * np.pi)


def _response(states: States) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, s, natural frequencies of Table 5.1's gains, rad/s, and damping ratios below 1."""
    slowest, fastest = np.sqrt(min(thesis.KP)), np.sqrt(max(thesis.KP))
    times, frequencies = _between(0.0, LONGEST_S, states.q[0]), _between(slowest, fastest, states.q[1])
    return times, frequencies, _between(0.1, 0.9, states.q[2])


def overdamped(states: States) -> np.ndarray:
    """(5.4)"""
    times, frequency, ratio = _response(states)
    ratio = 1.0 + ratio
    root = np.sqrt(ratio**2 - 1)
    fast, slow = np.exp(-(ratio + root) * frequency * times), np.exp(-(ratio - root) * frequency * times)
    return 1 - ((root - ratio) * fast + (root + ratio) * slow) / (2 * root)


def _overdamped_from_roots(states: States) -> np.ndarray:
    """From the two roots of (5.3), which are the exponents."""
    times, frequency, ratio = _response(states)
    ratio = 1.0 + ratio
    first, second = -ratio * frequency + np.array([[1], [-1]]) * frequency * np.sqrt(ratio**2 - 1)
    return 1 - (second * np.exp(first * times) - first * np.exp(second * times)) / (second - first)


def critical(states: States) -> np.ndarray:
    """(5.5)"""
    phase = np.prod(_response(states)[:2], axis=0)
    return 1 - (1 - np.exp(-phase) - phase * np.exp(-phase))


def _critical(states: States) -> np.ndarray:
    phase = np.prod(_response(states)[:2], axis=0)
    return 1 - np.exp(-phase) - phase * np.exp(-phase)


def _underdamped(factor: float) -> Formula:
    """(5.6) with 1 over `factor` times the root before the exponential."""

    def response(states: States) -> np.ndarray:
        times, frequency, ratio = _response(states)
        root = np.sqrt(1 - ratio**2)
        phase = frequency * root * times + np.arctan2(root, ratio)
        return 1 - np.exp(-ratio * frequency * times) / (factor * root) * np.sin(phase)

    return response


def _gain(states: States) -> np.ndarray:
    """The end value of (5.1) for a set-point of 1."""
    b0 = _between(1.0, 10.0, states.q[3])
    return b0 / (1 + b0)


def _geared(states: States) -> tuple[np.ndarray, ...]:
    """Gear ratio, inertia and friction of rotor and link, and the joint's acceleration and speed."""
    ranges = ((1.0, 100.0), (1e-8, 1e-6), (1e-4, 1e-2), (1e-8, 1e-6), (1e-4, 1e-2))
    ratio, *rest = (_between(low, high, angles) for (low, high), angles in zip(ranges, states.q, strict=True))
    return ratio, *rest, states.qdd[0], states.qd[0]


def at_the_motor(states: States) -> np.ndarray:
    """(5.13) times the gear ratio: the motor's torque at the joint."""
    ratio, rotor, link, bearing, friction, qacc, qvel = _geared(states)
    return ratio * ((rotor + link / ratio**2) * ratio * qacc + (bearing + friction / ratio**2) * ratio * qvel)


def at_the_joint(states: States) -> np.ndarray:
    """(5.14)"""
    ratio, rotor, link, bearing, friction, qacc, qvel = _geared(states)
    return (link + ratio**2 * rotor) * qacc + (friction + ratio**2 * bearing) * qvel


def _rate_error(of: str) -> Formula:
    """(5.43): the planned rate less the joint's angle or its rate, both of the states' own random numbers."""
    return lambda states: states.qdd - (states.q if of == "angle" else states.qd)


ERRATA = (
    Erratum(
        "(5.1), what a set-point of 1 becomes in the end",
        "b0 / (1 + b0); (5.2) and (5.4) to (5.6) have no b0",
        "omega_n^2 over s^2 + 2 zeta omega_n s + omega_n^2, whose end is 1",
        _gain,
        lambda states: np.ones(states.q.shape[1]),
    ),
    Erratum("(5.4), overdamped", "none", "", overdamped, _overdamped_from_roots),
    Erratum(
        "(5.5), critically damped",
        "the bracket is subtracted from 1: it falls from 1 to 0",
        "the bracket alone",
        critical,
        _critical,
    ),
    Erratum(
        "(5.6), underdamped",
        "1 / (2 sqrt(zeta^2 - 1)), an imaginary number; here its modulus",
        "1 / sqrt(1 - zeta^2)",
        _underdamped(2.0),
        _underdamped(1.0),
    ),
    Erratum("(5.13) and (5.14), motor's side and link's side", "none", "", at_the_joint, at_the_motor, "N m"),
    Erratum(
        "(5.43), rate of the servo error",
        "q without its dot",
        "the planned rate less the joint's rate",
        _rate_error("angle"),
        _rate_error("rate"),
        "rad/s",
    ),
)
