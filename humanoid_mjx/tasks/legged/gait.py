"""The clock of a gait, and open-loop steps as a motion for a learner to correct."""

import math
from functools import partial
from typing import Annotated, Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
import pydantic
from jaxtyping import Array, Float

from humanoid_mjx.robot import Robot
from humanoid_mjx.robot.lower_body import LEFTWARDS, SHORTENED
from humanoid_mjx.robot.reaching import monomials, reach_of
from humanoid_mjx.spec import Named, make, traced, written
from humanoid_mjx.tasks.legged.commands import moves
from humanoid_mjx.types import BoolScalar, FloatScalar


class Clock(NamedTuple):
    """State of a gait."""

    phase: FloatScalar
    """0 to 1"""
    generator: Any = None
    """Further state of a gait that is more than a clock: any pytree."""


def steps_under(command: Float[Array, "3"], robot: Robot) -> BoolScalar:
    """Return whether the feet are to step: under a command to move, and always if the robot does not rest."""
    return moves(command) if robot.rests else jnp.bool_(True)


class Gait(Named):
    """Contact schedule: every foot swings once per gait cycle, at its own phase (`Robot.phases`).

    This is the base of gaits, and itself the gait `clock`, which leaves the motion to the learner. Derive from it and
    override `reference` for a motion that the learner corrects.
    """

    name: str = "clock"
    period: float = traced(0.48, gt=0.05, le=5, description="s of a step with each foot, at slow speeds")
    cadence: float = traced(0.2, ge=0, le=10, description="relative increase of the gait frequency per m/s commanded")
    stance: float = traced(0.62, ge=0.5, lt=1, description="share of the period in which a foot is to stand")

    def check(self, robot: Robot) -> None:
        """Raise an InputError if the robot's legs do not fit the gait."""

    def start(self, phase: FloatScalar, robot: Robot) -> Clock:
        """The gait at the beginning of an episode."""
        return Clock(phase)

    def after(self, clock: Clock, command: Float[Array, "3"], seconds: FloatScalar, robot: Robot) -> Clock:
        """Return the clock `seconds` later; its phase is 0 while the feet rest."""
        later = jnp.mod(clock.phase + seconds / self.cycle_time(command), 1.0)
        return Clock(jnp.where(steps_under(command, robot), later, 0.0))

    def cycle_time(self, command: Float[Array, "3"]) -> FloatScalar:
        """Return the time of a gait cycle under this command, s."""
        return self.period / (1.0 + self.cadence * jnp.sqrt(jnp.sum(command[:2] ** 2) + 1e-12))

    def swing(self, phase: FloatScalar, robot: Robot) -> Float[Array, " feet"]:
        """Return each foot's height as a share of its largest: half a sine during its swing, otherwise 0."""
        share = jnp.mod(phase - robot.phases, 1.0) / (1.0 - self.stance)
        return jnp.where(share < 1.0, jnp.sin(jnp.pi * jnp.minimum(share, 1.0)), 0.0)

    def reference(self, clock: Clock, command: Float[Array, "3"], robot: Robot) -> Float[Array, " joints"]:
        """The motion about the posture, rad; here none."""
        return jnp.zeros(len(robot.joints))


class Steps(Gait):
    """Steps as commanded, for a learner to correct; with `stride` 0 on the spot.

    Under a servo of 20 N m/rad and 0.45 N m s/rad a period of 0.32 s with a stance of 0.62, a lift of 9 degrees and a
    sway of -2 steps and turns on the spot by itself, but falls when it is to go ahead. There the hips roll against the
    shift of weight, which lags half a cycle behind them at this pace.
    """

    name: Literal["steps"] = "steps"
    lift: float = traced(12.0, ge=0, le=60, description="of the hip's pitch in mid-swing, degrees")
    sway: float = traced(0.0, ge=-30, le=30, description="of the hips' roll towards the standing foot, degrees")
    stride: float = traced(1.0, ge=0, le=3, description="share of the commanded motion that the legs sweep through")
    landing: float = traced(0.0, ge=0, le=3, description="exponent that softens lift-off and landing; 0: none")

    def sweep(self, phase: FloatScalar, robot: Robot) -> Float[Array, " feet"]:
        """Return each foot's place along its way, 1 in front to -1 behind: steadily back while it stands, and forth
        while it swings, as a cubic that leaves the ground and comes back to it as fast as that goes."""
        turn, swing = jnp.mod(phase - robot.phases, 1.0), 1.0 - self.stance
        u = jnp.minimum(turn / swing, 1.0)
        slope = 2.0 * swing / self.stance
        forth = -1.0 + u * (u * (6.0 - 4.0 * u) - slope * (1.0 - u) * (1.0 - 2.0 * u))
        return jnp.where(turn < swing, forth, 1.0 - 2.0 * (turn - swing) / self.stance)

    def reference(self, clock: Clock, command: Float[Array, "3"], robot: Robot) -> Float[Array, " joints"]:
        """The motion about the posture, rad; 0 while the feet rest.

        A foot that stands goes back as the ground does under a body that moves as commanded (velocity forward and to
        the left, m/s, and turn rate to the left, rad/s), times `stride`.
        """
        phase, build = clock.phase, robot.build
        way = self.sweep(phase, robot) * self.cycle_time(command) * self.stance / 2
        if build is None:
            return jnp.where(steps_under(command, robot), self._by_inverse_kinematics(way, phase, command, robot), 0.0)
        forward, left, turn = self.stride * command
        pitch = jnp.arctan(way * (forward - turn * build.hip_offset * LEFTWARDS) / build.reach)
        aside, around = way * left / build.reach, way * turn
        # The hip's yaw and roll turn about axes that lean with the thigh.
        cos, sin = jnp.cos(build.lean + pitch), jnp.sin(build.lean + pitch)
        yaw, roll = cos * around - sin * aside, cos * aside + sin * around
        roll = roll - jnp.radians(robot.steps * self.sway) * jnp.sin(2 * jnp.pi * phase)
        swept = jnp.stack([pitch, yaw * LEFTWARDS, roll * LEFTWARDS, jnp.zeros(2), pitch], axis=-1)
        swing = self.swing(phase, robot)
        lift = swing * jnp.maximum(swing, 1e-6) ** self.landing
        lifted = jnp.radians(robot.steps * self.lift) * lift[:, None] * SHORTENED
        return jnp.where(steps_under(command, robot), (swept + lifted).reshape(-1), 0.0)

    def _by_inverse_kinematics(
        self, way: Float[Array, " feet"], phase: FloatScalar, command: Float[Array, "3"], robot: Robot
    ) -> Float[Array, " joints"]:
        """The motion of legs of any build, by their inverse kinematics."""
        length, bend = robot.leg_length, math.radians(robot.bend)
        place, matrix = (part.astype(np.float32) for part in reach_of(robot))
        ahead, aside = place.T
        forward, left, turn = self.stride * command
        over = np.sign(aside[0]) * jnp.radians(robot.steps * self.sway) * jnp.sin(2 * jnp.pi * phase)
        swing = self.swing(phase, robot)
        height = math.cos(bend) - jnp.cos(bend + jnp.radians(robot.steps * self.lift))
        lifted = height * swing * jnp.maximum(swing, 1e-6) ** self.landing
        parts = [way * (forward - turn * aside) / length, way * (left + turn * ahead) / length + over, lifted]
        parts += [way * turn] if robot.points > 2 else []
        terms = jnp.stack(monomials(parts), axis=-1).reshape(-1)
        return jnp.dot(terms, matrix, precision="highest")


GAITS = {
    "clock": "humanoid_mjx.tasks.legged.gait:Gait",
    "steps": "humanoid_mjx.tasks.legged.gait:Steps",
    "table": "humanoid_mjx.tasks.legged.thesis_gaits:TableSteps",
    "oscillators": "humanoid_mjx.tasks.legged.thesis_gaits:Oscillators",
}

Gaits = Annotated[pydantic.SerializeAsAny[Gait], written("gait", partial(make, "gait", GAITS, Gait))]
"""The type of a task's field `gait`: `gait: {name: table}`, or the name alone."""
