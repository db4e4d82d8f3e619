"""Chapter 5: responses of second order (5.2); the gains of Table 5.1, their damping, and what the links allow (5.6)."""

from collections.abc import Iterator

import numpy as np

from humanoid_mjx import dynamics
from humanoid_mjx.report.style import COLORS, label_lines, shades
from humanoid_mjx.reproduction.findings import Finding, Setting, check, compare, experiment, listed, three_digits
from humanoid_mjx.reproduction.leg_values import over
from humanoid_mjx.robot.leg import Leg
from humanoid_mjx.thesis import leg as thesis

CRITICAL = 0.05
"""Distance of a damping ratio from 1 within which it would be called critical."""

ALUMINIUM = {"modulus": 69e9, "density": 2710.0}
"""Elastic modulus, Pa, and density, kg/m^3, of aluminium 1060, the material of section 3.1."""

RESONANCE_SHARE = 0.5
"""Largest natural frequency as a share of the lowest resonance (5.37)."""

NEAR, FAR = 0.5, 0.01
"""A gain of the first share of its bound could have been selected by it; one below the second is under its bound
whatever the links' sections, of which nothing is printed."""


@experiment("table-5.1", "Gains of the joint controllers")
def table(setting: Setting) -> Iterator[Finding]:
    """Table 5.1: the damping that its gains give, which section 5.6 wants critical."""
    for joint, (kp, kd, ratio) in enumerate(zip(thesis.KP, thesis.KD, _damping_ratios(), strict=True)):
        quantity = f"damping ratio of joint {joint + 1} (critical by 5.35)"
        why = f"Kd is {kd:g}, {ratio:.2f} times the critical {kd / ratio:.2f}: the slow pole is "
        why += f"{np.roots([1.0, kd, kp]).real.max():.2f} /s, not {-np.sqrt(kp):.2f} /s"
        yield compare(quantity, 1.0, ratio, CRITICAL, why, 3)


def _damping_ratios() -> np.ndarray:
    """(5,) Those of Table 5.1's gains (5.34)."""
    return np.array(thesis.KD) / (2 * np.sqrt(thesis.KP))


@experiment("resonance-5.6", "What the links' stiffness allows of the gains")
def resonance(setting: Setting) -> list[Finding]:
    return judge_gains(np.array(thesis.KP), _allowed_gains())


def judge_gains(gains: np.ndarray, allowed: np.ndarray) -> list[Finding]:
    """Findings on the gains, by joint, against the largest that the resonance of each link allows, 1/s^2."""
    bound = "the largest Kp that (5.37) allows, by joint, 1/s^2: Table 5.1's are not above it"
    tubes = "the links are tubes of aluminium 1060, as thick as Table 3.1 at 1:4 and as heavy as Table 4.3; each bends "
    tubes += "at its base under the inertia beyond it, the largest in the ranges of Table 3.2; the lowest resonance is "
    tubes += f"{2 * np.sqrt(allowed.min()) / (2 * np.pi):.0f} Hz"
    share = "Table 5.1's Kp as shares of what (5.37) allows, by joint"
    selected = "the gains were selected on the material's stiffness and the natural frequency (chapter 8)"
    near = "a gain that the stiffness selected would be near its bound; these could be larger by a factor of "
    near += f"{(allowed / gains).min():.1g} and more, so it is something else that keeps them low"
    shares = gains / allowed
    return [
        check(bound, gains.tolist(), three_digits(allowed), shares.max() <= 1, tubes, could_differ=shares.max() > FAR),
        check(share, selected, three_digits(shares), (shares >= NEAR).all(), near, NEAR),
    ]


def _allowed_gains() -> np.ndarray:
    """(5,) The bounds of (5.37), 1/s^2."""
    around = {4: thesis.BODY_MM["upper_leg_circumference"], 5: thesis.BODY_MM["lower_leg_circumference"]}
    stiffness = {}
    for link, circumference in around.items():
        radius = 1e-3 * thesis.SCALE * circumference / (2 * np.pi)
        length = thesis.LINK_LENGTHS[link - 1]
        area = thesis.LINK_MASSES[link - 1] / (ALUMINIUM["density"] * length)
        stiffness[link] = 3 * ALUMINIUM["modulus"] * area * radius**2 / 2 / length  # 3 E I / L of a thin tube, N m/rad
    low, high = np.radians(thesis.JOINT_RANGES["proposed"]).T
    postures = np.random.default_rng(0).uniform(low, high, (2000, 5))
    still, anywhere = (over(dynamics.joint_inertias, Leg.physical(), q) for q in (np.zeros((1, 5)), postures))
    bends = np.array([stiffness[4]] * 4 + [stiffness[5]])
    resonance = np.sqrt(bends / np.maximum(anywhere.max(axis=0), still[0]))  # (5.36)
    return (RESONANCE_SHARE * resonance) ** 2


RATIOS = np.round(np.arange(0.05, 3.001, 0.01), 2)
SHOWN = (0.1, 0.3, 0.5, 0.7, 1.0, 2.0)
"""Damping ratios, and those whose responses are drawn: Table 5.1's are about 2."""

SETTLED, OVERSHOOT = 0.02, 1e-13
"""Shares of a step: what may be missing for good, and what rounding in double precision may make beyond it; at a ratio
of 0.99 it is 3e-10."""


@experiment("responses-5.2", "Responses of second order")
def responses(setting: Setting) -> list[Finding]:
    """Section 5.2: which damping is fastest without overshoot, and for which the system is stable."""
    times = np.linspace(0.0, 30.0, 6001)
    curves = _step_responses(times, RATIOS)
    with setting.figure(1, 2, size=(4.6, 3.4), title="A step of a second-order system at 1 rad/s") as (_, axes):
        left, right = axes[0]
        for ratio, color in zip(SHOWN, shades(len(SHOWN)), strict=True):
            left.plot(times, curves[np.argmin(np.abs(RATIOS - ratio))], color=color, label=f"{ratio:g}")
        left.set(xlim=(0, 15), xlabel="time, s", ylabel="response", title="Responses")
        label_lines(left, "damping ratio")
        right.plot(RATIOS, [_settling(times, curve) for curve in curves], color=COLORS[0], label="any ratio")
        for joint, ratio in enumerate(_damping_ratios()):
            settled = _settling(times, _step_responses(times, ratio[None])[0])
            right.plot(ratio, settled, "o", color=COLORS[joint + 1], label=f"joint {joint + 1}, Table 5.1")
        right.set(xlabel="damping ratio", ylabel="time, s", title=f"Time to stay within {SETTLED:.0%} of the end")
        label_lines(right)
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
    overshoot = "overshoot of a step at damping ratios of 0.9 and 0.95, per cent"
    every = "every ratio below 1 overshoots; without oscillation it must be 1 or more"
    slowest = "the slowest decay over damping ratios of -1 to 3, 1/s at 1 rad/s"
    always = "stable for all values of the damping ratio"
    grows = "minus the larger real part of the roots (5.3): at 0 a step oscillates for ever, below 0 it grows"
    return [
        compare(quantity, 1.0, best, 0.01, fastest, 2),
        check(overshoot, asked, beyond, (over[close] <= OVERSHOOT).all(), every, 100 * OVERSHOOT),
        check(slowest, always, three_digits(decay), decay > 0, grows),
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
    """(ratios, times) Responses from rest at a natural frequency of 1 rad/s (5.4 to 5.6, corrected), 1 being the end:
    one formula for all three cases, as the hyperbolic functions of an imaginary number are cosine and sine."""
    damping = ratios[:, None].astype(complex)
    root = np.sqrt(damping**2 - 1)
    root[root == 0] = 1e-9  # the limit of critical damping
    return 1 - (np.exp(-damping * times) * (np.cosh(root * times) + damping / root * np.sinh(root * times))).real
