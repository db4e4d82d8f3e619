# pyright: reportAttributeAccessIssue=false
"""Actuators of a user's model: the joints that they drive, their torque limits, and the gains of their servos."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float, Int

from humanoid_mjx.spec import InputError

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


def motors_on(model: mujoco.MjModel, joint: int) -> Int[np.ndarray, " motors"]:
    """Return the indices of the actuators that drive the joint of this index, not through a tendon or a site."""
    return np.flatnonzero(np.isin(model.actuator_trntype, ON_JOINTS) & (model.actuator_trnid[:, 0] == joint))


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


def motor_limits(model: mujoco.MjModel) -> Float[np.ndarray, " motors"]:
    """Return the largest torque of each motor at its joint, N m."""
    return np.array([np.abs(bounds(model, motor)).max() for motor in range(len(model.actuator_trntype))], float)


def own_drives(model: mujoco.MjModel, joints: Sequence[str]) -> Float[np.ndarray, "3 joints"]:
    """Return each joint's largest torque, N m, and the stiffness and damping of its actuators together, NaN without.

    The torque is the sum over actuators, without those that only damp, within the joint's own limit; infinite without.
    """
    found = []
    for row in (model.joint(joint).id for joint in joints):
        motors = motors_on(model, row).tolist()
        each = np.array([gains(model, motor) for motor in motors]).reshape(-1, 2)
        limits = motor_limits(model)[motors]
        drives = (each[:, 0] != 0) | (each[:, 1] <= 0)
        torque = limits[drives if drives.any() else slice(None)].sum() if motors else np.inf
        if model.jnt_actfrclimited[row]:
            torque = min(torque, np.abs(model.jnt_actfrcrange[row]).max())
        stiffness, damping = each.sum(axis=0)
        held = stiffness > 0
        found.append((torque, stiffness if held else np.nan, max(damping, 0.0) if held or damping > 0 else np.nan))
    return np.array(found).T
