"""Keep standing on the ground while pushed, from the sensors' readings.

The advantage of a learner that sees `privileged` is the price of partial observation.
"""

from pydantic import Field

from humanoid_mjx.tasks.legged.rewards import StandRewards
from humanoid_mjx.tasks.legged.task import LeggedTask


class Stand(LeggedTask):
    """Keep the torso upright for `duration` seconds.

    A step earns `alive` 0.4, and up to 0.3 for an `upright` torso, 0.2 for one that is `still`, 0.1 for `calm`
    set-points near the posture. A body that falls, or whose simulation breaks down, terminates with the reward 0. An
    episode succeeds if it lasts to its end.
    """

    rewards: StandRewards = Field(StandRewards(), description="weights of the reward's terms")
