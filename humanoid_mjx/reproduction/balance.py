# pyright: reportAttributeAccessIssue=false
"""Balance on level ground: zero-moment point and support polygon (sections 4.5 and 4.8) of recorded motions.

The thesis asks that the zero-moment point stay in the polygon of the feet and prints no formula. These are the standard
ones (Vukobratovic and Borovac, International Journal of Humanoid Robotics 1, 2004): the ground must give the wrench
that the bodies' weights and accelerations require, and the zero-moment point is where this wrench has no moment about a
level axis. As long as the feet can give it, the point is the centre of pressure of the contact forces and lies in their
convex hull.
"""

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from humanoid_mjx.physics.model import MujocoPhysics
from humanoid_mjx.robot.description import lowest
from humanoid_mjx.types import AnyArray


def ground_wrench(
    model: mujoco.MjModel,
    qpos: Float[AnyArray, "times nq"],
    qvel: Float[AnyArray, "times nv"],
    qacc: Float[AnyArray, "times nv"],
) -> tuple[Float[np.ndarray, "times 3"], Float[np.ndarray, "times 3"]]:
    """Return the force, N, and the moment about the world's origin, N m, that the motion of a body with a free torso
    needs from the ground.

    It is what inverse dynamics leaves to the six degrees of freedom that no motor drives. Where only the ground pushes,
    it is the ground's wrench.
    """
    data, needed = mujoco.MjData(model), np.empty(model.nv)
    force, moment = np.empty((2, len(qpos), 3))
    for t in range(len(qpos)):
        data.qpos, data.qvel, data.qacc = qpos[t], qvel[t], qacc[t]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_rne(model, data, 1, needed)
        force[t] = needed[:3]
        mujoco.mju_rotVecQuat(moment[t], needed[3:6], data.qpos[3:7])
        moment[t] += np.cross(data.qpos[:3], force[t])
    return force, moment


def zero_moment_point(force: Float[np.ndarray, "times 3"], moment: Float[np.ndarray, "times 3"]) -> np.ndarray:
    """Return the points on the plane z = 0 at which a wrench has no moment about x and y, (times, 2), m.

    Args:
      force: force, N, in the world's frame, z up.
      moment: moment about the world's origin, N m.

    Returns:
      x and y; NaN where the force does not push the ground, as in flight.
    """
    up = np.where(force[:, 2:] > 0, force[:, 2:], np.nan)
    return np.stack([-moment[:, 1], moment[:, 0]], axis=1) / up


def inside_support(
    point: Float[np.ndarray, "*times 2"],
    corners: Float[np.ndarray, "*times corners 2"],
    touching: Bool[np.ndarray, "*times corners"],
) -> Bool[np.ndarray, "*times"]:
    """Return whether a point is inside the support polygon, the convex hull of the corners that touch: seen from it
    they lie on all sides, no two neighbours half a turn or more apart. An edge and a corner have no inside."""
    x, y = np.moveaxis(corners - point[..., None, :], -1, 0)
    side = np.sort(np.where(touching, np.arctan2(y, x), np.nan), axis=-1)  # NaN at the end
    following = np.concatenate([side[..., 1:], np.full_like(side[..., :1], np.nan)], axis=-1)
    following = np.where(np.isnan(following), side[..., :1] + 2 * np.pi, following)
    gap = np.nan_to_num(following - side, nan=-np.inf).max(axis=-1)
    return (gap > 0) & (gap < np.pi - 1e-9)


def foot_corners(physics: MujocoPhysics, qpos: Float[AnyArray, "times nq"]) -> Float[np.ndarray, "times corners 3"]:
    """The lowest points of the feet's corners in recorded postures, m, outside jax; where z <= 0 they touch."""
    model, (balls, _) = physics.model, physics.ground_points
    data, found = mujoco.MjData(model), np.empty((len(qpos), len(balls), 3))
    for row, posture in zip(found, qpos, strict=True):
        data.qpos = posture
        mujoco.mj_kinematics(model, data)
        row[:] = lowest(model, data.geom_xpos[balls])
    return found
