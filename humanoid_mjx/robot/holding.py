# pyright: reportAttributeAccessIssue=false
"""Does the servo of a robot hold it? Its torques while it stands at home, and gains that would do."""

import mujoco
import numpy as np
from jaxtyping import Float

from humanoid_mjx.robot.description import Robot, ground_points

SAG_DEG, SAGGED_DEG = 10.0, 5.0
"""Sag of a joint, degrees, above which gains are called too soft, and that of the gains that are named instead."""

LEAST_RATIO, RATIO = 0.1, 0.5
"""The same of damping ratios: below and instead."""


def standing(robot: Robot) -> tuple[Float[np.ndarray, " joints"], Float[np.ndarray, " joints"]]:
    """Return the torque that holds each joint of a robot which stands at home, N m, and the inertia about the joint
    while all else rests, kg m^2. The ground pushes all feet vertically, as evenly as balances."""
    model, (balls, _) = robot.model, ground_points(robot.model)
    data, matrix, dofs = mujoco.MjData(model), np.empty((model.nv, model.nv)), model.jnt_dofadr[robot.driven]
    data.qpos[model.jnt_qposadr[robot.driven]] = robot.posture
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, matrix)
    places, torque, jacobian = data.geom_xpos[balls], data.qfrc_bias.copy(), np.empty((3, model.nv))
    balance = np.vstack([np.ones(len(balls)), (places - data.subtree_com[0]).T[:2]])
    forces = np.linalg.lstsq(balance, np.array([robot.mass * float(np.linalg.norm(model.opt.gravity)), 0.0, 0.0]))[0]
    for ball, place, force in zip(balls, places, forces, strict=True):
        mujoco.mj_jac(model, data, jacobian, None, place, model.geom_bodyid[ball])
        torque -= force * jacobian[2]
    return np.abs(torque[dofs]), matrix[dofs, dofs]


def in_words(robot: Robot) -> list[str]:
    """Return a line on the servo of a robot with feet, and one with other gains where it cannot hold the robot."""
    assert robot.servo is not None
    (torque, inertia), (stiffness, damping), names = standing(robot), robot.servo, np.array(robot.joints)
    own, critical = robot.model.dof_damping[robot.model.jnt_dofadr[robot.driven]], 2 * np.sqrt(inertia)
    sag, share = np.degrees(torque / np.maximum(stiffness, 1e-9)), torque / robot.torque_limits
    ratio = (damping + own) / critical / np.sqrt(np.maximum(stiffness, 1e-9))
    most, loaded, least = sag.argmax(), share.argmax(), ratio.argmin()
    lines = [
        f"under its weight {names[most]} gives way by {sag[most]:.2g} degrees, {names[loaded]} takes "
        f"{share[loaded]:.0%} of its motor's limit; least damping ratio {ratio[least]:.2g}, of {names[least]}"
    ]
    if share[loaded] > 1:
        return [*lines, "no gains hold it: a motor is too weak, or home is no posture to stand in"]
    needed = np.maximum(torque / np.radians(SAGGED_DEG), stiffness)
    damped = np.maximum(RATIO * critical * np.sqrt(needed) - own, damping)
    groups = [robot.kinds == kind for kind in np.unique(robot.kinds[(sag > SAG_DEG) | (ratio < LEAST_RATIO)])]
    gains = (
        ", ".join(f"{'|'.join(names[group])}: {float(f'{1.05 * values[group].max():.1e}'):g}" for group in groups)
        for values in (needed, damped)  # to two digits, upwards
    )
    better = "stiffness: {{{}}}, damping: {{{}}}".format(*gains)
    words = f"too soft to hold it; {SAGGED_DEG:g} degrees and a damping ratio of {RATIO:g} take servo: {{{better}}}"
    return [*lines, words] if groups else lines
