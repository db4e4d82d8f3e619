"""Controllers: pure functions of their parameters, the reference and the state."""

from humanoid_mjx.control.computed_torque import ComputedTorque, Reference, computed_torque

__all__ = ["ComputedTorque", "Reference", "computed_torque"]
