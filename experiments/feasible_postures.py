# pyright: reportAttributeAccessIssue=false
"""Searches for the furthest that the lower body can go with its soles flat: balance on one foot, steps, turns.

A sole that is flat on the ground gives the orientation of everything else, so postures are looked at from the stance
foot, the right one. As no ankle rolls, its hip is straight above the foot's middle line in every one of them.
"""

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import product
from typing import Any, NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from humanoid_mjx.robot import lower_body as robot

STARTS = 40
"""Random postures that a search starts from. With 150 none of what `feasible_ranges` finds is further by 0.01 mm."""

LONG = 100.0
"""Factor on lengths within a search: centimetres change as much as radians do."""

MISS = 1e-4
"""By how much a found posture may miss a condition: rad, or, lengths being multiplied by `LONG`, a micrometre."""


class Seen(NamedTuple):
    """A posture as seen from the right foot, flat on the ground: x forward, y left, z up; the origin is below its
    ankle."""

    center: Float[np.ndarray, "3"]
    """Centre of mass, m."""
    up: Float[np.ndarray, "3"]
    """The torso's own z axis."""
    turned: Float[np.ndarray, "3 3"]
    """Orientation of the left foot."""
    ankle: Float[np.ndarray, "3"]
    """The left foot's ankle, m above its sole: where it stands if it is flat."""
    corners: Float[np.ndarray, "4 3"]
    """Lower corners of the left foot, m."""
    apart: float
    """Distance between the two legs, m, all parts of them, of which the model's own contacts leave some out."""

    @property
    def margin(self) -> Float[np.ndarray, "4"]:
        """How far the centre of mass is inside each edge of the right sole, m: heel, toe, left, right."""
        x, y, _ = self.center
        heel, half = robot.ANKLE_FROM_HEEL, robot.FOOT_WIDTH / 2
        return np.array([x + heel, robot.FOOT_LENGTH - heel - x, half - y, half + y])

    @property
    def lean(self) -> float:
        """Lean of the torso, rad."""
        return float(np.arccos(np.clip(self.up[2], -1.0, 1.0)))


class Reached(NamedTuple):
    """A right leg under an upright torso that looks forward: x forward, y left, z up, the origin in the hip."""

    turned: Float[np.ndarray, "3 3"]
    """Orientation of the foot."""
    ankle: Float[np.ndarray, "3"]
    """m"""
    toe: Float[np.ndarray, "3"]
    """Middle of the sole's front edge, m."""

    @property
    def tilt(self) -> Float[np.ndarray, "2"]:
        """The level parts of the foot's up axis: 0 where the sole is flat."""
        return self.turned[2, :2]

    @property
    def heading(self) -> float:
        """Heading of the foot, rad, positive to the left: toes inwards."""
        return float(np.arctan2(self.turned[1, 0], self.turned[0, 0]))


class Body:
    """The lower body with one column of Table 3.2, as its postures are looked at."""

    def __init__(self, ranges: str):
        self.model = robot.lower_body_model(ranges=ranges)
        self.data = mujoco.MjData(self.model)
        self.limits = self.model.jnt_range[1:].copy()
        self.right, self.left, self.hip = (
            self.model.body(name).id for name in ("right_foot", "left_foot", "right_thigh")
        )
        self._corners = [self.model.geom(f"left_corner{i}").id for i in range(len(robot.CORNERS))]
        self._pairs = [
            (self.model.geom(f"right_{one}").id, self.model.geom(f"left_{other}").id)
            for one, other in product(("thigh", "shank", "sole"), repeat=2)
        ]

    def see(self, joints: Float[np.ndarray, "10"]) -> Seen:
        data = self._placed(joints)
        frame, below = data.xmat[self.right].reshape(3, 3), np.array([0.0, 0.0, robot.FOOT_HEIGHT])
        place = data.xpos[self.right]
        mujoco.mj_comPos(self.model, data)
        corners = (data.geom_xpos[self._corners] - place) @ frame + below - (0.0, 0.0, robot.CORNER_RADIUS)
        between = (mujoco.mj_geomDistance(self.model, data, *pair, 1.0, None) for pair in self._pairs)
        return Seen(
            center=(data.subtree_com[0] - place) @ frame + below,
            up=frame[2].copy(),
            turned=frame.T @ data.xmat[self.left].reshape(3, 3),
            ankle=(data.xpos[self.left] - place) @ frame,
            corners=corners,
            apart=min(between),
        )

    def reach(self, joints: Float[np.ndarray, "5"]) -> Reached:
        data = self._placed(np.append(joints, np.zeros(5)))
        turned, ankle = data.xmat[self.right].reshape(3, 3).copy(), data.xpos[self.right] - data.xpos[self.hip]
        toe = np.array([robot.FOOT_LENGTH - robot.ANKLE_FROM_HEEL, 0.0, -robot.FOOT_HEIGHT])
        return Reached(turned, ankle, ankle + turned @ toe)

    def standing(self, joints: Float[np.ndarray, "10"]) -> Float[np.ndarray, " nq"]:
        """`qpos` with the right sole flat on the ground, its ankle above the origin."""
        data = self._placed(joints)
        frame, rotation = data.xmat[self.right].reshape(3, 3), np.empty(4)
        mujoco.mju_mat2Quat(rotation, frame.T.ravel().copy())
        ankle = np.array([0.0, 0.0, robot.FOOT_HEIGHT])
        return np.concatenate([ankle - data.xpos[self.right] @ frame, rotation, joints])

    def _placed(self, joints: np.ndarray) -> mujoco.MjData:
        """The torso upright at the origin."""
        self.data.qpos[:] = np.concatenate([[0, 0, 0, 1, 0, 0, 0], joints])
        mujoco.mj_kinematics(self.model, self.data)
        return self.data


Conditions = Callable[[Any], Any]
"""From what is seen of a posture to numbers, lengths multiplied by `LONG`."""


def furthest(
    look: Callable[[np.ndarray], Any],
    limits: Float[np.ndarray, "joints 2"],
    goal: Conditions,
    inside: Conditions = lambda seen: [],
    equal: Conditions = lambda seen: [],
    known: Sequence[np.ndarray] = (),
) -> np.ndarray | None:
    """The posture with the largest goal, by sequential quadratic programming from many starts.

    Args:
      look: from the joints to what the conditions are of.
      limits: lowest and highest angle of each joint, rad.
      goal: numbers whose least is to be as large as can be.
      inside: numbers that must not be negative.
      equal: numbers that must be 0.
      known: postures to start from besides.

    Returns:
      the joints, rad, or None where no start led to a posture that meets all.
    """
    random, best, most = np.random.default_rng(0), None, -np.inf
    pull = np.append(np.zeros(len(limits)), -1.0)

    # Both kinds of conditions are asked of the same postures.
    seen_at = lru_cache(64)(lambda joints: look(np.frombuffer(joints)))

    def unequal(x: np.ndarray) -> np.ndarray:
        seen = seen_at(x[:-1].tobytes())
        return np.concatenate([np.atleast_1d(goal(seen)) - x[-1], inside(seen)])

    def equalities(x: np.ndarray) -> np.ndarray:
        return np.asarray(equal(seen_at(x[:-1].tobytes())), float)

    kinds: list[dict[str, Any]] = [{"type": "ineq", "fun": unequal}]
    if len(equalities(np.append(limits.mean(axis=1), 0.0))):
        kinds.append({"type": "eq", "fun": equalities})
    drawn = (random.uniform(*limits.T) * random.choice([0.3, 1.0]) for _ in range(STARTS))
    for joints in (*known, *drawn):
        start = np.append(joints, np.min(goal(look(joints))))
        bounds = [*limits, (None, None)]
        found = minimize(
            lambda x: -x[-1],
            start,
            jac=lambda x: pull,
            bounds=bounds,
            constraints=kinds,
            method="SLSQP",
            options={"maxiter": 300, "ftol": 1e-9},
        ).x
        joints = np.clip(found[:-1], *limits.T)
        seen = look(joints)
        misses = max(-np.min(inside(seen), initial=np.inf), np.max(np.abs(equal(seen)), initial=0.0))
        value = float(np.min(goal(seen)))
        if misses <= MISS and value > most:
            best, most = joints, value
    return best


def leg_over(
    ahead: Float[np.ndarray, "*places"], height: Float[np.ndarray, "*places"]
) -> Float[np.ndarray, "*places 5"]:
    """Joints of a leg whose ankle is so far ahead of the hip and below it, m, and whose sole is level."""
    bend = np.arccos(np.clip(np.hypot(ahead, height) / (robot.THIGH_LENGTH + robot.SHANK_LENGTH), -1.0, 1.0))
    hip, none = np.arctan2(ahead, height) + bend, np.zeros_like(bend)
    return np.stack([hip, none, none, 2 * bend, hip - 2 * bend], axis=-1)


def level_travel(limits: Float[np.ndarray, "5 2"], height: float) -> tuple[float, float]:
    """How far a flat foot may be ahead of the hip and behind it, m, and anywhere in between, the hip at one height.

    Args:
      limits: of a leg's joints, rad.
      height: of the hip above the ankle, m.
    """
    steps = np.arange(0.0, robot.THIGH_LENGTH, 1e-4)
    ends = []
    for sign in (1.0, -1.0):
        joints = leg_over(sign * steps, np.full_like(steps, height))
        inside = ((joints >= limits[:, 0] - 1e-9) & (joints <= limits[:, 1] + 1e-9)).all(axis=1)
        inside &= np.hypot(steps, height) <= robot.THIGH_LENGTH + robot.SHANK_LENGTH
        ends.append(float(steps[np.argmin(inside) - 1]) if inside[0] else math.nan)
    return ends[0], ends[1]
