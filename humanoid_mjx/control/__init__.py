"""Controllers: pure functions of their parameters, the reference and the state."""

from humanoid_mjx.control.computed_torque import ComputedTorque, computed_torque
from humanoid_mjx.control.ground import GroundControl, grounded_torque
from humanoid_mjx.control.pd import PD, PartitionedPD, Reference, implicit_euler, partitioned_pd, pd, servo

__all__ = [
    "PD",
    "ComputedTorque",
    "GroundControl",
    "PartitionedPD",
    "Reference",
    "computed_torque",
    "grounded_torque",
    "implicit_euler",
    "partitioned_pd",
    "pd",
    "servo",
]
