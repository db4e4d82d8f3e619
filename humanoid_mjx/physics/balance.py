# pyright: reportAttributeAccessIssue=false
"""From a robot's state and accelerations to what `mechanics.balance` needs."""

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from humanoid_mjx.mechanics.balance import LinkMotion
from humanoid_mjx.mechanics.rotations import rotate
from humanoid_mjx.physics.base import Stages
from humanoid_mjx.physics.model import MujocoPhysics
from humanoid_mjx.types import AnyArray


def link_motion(
    model: mujoco.MjModel,
    qpos: Float[AnyArray, "times nq"],
    qvel: Float[AnyArray, "times nv"],
    qacc: Float[AnyArray, "times nv"],
) -> LinkMotion:
    """The bodies of a recorded motion, outside jax, in float64.

    Args:
      model: model of the robot.
      qpos: and
      qvel: the states.
      qacc: the accelerations in them. Over a step of semi-implicit Euler they are the change of `qvel` over the step.
    """
    data, bodies = mujoco.MjData(model), range(1, model.nbody)
    times, links = len(qpos), len(bodies)
    inertia, (position, acceleration, omega, alpha) = np.empty((times, links, 3, 3)), np.empty((4, times, links, 3))
    rates, kind = np.empty((2, 6)), mujoco.mjtObj.mjOBJ_BODY
    for t in range(times):
        data.qpos, data.qvel, data.qacc = qpos[t], qvel[t], qacc[t]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        data.qacc = qacc[t]
        mujoco.mj_rnePostConstraint(model, data)
        for i, body in enumerate(bodies):
            mujoco.mj_objectVelocity(model, data, kind, body, rates[0], 0)
            mujoco.mj_objectAcceleration(model, data, kind, body, rates[1], 0)
            frame = data.ximat[body].reshape(3, 3)
            inertia[t, i] = (frame * model.body_inertia[body]) @ frame.T
            position[t, i], omega[t, i], alpha[t, i] = data.xipos[body], rates[0, :3], rates[1, :3]
            acceleration[t, i] = rates[1, 3:]
    # MuJoCo's accelerations are those that an accelerometer feels.
    acceleration += model.opt.gravity
    return LinkMotion(np.tile(model.body_mass[1:], (times, 1)), inertia, position, acceleration, omega, alpha)


def ground_wrench(stages: Stages, qacc: Float[Array, " nv"]) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """What pushes a free body from outside, inside jax: force, N, and moment about the world's origin, N m.

    It is what the first six rows of `mass_matrix @ qacc + bias` leave unexplained: the force at the torso, world, and
    the moment about its frame's origin, in its frame. Where only the ground pushes, it is the ground's wrench.

    Args:
      stages: stages of a robot with a free torso.
      qacc: accelerations of all degrees of freedom.
    """
    force, moment = jnp.split((stages.mass_matrix @ qacc + stages.bias)[:6], 2)
    turned = rotate(stages.world.qpos[3:7], moment)
    return force, turned + jnp.cross(stages.world.qpos[:3], force)


def accelerations(qvel: Float[AnyArray, "*batch times nv"], timestep: float) -> Float[AnyArray, "*batch steps nv"]:
    """From the velocities at each time step those that semi-implicit Euler took between them."""
    return (qvel[..., 1:, :] - qvel[..., :-1, :]) / timestep


def foot_corners(physics: MujocoPhysics, qpos: Float[AnyArray, "times nq"]) -> Float[np.ndarray, "times corners 3"]:
    """The lowest points of the feet's corners in recorded postures, m, outside jax; where z <= 0 they touch."""
    model, (balls, _) = physics.model, physics.ground_points
    data, found = mujoco.MjData(model), np.empty((len(qpos), len(balls), 3))
    for row, posture in zip(found, qpos, strict=True):
        data.qpos = posture
        mujoco.mj_kinematics(model, data)
        row[:] = data.geom_xpos[balls] - model.geom_size[balls, :1] * (0.0, 0.0, 1.0)
    return found
