"""Tasks of the lower body on the ground, made of parts that are declared.

body          the robot in a physics under a control law, and the values of its world
view          what observations, rewards and terminations are functions of
observations  named numbers, from which size, scale and mirror image follow
rewards       named terms, and the Specs that hold their weights
commands      commanded velocities, turn rates and sudden turns
gait          the gait clock and open-loop steps; `thesis_gaits`: those of the thesis
events        pushes, domain randomisation, and a fall, which ends an episode early
episode       the data of a state, and the estimated attitude
task          reset and step
stand, walk   the tasks that ship
"""

from humanoid_mjx.tasks.legged.rewards import Rewards, StandRewards, WalkRewards
from humanoid_mjx.tasks.legged.stand import Stand
from humanoid_mjx.tasks.legged.task import LeggedTask
from humanoid_mjx.tasks.legged.view import Feet, View
from humanoid_mjx.tasks.legged.walk import Walk

__all__ = ["Feet", "LeggedTask", "Rewards", "Stand", "StandRewards", "View", "Walk", "WalkRewards"]
