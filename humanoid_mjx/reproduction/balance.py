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


def support_margin(
    point: Float[np.ndarray, "*times 2"],
    corners: Float[np.ndarray, "*times corners 2"],
    touching: Bool[np.ndarray, "*times corners"],
) -> Float[np.ndarray, "*times"]:
    """Return the distance of a point from the edge of the support polygon, the convex hull of the corners that touch,
    m.

    Negative outside it: the distance to the polygon. With less than three corners it is an edge or a point, which has
    no inside; with none the margin is minus infinity.
    """
    pair = touching[..., :, None] & touching[..., None, :]
    along = corners[..., None, :, :] - corners[..., :, None, :]
    arm = (point[..., None, :] - corners)[..., :, None, :]
    length = np.linalg.norm(along, axis=-1)
    proper = pair & (length > 0)
    unit = along / np.where(proper, length, 1.0)[..., None]
    # Seen from corner i towards corner j: how far along the line, and how far to its left.
    place = np.clip((arm * unit).sum(axis=-1), 0.0, length)
    to_point, to_corners = _left(unit, arm), _left(unit[..., None, :], along[..., :, None, :, :])
    edge = proper & ((to_corners > -1e-7) | ~touching[..., None, None, :]).all(axis=-1)
    has_area = (proper[..., None] & touching[..., None, None, :] & (np.abs(to_corners) > 1e-7)).any(axis=(-3, -2, -1))
    inside = np.where(edge, to_point, np.inf).min(axis=(-2, -1))
    away = np.linalg.norm(arm - place[..., None] * unit, axis=-1)
    outside = np.where(pair, away, np.inf).min(axis=(-2, -1))
    return np.where(has_area & (inside >= 0), inside, -outside)


def foot_corners(physics: MujocoPhysics, qpos: Float[AnyArray, "times nq"]) -> Float[np.ndarray, "times corners 3"]:
    """The lowest points of the feet's corners in recorded postures, m, outside jax; where z <= 0 they touch."""
    model, (balls, _) = physics.model, physics.ground_points
    data, found = mujoco.MjData(model), np.empty((len(qpos), len(balls), 3))
    for row, posture in zip(found, qpos, strict=True):
        data.qpos = posture
        mujoco.mj_kinematics(model, data)
        row[:] = lowest(model, data.geom_xpos[balls])
    return found


def _left(unit: np.ndarray, arm: np.ndarray) -> np.ndarray:
    return unit[..., 0] * arm[..., 1] - unit[..., 1] * arm[..., 0]
