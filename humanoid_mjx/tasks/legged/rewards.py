"""Terms of rewards, plain functions of a view, and the Specs that give them weights.

A weight is a traced field with the name of its term: `task.rewards.slip` can be swept. To add a term, derive from a
Spec below, declare a field for the weight and add an entry to `terms`.
"""

import jax.numpy as jnp
import numpy as np

from humanoid_mjx.mechanics.rotations import heading_frame
from humanoid_mjx.spec import InputError, Spec, traced
from humanoid_mjx.tasks.legged.view import View
from humanoid_mjx.types import FloatScalar

UPRIGHT, STILL = np.radians(10.0), 0.14
"""Lean, rad, and speed, as a share of the robot's pace, at which a reward has dropped to 1 / e."""

SPEED_SCALES = 0.00245, 0.0195, 0.147
"""Squared errors at which the three parts of `speed` have dropped to 1 / e, as shares of the squared pace. With the
narrow parts alone a body learns to stay on the spot, where they have no gradient; with the wide part alone it follows
the command loosely. The narrow parts take the mean error, since within a step the body sways by more."""

TURN_SCALES = 0.03, 0.2, 1.0
"""Squared errors at which the three parts of `turn` have dropped to 1 / e, (rad/s)^2."""

LOADED = 0.048
"""Force on a foot that stands, as a share of the weight."""

CLEARANCE, CLOSE = 0.144, 0.058
"""Height of a foot in mid-swing, and the error at which `clearance` has dropped to 1 / e, as shares of the legs'
length."""

APART, TOO_NEAR = 0.24, 0.096
"""Lateral distance between the feet below which they are too near, and the shortfall at which `crossing` is 1, as
shares of the legs' length."""

SLIPS = 0.049
"""Square of the speed of a foot that slips badly, as a share of the squared pace."""


class Rewards(Spec):
    """Base of rewards: declare a weight for each term, and give the terms by name."""

    def terms(self, view: View) -> dict[str, FloatScalar]:
        """The terms without their weights."""
        raise NotImplementedError

    def weighted(self, view: View) -> dict[str, FloatScalar]:
        """The parts of the reward by name; it is their sum.

        Raises:
          InputError: a term has no weight.
        """
        terms = self.terms(view)
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

    def terms(self, view: View) -> dict[str, FloatScalar]:
        return {"alive": 1.0, "upright": upright(view), "still": still(view), "calm": calm(view)}


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
    slip: float = traced(-2.4, description="for corners that touch and move")
    flat: float = traced(-0.03, description="for feet that stand tilted")
    crossing: float = traced(-0.06, description="for feet too near each other")
    yawing: float = traced(-0.5, description="for a torso that turns to and fro")
    smooth: float = traced(-0.12, description="for set-points that jump")
    effort: float = traced(-0.006, description="for torque")

    def terms(self, view: View) -> dict[str, FloatScalar]:
        return {
            "speed": speed(view),
            "turn": turn(view),
            "upright": upright(view),
            "schedule": schedule(view),
            "clearance": clearance(view),
            "flight": flight(view),
            "slip": slip(view),
            "flat": tilted_feet(view),
            "crossing": crossing(view),
            "yawing": yawing(view),
            "smooth": jumps(view),
            "effort": effort(view),
        }


def upright(view: View) -> FloatScalar:
    """1 for an upright torso, 1 / e at a lean of 10 degrees."""
    return jnp.exp(-((view.lean / UPRIGHT) ** 2))


def still(view: View) -> FloatScalar:
    """1 for hips that do not move, 1 / e at `STILL`."""
    return jnp.exp(-jnp.sum(view.episode.world.qvel[:3] ** 2) / view.robot.speed(STILL) ** 2)


def calm(view: View) -> FloatScalar:
    """1 less the mean square of the offsets."""
    return 1.0 - jnp.mean(view.episode.offsets**2)


def speed(view: View) -> FloatScalar:
    """1 at the commanded velocity, forward and sideways; the widest of three scales takes the last decision alone."""
    late, now = jnp.sum(view.episode.tracking_error[:2] ** 2), jnp.sum((view.velocity[:2] - view.command[:2]) ** 2)
    near, middle, far = map(view.robot.square, SPEED_SCALES)
    return (jnp.exp(-late / near) + jnp.exp(-late / middle) + jnp.exp(-now / far)) / 3


def turn(view: View) -> FloatScalar:
    """1 at the commanded turn rate; the widest of three scales takes the last decision alone."""
    late, now = view.episode.tracking_error[2] ** 2, (view.turn_rate - view.command[2]) ** 2
    near, middle, far = TURN_SCALES
    return (jnp.exp(-late / near) + jnp.exp(-late / middle) + jnp.exp(-now / far)) / 3


def schedule(view: View) -> FloatScalar:
    """The share of feet that are in the air where they should swing, and carry weight where they should stand."""
    loaded = view.feet.load > view.robot.force(LOADED)
    return jnp.mean(jnp.where(view.swing > 0.2, ~loaded, loaded))


def clearance(view: View) -> FloatScalar:
    """1 where all feet are as high as the clock says."""
    highest, close = view.robot.length(CLEARANCE), view.robot.length(CLOSE)
    return jnp.exp(-jnp.sum(((view.feet.height - highest * view.swing) / close) ** 2))


def flight(view: View) -> FloatScalar:
    """1 without a foot on the ground."""
    return (view.feet.load <= view.robot.force(LOADED)).all() * 1.0


def slip(view: View) -> FloatScalar:
    """The sum of the squared speeds along the ground of the corners in contact, divided by the corners per foot and by
    `SLIPS`; at most 1.

    Corners count, since the middle of a foot that rolls over its edge moves without slipping.
    """
    squares = jnp.sum(view.feet.corner_velocity[..., :2] ** 2, axis=-1)
    return jnp.minimum(jnp.sum(squares * view.feet.touching) / (view.robot.points * view.robot.square(SLIPS)), 1.0)


def tilted_feet(view: View) -> FloatScalar:
    """Five times the squared sines of the tilts of loaded feet, summed; at most 1; 0 for feet of one or two points."""
    if view.robot.points < 3:
        return jnp.float32(0.0)
    loaded = view.feet.load > view.robot.force(LOADED)
    return jnp.minimum(5 * jnp.sum(loaded * (1 - view.feet.rotation[:, 2, 2] ** 2)), 1.0)


def crossing(view: View) -> FloatScalar:
    """The squared shortfall of the lateral distance between the feet, in units of `TOO_NEAR`; at most 2."""
    right, left = view.robot.foot_pairs.T
    if not len(right):
        return jnp.float32(0.0)
    gap = ((view.feet.position[left] - view.feet.position[right]) @ heading_frame(view.rotation)[1]).min()
    lack = jnp.maximum(view.robot.length(APART) - gap, 0.0)
    return jnp.minimum((lack / view.robot.length(TOO_NEAR)) ** 2, 2.0)


def yawing(view: View) -> FloatScalar:
    """The squared deviation of the turn-rate error from its running mean, (rad/s)^2; at most 1.

    A torso that oscillates about the vertical with its steps has no mean error, but does not keep its heading.
    """
    return jnp.minimum((view.turn_rate - view.command[2] - view.episode.tracking_error[2]) ** 2, 1.0)


def jumps(view: View) -> FloatScalar:
    """The mean square of the offsets' changes."""
    return jnp.mean((view.episode.offsets - view.last_offsets) ** 2)


def effort(view: View) -> FloatScalar:
    """The mean square of the torques as shares of the robot's own limit."""
    return jnp.mean((view.torque / view.robot.torque_limits) ** 2)
