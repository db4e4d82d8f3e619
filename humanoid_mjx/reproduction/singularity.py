"""Chapter 8: that no singular posture occurs during walking; section 4.4: how to find one."""

from typing import Any

import numpy as np

from humanoid_mjx.reproduction.findings import Experiment, Finding, Setting, judge
from humanoid_mjx.thesis import leg as thesis

SINGULAR = 1e-5
"""m and rad. Below it the least singular value of the Jacobian counts as 0 in single precision."""

GAITS = {"straight_walk": "walking straight, Table 4.5", "sudden_turn": "the sudden turn, Table 4.6"}

SAMPLES = 2001


def singularity(setting: Setting) -> list[Finding]:
    findings = [_walk(name, title) for name, title in GAITS.items()]
    return [*findings, _rank_test()]


def _walk(name: str, title: str) -> Finding:
    """How near to singular postures a gait comes."""
    from humanoid_mjx.mechanics.gaits import gait

    motion = gait(name, "linear")
    t = np.linspace(0.0, thesis.GAIT_TIMES_S[-1], SAMPLES)
    q = _angles(motion, t)
    crossing = np.flatnonzero(np.diff(np.sign(q[:, 3])) != 0)
    share = q[crossing, 3] / (q[crossing, 3] - q[crossing + 1, 3])
    times = t[crossing] + share * (t[crossing + 1] - t[crossing])
    at_crossing = _least(_angles(motion, times))
    singular = times[at_crossing < SINGULAR]
    least = float(min(at_crossing.min(), _least(q).min()))
    return Finding(
        name="finding-singularity",
        quantity=f"{title}: singular postures in a step",
        printed=0,
        reproduced=len(singular),
        tolerance=None,
        verdict=judge(len(singular) == 0, {}, {}),
        why=f"the leg is singular where yaw and knee are both 0; the knee passes 0 at "
        f"{', '.join(f'{x:.3f}' for x in times)} s, "
        + (
            f"the yaw is 0 at {', '.join(f'{x:.3f}' for x in singular)} s; "
            if len(singular)
            else "where the yaw is not; "
        )
        + f"the least singular value of the Jacobian is {least:.2g} (at the start {_least(q[:1])[0]:.2g})",
    )


def _rank_test() -> Finding:
    """Whether the determinants (4.22) and (4.23) vanish exactly where the Jacobian loses rank."""
    from humanoid_mjx.mechanics.gaits import gait

    q = _angles(gait("straight_walk", "linear"), np.linspace(0.0, thesis.GAIT_TIMES_S[-1], SAMPLES))
    jac, least = _jacobians(q), _least(q)
    leg = np.abs(np.linalg.det(jac[:, :3][:, :, [0, 3, 4]]))
    torso = np.abs(np.linalg.det(jac[:, :2][:, :, [1, 2]]))
    vanish = (leg < SINGULAR**2) & (torso < SINGULAR**2)
    wrong = float(np.mean(vanish & (least > SINGULAR)))
    return Finding(
        name="finding-singularity",
        quantity="share of the straight walk where (4.22) and (4.23) are 0 and the Jacobian has full rank",
        printed="singular where the determinants are 0 (4.4.1)",
        reproduced=round(wrong, 4),
        tolerance=None,
        verdict=judge(wrong == 0.0, {}, {}),
        why="the determinants of parts of the Jacobian are both 0 wherever yaw and roll are, at any angle of the knee: "
        "they are no test of its rank",
    )


def _angles(motion: Any, t: np.ndarray) -> np.ndarray:
    """(n, 5) A gait's joint angles, rad."""
    import jax
    import jax.numpy as jnp

    return np.asarray(jax.vmap(motion.at)(jnp.asarray(t)).position, float)


def _jacobians(q: np.ndarray) -> np.ndarray:
    """(n, 6, 5)"""
    import jax
    import jax.numpy as jnp

    from humanoid_mjx import Leg, kinematics

    compute = jax.jit(jax.vmap(kinematics.jacobian, in_axes=(None, 0)))
    return np.asarray(compute(Leg.physical(), jnp.asarray(q)), float)


def _least(q: np.ndarray) -> np.ndarray:
    """(n,) The least singular value of the Jacobian, m and rad."""
    return np.linalg.svd(_jacobians(q), compute_uv=False)[:, -1]


EXPERIMENTS = [Experiment("finding-singularity", "Singular postures during walking", singularity)]
