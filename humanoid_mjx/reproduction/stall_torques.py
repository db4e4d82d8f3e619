"""Table 4.2: the joint torques that hold a force at the toe in the initial posture."""

from collections.abc import Iterator
from itertools import combinations
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx import kinematics
from humanoid_mjx.reproduction.findings import Finding, Setting, compare, experiment, in_words
from humanoid_mjx.robot.leg import Leg, cylinder_inertias
from humanoid_mjx.thesis import leg as thesis

TOLERANCE = 5e-6
"""Half of the last printed digit, N m."""

CONFIG = {
    "lengths": {f"l{i}": x for i, x in enumerate(thesis.SCRIPT_LENGTHS, start=1)},
    "force": dict(zip("xyz", thesis.SCRIPT_FORCE, strict=True)),
}

LENGTHS = {
    "the script's lengths": thesis.SCRIPT_LENGTHS,
    "the recovered lengths": thesis.LINK_LENGTHS,
    "Table 3.1 at 1:4": (0.04125, 0.04, 0.04, 0.095, 0.095),
    "Table 3.1 in full": (0.165, 0.16, 0.16, 0.38, 0.38),
}
MASSES = {"Table 4.3": thesis.LINK_MASSES, "the script": thesis.SCRIPT_MASSES}


@experiment("table-4.2", "Stall torques", CONFIG)
def stall_torque(setting: Setting) -> Iterator[Finding]:
    """Table 4.2 against the torques of the script's force, and against those of all forces that are printed."""
    used = setting.config["lengths"] | setting.config["force"]
    printed = CONFIG["lengths"] | CONFIG["force"]
    lengths = setting.config["lengths"].values()
    torque = _torque(lengths, np.zeros(5), list(setting.config["force"].values()))
    tried = _search()
    nearest = tried[0]
    heads = ("lengths", "force along z, N", "posture", "torque of the roll, N m", "off by")
    setting.table(heads, ((*words, f"{roll:.5f}", f"{off:.2g}") for off, *words, roll in tried[:20]))
    arms = _torque(lengths, np.zeros(5), [0.0, 0.0, 1.0])
    for joint, (mark, value) in enumerate(zip(thesis.STALL_TORQUES, torque, strict=True)):
        why, arm = f"{in_words(used, printed)} of the script, at the zero posture", float(arms[joint])
        if arm:
            why += f"; it would take {mark / arm:.5f} N; of {len(tried)} sets of printed lengths, postures and weights "
            why += f"the nearest ({nearest[1]}, {nearest[2]}, {nearest[3]}) is off by {nearest[0]:.2g} N m"
        else:
            why += ": a force along z turns only the roll, whatever its size and the lengths"
        quantity = f"stall torque of joint {joint + 1} ({thesis.JOINT_NAMES[joint]}), N m"
        possible = arm and nearest[0] < TOLERANCE
        judged: Any = {"values": (used, printed), "possible": possible, "could_differ": arm}
        yield compare(quantity, mark, value, TOLERANCE, why, 5, **judged)


def _search() -> list[tuple[float, str, str, str, float]]:
    """Torques of the roll from printed numbers, the nearest to Table 4.2 first, each after its distance and its words.

    The force is the script's, or the weight of any of the links.
    """
    forces = {f"{-thesis.SCRIPT_FORCE[2]:g} (script)": -thesis.SCRIPT_FORCE[2]}
    for name, masses in MASSES.items():
        for count in range(1, 6):
            for links in combinations(range(5), count):
                weight = thesis.GRAVITY * sum(masses[i] for i in links)
                forces[f"{weight:.4f} (links {', '.join(str(i + 1) for i in links)} of {name})"] = weight
    postures = {"zero": np.zeros(5), "start of the trajectories": np.radians(thesis.QUINTIC_RANGES)[:, 0]}
    tried = []
    for length_name, lengths in LENGTHS.items():
        for posture_name, posture in postures.items():
            arm = _torque(lengths, posture, [0.0, 0.0, 1.0])[2]
            for force_name, force in forces.items():
                roll = float(-force * arm)
                tried.append((abs(roll - thesis.STALL_TORQUES[2]), length_name, force_name, posture_name, roll))
    return sorted(tried)


def _torque(lengths: object, posture: np.ndarray, force: list[float]) -> np.ndarray:
    """(5,) Joint torques, N m, of a force at the toe, N (equation 4.25)."""
    leg = Leg.from_links(list(lengths), cylinder_inertias())  # pyright: ignore[reportArgumentType, reportCallIssue]
    wrench = jnp.array([*force, 0.0, 0.0, 0.0], leg.d.dtype)
    return np.asarray(jax.jit(kinematics.static_torque)(leg, jnp.asarray(posture, leg.d.dtype), wrench))
