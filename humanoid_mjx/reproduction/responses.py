"""Section 5.2: responses of second order, and what their damping does."""

import jax
import numpy as np

from humanoid_mjx.control.gains import step_response
from humanoid_mjx.reproduction.findings import Finding, Setting, check, compare, experiment, listed, three_digits

RATIOS = np.round(np.arange(0.05, 3.001, 0.01), 2)
"""Damping ratios."""

SETTLED = 0.02
"""Share of a step that may be missing for good."""

OVERSHOOT = 1e-13
"""Share of a step beyond it that rounding in double precision may make; at a ratio of 0.99 it is 3e-10."""


@experiment("responses-5.2", "Responses of second order")
def responses(setting: Setting) -> list[Finding]:
    """Section 5.2: which damping is fastest without overshoot, and for which the system is stable."""
    times = np.linspace(0.0, 30.0, 6001)
    curves = _step_responses(times, RATIOS)
    return judge_responses(times, curves)


def judge_responses(times: np.ndarray, curves: np.ndarray) -> list[Finding]:
    """Findings on section 5.2 from responses, (ratios, times), to a step at a natural frequency of 1 rad/s."""
    over = curves.max(axis=1) - 1
    settling = np.array([_settling(times, curve) for curve in curves])
    clean = over <= OVERSHOOT
    best = float(RATIOS[clean][np.argmin(settling[clean])]) if clean.any() else float("nan")
    quickest = int(np.argmin(settling))
    slow = float(settling[np.argmin(np.abs(RATIOS - 2.0))])
    decay = _slowest_decay(np.linspace(-1.0, 3.0, 401))
    close = (RATIOS >= 0.9) & (RATIOS < 1.0)
    fastest = f"of {listed((RATIOS[0], RATIOS[-1]))} in steps of 0.01, settled to {SETTLED:.0%}; with overshoot "
    fastest += f"{RATIOS[quickest]:g} is quicker still ({settling[quickest]:.2f} in place of "
    fastest += f"{settling[np.argmin(np.abs(RATIOS - 1.0))]:.2f} over the natural frequency); at 2, about what Table "
    fastest += f"5.1's gains give, it is {slow:.1f}"
    quantity = "damping ratio of the fastest response that does not overshoot"
    asked = "a response without oscillation asks for a ratio of 1, or close to one but less"
    beyond = [three_digits(100 * over[np.argmin(np.abs(RATIOS - ratio))]) for ratio in (0.9, 0.95)]
    return [
        compare(quantity, 1.0, best, 0.01, fastest, 2),
        check(
            "overshoot of a step at damping ratios of 0.9 and 0.95, per cent",
            asked,
            beyond,
            (over[close] <= OVERSHOOT).all(),
            "every ratio below 1 overshoots; without oscillation it must be 1 or more",
            100 * OVERSHOOT,
        ),
        check(
            "the slowest decay over damping ratios of -1 to 3, 1/s at 1 rad/s",
            "stable for all values of the damping ratio",
            three_digits(decay),
            decay > 0,
            "minus the larger real part of the roots (5.3): at 0 a step oscillates for ever, below 0 it grows",
        ),
    ]


def _slowest_decay(ratios: np.ndarray) -> float:
    roots = -ratios + np.sqrt(ratios.astype(complex) ** 2 - 1)
    return float((-np.real(roots)).min())


def _settling(times: np.ndarray, curve: np.ndarray) -> float:
    """Time from which a response stays within `SETTLED` of its end, s; infinite if it does not within these times."""
    away = np.flatnonzero(np.abs(curve - 1) > SETTLED)
    last = int(away[-1]) + 1 if len(away) else 0
    return float(times[last]) if last < len(times) else float("inf")


def _step_responses(times: np.ndarray, ratios: np.ndarray) -> np.ndarray:
    """(ratios, times) Responses at a natural frequency of 1 rad/s."""
    with jax.enable_x64(True):
        respond = jax.jit(jax.vmap(step_response, in_axes=(None, None, 0)))
        return np.asarray(respond(times, 1.0, ratios))
