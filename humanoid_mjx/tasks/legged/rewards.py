"""Terms of rewards, plain functions of a view, and the Specs that give them weights.

A weight is a traced field with the name of its term: `task.rewards.slip` can be swept, and so can the numbers that
shape the terms, such as `task.rewards.shapes.upright`. To add a term of your own, derive from a Spec below, declare a
field for the weight and add an entry to what `terms` returns.
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from pydantic import Field, model_serializer

from humanoid_mjx.mechanics.rotations import heading_frame
from humanoid_mjx.spec import InputError, Spec, traced
from humanoid_mjx.tasks.legged.view import View
from humanoid_mjx.types import FloatScalar


def shape(default: float, description: str) -> Any:
    """Declare a number of `Shapes`."""
    return Field(default, gt=0, description=description)


class Shapes(Spec):
    """Shapes of the terms. They are constants of the compiled program: each combination of a sweep compiles once.

    The narrow parts of `speed` and `turn` take the mean error, since within a step the body sways by more. With them
    alone a body learns to stay on the spot, where they have no gradient; with the wide part alone it follows the
    command loosely.
    """

    upright: float = shape(10.0, "lean, degrees, at which `upright` is 1 / e")
    still: float = shape(0.14, "speed at which `still` is 1 / e, as a share of the robot's pace")
    speed_near: float = shape(0.00245, "squared error at which a part of `speed` is 1 / e, over the squared pace")
    speed_middle: float = shape(0.0195, "the same of the second part")
    speed_far: float = shape(0.147, "the same of the widest part")
    turn_near: float = shape(0.03, "squared error at which a part of `turn` is 1 / e, (rad/s)^2")
    turn_middle: float = shape(0.2, "the same of the second part")
    turn_far: float = shape(1.0, "the same of the widest part")
    loaded: float = shape(0.048, "force on a foot that stands, as a share of the weight")
    swing_height: float = shape(0.144, "height of a foot in mid-swing, as a share of the legs' length")
    clearance: float = shape(0.058, "error at which `clearance` is 1 / e, as a share of the legs' length")
    apart: float = shape(0.24, "lateral distance of feet that are not too near, as a share of the legs' length")
    crossing: float = shape(0.096, "shortfall at which `crossing` is 1, as a share of the legs' length")
    slip: float = shape(0.01225, "mean squared speed of feet on the ground at which `slip` is 1, over the squared pace")


SHAPES = Shapes()


class Rewards(Spec):
    """Base of rewards: declare a weight for each term of `TERMS`, and add others in `terms`."""

    shapes: Shapes = Field(default=SHAPES, description="numbers that shape the terms")

    @model_serializer(mode="wrap")
    def _with_shapes_of_its_own(self, write: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        """Leave usual shapes out, so that configs of before have the digest of before."""
        return {key: value for key, value in write(self).items() if key != "shapes" or self.shapes != SHAPES}

    def terms(self, view: View) -> dict[str, FloatScalar]:
        """The terms without their weights: those of `TERMS` that have a weight."""
        return {name: TERMS[name](view, self.shapes) for name in type(self).model_fields if name in TERMS}

    def weighted(self, view: View) -> dict[str, FloatScalar]:
        """The parts of the reward by name; it is their sum.

        Raises:
          InputError: there is no term, or a term has no weight.
        """
        terms = self.terms(view)
        if not terms:
            raise InputError(f"rewards: {type(self).__name__} has no term; declare a traced field, as `upright`.")
        if missing := [name for name in terms if name not in type(self).model_fields]:
            name = type(self).__name__
            raise InputError(
                f"rewards: the term {missing[0]!r} of {name} has no weight; declare a traced field for it."
            )
        return {name: jnp.asarray(getattr(self, name) * term, jnp.float32) for name, term in terms.items()}


class StandRewards(Rewards):
    """Keep the torso upright and still with set-points near the posture. The sum is at most 1."""

    alive: float = traced(0.4, description="for every step")
    upright: float = traced(0.3, description="for a torso that does not lean")
    still: float = traced(0.2, description="for hips that do not move")
    calm: float = traced(0.1, description="for set-points near the posture")


class WalkRewards(Rewards):
    """Do as commanded, step by the gait's clock, keep upright, and neither slip, fly nor cross the feet.

    The sum is at most 1.26. `docs/walking_settings.md` says what was tried, and how bodies then walked.
    """

    speed: float = traced(0.6, description="for the commanded velocity, at three scales")
    turn: float = traced(0.4, description="for the commanded turn rate, at three scales")
    upright: float = traced(0.02, description="for a torso that does not lean")
    schedule: float = traced(0.18, description="for feet that are loaded and lifted when the clock says so")
    clearance: float = traced(0.06, description="for feet as high above the ground as the clock says")
    flight: float = traced(-0.3, description="for each step without a foot on the ground")
    slip: float = traced(-1.2, description="for corners that touch and move")
    flat: float = traced(-0.03, description="for feet that stand tilted")
    crossing: float = traced(-0.06, description="for feet too near each other")
    yawing: float = traced(-0.5, description="for a torso that turns to and fro")
    smooth: float = traced(-0.12, description="for set-points that jump")
    effort: float = traced(-0.006, description="for torque")


def alive(view: View, _: Shapes = SHAPES) -> FloatScalar:
    """1 in every step."""
    return jnp.float32(1.0)


def upright(view: View, shapes: Shapes = SHAPES) -> FloatScalar:
    """1 for an upright torso."""
    return jnp.exp(-((view.lean / np.radians(shapes.upright)) ** 2))


def still(view: View, shapes: Shapes = SHAPES) -> FloatScalar:
    """1 for hips that do not move."""
    return jnp.exp(-jnp.sum(view.episode.world.qvel[:3] ** 2) / view.robot.speed(shapes.still) ** 2)


def calm(view: View, _: Shapes = SHAPES) -> FloatScalar:
    """1 less the mean square of the offsets."""
    return 1.0 - jnp.mean(view.episode.offsets**2)


def speed(view: View, shapes: Shapes = SHAPES) -> FloatScalar:
    """1 at the commanded velocity, forward and sideways; the widest of three scales takes the last decision alone."""
    late, now = jnp.sum(view.episode.tracking_error[:2] ** 2), jnp.sum((view.velocity[:2] - view.command[:2]) ** 2)
    scales = shapes.speed_near, shapes.speed_middle, shapes.speed_far
    near, middle, far = map(view.robot.square, scales)
    return (jnp.exp(-late / near) + jnp.exp(-late / middle) + jnp.exp(-now / far)) / 3


def turn(view: View, shapes: Shapes = SHAPES) -> FloatScalar:
    """1 at the commanded turn rate; the widest of three scales takes the last decision alone."""
    late, now = view.episode.tracking_error[2] ** 2, (view.turn_rate - view.command[2]) ** 2
    near, middle, far = shapes.turn_near, shapes.turn_middle, shapes.turn_far
    return (jnp.exp(-late / near) + jnp.exp(-late / middle) + jnp.exp(-now / far)) / 3


def schedule(view: View, shapes: Shapes = SHAPES) -> FloatScalar:
    """The share of feet that are in the air where they should swing, and carry weight where they should stand."""
    loaded = view.feet.load > view.robot.force(shapes.loaded)
    return jnp.mean(jnp.where(view.swing > 0.2, ~loaded, loaded))


def clearance(view: View, shapes: Shapes = SHAPES) -> FloatScalar:
    """1 where all feet are as high as the clock says."""
    highest, close = view.robot.length(shapes.swing_height), view.robot.length(shapes.clearance)
    return jnp.exp(-jnp.sum(((view.feet.height - highest * view.swing) / close) ** 2))


def flight(view: View, shapes: Shapes = SHAPES) -> FloatScalar:
    """1 without a foot on the ground."""
    return (view.feet.load <= view.robot.force(shapes.loaded)).all() * 1.0


def slip(view: View, shapes: Shapes = SHAPES) -> FloatScalar:
    """The squared speed along the ground of the corners in contact, a mean over all corners of all feet, divided by
    `shapes.slip`; at most 1.

    Corners count, since the middle of a foot that rolls over its edge moves without slipping.
    """
    squares = jnp.sum(view.feet.corner_velocity[..., :2] ** 2, axis=-1)
    return jnp.minimum(jnp.mean(squares * view.feet.touching) / view.robot.square(shapes.slip), 1.0)


def flat(view: View, shapes: Shapes = SHAPES) -> FloatScalar:
    """Five times the squared sines of the tilts of loaded feet, summed; at most 1; 0 for feet of one or two points."""
    if view.robot.points < 3:
        return jnp.float32(0.0)
    loaded = view.feet.load > view.robot.force(shapes.loaded)
    return jnp.minimum(5 * jnp.sum(loaded * (1 - view.feet.rotation[:, 2, 2] ** 2)), 1.0)


def crossing(view: View, shapes: Shapes = SHAPES) -> FloatScalar:
    """The squared shortfall of the lateral distance between the feet, in units of `shapes.crossing`; at most 2."""
    right, left = view.robot.foot_pairs.T
    if not len(right):
        return jnp.float32(0.0)
    gap = ((view.feet.position[left] - view.feet.position[right]) @ heading_frame(view.rotation)[1]).min()
    lack = jnp.maximum(view.robot.length(shapes.apart) - gap, 0.0)
    return jnp.minimum((lack / view.robot.length(shapes.crossing)) ** 2, 2.0)


def yawing(view: View, _: Shapes = SHAPES) -> FloatScalar:
    """The squared deviation of the turn-rate error from its running mean, (rad/s)^2; at most 1.

    A torso that oscillates about the vertical with its steps has no mean error, but does not keep its heading.
    """
    return jnp.minimum((view.turn_rate - view.command[2] - view.episode.tracking_error[2]) ** 2, 1.0)


def smooth(view: View, _: Shapes = SHAPES) -> FloatScalar:
    """The mean square of the offsets' changes."""
    return jnp.mean((view.episode.offsets - view.last_offsets) ** 2)


def effort(view: View, _: Shapes = SHAPES) -> FloatScalar:
    """The mean square of the torques as shares of the robot's own limit."""
    return jnp.mean((view.torque / view.robot.torque_limits) ** 2)


TERMS: dict[str, Callable[[View, Shapes], FloatScalar]] = {
    term.__name__: term
    for term in [
        *(alive, upright, still, calm, speed, turn, schedule, clearance, flight, slip, flat),
        *(crossing, yawing, smooth, effort),
    ]
}
"""The terms by name."""
