# pyright: reportAttributeAccessIssue=false
"""Actuators of a user's model: the joints that they drive, their torque limits, and the gains of their servos."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int

from humanoid_mjx.robot.mjcf import element
from humanoid_mjx.spec import InputError
from humanoid_mjx.types import AnyArray

GAIN, BIAS, DYN, INTEGRATOR = mujoco.mjtGain, mujoco.mjtBias, mujoco.mjtDyn, mujoco.mjtDyn.mjDYN_INTEGRATOR
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


class Controls(NamedTuple):
    """The controls of a model's own actuators, affine in what its joints are asked for and in their motion."""

    constant: Float[np.ndarray, " motors"]
    of_setpoint: Float[np.ndarray, "motors joints"]
    of_torque: Float[np.ndarray, "motors joints"]
    of_angle: Float[np.ndarray, "motors joints"]
    of_velocity: Float[np.ndarray, "motors joints"]
    aimed: Bool[np.ndarray, " joints"]
    """Joints that position actuators bring to their set-points."""
    applied: Bool[np.ndarray, " joints"]
    """Joints without an actuator."""

    def __call__(self, *asked: Float[AnyArray, " joints"]) -> Any:
        """Return the controls for set-points, rad, torques, N m, angles, rad, and velocities, rad/s, of the joints."""
        return self.constant + sum(gain @ numbers for gain, numbers in zip(self[1:5], asked, strict=True))


def controls_of(m: mujoco.MjModel, joints: Sequence[str], constant: Float[np.ndarray, " motors"]) -> Controls:
    """Return how a model's own actuators are driven; those that drive none of the joints keep `constant`.

    A joint with position actuators: each rests at the set-point, its velocity actuators ask for standstill, dampers act
    in full, motors give nothing. Another joint: its motors share the torque of the servo by their limits, or its
    velocity actuators if it has no motor, and its other actuators give nothing.

    Raises:
      InputError: an actuator of a joint has another kind of gain, bias or dynamics.
    """
    found = Controls(constant.copy(), *np.zeros((4, len(constant), len(joints))), *np.zeros((2, len(joints)), bool))
    for column, joint in enumerate(joints):
        motors = motors_on(m, m.joint(joint).id)
        places = getattr(m, "actuator_ctrladr", np.arange(len(constant)))[motors]
        held, limits = np.array([gains(m, motor) for motor in motors]).reshape(-1, 2).T[0] > 0, motor_limits(m)[motors]
        plain = (m.actuator_gaintype[motors] == GAIN.mjGAIN_FIXED) & (m.actuator_gainprm[motors, 0] != 0)
        torques = plain & (m.actuator_biastype[motors] == BIAS.mjBIAS_NONE) & (limits > 0)
        carry = (torques if torques.any() else plain & (limits > 0)) & ~held.any()
        found.aimed[column], found.applied[column] = held.any(), not len(motors)
        for motor, row, holds, acts, limit in zip(motors.tolist(), places, held, carry, limits, strict=True):
            _check(m, motor, joint)
            gear, gain = m.actuator_gear[motor, 0], m.actuator_gainprm[motor, 0]
            fixed, angle, velocity = m.actuator_biasprm[motor, :3] * (m.actuator_biastype[motor] == BIAS.mjBIAS_AFFINE)
            if m.actuator_gaintype[motor] == GAIN.mjGAIN_AFFINE:  # a damper
                full = np.abs(m.actuator_ctrlrange[motor]).max() if m.actuator_ctrllimited[motor] else 1.0
                found.constant[row] = full * held.any()
            elif holds:
                found.constant[row], found.of_setpoint[row, column] = -fixed / gain, -angle * gear / gain
            elif gain and not held.any():
                known = limits[carry]
                share = (limit / known.sum() if np.isfinite(known).all() else 1 / len(known)) if acts else 0.0
                found.of_torque[row, column] = share / gear / gain if acts else 0.0
                found.constant[row], found.of_angle[row, column] = -fixed / gain, -angle * gear / gain
                found.of_velocity[row, column] = -velocity * gear / gain
            else:
                found.constant[row] = 0.0
    return found


def _check(m: mujoco.MjModel, motor: int, joint: str) -> None:
    """Refuse an actuator that is none of motors, position and velocity actuators and dampers."""
    allowed = {
        "gain": (GAIN.mjGAIN_FIXED, GAIN.mjGAIN_AFFINE),
        "bias": (BIAS.mjBIAS_NONE, BIAS.mjBIAS_AFFINE),
        "dyn": (DYN.mjDYN_NONE, DYN.mjDYN_FILTER, DYN.mjDYN_FILTEREXACT),
    }
    for kind, known in allowed.items():
        if not np.isin(getattr(m, f"actuator_{kind}type")[motor], known):
            raise InputError(
                f"unmodified: {element(m, 'actuator', motor)} on {joint} is neither a motor, a position or velocity "
                "actuator nor a damper; play it with --physics mujoco, by the motors of its YAML"
            )
