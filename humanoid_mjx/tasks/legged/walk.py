"""Walk as commanded: forwards, sideways and round, from the readings of real sensors.

The learner corrects open-loop steps on the spot (`gait`); with `gait: {lift: 0, sway: 0}` it has to find its own. Each
weight of the reward, each range of the commands and each value of the world can be set by its name.
"""

from typing import ClassVar

from pydantic import Field

from humanoid_mjx.control import Control
from humanoid_mjx.control.laws import ServoLaw
from humanoid_mjx.physics.sensors import Sensors
from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.legged.commands import Velocity
from humanoid_mjx.tasks.legged.events import Push
from humanoid_mjx.tasks.legged.gait import Gait
from humanoid_mjx.tasks.legged.observations import PRIVILEGED, PROPRIOCEPTION, Observation
from humanoid_mjx.tasks.legged.rewards import WalkRewards
from humanoid_mjx.tasks.legged.task import LeggedTask

SENSORS = Sensors(
    encoder_noise=0.0015,
    encoder_bias=0.01,
    gyroscope_noise=0.02,
    gyroscope_bias=0.02,
    accelerometer_noise=0.2,
    accelerometer_bias=0.2,
    foot_contact_noise=0.5,
    delay=1,
)
"""Cheap parts, well mounted: encoders of 12 bits, whose steps are 0.0015 rad, set to zero within half a degree; a MEMS
gyroscope that drifts by 1 degree/s after its calibration and accelerometer off by 20 mg, both noisier than in their
data sheets, as a walking body shakes them; force-sensing resistors good to 3 % of the weight; one control cycle until
all of it is read."""


SERVO = ServoLaw(stiffness=6.0, damping=0.2)
"""Soft, so that a random choice is no blow. Open-loop steps do not keep the body up with it; a learner has to."""


class Walk(LeggedTask):
    """Follow a commanded velocity and turn rate for `duration` seconds without a fall."""

    observations: ClassVar[tuple[str | Observation, ...]] = (*PROPRIOCEPTION, "command", "clock")
    privileged: ClassVar[tuple[str | Observation, ...]] = (*PRIVILEGED, "turn_rate", "foot_heights", "foot_loads")

    control: Control = Field(SERVO, description="the law that drives the joints")
    offset: float = traced(25.0, gt=0, le=90, description="largest offset of a set-point from the motion, degrees")
    offset_shares: tuple[float, float, float, float, float] = traced(
        (1.0, 0.8, 0.6, 1.2, 1.0), strict=False, description="of it for hip pitch, yaw and roll, knee and ankle"
    )
    sensors: Sensors = Field(SENSORS, description="errors of the sensors")
    command: Velocity = Field(Velocity(forward=(0.0, 0.8)), description="what the body is told to do")
    gait: Gait = Field(Gait(), description="clock and open-loop steps")
    rewards: WalkRewards = Field(WalkRewards(), description="weights of the reward's terms")
    push: Push = Field(Push(impulse=0.1, every=3.0), description="what disturbs the body")
    duration: float = traced(20.0, gt=0, le=1000, description="s of an episode")
