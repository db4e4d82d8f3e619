"""Servos: torques or accelerations from the error and its rate (thesis 5.5)."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Float

from humanoid_mjx.mechanics.dynamics import Integrator, Joints, State, mass_matrix_and_bias
from humanoid_mjx.robot.chain import Chain
from humanoid_mjx.types import AnyArray, FloatScalar

Gain = FloatScalar | Float[AnyArray, " joints"]
"""A gain for all joints, or one for each."""


class Reference(NamedTuple):
    """The motion wanted: rad, rad/s and rad/s^2, by joint."""

    qpos: Joints
    qvel: Joints
    qacc: Joints


def at_rest(qpos: Joints) -> Reference:
    """The reference that stays in a posture."""
    return Reference(qpos, jnp.zeros_like(qpos), jnp.zeros_like(qpos))


def pd(kp: Gain, kd: Gain, reference: Reference, qpos: Joints, qvel: Joints) -> Joints:
    """Return `kp (q_d - q) + kd (qd_d - qd)`: torques in N m of gains in N m/rad and N m s/rad."""
    return kp * (reference.qpos - qpos) + kd * (reference.qvel - qvel)


def servo(kp: Gain, kd: Gain, reference: Reference, qpos: Joints, qvel: Joints) -> Joints:
    """Return `qdd_d + kp (q_d - q) + kd (qd_d - qd)`, rad/s^2, of gains in 1/s^2 and 1/s (5.30, 5.44).

    These accelerations are the torques of a robot of unit inertias. A model's `dynamics.joint_inertias` times them is
    partitioned PD (5.26 to 5.30), without what couples the joints (5.17); `dynamics.inverse_dynamics` makes them
    computed torque (5.40).
    """
    return reference.qacc + pd(kp, kd, reference, qpos, qvel)


def implicit_euler(
    kp: Float[AnyArray, " joints"], kd: Float[AnyArray, " joints"], armature: FloatScalar = 0.0
) -> Integrator:
    """Return steps of first order through which a servo of these gains, N m/rad and N m s/rad, acts as analog ones do,
    with rotors that add `armature`, kg m^2, to the inertia of each joint.

    Linearly implicit in the servo, so that its stiffness does not limit the step: a held torque is unstable in steps
    longer than `2 M / kd`, 7 microseconds for the gains of Table 5.1 as N m/rad and N m s/rad on the thesis's leg.
    """

    def step(leg: Chain, state: State, torque: Joints, dt: FloatScalar) -> State:
        matrix, bias = mass_matrix_and_bias(leg, *state)
        stiffened = matrix + jnp.diag(armature + dt * kd + dt**2 * kp)
        qacc = jnp.linalg.solve(stiffened, torque - dt * kp * state.qvel - bias)
        qvel = state.qvel + dt * qacc
        return State(state.qpos + dt * qvel, qvel)

    return step
