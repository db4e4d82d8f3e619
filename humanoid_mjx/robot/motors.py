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
    """Return the hinges that motors drive, in the motors' order; all hinges of a model without motors that act.

    Raises:
      InputError: there are none, one has no name, or a motor drives another joint.
    """
    on, hinge = acting(model), mujoco.mjtJoint.mjJNT_HINGE
    of_joint = on & np.isin(model.actuator_trntype, ON_JOINTS)
    joints = model.actuator_trnid[of_joint, 0] if on.any() else np.flatnonzero(model.jnt_type == hinge)
    names = tuple(dict.fromkeys(model.joint(int(joint)).name for joint in joints))
    if not names or "" in names:
        wanted = 'a joint that moves has no name; write name="..." into it' if names else "it has no hinge"
        raise InputError(f"model: {wanted}")
    if wrong := [name for name in names if model.joint(name).type[0] != hinge]:
        raise InputError(f"model: the motor of {wrong[0]} drives no hinge; take it out of the file")
    return names


def acting(m: mujoco.MjModel) -> Bool[np.ndarray, " motors"]:
    """True for actuators that act: the model disables neither their group nor all of them."""
    off = [group for group in range(31) if m.opt.disableactuator >> group & 1]
    return ~np.isin(m.actuator_group, off) & (not m.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_ACTUATION)


def motors_on(model: mujoco.MjModel, joint: int) -> Int[np.ndarray, " motors"]:
    """Return the indices of the actuators that drive the joint of this index, not through a tendon or a site."""
    return np.flatnonzero(np.isin(model.actuator_trntype, ON_JOINTS) & (model.actuator_trnid[:, 0] == joint))


def _acting_on(model: mujoco.MjModel, joint: int) -> list[int]:
    """Those of `motors_on` that act."""
    motors = motors_on(model, joint)
    return motors[acting(model)[motors]].tolist()


def gains(m: mujoco.MjModel, motor: Any) -> Float[np.ndarray, "2"]:
    """Return an actuator's stiffness, N m/rad, and damping, N m s/rad, at its joint; a damper's at full control."""
    found = -m.actuator_biasprm[motor, 1:3] * (m.actuator_biastype[motor] == BIAS.mjBIAS_AFFINE)
    if m.actuator_gaintype[motor] == GAIN.mjGAIN_AFFINE:
        control = np.abs(m.actuator_ctrlrange[motor]).max() if m.actuator_ctrllimited[motor] else 1.0
        found[1] -= control * m.actuator_gainprm[motor, 2]
    return found * m.actuator_gear[motor, 0] ** 2 + 0.0  # no -0


def inputs(m: mujoco.MjModel, motor: Any) -> Float[np.ndarray, "2"]:
    """Return the smallest and largest control of an actuator, or activation of an integrator: infinite without."""
    kind = "act" if m.actuator_dyntype[motor] == INTEGRATOR else "ctrl"
    free = kind == "ctrl" and m.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL
    limited = getattr(m, f"actuator_{kind}limited")[motor] and not free
    return getattr(m, f"actuator_{kind}range")[motor] if limited else np.array([-np.inf, np.inf])


def bounds(m: mujoco.MjModel, motor: Any, alone: bool = False) -> Float[np.ndarray, "2"]:
    """Return an actuator's smallest and largest torque at its joint, N m, within that joint's own limit unless
    `alone`; infinite without any."""
    span, gear, joint = np.array([-np.inf, np.inf]), m.actuator_gear[motor, 0], m.actuator_trnid[motor, 0]
    constant = m.actuator_gaintype[motor] == GAIN.mjGAIN_FIXED and m.actuator_biastype[motor] == BIAS.mjBIAS_NONE
    if constant:
        span = np.sort(gain * inputs(m, motor)) if (gain := m.actuator_gainprm[motor, 0]) else np.zeros(2)
    if m.actuator_forcelimited[motor]:
        span = np.clip(span, *m.actuator_forcerange[motor])
    span = np.sort(gear * span) if gear else np.zeros(2)
    held = not alone and np.isin(m.actuator_trntype[motor], ON_JOINTS) and m.jnt_actfrclimited[joint]
    return np.clip(span, *m.jnt_actfrcrange[joint]) if held else span


def motor_limits(model: mujoco.MjModel) -> Float[np.ndarray, " motors"]:
    """Return the largest torque of each motor at its joint, N m."""
    return np.array([np.abs(bounds(model, motor)).max() for motor in range(len(model.actuator_trntype))], float)


def own_drives(model: mujoco.MjModel, joints: Sequence[str]) -> Float[np.ndarray, "3 joints"]:
    """Return each joint's largest torque, N m, and the stiffness and damping of its acting actuators, NaN without.

    The torque is the sum over actuators, without those that only damp; infinite without a limit.
    """
    found = []
    for row in (model.joint(joint).id for joint in joints):
        motors = _acting_on(model, row)
        each = np.array([gains(model, motor) for motor in motors]).reshape(-1, 2)
        limits = motor_limits(model)[motors]
        drives = (each[:, 0] != 0) | (each[:, 1] <= 0)
        torque = limits[drives if drives.any() else slice(None)].sum() if motors else np.inf
        stiffness, damping = each.sum(axis=0)
        held = stiffness > 0
        found.append((torque, stiffness if held else np.nan, max(damping, 0.0) if held or damping > 0 else np.nan))
    return np.array(found).T


def joint_limits(model: mujoco.MjModel, joints: Sequence[str]) -> Float[np.ndarray, " joints"]:
    """Return the largest torque that each joint takes of all its actuators, N m; infinite without a limit."""
    rows = [model.joint(joint).id for joint in joints]
    return np.where(model.jnt_actfrclimited[rows], np.abs(model.jnt_actfrcrange[rows]).max(axis=1), np.inf)


def setpoint_limits(model: mujoco.MjModel, joints: Sequence[str]) -> Float[np.ndarray, "2 joints"]:
    """Return the lowest and highest set-points that each joint's position actuators take, rad; infinite without."""
    found = np.repeat([[-np.inf], [np.inf]], len(joints), axis=1)
    for ends, row in zip(found.T, (model.joint(joint).id for joint in joints), strict=True):
        for motor in _acting_on(model, row):
            if (gain := model.actuator_gainprm[motor, 0]) and gains(model, motor)[0] > 0:
                constant, slope = model.actuator_biasprm[motor, :2]
                torques = gain * inputs(model, motor) + constant
                ends[:] = np.clip(ends, *np.sort(torques / (-slope * model.actuator_gear[motor, 0])))
    return found


class Controls(NamedTuple):
    """The controls of a model's own actuators, affine in what its joints are asked for and in their motion."""

    constant: Float[np.ndarray, " controls"]
    gains: Float[np.ndarray, "4 controls joints"]
    """Of set-points, torques, angles and velocities."""
    aimed: Bool[np.ndarray, " joints"]
    """Joints that position actuators bring to their set-points."""
    applied: Bool[np.ndarray, " joints"]
    """Joints without an actuator."""

    def __call__(self, *asked: Float[AnyArray, " joints"]) -> Any:
        """Return the controls for set-points, rad, torques, N m, angles, rad, and velocities, rad/s, of the joints."""
        return self.constant + sum(gain @ numbers for gain, numbers in zip(self.gains, asked, strict=True))


PLAYED = {
    "gain": (GAIN.mjGAIN_FIXED, GAIN.mjGAIN_AFFINE),
    "bias": (BIAS.mjBIAS_NONE, BIAS.mjBIAS_AFFINE),
    "dyn": (DYN.mjDYN_NONE, DYN.mjDYN_FILTER, DYN.mjDYN_FILTEREXACT),
}
"""Kinds of motors, position and velocity actuators and dampers."""


def controls_of(m: mujoco.MjModel, joints: Sequence[str], constant: Float[np.ndarray, " controls"]) -> Controls:
    """Return how a model's own actuators are driven; those of no joint, or that do not act, keep `constant`.

    A joint with position actuators: each rests at the set-point, velocity actuators ask for standstill, dampers act in
    full, motors give nothing. Another joint: its motors, or without any its velocity actuators, share the torque by
    their limits, and its other actuators give nothing.

    Raises:
      InputError: an actuator of a joint is of none of these kinds.
    """
    ways = acting(m) & np.isin(m.actuator_trntype, ON_JOINTS)
    on = ways[:, None] & (m.actuator_trnid[:, :1] == [m.joint(j).id for j in joints])
    motors, of = map(np.asarray, np.nonzero(on))
    for kind, played in PLAYED.items():
        known = np.isin(getattr(m, f"actuator_{kind}type")[motors], played) & (m.actuator_plugin[motors] < 0)
        if len(odd := np.flatnonzero(~known)):
            what = f"{element(m, 'actuator', int(motors[odd[0]]))} on {joints[int(of[odd[0]])]}"
            raise InputError(f"unmodified: {what} is no motor, position or velocity actuator or damper")
    gear, gain = m.actuator_gear[motors, 0], m.actuator_gainprm[motors, 0]
    bias = m.actuator_biasprm[motors, :3].T * (m.actuator_biastype[motors] == BIAS.mjBIAS_AFFINE)
    damps, limits = m.actuator_gaintype[motors] == GAIN.mjGAIN_AFFINE, motor_limits(m)[motors]
    full = np.where(m.actuator_ctrllimited[motors], np.abs(m.actuator_ctrlrange[motors]).max(axis=1), 1.0)
    holds = np.array([gains(m, motor)[0] > 0 for motor in motors], bool)

    def anywhere(which: Any) -> Any:
        """Mask of the actuators whose joint has such an actuator."""
        return np.bincount(of, which, len(joints))[of] > 0

    held, acts = anywhere(holds), ~damps & (limits > 0)
    plain = acts & ~bias.any(axis=0)
    carries = acts & ~held & (plain | ~anywhere(plain))
    weights = np.where(carries, np.where(anywhere(carries & np.isinf(limits)), 1.0, limits), 0.0)
    shares = weights / np.maximum(np.bincount(of, weights, len(joints))[of], 1e-9)
    places = m.actuator_ctrladr[motors]
    constant, slopes = constant.copy(), np.zeros((4, len(constant), len(joints)))
    # Force = gain control + bias[0] + gear (bias[1] angle + bias[2] velocity), solved for the control where the force
    # is that of the joint's torque or where a position actuator rests; velocity actuators beside one get 0.
    solved = ~damps & (gain != 0) & (holds | ~held)
    inverse = solved / np.where(solved, gain, 1.0)
    constant[places] = np.where(damps, full * held, -bias[0] * inverse)
    angle, velocity = -gear * bias[1:]
    force = shares / np.where(carries, gear, 1.0)
    slopes[:, places, of] = inverse * [angle * holds, force, angle * ~held, velocity * ~held]
    return Controls(constant, slopes, np.bincount(of, holds, len(joints)) > 0, ~on.any(axis=0))
