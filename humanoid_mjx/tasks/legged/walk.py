"""Walk as commanded: forwards, sideways and round, from the readings of noisy sensors.

The learner corrects open-loop steps (`gait`), which go where the command says but fall. With `gait: {stride: 0}` it
corrects steps on the spot, with `gait: table` or `gait: oscillators` the thesis's, and with `gait: clock` it has to
find its own. Each weight of the reward, each range of the commands and each value of the world can be set by its name.
"""

from typing import ClassVar, Literal

from pydantic import Field

from humanoid_mjx.control import Control
from humanoid_mjx.control.laws import ServoLaw
from humanoid_mjx.physics.sensors import Sensors
from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.legged.commands import Velocity
from humanoid_mjx.tasks.legged.events import Push
from humanoid_mjx.tasks.legged.gait import Gaits, Steps
from humanoid_mjx.tasks.legged.observations import PRIVILEGED, PROPRIOCEPTION, Observation
from humanoid_mjx.tasks.legged.rewards import WalkRewards
from humanoid_mjx.tasks.legged.task import LeggedTask
from humanoid_mjx.types import FloatScalar

SENSORS = Sensors(
    encoder_noise=0.0015,
    encoder_bias=0.01,
    gyroscope_noise=0.02,
    gyroscope_bias=0.003,
    accelerometer_noise=0.2,
    accelerometer_bias=0.2,
    foot_contact_noise=0.5,
    delay=1,
    jitter=0,
    averages=True,
)
"""Cheap parts, well mounted: encoders of 12 bits, whose steps are 0.0015 rad, set to zero within half a degree; a MEMS
gyroscope whose zero was taken in a second of standing still (a fiftieth of its noise squared is left) and an
accelerometer off by 20 mg, both noisier than in their data sheets, as a walking body shakes them, and both integrated
over the control cycle; force-sensing resistors good to 3 % of the weight; one control cycle until all of it is read."""

SERVO = ServoLaw(stiffness=7.5, damping=0.24)
"""Soft: a learner's random choice is no blow, and a foot that meets the ground early gives way. The body does not stay
up by open-loop steps under it when it is to go ahead."""

COMMAND = Velocity(forward=(0.0, 0.8), sideways=(-0.15, 0.15), sudden=0.15, heading_gain=4.0)
"""Up to the speed at which running begins to pay, and to sidesteps and turns as quick as the evaluator asks for. One
command in seven is to turn at once."""


class Walk(LeggedTask):
    """Follow a commanded velocity and turn rate for `duration` seconds without a fall."""

    observations: ClassVar[tuple[str | Observation, ...]] = (*PROPRIOCEPTION, "command", "clock")
    privileged: ClassVar[tuple[str | Observation, ...]] = (*PRIVILEGED, "turn_rate", "foot_heights", "foot_loads")

    control: Control = Field(SERVO, description="the law that drives the joints")
    bins: Literal[3, 5, 9] = Field(5, description="values of a joint's offset, evenly from -1 to 1 times it")
    action_scale: float = traced(
        16.0, gt=0, le=90, description="largest offset of a set-point from the motion, degrees"
    )
    action_shares: tuple[float, ...] = traced(
        (), strict=False, description="factors on action_scale by kind of joint; empty: the robot's own"
    )
    smoothing: float = traced(0.5, ge=0, lt=1)
    sensors: Sensors = Field(SENSORS, description="errors of the sensors")
    command: Velocity = Field(COMMAND, description="commanded velocity and turn rate")
    gait: Gaits = Field(Steps(), description="clock and open-loop steps")
    rewards: WalkRewards = Field(WalkRewards(), description="weights of the reward's terms")
    push: Push = Field(Push(impulse=0.04091, every=3.0), description="what disturbs the body")
    duration: float = traced(20.0, gt=0, le=1000, description="s of an episode")

    @property
    def shares(self) -> tuple[FloatScalar, ...]:
        return self.action_shares or self.robot.shares
