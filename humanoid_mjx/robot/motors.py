# pyright: reportAttributeAccessIssue=false
"""Actuators of a user's model: the joints that they drive, their torque limits, and the gains of their servos."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float

from humanoid_mjx.robot.description import motors_on
from humanoid_mjx.spec import InputError

DAMPING = 0.03
"""Servo damping by stiffness where a description gives none, s."""

GAIN, BIAS, INTEGRATOR = mujoco.mjtGain, mujoco.mjtBias, mujoco.mjtDyn.mjDYN_INTEGRATOR
ON_JOINTS = mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT


def driven(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the hinges that motors drive, in the motors' order; all hinges of a model without motors.

    Raises:
      InputError: there are none, one has no name, or a motor drives another joint.
    """
    of_joint, hinge = np.isin(model.actuator_trntype, ON_JOINTS), mujoco.mjtJoint.mjJNT_HINGE
    joints = model.actuator_trnid[of_joint, 0] if model.nu else np.flatnonzero(model.jnt_type == hinge)
    names = tuple(dict.fromkeys(model.joint(int(joint)).name for joint in joints))
    if not names or "" in names:
        raise InputError("model: no motor drives a hinge that has a name")
    if wrong := [name for name in names if model.joint(name).type[0] != hinge]:
        raise InputError(f"model: the motor of {wrong[0]} drives no hinge")
    return names


def gains(m: mujoco.MjModel, motor: Any) -> Float[np.ndarray, "2"]:
    """Return an actuator's stiffness, N m/rad, and damping, N m s/rad, at its joint; a damper's at full control."""
    found = -m.actuator_biasprm[motor, 1:3] * (m.actuator_biastype[motor] == BIAS.mjBIAS_AFFINE)
    if m.actuator_gaintype[motor] == GAIN.mjGAIN_AFFINE:
        control = np.abs(m.actuator_ctrlrange[motor]).max() if m.actuator_ctrllimited[motor] else 1.0
        found[1] -= control * m.actuator_gainprm[motor, 2]
    return found * m.actuator_gear[motor, 0] ** 2 + 0.0  # no -0


def bounds(m: mujoco.MjModel, motor: Any) -> Float[np.ndarray, "2"]:
    """Return an actuator's smallest and largest torque at its joint, N m: infinite without a limit."""
    span, gear = np.array([-np.inf, np.inf]), m.actuator_gear[motor, 0]
    kind = "act" if m.actuator_dyntype[motor] == INTEGRATOR else "ctrl"
    constant = m.actuator_gaintype[motor] == GAIN.mjGAIN_FIXED and m.actuator_biastype[motor] == BIAS.mjBIAS_NONE
    if constant and getattr(m, f"actuator_{kind}limited")[motor]:
        span = np.sort(m.actuator_gainprm[motor, 0] * getattr(m, f"actuator_{kind}range")[motor])
    if m.actuator_forcelimited[motor]:
        span = np.clip(span, *m.actuator_forcerange[motor])
    return np.sort(gear * span) if gear else np.zeros(2)


def own_torques(model: mujoco.MjModel, joints: Sequence[str]) -> Float[np.ndarray, " joints"]:
    """Return the model's largest torques, N m; infinite where there is no limit.

    They are sums over a joint's actuators, without those that only damp, within the joint's own limit.
    """
    limits = np.full(len(joints), np.inf)
    for index, row in enumerate(model.joint(joint).id for joint in joints):
        motors = motors_on(model, row).tolist()
        kinds = [gains(model, motor) for motor in motors]
        driving = [motor for motor, (hold, damp) in zip(motors, kinds, strict=True) if hold or damp <= 0] or motors
        if driving:
            limits[index] = sum(np.abs(bounds(model, motor)).max() for motor in driving)
        if model.jnt_actfrclimited[row]:
            limits[index] = min(limits[index], np.abs(model.jnt_actfrcrange[row]).max())
    return limits


def own_servo(
    model: mujoco.MjModel, joints: Sequence[str], torque: np.ndarray
) -> tuple[Float[np.ndarray, " joints"], Float[np.ndarray, " joints"]]:
    """Return the stiffness and damping of each joint's actuators together; else the torque limit a radian, and
    `DAMPING` of it."""
    stiffness, damping = torque.copy(), DAMPING * torque
    for index, joint in enumerate(joints):
        position, speed = sum((gains(model, motor) for motor in motors_on(model, model.joint(joint).id)), np.zeros(2))
        stiffness[index] = position if position > 0 else stiffness[index]
        damping[index] = max(speed, 0.0) if position > 0 or speed > 0 else damping[index]
    return stiffness, damping
