"""Controllers: pure functions of their parameters, the reference and the state, and the laws that tasks choose from."""

from humanoid_mjx.control.computed_torque import ComputedTorque, computed_torque
from humanoid_mjx.control.ground import GroundControl, grounded_torque
from humanoid_mjx.control.laws import Control, Follow, Law, make_law
from humanoid_mjx.control.pd import PD, PartitionedPD, Reference, at_rest, implicit_euler, partitioned_pd, pd, servo

__all__ = [
    "PD",
    "ComputedTorque",
    "Control",
    "Follow",
    "GroundControl",
    "Law",
    "PartitionedPD",
    "Reference",
    "at_rest",
    "computed_torque",
    "grounded_torque",
    "implicit_euler",
    "make_law",
    "partitioned_pd",
    "pd",
    "servo",
]
