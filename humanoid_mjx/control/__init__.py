"""Controllers: pure functions of gains, the reference and the state, and the laws that tasks choose from."""

from humanoid_mjx.control.ground import grounded_torque
from humanoid_mjx.control.laws import Control, Law, make_law
from humanoid_mjx.control.pd import Reference, at_rest, implicit_euler, pd, servo

__all__ = ["Control", "Law", "Reference", "at_rest", "grounded_torque", "implicit_euler", "make_law", "pd", "servo"]
