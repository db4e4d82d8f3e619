"""Sections 5.3 and 5.4: what a gear makes of the leg's dynamics."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx.control import Reference, implicit_euler, servo
from humanoid_mjx.mechanics.dynamics import joint_inertias
from humanoid_mjx.mechanics.trajectories import thesis_quintics
from humanoid_mjx.reproduction.findings import Finding, Setting, check, experiment, listed, three_digits, unprinted
from humanoid_mjx.reproduction.leg_values import errors_along, over, planned
from humanoid_mjx.robot.leg import Leg
from humanoid_mjx.thesis import leg as thesis

HIGH, SHOWN = np.array([10.0, 30.0, 100.0, 300.0]), 100.0
"""Gear ratios far above 1, and the one at which inertias are told."""

ROTORS = np.array([1e-8, 1e-7, 1e-6, 1e-5])
"""Rotor inertias that are tried, kg m^2: from motors of a few grams to one that weighs more than the leg."""

TRACKS, STEP_S = np.radians(1.0), 1e-3
"""Largest error of a good trajectory tracking, rad; step of the simulation, s."""


@experiment("motors-5.3", "Gear and motor")
def motors(setting: Setting) -> list[Finding]:
    """Sections 5.3 and 5.4: what a gear makes of the leg's dynamics."""
    inertia = over(joint_inertias, Leg.physical(), planned(np.linspace(0, thesis.QUINTIC_S, 501)).position)
    varies = {rotor: np.ptp(inertia, axis=0) / (inertia.min(axis=0) + SHOWN**2 * rotor) for rotor in ROTORS}
    reflected = HIGH**2 * ROTORS[:, None]
    errors = tracking_errors(reflected.ravel(), inertia.mean(axis=0)).max(axis=1).reshape(reflected.shape)
    quantity = f"share by which I_eff of (5.20) varies at a gear of {SHOWN:g}, by rotor and joint"
    why = 'from the least to the largest on the planned motion; "almost constant for highly geared manipulators" (5.4) '
    why += "holds or fails with the rotor, of which nothing is printed. Without a gear and a rotor it varies by a "
    why += f"factor of up to {(inertia.max(axis=0) / inertia.min(axis=0)).max():.1f}"
    return [unprinted(quantity, _by_rotor(varies), why), judge_tracking(errors)]


def judge_tracking(errors: np.ndarray) -> Finding:
    """The finding on section 5.3's claim that a highly geared joint tracks well though its controller ignores d.

    No rotor and no gear is printed, so there is a verdict only where it is the same for all of them.

    Args:
      errors: (rotors, gears) Largest errors of the worst joint, rad, by `ROTORS` and `HIGH`.
    """
    tracks = errors <= TRACKS
    quantity = f"largest error of the planned motion without d, rad, by rotor and gears of {listed(HIGH)}"
    found = _by_rotor(dict(zip(ROTORS, errors, strict=True)))
    why = "worst joint, each alone under Table 5.1's gains and the mean of its I_eff, the leg as it is, gravity along "
    why += f"it; of {tracks.size} rotors and gears {tracks.sum()} track within a degree. What counts is the inertia "
    why += "that the rotor adds to the joint, gear ratio^2 times its own"
    if tracks.any() and not tracks.all():
        return unprinted(quantity, found, f"{why}: the claim (5.3) holds or fails with values that are not printed")
    return check(quantity, "a good trajectory tracking performance (5.3)", found, tracks.all(), why, float(TRACKS))


def tracking_errors(reflected: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """(n, 5) Largest errors, rad, of joints that ignore d, by the inertia that the rotors add; infinite if unstable.

    Args:
      reflected: (n,) inertias that the rotors add to each joint, kg m^2.
      inertia: (5,) the controllers' constant inertias of the links, kg m^2.
    """
    leg, kp, kd = Leg.physical(), jnp.array(thesis.KP), jnp.array(thesis.KD)

    def simulate(added: Any, start: Any) -> Any:
        def act(plan: Reference, qpos: Any, qvel: Any) -> Any:
            return (inertia + added) * servo(kp, kd, plan, qpos, qvel)

        free = implicit_euler(jnp.zeros(5), jnp.zeros(5), armature=added)
        return jnp.abs(errors_along(leg, act, start, STEP_S, free)).max(axis=0)

    starts = jnp.tile(thesis_quintics().at(0.0).position, (len(reflected), 1))
    found = np.asarray(jax.jit(jax.vmap(simulate))(jnp.asarray(reflected, float), starts), float)
    return np.nan_to_num(found, nan=np.inf)


def _by_rotor(values: Mapping[float, np.ndarray]) -> dict[str, list[float]]:
    return {f"{rotor:g} kg m^2": three_digits(np.minimum(found, 1e9)) for rotor, found in values.items()}
