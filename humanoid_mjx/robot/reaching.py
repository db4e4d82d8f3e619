# pyright: reportAttributeAccessIssue=false
"""The inverse kinematics of a robot's legs as polynomials, fitted once to the model.

Damped Gauss-Newton steps on the leg's product of exponentials solve the joints for samples of foot positions. Cubic
polynomials in the displacement of the foot fit these solutions. A foot of three points or more also stays level and
turns about the vertical.
"""

from functools import lru_cache, reduce
from itertools import combinations_with_replacement
from operator import mul
from typing import Any, NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float, Int

from humanoid_mjx.robot.description import Robot, ground_points
from humanoid_mjx.spec import InputError

REGION = np.array([[-0.4, 0.4], [-0.25, 0.25], [0.0, 0.3], [-0.5, 0.5]])
"""Displacements forward, to the left and up as shares of the legs' length, and the turn to the left, rad."""

SAMPLES, ROUNDS = 600, 20

DAMPING, LEVEL = 1e-3, 0.3
"""Weights, against the displacement by the legs' length, of a joint's way and of a tilt, by rad."""


class _Leg(NamedTuple):
    joints: Int[np.ndarray, " of_leg"]
    axes: Float[np.ndarray, "of_leg 3"]
    anchors: Float[np.ndarray, "of_leg 3"]
    foot: Float[np.ndarray, "3"]
    flat: bool


def monomials(x: Any) -> list[Any]:
    """The monomials of degrees 1 to 3 of the entries of a sequence."""
    return [reduce(mul, factors) for degree in (1, 2, 3) for factors in combinations_with_replacement(x, degree)]


@lru_cache
def reach_of(robot: Robot) -> tuple[Float[np.ndarray, "feet 2"], Float[np.ndarray, "terms joints"]]:
    """Return the places of the feet at home, forward and to the left of the torso, m; and the joints for other places,
    as coefficients of the `monomials` of all feet, foot by foot, rad.

    Raises:
      InputError: the robot hangs: it has no foot on the ground.
    """
    if not robot.points:
        raise InputError(f"robot: {robot.name} hangs from its base; name one that stands, such as lower_body.")
    legs = [_leg(robot, foot) for foot in range(len(robot.feet))]
    blocks = []
    for leg in legs:
        region = REGION if leg.flat else REGION[:3]
        wanted = np.random.default_rng(0).uniform(region[:, 0], region[:, 1], (SAMPLES, len(region)))
        terms = np.stack(monomials(wanted.T), axis=1)
        block = np.zeros((terms.shape[1], len(robot.joints)))
        block[:, leg.joints] = np.linalg.lstsq(terms, _solve(robot, leg, wanted), rcond=None)[0]
        blocks.append(block)
    return np.array([leg.foot[:2] for leg in legs]), np.concatenate(blocks)


def _leg(robot: Robot, foot: int) -> _Leg:
    """The joints that move one foot alone, at home, in the torso's frame."""
    model, data = robot.model, mujoco.MjData(robot.model)
    rows = robot.driven
    data.qpos[model.jnt_qposadr[rows]] = robot.posture
    data.qpos[:7] = (0, 0, 0, 1, 0, 0, 0)
    mujoco.mj_kinematics(model, data)
    balls, moved_by = ground_points(model)
    dofs = model.jnt_dofadr[rows]
    of_feet = moved_by[:: robot.points][:, dofs]
    joints = np.flatnonzero(of_feet[foot] & (of_feet.sum(axis=0) == 1))
    places = data.geom_xpos[balls].reshape(len(robot.feet), robot.points, 3)
    joints = joints[np.argsort(dofs[joints])]
    return _Leg(
        joints, data.xaxis[rows[joints]], data.xanchor[rows[joints]], places[foot].mean(axis=0), robot.points > 2
    )


def _solve(robot: Robot, leg: _Leg, wanted: Float[np.ndarray, "samples parts"]) -> Float[np.ndarray, "samples joints"]:
    """Changes of the leg's joints that bring the foot where it is wanted, rad."""
    q, step = np.zeros((len(wanted), len(leg.joints))), 1e-6
    low, high = (robot.ranges_rad - robot.posture[:, None])[leg.joints].T
    limited = robot.model.jnt_limited[robot.driven[leg.joints]] > 0
    low, high = np.where(limited, low, -np.pi), np.where(limited, high, np.pi)
    for _ in range(ROUNDS):
        miss = _miss(robot, leg, q, wanted)
        columns = [(_miss(robot, leg, q + step * unit, wanted) - miss) / step for unit in np.eye(len(leg.joints))]
        jacobian = np.stack(columns, axis=-1)
        normal = jacobian.swapaxes(1, 2) @ jacobian + DAMPING * np.eye(len(leg.joints))
        right = np.einsum("sij,si->sj", jacobian, miss) + DAMPING * q
        q = np.clip(q - np.linalg.solve(normal, right[..., None])[..., 0], low, high)
    return q


def _miss(robot: Robot, leg: _Leg, q: np.ndarray, wanted: np.ndarray) -> Float[np.ndarray, "samples parts"]:
    """Return the error of the foot: displacement by the legs' length; of a flat foot also rotation times `LEVEL`."""
    from scipy.spatial.transform import Rotation  # takes longer to import than all of this module

    place, rotation = np.broadcast_to(leg.foot, (len(q), 3)), Rotation.identity(len(q))
    for axis, anchor, angle in zip(leg.axes[::-1], leg.anchors[::-1], q.T[::-1], strict=True):
        turn = Rotation.from_rotvec(angle[:, None] * axis)
        place, rotation = anchor + turn.apply(place - anchor), turn * rotation
    miss = (place - leg.foot) / robot.leg_length - wanted[:, :3]
    if not leg.flat:
        return miss
    around = Rotation.from_rotvec(wanted[:, 3:] * np.array([0.0, 0.0, 1.0]))
    return np.concatenate([miss, LEVEL * (around.inv() * rotation).as_rotvec()], axis=1)
