"""Torques that the joints must hold when the leg carries the body, against Table 4.7, whose leg hangs in the air.

The torso is a load at the middle between the hips that stays upright; the feet touch the ground with the toe, the end
of the chain; everything is slow enough for statics. The last link stays upright, as a foot flat on the ground would
keep it, and the body's centre of mass stays above what carries it: that leaves the knee's angle free.

Table 4.2 has the torques that hold a force at the toe in the initial posture.

Section 4.9 selects the motors by Table 4.7; chapter 8.1 tells that their stall torque was too small to hold the body
upright.
"""

from collections.abc import Iterator
from itertools import combinations, product
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx import dynamics, kinematics
from humanoid_mjx.reproduction.findings import Finding, Setting, check, compare, experiment, in_words
from humanoid_mjx.reproduction.leg_values import NAMES, over, planned
from humanoid_mjx.robot.leg import Leg, cylinder_inertias
from humanoid_mjx.thesis import leg as thesis

CONFIG = {"load": {"torso": -thesis.SCRIPT_FORCE[2]}, "squat": {"knee": 90.0}}
"""The torso's weight, N: the script's force. How far the knees bend, degrees."""

STEP, UPRIGHT = 0.5, 1e-6
"""Between the postures, degrees of the knee; torque that counts as none, N m."""

MOTORS = np.array(thesis.MAX_TORQUES)


@experiment("motor-sizing", "The torques to stand and to squat", CONFIG)
def motor_sizing(setting: Setting) -> list[Finding]:
    weight, deepest = setting.config["load"]["torso"], setting.config["squat"]["knee"]
    knee, (low, high) = np.arange(0.0, deepest + STEP / 2, STEP), np.radians(thesis.JOINT_RANGES["proposed"]).T
    (both, needed), (alone, carrying) = (squat(weight, legs, knee) for legs in (2, 1))
    inside, inside_alone = ((low - 1e-6 <= q) & (q <= high + 1e-6) for q in (both, alone))
    allowed = float(knee[inside.all(axis=1)].max())
    held = float(knee[(needed <= MOTORS + UPRIGHT).all(axis=1)].max())
    carried = f"{body_weight(weight):.1f} N, of which the torso {weight:g} N"
    motion = planned(np.linspace(0.0, thesis.QUINTIC_S, 501))
    swing = np.abs(over(dynamics.inverse_dynamics, Leg.physical(), *motion)).max(axis=0)
    outside = ", ".join(NAMES[joint] for joint in np.flatnonzero(~inside_alone[0]))
    half = f"each leg carries half of {carried}"
    limit = f"a joint reaches its range, the knee {allowed:g} degrees"
    free = "the leg swings freely, as in the simulation behind the table, with gravity along it; no weight on it"
    straight = f"{half}; the force goes through all axes, but nothing keeps it there"
    bent = f"{half}; the knees hold it only to {held:g} degrees: so small motors would not keep the body up, which is "
    bent += "what chapter 8.1 tells"
    leans = f"it carries {carried}, and leans by {abs(np.degrees(alone[0, 2])):.0f} degrees, so that the toe is under "
    leans += f"the centre of mass, which takes {outside or 'no joint'} out of the proposed ranges"

    def largest(torque: np.ndarray, angle: float) -> np.ndarray:
        """(5,) The largest torques up to an angle of the knee in degrees, N m."""
        return torque[knee <= angle + 1e-9].max(axis=0)

    return [
        _finding("the planned motion, the torso fixed", swing, free),
        _finding("standing on two straight legs", needed[0], straight),
        _finding(f"squatting on two legs until {limit}", largest(needed, allowed), bent),
        _finding(f"squatting on two legs, the knee {deepest:g} degrees", largest(needed, deepest), half),
        _finding("standing on one straight leg", carrying[0], leans),
        _finding(
            f"squatting on one leg, the knee {deepest:g} degrees", largest(carrying, deepest), f"it carries {carried}"
        ),
    ]


def _finding(what: str, needed: np.ndarray, why: str) -> Finding:
    worst, enough = int((needed / MOTORS).argmax()), (needed <= MOTORS + UPRIGHT).all()
    if not enough:
        why += f"; joint {worst + 1} ({NAMES[worst]}) needs {needed[worst] / MOTORS[worst]:.1f} times the torque"
    quantity, found = f"{what}: the torques of Table 4.7 suffice, N m", (np.round(needed, 4) + 0.0).tolist()
    return check(quantity, MOTORS.tolist(), found, enough, why, could_differ=needed.max() > UPRIGHT)


def body_weight(torso: float) -> float:
    """Weight of the torso and both legs, N."""
    return torso + 2 * thesis.GRAVITY * sum(thesis.LINK_MASSES)


def squat(torso: float, legs: int, knee: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The postures of a leg that carries the body on one or two legs, rad, and the sizes of the torques that hold them,
    N m, (n, 5) each, by the knee's angle, (n,) degrees.

    On one leg the roll leans the leg, so that the centre of mass comes above the toe also from the side; the other leg
    hangs straight from its hip.
    """
    leg = Leg.physical()
    weight = body_weight(torso)

    def moments(q: Any) -> Any:
        """First moments of the leg along the axes of frame 0, kg m."""
        poses = kinematics.frames(leg, q)[1:]
        return jnp.einsum("lab,lb->a", poses[:, :3], leg.pseudo_inertia[:, :, 3])

    hanging = moments(jnp.zeros(5))[::2] * jnp.array([1.0, -1.0])

    def posture(free: Any, knee: Any) -> Any:
        pitch, roll, ankle = free
        return jnp.array([pitch, 0.0, roll, knee, ankle])

    def unbalanced(free: Any, knee: Any) -> Any:
        q = posture(free, knee)
        toe = kinematics.forward(leg, q)
        first = moments(q)
        both = jnp.array([2 * first[0], 0.0]) if legs == 2 else first[::2] + hanging
        centre = both * thesis.GRAVITY / weight
        sideways = free[1] if legs == 2 else centre[1] - toe[2, 3]
        return jnp.array([centre[0] - toe[0, 3], sideways, toe[0, 0]])

    def hold(knee: Any) -> Any:
        free = jnp.array([knee / 2, 0.0, -knee / 2])

        def newton(_: Any, free: Any) -> Any:
            return free - jnp.linalg.solve(jax.jacfwd(unbalanced)(free, knee), unbalanced(free, knee))

        free = jax.lax.fori_loop(0, 8, newton, free)
        q = posture(free, knee)
        ground = jnp.array([0.0, weight / legs, 0.0, 0.0, 0.0, 0.0])
        torque = dynamics.gravity(leg, q) - kinematics.static_torque(leg, q, ground)
        return q, torque

    q, torque = (np.asarray(x, float) for x in jax.jit(jax.vmap(hold))(jnp.radians(knee)))
    return q, np.abs(torque)


STALL_TOLERANCE = 5e-6
"""Half of the last printed digit, N m."""

STALL_CONFIG = {
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


@experiment("table-4.2", "Stall torques", STALL_CONFIG)
def stall_torque(setting: Setting) -> Iterator[Finding]:
    """Table 4.2 against the torques of the script's force, and against those of all forces that are printed."""
    used, printed = (config["lengths"] | config["force"] for config in (setting.config, STALL_CONFIG))
    lengths = setting.config["lengths"].values()
    torque = _stall_torque(lengths, np.zeros(5), list(setting.config["force"].values()))
    tried = _search()
    nearest = tried[0]
    heads = ("lengths", "force along z, N", "posture", "torque of the roll, N m", "off by")
    setting.table(heads, ((*words, f"{roll:.5f}", f"{off:.2g}") for off, *words, roll in tried[:20]))
    arms = _stall_torque(lengths, np.zeros(5), [0.0, 0.0, 1.0])
    for joint, (mark, value) in enumerate(zip(thesis.STALL_TORQUES, torque, strict=True)):
        why, arm = f"{in_words(used, printed)} of the script, at the zero posture", float(arms[joint])
        if arm:
            why += f"; it would take {mark / arm:.5f} N; of {len(tried)} sets of printed lengths, postures and weights "
            why += f"the nearest ({nearest[1]}, {nearest[2]}, {nearest[3]}) is off by {nearest[0]:.2g} N m"
        else:
            why += ": a force along z turns only the roll, whatever its size and the lengths"
        quantity = f"stall torque of joint {joint + 1} ({thesis.JOINT_NAMES[joint]}), N m"
        possible = arm and nearest[0] < STALL_TOLERANCE
        judged: Any = {"values": (used, printed), "possible": possible, "could_differ": arm}
        yield compare(quantity, mark, value, STALL_TOLERANCE, why, 5, **judged)


def _search() -> list[tuple[float, str, str, str, float]]:
    """Torques of the roll from printed numbers, the nearest to Table 4.2 first, each after its distance and its words.

    The force is the script's, or the weight of any of the links.
    """
    forces = {f"{-thesis.SCRIPT_FORCE[2]:g} (script)": -thesis.SCRIPT_FORCE[2]}
    some = [links for count in range(1, 6) for links in combinations(range(5), count)]
    for (name, masses), links in product(MASSES.items(), some):
        weight = thesis.GRAVITY * sum(masses[i] for i in links)
        forces[f"{weight:.4f} (links {', '.join(str(i + 1) for i in links)} of {name})"] = weight
    postures = {"zero": np.zeros(5), "start of the trajectories": np.radians(thesis.QUINTIC_RANGES)[:, 0]}
    tried = []
    for (length_name, lengths), (posture_name, posture) in product(LENGTHS.items(), postures.items()):
        arm = _stall_torque(lengths, posture, [0.0, 0.0, 1.0])[2]
        for force_name, force in forces.items():
            roll = float(-force * arm)
            tried.append((abs(roll - thesis.STALL_TORQUES[2]), length_name, force_name, posture_name, roll))
    return sorted(tried)


def _stall_torque(lengths: Any, posture: np.ndarray, force: list[float]) -> np.ndarray:
    """(5,) Joint torques, N m, of a force at the toe, N (equation 4.25)."""
    leg = Leg.from_links(list(lengths), cylinder_inertias())
    wrench = jnp.array([*force, 0.0, 0.0, 0.0], leg.d.dtype)
    return np.asarray(jax.jit(kinematics.static_torque)(leg, jnp.asarray(posture, leg.d.dtype), wrench))
