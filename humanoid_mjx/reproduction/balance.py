# pyright: reportAttributeAccessIssue=false
"""Balance on level ground: zero-moment point and support polygon (sections 4.5 and 4.8) of recorded motions.

The thesis asks that the zero-moment point stay in the polygon of the feet and prints no formula. These are the standard
ones (Vukobratovic and Borovac, International Journal of Humanoid Robotics 1, 2004): the ground must give the wrench
that the bodies' weights and accelerations require, and the zero-moment point is where this wrench has no moment about a
level axis. As long as the feet can give it, the point is the centre of pressure of the contact forces and lies in their
convex hull.
"""

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Bool, Float

from humanoid_mjx.physics.model import MujocoPhysics
from humanoid_mjx.robot.description import lowest
from humanoid_mjx.types import AnyArray, FloatScalar


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
    point: Float[AnyArray, "2"], corners: Float[AnyArray, "corners 2"], touching: Bool[AnyArray, " corners"]
) -> FloatScalar:
    """Return the distance of a point from the edge of the support polygon, the convex hull of the corners that touch,
    m.

    Negative outside it: the distance to the polygon. With less than three corners it is an edge or a point, which has
    no inside; with none the margin is minus infinity.
    """
    corners = jnp.asarray(corners)
    pair = touching[:, None] & touching
    along = corners - corners[:, None]
    length = jnp.linalg.norm(along, axis=-1)
    proper = pair & (length > 0)
    unit = along / jnp.where(proper, length, 1.0)[..., None]
    # Seen from corner i towards corner j: how far along the line, and how far to its left.
    place = jnp.clip(jnp.sum((point - corners[:, None]) * unit, axis=-1), 0.0, length)
    to_point = _left(unit, point - corners[:, None])
    to_corners = _left(unit[:, :, None], corners - corners[:, None, None])
    edge = proper & ((to_corners > -1e-7) | ~touching).all(axis=-1)
    has_area = (proper[..., None] & touching & (jnp.abs(to_corners) > 1e-7)).any()
    inside = jnp.min(jnp.where(edge, to_point, jnp.inf))
    nearest = corners[:, None] + place[..., None] * unit
    outside = jnp.min(jnp.where(pair, jnp.linalg.norm(point - nearest, axis=-1), jnp.inf))
    return jnp.where(has_area & (inside >= 0), inside, -outside)


def foot_corners(physics: MujocoPhysics, qpos: Float[AnyArray, "times nq"]) -> Float[np.ndarray, "times corners 3"]:
    """The lowest points of the feet's corners in recorded postures, m, outside jax; where z <= 0 they touch."""
    model, (balls, _) = physics.model, physics.ground_points
    data, found = mujoco.MjData(model), np.empty((len(qpos), len(balls), 3))
    for row, posture in zip(found, qpos, strict=True):
        data.qpos = posture
        mujoco.mj_kinematics(model, data)
        row[:] = lowest(model, data.geom_xpos[balls])
    return found


def _left(unit: Array, arm: Array) -> Array:
    return unit[..., 0] * arm[..., 1] - unit[..., 1] * arm[..., 0]
