"""Computed torque: the motion wanted, corrected in proportion to the error and its rate, through a model's dynamics."""

from typing import Any, NamedTuple

from humanoid_mjx.control.pd import Joints, Reference, checked_gains, servo
from humanoid_mjx.mechanics.dynamics import inverse_dynamics
from humanoid_mjx.robot.chain import Chain


class ComputedTorque(NamedTuple):
    """The parameters of the controller. `ComputedTorque.build` checks them."""

    model: Chain
    """It need not be the robot."""
    kp: Joints
    """1/s^2"""
    kd: Joints
    """1/s"""

    @classmethod
    def build(cls, model: Chain, kp: Any, kd: Any) -> "ComputedTorque":
        """Check the gains, a number or one for each joint.

        Raises:
          InputError: a gain that is negative, not finite or of another shape.
        """
        return cls(model, *checked_gains(model.num_joints, kp, kd))


def computed_torque(params: ComputedTorque, reference: Reference, qpos: Joints, qvel: Joints) -> Joints:
    """`M(q) (qdd_d + kd (qd_d - qd) + kp (q_d - q)) + bias(q, qd)` of the model, N m (section 5.7)."""
    return inverse_dynamics(params.model, qpos, qvel, servo(params.kp, params.kd, reference, qpos, qvel))
