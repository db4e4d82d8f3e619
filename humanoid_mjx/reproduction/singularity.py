"""Chapter 8: that no singular posture occurs during walking; section 4.4: how to find one."""

import numpy as np

from humanoid_mjx import kinematics
from humanoid_mjx.mechanics.gaits import Gait, gait
from humanoid_mjx.reproduction.findings import Finding, Setting, check, experiment
from humanoid_mjx.reproduction.leg_values import over
from humanoid_mjx.robot.leg import Leg
from humanoid_mjx.thesis import leg as thesis

SINGULAR = 1e-5
"""m and rad. Below it the least singular value of the Jacobian counts as 0 in single precision."""

NEAR = 0.25
"""Share of the least singular value at the start, below which a posture is nearly singular."""

GAITS = {"straight_walk": "walking straight, Table 4.5", "sudden_turn": "the sudden turn, Table 4.6"}

SAMPLES = 2001


@experiment("finding-singularity", "Singular postures during walking")
def singularity(setting: Setting) -> list[Finding]:
    """The singular postures of both gaits, and what the determinants of section 4.4 tell of them."""
    t = np.linspace(0.0, thesis.GAIT_TIMES_S[-1], SAMPLES)
    return [*(_walk(gait(name, "linear"), title, t) for name, title in GAITS.items()), _rank_test(t)]


def _walk(motion: Gait, title: str, t: np.ndarray) -> Finding:
    """The singular postures of a gait."""
    q = _angles(motion, t)
    crossing = np.flatnonzero(np.diff(np.sign(q[:, 3])) != 0)
    share = q[crossing, 3] / (q[crossing, 3] - q[crossing + 1, 3])
    times = t[crossing] + share * (t[crossing + 1] - t[crossing])
    at_crossing = _least(_angles(motion, times))
    singular = times[at_crossing < SINGULAR]
    values = _least(q)
    least, near = float(min(at_crossing.min(), values.min())), values < NEAR * values[0]
    passes = int(near[0]) + int((np.diff(near.astype(int)) > 0).sum())
    yaw = f"the yaw is 0 at {_seconds(singular)} s" if len(singular) else "where the yaw is not"
    why = f"the leg is singular where yaw and knee are both 0; the knee passes 0 at {_seconds(times)} s, {yaw}; "
    why += f"the least singular value of the Jacobian is {least:.2g} (at the start {values[0]:.2g}), "
    why += f"and below {NEAR:g} of that at the start {passes} times a step: nearly singular"
    return check(f"{title}: singular postures in a step", 0, len(singular), len(singular) == 0, why)


def _seconds(times: np.ndarray) -> str:
    return ", ".join(f"{x:.3f}" for x in times)


def _rank_test(t: np.ndarray) -> Finding:
    """The share of a walk where the determinants (4.22) and (4.23) vanish and the Jacobian keeps its rank."""
    q = _angles(gait("straight_walk", "linear"), t)
    jac, least = over(kinematics.jacobian, Leg.physical(), q), _least(q)
    leg = np.abs(np.linalg.det(jac[:, :3][:, :, [0, 3, 4]]))
    torso = np.abs(np.linalg.det(jac[:, :2][:, :, [1, 2]]))
    vanish = (leg < SINGULAR**2) & (torso < SINGULAR**2)
    wrong = float(np.mean(vanish & (least > SINGULAR)))
    quantity = "share of the straight walk where (4.22) and (4.23) are 0 and the Jacobian has full rank"
    why = "the determinants of parts of the Jacobian are both 0 wherever yaw and roll are, at any angle of the knee: "
    why += "they are no test of its rank"
    return check(quantity, "singular where the determinants are 0 (4.4.1)", round(wrong, 4), wrong == 0.0, why)


def _angles(motion: Gait, t: np.ndarray) -> np.ndarray:
    """(n, 5) A gait's joint angles, rad."""
    return over(Gait.at, motion, t).position


def _least(q: np.ndarray) -> np.ndarray:
    """(n,) The least singular value of the Jacobian, m and rad."""
    return np.linalg.svd(over(kinematics.jacobian, Leg.physical(), q), compute_uv=False)[:, -1]
