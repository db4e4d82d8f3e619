"""Servos: torques from the error and its rate, alone or through an inertia for each joint (thesis 5.5)."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from humanoid_mjx.control.gains import check_gains
from humanoid_mjx.mechanics.dynamics import Integrator, State, joint_inertias, mass_matrix_and_bias
from humanoid_mjx.robot.chain import Chain
from humanoid_mjx.types import FloatScalar

Joints = Float[Array, " joints"]
Gain = FloatScalar | Joints
"""A gain for all joints, or one for each."""


class Reference(NamedTuple):
    """The motion wanted: rad, rad/s and rad/s^2, by joint."""

    qpos: Joints
    qvel: Joints
    qacc: Joints


def at_rest(qpos: Joints) -> Reference:
    """The reference that stays in a posture."""
    return Reference(qpos, jnp.zeros_like(qpos), jnp.zeros_like(qpos))


class PD(NamedTuple):
    """The parameters of a servo without a model of the robot. `PD.build` checks them."""

    kp: Gain
    """N m/rad"""
    kd: Gain
    """N m s/rad"""

    @classmethod
    def build(cls, joints: int, kp: Any, kd: Any) -> "PD":
        """Check the gains, as `checked_gains` does."""
        return cls(*checked_gains(joints, kp, kd))


class ModelServo(NamedTuple):
    """The parameters of `partitioned_pd` and `computed_torque`: a servo in front of a model. `build` checks them."""

    model: Chain
    """The model, which may differ from the robot. Partitioned PD uses the inertia of each joint alone."""
    kp: Gain
    """1/s^2"""
    kd: Gain
    """1/s"""

    @classmethod
    def build(cls, model: Chain, kp: Any, kd: Any) -> "ModelServo":
        """Check the gains, as `checked_gains` does."""
        return cls(model, *checked_gains(model.num_joints, kp, kd))


PartitionedPD = ModelServo


def pd(params: PD, reference: Reference, qpos: Joints, qvel: Joints) -> Joints:
    """`kp (q_d - q) + kd (qd_d - qd)`, N m."""
    return params.kp * (reference.qpos - qpos) + params.kd * (reference.qvel - qvel)


def servo(kp: Gain, kd: Gain, reference: Reference, qpos: Joints, qvel: Joints) -> Joints:
    """`qdd_d + kd (qd_d - qd) + kp (q_d - q)`, rad/s^2 (5.30, 5.44): the torques of a robot of unit inertias."""
    return reference.qacc + (kp * (reference.qpos - qpos) + kd * (reference.qvel - qvel))


def partitioned_pd(params: ModelServo, reference: Reference, qpos: Joints, qvel: Joints) -> Joints:
    """`diag(M(q)) servo` of the model, N m (5.26 to 5.30), without friction, as the chain has none.

    What couples the joints (5.17) is left out. To hold the leg, add `dynamics.gravity` of a model; to keep all but the
    inertial couplings, `dynamics.bias`.
    """
    return joint_inertias(params.model, qpos) * servo(params.kp, params.kd, reference, qpos, qvel)


def implicit_euler(params: PD) -> Integrator:
    """Steps of first order through which a servo of these gains acts, as analog ones do, in place of a held torque.

    Linearly implicit in the servo, so that its stiffness does not limit the step: a held torque is unstable in steps
    longer than `2 M / kd`, 7 microseconds for the gains of Table 5.1 as N m/rad and N m s/rad on the thesis's leg.
    """

    def step(leg: Chain, state: State, torque: Joints, dt: FloatScalar) -> State:
        matrix, bias = mass_matrix_and_bias(leg, *state)
        stiffened = matrix + jnp.diag(dt * params.kd + dt**2 * params.kp)
        qacc = jnp.linalg.solve(stiffened, torque - dt * params.kp * state.qvel - bias)
        qvel = state.qvel + dt * qacc
        return State(state.qpos + dt * qvel, qvel)

    return step


def checked_gains(joints: int, kp: Any, kd: Any) -> tuple[Joints, Joints]:
    """Gains, a number or one for each joint, as arrays of jax.

    Raises:
      InputError: a gain that is negative, not finite or of another shape.
    """
    gains = check_gains(joints, kp=kp, kd=kd)
    return jnp.asarray(gains["kp"], float), jnp.asarray(gains["kd"], float)
