# pyright: reportAttributeAccessIssue=false
"""What it takes to carry the lower body on its right foot: torques, where the ground pushes, and rocking sideways."""

import math
from typing import NamedTuple

import mujoco
import numpy as np
from feasible_postures import Body, leg_over
from jaxtyping import Float
from scipy.interpolate import BPoly, CubicSpline

from humanoid_mjx.robot import lower_body as robot
from humanoid_mjx.thesis import leg as thesis

INNER, OUTER = robot.HIP_OFFSET - robot.FOOT_WIDTH / 2, robot.HIP_OFFSET + robot.FOOT_WIDTH / 2
"""From the middle between the feet, below the hips, to the inner and the outer edge of a sole, m."""

MOMENTS = 400
"""Moments of a gait at which it is looked at."""

DORSIFLEXION = math.radians(thesis.JOINT_RANGES["human"][4][0])
"""Least angle of an ankle, rad, the same in both columns. A lifted foot would have to go beyond it to stay level."""


class Way(NamedTuple):
    """How the body is to walk: a gait's clock, s and share, and what it does at least, m/s, m/s, rad/s and m."""

    period: float
    stance: float
    speed: float
    sideways: float
    turn: float
    lift: float
    """How high it lifts its ankles."""

    @property
    def on_ground(self) -> float:
        """For how long a foot stands, s."""
        return self.stance * self.period


class Load(NamedTuple):
    """What carries a body on its right foot."""

    torque: Float[np.ndarray, "10"]
    """Torques of the joints, N m."""
    force: Float[np.ndarray, "3"]
    """Force of the ground on the foot, N."""
    point: Float[np.ndarray, "2"]
    """Zero-moment point: where on the ground, in the world, the force would have to act, m."""


class Rocking(NamedTuple):
    """A stiff body that tips from foot to foot, over their outer edges, once each way in a period."""

    rate: float
    """1/s: how fast it would fall from the edge, its leaning growing as exp(rate * time)."""
    natural: float
    """1/s: the same of a point mass at its height, the square root of g / h."""
    sway: float
    """How far the centre of mass goes to each side, m."""
    tilt: float
    """How far the soles tilt, rad."""


def carried(body: Body, qpos: np.ndarray, qvel: np.ndarray | None = None, qacc: np.ndarray | None = None) -> Load:
    """Inverse dynamics of a body that only its right foot carries, whatever its sole could bear.

    Args:
      body: body.
      qpos: its state, in the world,
      qvel: at rest by default,
      qacc: and its acceleration, none by default.
    """
    model, data = body.model, body.data
    data.qpos[:] = qpos
    data.qvel[:] = 0.0 if qvel is None else qvel
    data.qacc[:] = 0.0 if qacc is None else qacc
    flags = model.opt.disableflags
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    mujoco.mj_inverse(model, data)
    model.opt.disableflags = flags
    needed, jacobian = data.qfrc_inverse.copy(), np.zeros((6, model.nv))
    place = data.xpos[body.right].copy()
    mujoco.mj_jac(model, data, jacobian[:3], jacobian[3:], place, body.right)
    force, moment = np.split(np.linalg.solve(jacobian[:, :6].T, needed[:6]), 2)
    torque = needed[6:] - jacobian[:, 6:].T @ np.concatenate([force, moment])
    about_origin = moment + np.cross(place, force)
    return Load(torque, force, np.array([-about_origin[1], about_origin[0]]) / force[2])


def gait(
    speed: float, height: float, period: float, stance: float, lift: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`qpos`, `qvel` and `qacc` of an even walk at `MOMENTS` times from the right foot's touch-down, (times, n) each.

    The torso glides straight and upright; feet stand flat and swing by a polynomial of fifth order, their toes down.

    Args:
      speed: m/s.
      height: of the hips above the ankles, m.
      period: of a step with each foot, s.
      stance: share of it in which a foot stands.
      lift: of the ankle in mid-swing, m.
    """
    phase = np.linspace(0.0, 1.0, MOMENTS + 1)
    joints = np.concatenate([_swinging(phase + apart, speed, height, period, stance, lift) for apart in (0, 0.5)], 1)
    joints[-1] = joints[0]
    motion = CubicSpline(period * phase, joints, bc_type="periodic")
    times = period * phase[:-1]
    torso = np.zeros((3, MOMENTS, 7))
    torso[0, :, 0], torso[0, :, 2], torso[0, :, 3] = speed * times, height + robot.FOOT_HEIGHT, 1.0
    torso[1, :, 0] = speed
    states = (np.concatenate([torso[k, :, : 7 if k == 0 else 6], motion(times, k)], axis=1) for k in range(3))
    qpos, qvel, qacc = states
    return qpos, qvel, qacc


def rocking(body: Body, joints: np.ndarray, period: float, stance: float) -> Rocking:
    """How a body tips from side to side, linear in its small tilt.

    Where both soles are flat it tips over to the other foot. On the outer edge of one it slows down, for half the time
    that the other foot is in the air, and comes back. With r the rate, t that time, p the distance of the edge and h
    the height of the centre of mass, the tilt is p / h (1 - 1 / cosh(r t / 2)).
    """
    rate, height = _falling(body, joints)
    tilt = OUTER / height * (1 - 1 / math.cosh(rate * (1 - stance) * period / 2))
    return Rocking(rate, math.sqrt(thesis.GRAVITY / height), height * tilt, tilt)


def slowest(body: Body, joints: np.ndarray, stance: float) -> float:
    """The period, s, above which a rocking body's centre of mass comes above a sole."""
    rate, _ = _falling(body, joints)
    return 2 * math.acosh(1 / (1 - INNER / OUTER)) / (rate * (1 - stance))


def hiking(body: Body, period: float, stance: float) -> tuple[float, float]:
    """A body on straight legs that tips no sole: how fast its free hip drops, rad/s^2, and how far it is to be up, rad.

    The torso and the free leg turn about the hip of the standing one, whose roll may push only as hard as the sole's
    inner edge bears. For the foot to be free for its time, the hip must go up and come down again.
    """
    qpos, qacc = body.standing(np.zeros(10)), np.zeros((2, body.model.nv))
    qacc[1, :3] = np.cross([1.0, 0.0, 0.0], [0.0, robot.HIP_OFFSET, 0.0])
    qacc[1, 3] = qacc[1, 6 + 2] = 1.0
    none, one = (carried(body, qpos, None, x) for x in qacc)
    edge = robot.FOOT_WIDTH / 2
    moments = [load.force[2] * (load.point[1] - edge) for load in (none, one)]
    drop = moments[0] / (moments[1] - moments[0])
    return float(drop), float(drop) / 2 * ((1 - stance) * period / 2) ** 2


def _falling(body: Body, joints: np.ndarray) -> tuple[float, float]:
    """The rate at which the stiff body falls over the outer edge of a sole, 1/s, and the height of its mass, m."""
    model, data = body.model, body.data
    data.qpos[:] = body.standing(joints)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mass, height = model.body_mass.sum(), data.subtree_com[0, 2]
    arms = data.xipos - data.subtree_com[0]
    frames = data.ximat.reshape(-1, 3, 3)
    roll = (frames[:, 0] ** 2 * model.body_inertia).sum() + model.body_mass @ (arms[:, 1:] ** 2).sum(axis=1)
    return math.sqrt(mass * thesis.GRAVITY * height / (roll + mass * (height**2 + OUTER**2))), float(height)


def _swinging(
    phase: np.ndarray, speed: float, height: float, period: float, stance: float, lift: float
) -> Float[np.ndarray, "times 5"]:
    """The joints of one leg of the gait."""
    phase = phase % 1.0
    swings, share = phase >= stance, np.maximum(phase - stance, 0.0) / (1 - stance)
    half, back = speed * stance * period / 2, -speed * (1 - stance) * period
    way = BPoly.from_derivatives([0.0, 1.0], [[-half, back, 0.0], [half, back, 0.0]])
    ahead = np.where(swings, way(share), half - speed * period * phase)
    up = np.where(swings, 16 * (share * (1 - share)) ** 2, 0.0)
    joints = leg_over(ahead, height - lift * up)
    # The ankle leaves the ground and meets it as it moves there, and in between goes as far as it can.
    small = 1e-6
    ends = np.add.outer([-half, half], [-small, 0.0, small])
    beside = leg_over(ends, np.full_like(ends, height))[..., 4]
    leaves, meets = ([angle, back * (after - before) / (2 * small), 0.0] for before, angle, after in beside)
    ankle = BPoly.from_derivatives([0.0, 0.5, 1.0], [leaves, [DORSIFLEXION, 0.0], meets])
    joints[:, 4] = np.where(swings, ankle(share), joints[:, 4])
    return joints
