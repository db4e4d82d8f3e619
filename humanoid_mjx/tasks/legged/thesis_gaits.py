"""The thesis's gaits as motions for a learner to correct: the tables of section 4.8, the oscillators of section 4.7.

Both know how to go ahead alone: a table's motion about its mean, larger for a faster command. They neither sidestep nor
turn as commanded.
"""

from functools import lru_cache
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from pydantic import Field

from humanoid_mjx.mechanics import gaits, pattern_generator
from humanoid_mjx.robot import Robot
from humanoid_mjx.spec import InputError, traced
from humanoid_mjx.tasks.legged.commands import moves
from humanoid_mjx.tasks.legged.gait import Clock, Gait, steps_under
from humanoid_mjx.thesis import leg as thesis
from humanoid_mjx.types import FloatScalar

FORTH = 4 / 12
"""Phase of a table's period at which its hip begins to come forward, 0.2667 s of 0.8 s: a foot of the clock swings
then."""


class TableSteps(Gait):
    """Table 4.5 or 4.6 in the clock's time, about its mean. Its angles count in the senses of the lower body."""

    name: Literal["table"] = "table"
    table: Literal["straight_walk", "sudden_turn"] = Field("straight_walk", description="Table 4.5 or Table 4.6")
    stride: float = traced(1.0, ge=0, le=3, description="share of the commanded speed that the hips sweep through")

    @property
    def motion(self) -> gaits.Gait:
        """The table as a periodic motion of a leg."""
        return _table(self.table)

    def check(self, robot: Robot) -> None:
        if robot.build is None:
            raise InputError(
                f"gait: {self.name} needs two legs of hip pitch, yaw and roll, knee and ankle, as lower_body has; "
                f"{robot.name} has others: take clock."
            )

    def amplitude(self, command: Float[Array, "3"], robot: Robot) -> FloatScalar:
        """Size of the motion, 1 as in the table: the hips' way back is as long as the body is to go meanwhile."""
        degrees = np.array(gaits.TABLES[self.table]["hip_pitch"])
        assert robot.build
        way = robot.build.reach * np.radians(degrees.max() - degrees.min())
        back = 1.0 - (thesis.GAIT_TIMES_S[degrees.argmax()] / thesis.GAIT_TIMES_S[-1] - FORTH)
        return self.stride * command[0] * self.cycle_time(command) * back / way

    def reference(self, clock: Clock, command: Float[Array, "3"], robot: Robot) -> Float[Array, " joints"]:
        """The motion about the posture, rad; 0 while the command is to stand."""
        legs = self.motion.both_legs((clock.phase + FORTH) * self.motion.period).position
        size = jnp.where(moves(command), self.amplitude(command, robot), 0.0)
        return size * (legs - pattern_generator.mean_posture(self.motion)).reshape(-1)


class Oscillators(TableSteps):
    """A table read by two phase oscillators (`mechanics.pattern_generator`), the gait's clock.

    Amplitude and frequency follow the command smoothly, also where the body begins and ceases to walk.
    """

    name: Literal["oscillators"] = "oscillators"
    response: float = traced(8.0, gt=0, le=100, description="how fast they follow their commands, 1/s")

    def start(self, phase: FloatScalar, robot: Robot) -> Clock:
        angle = 2 * jnp.pi * (phase + FORTH)
        return Clock(phase, pattern_generator.init(self._params(jnp.zeros(3), robot), angle))

    def after(self, clock: Clock, command: Float[Array, "3"], seconds: FloatScalar, robot: Robot) -> Clock:
        """The oscillators so much later; while the body stands they wait where they are."""
        state = pattern_generator.step(self._params(command, robot), clock.generator, seconds)
        return Clock(jnp.mod(state.phase[0] / (2 * jnp.pi) - FORTH, 1.0), state)

    def reference(self, clock: Clock, command: Float[Array, "3"], robot: Robot) -> Float[Array, " joints"]:
        legs = pattern_generator.posture(self._params(command, robot), clock.generator)
        return (legs - pattern_generator.mean_posture(self.motion)).reshape(-1)

    def _params(self, command: Float[Array, "3"], robot: Robot) -> pattern_generator.Params:
        moving = steps_under(command, robot)
        frequency = jnp.where(moving, 1.0 / self.cycle_time(command), 0.0)
        amplitude = jnp.where(moving, self.amplitude(command, robot), 0.0)
        return pattern_generator.Params(self.motion, frequency, amplitude, response=self.response)


@lru_cache
def _table(name: str) -> gaits.Gait:
    with jax.ensure_compile_time_eval():
        return gaits.gait(name)
