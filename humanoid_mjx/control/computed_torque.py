"""Computed torque: the motion wanted, corrected in proportion to the error and its rate, through a model's dynamics."""

from humanoid_mjx.control.pd import Joints, ModelServo, Reference, servo
from humanoid_mjx.mechanics.dynamics import inverse_dynamics

ComputedTorque = ModelServo


def computed_torque(params: ModelServo, reference: Reference, qpos: Joints, qvel: Joints) -> Joints:
    """`M(q) (qdd_d + kd (qd_d - qd) + kp (q_d - q)) + bias(q, qd)` of the model, N m (section 5.7)."""
    return inverse_dynamics(params.model, qpos, qvel, servo(params.kp, params.kd, reference, qpos, qvel))
