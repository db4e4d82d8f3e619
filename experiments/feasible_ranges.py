"""What a column of Table 3.2 lets the lower body do on flat soles: balance, shift its weight, step and turn."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from feasible_postures import LONG, Body, Reached, Seen, furthest, level_travel
from feasible_torques import carried

from humanoid_mjx.robot import lower_body as robot

LEANS = (1.0, 5.0, 15.0, 25.0, 35.0, 45.0)
"""Largest lean of the torso, degrees: from upright to what the legged tasks count as a fall."""

HELD = 0.005
"""m. A body stands on one foot if its mass is so far inside the sole's edges: nearly half of what there is, and used up
by a tilt of 1.5 degrees."""

CLEAR = 0.005
"""m. The height of the other foot, if it is lifted."""

LEG_LENGTH = robot.THIGH_LENGTH + robot.SHANK_LENGTH


class Column(NamedTuple):
    """What one column allows. Lengths in m, angles in rad, torques in N m."""

    lifted: list[float]
    """Margin of the centre of mass in one sole for each of `LEANS`, the other foot lifted,"""
    planted: list[float]
    """or flat on the ground too, wherever it is,"""
    beside: float
    """or flat on the ground beside it, below the hips, for the last lean."""
    balanced: np.ndarray
    """The joints of the least leaning posture that stands on one foot,"""
    lean: float
    """its lean,"""
    torque: np.ndarray
    """and the torques that hold it."""
    highest: float
    """How high the other foot can be while the body stands on one, for the last lean."""
    travel: float
    """How far hips at the posture's height can pass over a flat foot,"""
    longest: tuple[float, float]
    """at the best height how far, and above the ankle where,"""
    rolling: float
    """and at the posture's height if the foot may end on its tip, the sole nearly upright."""
    level: float
    """How high a foot can be lifted flat below the hip."""
    toes_in: float
    toes_out: float
    """Heading of a flat foot below the hip against an upright torso, in the posture's height."""
    roll: tuple[float, float]
    """A hip's roll: inwards (negative) and outwards."""


def explore(name: str, height: float, tell: Callable[[str], None] = lambda words: None) -> Column:
    """Search the postures that a column allows.

    Args:
      name: of the column.
      height: of the walking posture's hips above its ankles, m.
      tell: called with the progress in words.
    """
    body = Body(name)
    tell(f"{name} ranges: the mass above one foot")
    lifted = furthest_inside(body, _lifted)
    tell(f"{name} ranges: the mass above one of two feet")
    planted = furthest_inside(body, _nothing, _flat)
    tell(f"{name} ranges: steps and turns")
    (beside,) = furthest_inside(body, _nothing, _beside, LEANS[-1:])
    least = furthest(body.see, body.limits, lambda s: s.up[2], lambda s: [*_held(s), *_lifted(s)], known=lifted)
    high = furthest(
        body.see, body.limits, lambda s: LONG * s.corners[:, 2], lambda s: [*_held(s), *_upright(s, LEANS[-1])]
    )
    balanced = _found(least)
    legs = body.limits[:5]
    ahead, behind = level_travel(legs, height)
    heights = np.arange(0.8, 1.0, 0.0025) * LEG_LENGTH
    travels = np.nan_to_num([sum(level_travel(legs, h)) for h in heights])
    return Column(
        lifted=[margin(body, joints) for joints in lifted],
        planted=[margin(body, joints) for joints in planted],
        beside=margin(body, beside),
        balanced=balanced,
        lean=body.see(balanced).lean,
        torque=carried(body, body.standing(balanced)).torque,
        highest=float(body.see(_found(high)).corners[:, 2].min()),
        travel=ahead + behind,
        longest=(float(travels.max()), float(heights[travels.argmax()])),
        rolling=ahead - _toes(body, height) + robot.FOOT_LENGTH - robot.ANKLE_FROM_HEEL,
        level=height + float(_leg(body, lambda r: LONG * r.ankle[2], lambda r: [*_below(r), r.heading]).ankle[2]),
        toes_in=_leg(body, lambda r: r.heading, lambda r: [*_below(r), LONG * (r.ankle[2] + height)]).heading,
        toes_out=-_leg(body, lambda r: -r.heading, lambda r: [*_below(r), LONG * (r.ankle[2] + height)]).heading,
        roll=(float(legs[2, 0]), float(legs[2, 1])),
    )


def furthest_inside(
    body: Body,
    inside: Callable[[Seen], Any],
    equal: Callable[[Seen], Any] = lambda seen: [],
    leans: Sequence[float] | None = None,
) -> list[np.ndarray]:
    """The postures, joints in rad, whose centre of mass is furthest inside the right sole, one for each lean.

    Args:
      body: body.
      inside: and
      equal: further conditions, as in `furthest`.
      leans: largest leans of the torso, degrees, in rising order; by default `LEANS`.
    """
    found: list[np.ndarray] = []
    for lean in reversed(LEANS if leans is None else leans):
        best = furthest(
            body.see,
            body.limits,
            lambda s: LONG * s.margin,
            lambda s, lean=lean: [*_upright(s, lean), *inside(s)],
            equal,
            found[-1:],
        )
        found.append(_found(best))
    return found[::-1]


def margin(body: Body, joints: np.ndarray) -> float:
    """How far the centre of mass is inside the right sole, m, negative outside it."""
    return float(body.see(joints).margin.min())


def _leg(body: Body, goal: Any, equal: Any) -> Reached:
    return body.reach(_found(furthest(body.reach, body.limits[:5], goal, equal=equal)))


def _toes(body: Body, height: float) -> float:
    """How far the toes of a foot whose heel is lifted can be ahead of the hip at least, m, usually behind it."""
    back = furthest(
        body.reach,
        body.limits[:5],
        lambda r: -LONG * r.toe[0],
        lambda r: [-r.turned[2, 0]],
        lambda r: [r.heading, r.tilt[1], LONG * (r.toe[2] + height + robot.FOOT_HEIGHT)],
    )
    return float(body.reach(_found(back)).toe[0])


def _found(joints: np.ndarray | None) -> np.ndarray:
    if joints is None:
        raise RuntimeError("no posture within the joints' ranges meets the conditions of the search.")
    return joints


def _nothing(seen: Seen) -> list[float]:
    return []


def _held(seen: Seen) -> Any:
    return LONG * (seen.margin - HELD)


def _upright(seen: Seen, lean: float) -> list[float]:
    """The torso leans no further, and the legs do not pass through each other."""
    return [seen.up[2] - math.cos(math.radians(lean)), LONG * seen.apart]


def _lifted(seen: Seen) -> list[float]:
    return [*(LONG * (seen.corners[:, 2] - CLEAR)), LONG * seen.apart]


def _flat(seen: Seen) -> list[float]:
    return [*seen.turned[:2, 2], LONG * seen.ankle[2]]


def _beside(seen: Seen) -> list[float]:
    place = seen.ankle - (0.0, 2 * robot.HIP_OFFSET, 0.0)
    return [*seen.turned[:2, 2], seen.turned[1, 0], *(LONG * place)]


def _below(reached: Reached) -> list[float]:
    """Flat, the ankle below the hip: to its side it cannot be."""
    return [*reached.tilt, LONG * reached.ankle[0]]
