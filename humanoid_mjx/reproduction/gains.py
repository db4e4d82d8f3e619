"""Table 5.1: the gains of the joint controllers, the damping that they give, and what the links allow (5.6)."""

from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np

from humanoid_mjx import dynamics
from humanoid_mjx.control.gains import critical_kd, damping_ratio, max_kp, poles
from humanoid_mjx.reproduction.findings import Finding, Setting, check, compare, experiment, three_digits
from humanoid_mjx.reproduction.leg_values import over
from humanoid_mjx.robot.leg import Leg
from humanoid_mjx.thesis import leg as thesis

CRITICAL = 0.05
"""Distance of a damping ratio from 1 within which it would be called critical."""

ALUMINIUM = {"modulus": 69e9, "density": 2710.0}
"""Elastic modulus, Pa, and density, kg/m^3, of aluminium 1060, the material of section 3.1."""

NEAR = 0.5
"""A gain of this share of its bound could have been selected by it."""

FAR = 0.01
"""Below this share of its bound a gain is under it whatever the links' sections, of which nothing is printed."""


@experiment("table-5.1", "Gains of the joint controllers")
def table(setting: Setting) -> Iterator[Finding]:
    """Table 5.1: the damping that its gains give, which section 5.6 wants critical."""
    kp, kd = jnp.array(thesis.KP), jnp.array(thesis.KD)
    ratios, critical = np.asarray(damping_ratio(kp, kd)), np.asarray(critical_kd(kp))
    slow = np.asarray(poles(kp, kd))[0]
    for joint in range(5):
        quantity, ratio = f"damping ratio of joint {joint + 1} (critical by 5.35)", float(ratios[joint])
        why = f"Kd is {kd[joint]:g}, {kd[joint] / critical[joint]:.2f} times the critical {critical[joint]:.2f}: the "
        why += f"slow pole is {slow[joint]:.2f} /s, not {-np.sqrt(kp[joint]):.2f} /s"
        yield compare(quantity, 1.0, ratio, CRITICAL, why, 3)


@experiment("resonance-5.6", "What the links' stiffness allows of the gains")
def resonance(setting: Setting) -> list[Finding]:
    """Section 5.6: what the links' stiffness allows of Kp, against Table 5.1."""
    return judge_gains(np.array(thesis.KP), _allowed_gains())


def judge_gains(gains: np.ndarray, allowed: np.ndarray) -> list[Finding]:
    """Findings on the gains, by joint, against the largest that the resonance of each link allows, 1/s^2."""
    bound = "the largest Kp that (5.37) allows, by joint, 1/s^2: Table 5.1's are not above it"
    tubes = "the links are tubes of aluminium 1060, as thick as Table 3.1 at 1:4 and as heavy as Table 4.3; each bends "
    tubes += "at its base under the inertia beyond it, the largest in the ranges of Table 3.2"
    tubes += f"; the lowest resonance is {2 * np.sqrt(allowed.min()) / (2 * np.pi):.0f} Hz"
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
    frequency = np.sqrt(bends / still[0])
    return np.asarray(max_kp(frequency, still[0], np.maximum(anywhere.max(axis=0), still[0])), float)
