"""Computed torque: the motion wanted, corrected in proportion to the error and its rate, through a model's dynamics."""

from typing import NamedTuple

from jaxtyping import Array, Float

from humanoid_mjx.mechanics.dynamics import inverse_dynamics
from humanoid_mjx.robot.chain import Chain


class ComputedTorque(NamedTuple):
    """The parameters of the controller. Its model need not be the robot that it drives."""

    model: Chain
    kp: Float[Array, " joints"]
    """1/s^2"""
    kd: Float[Array, " joints"]
    """1/s"""


class Reference(NamedTuple):
    """The motion wanted: rad, rad/s and rad/s^2, by joint."""

    qpos: Float[Array, " joints"]
    qvel: Float[Array, " joints"]
    qacc: Float[Array, " joints"]


def computed_torque(
    params: ComputedTorque, reference: Reference, qpos: Float[Array, " joints"], qvel: Float[Array, " joints"]
) -> Float[Array, " joints"]:
    """`M(q) (qdd_d + kd (qd_d - qd) + kp (q_d - q)) + bias(q, qd)` of the model, N m (section 5.7)."""
    correction = params.kd * (reference.qvel - qvel) + params.kp * (reference.qpos - qpos)
    return inverse_dynamics(params.model, qpos, qvel, reference.qacc + correction)
