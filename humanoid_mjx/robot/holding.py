# pyright: reportAttributeAccessIssue=false
"""Does the servo of a robot hold it? Its torques while it stands at home, and gains that would do."""

import mujoco
import numpy as np
from jaxtyping import Float
from scipy.linalg import eigh, null_space

from humanoid_mjx.robot.description import Robot, ground_points, two_digits
from humanoid_mjx.robot.mjcf import pattern

SAG_DEG, SAGGED_DEG = 10.0, 5.0
"""Sag of a joint, degrees, above which gains are called too soft, and that of the gains that are named instead."""

LEAST_RATIO, RATIO = 0.1, 0.5
"""The same of damping ratios: below and instead."""

MOST_FACTOR, SURE = 100.0, 1.6
"""Factor of the stiffness from which on no stiffness keeps a robot from tipping over, and the share above the least one
that keeps it up although it sags; 1.3 does not do for G1 and T1."""


class Standing:
    """A robot that stands at home: its state, and the ground's vertical forces on its feet, as even as balances, N."""

    def __init__(self, robot: Robot):
        self.model, (self.balls, _) = robot.model, ground_points(robot.model)
        self.data = mujoco.MjData(self.model)
        self.data.qpos[self.model.jnt_qposadr[robot.driven]] = robot.posture
        mujoco.mj_forward(self.model, self.data)
        self.home, places = self.data.qpos.copy(), self.data.geom_xpos[self.balls]
        borne = self.model.body_mass * (1.0 - self.model.body_gravcomp)
        center = borne @ self.data.xipos / max(borne.sum(), 1e-9)
        balance = np.vstack([np.ones(len(places)), (places - center).T[:2]])
        weight = borne.sum() * np.linalg.norm(self.model.opt.gravity)
        self.forces = np.linalg.lstsq(balance, np.array([weight, 0.0, 0.0]))[0]

    def jacobians(self) -> Float[np.ndarray, "points 3 nv"]:
        """Return the Jacobians of the points of the feet."""
        found = np.empty((len(self.balls), 3, self.model.nv))
        for jacobian, ball in zip(found, self.balls.tolist(), strict=True):
            mujoco.mj_jacGeom(self.model, self.data, jacobian, None, ball)
        return found

    def load(self, change: Float[np.ndarray, " nv"]) -> Float[np.ndarray, " nv"]:
        """Return what weight, springs and ground ask of each degree of freedom, after a small change from home."""
        self.data.qpos[:] = self.home
        mujoco.mj_integratePos(self.model, self.data.qpos, change, 1.0)
        mujoco.mj_forward(self.model, self.data)
        return self.data.qfrc_bias - self.data.qfrc_passive - self.forces @ self.jacobians()[:, 2]


def standing(robot: Robot) -> tuple[Float[np.ndarray, " joints"], Float[np.ndarray, " joints"]]:
    """Return the torque that holds each joint of a robot which stands at home, N m, and the inertia about the joint
    while all else rests, kg m^2. The ground pushes all feet vertically, as evenly as balances."""
    state, model = Standing(robot), robot.model
    matrix, dofs = np.empty((model.nv, model.nv)), model.jnt_dofadr[robot.driven]
    mujoco.mj_fullM(model, state.data, matrix)
    return np.abs(state.load(np.zeros(model.nv))[dofs]), matrix[dofs, dofs]


def tipping(robot: Robot) -> tuple[float, int]:
    """Return how many times as stiff the servo must be for a robot that stands at home not to tip over, and the joint
    whose stiffness counts most.

    While the feet stay where they are, a posture is stable if its energy, of weight and servo, is the least of all
    nearby: in each direction the servo's springs must outweigh what the weight gains.
    """
    assert robot.servo is not None
    state, model, dofs = Standing(robot), robot.model, robot.model.jnt_dofadr[robot.driven]
    free, springs = null_space(state.jacobians().reshape(-1, model.nv)), np.zeros(model.nv)
    if not free.size:  # nothing can move while the feet stay
        return 0.0, 0
    small = 1e-4 * np.eye(model.nv)
    weight = np.array([state.load(change) - state.load(-change) for change in small]) / 2e-4
    springs[dofs] = np.maximum(robot.servo[0], 1e-9)
    stiffness = free.T @ (springs[:, None] * free)
    least = 1e-6 * np.trace(stiffness) / len(stiffness) * np.eye(len(stiffness))
    shares, ways = eigh(-free.T @ (weight + weight.T) @ free / 2, stiffness + least)
    return float(shares[-1]), int((springs * (free @ ways[:, -1]) ** 2)[dofs].argmax())


def in_words(robot: Robot) -> list[str]:
    """Return lines on the servo of a robot with feet: what it takes, whether it tips over, gains that would hold it."""
    assert robot.servo is not None
    (torque, inertia), (stiffness, damping), names = standing(robot), robot.servo, np.array(robot.joints)
    own, critical = robot.model.dof_damping[robot.model.jnt_dofadr[robot.driven]], 2 * np.sqrt(inertia)
    spring, share = robot.model.jnt_stiffness[robot.driven], torque / robot.torque_limits
    firm = np.maximum(stiffness + spring, 1e-9)
    sag, ratio = np.degrees(torque / firm), (damping + own) / critical / np.sqrt(firm)
    most, loaded, least = sag.argmax(), share.argmax(), ratio.argmin()
    lines = [
        f"under its weight {names[most]} gives way by {sag[most]:.2g} degrees, {names[loaded]} takes "
        f"{share[loaded]:.0%} of its motor's limit; least damping ratio {ratio[least]:.2g}, of {names[least]}"
    ]
    factor, weakest = tipping(robot)
    if factor > MOST_FACTOR:
        limp = ", or a joint without a motor gives way" * (robot.model.nv > 6 + len(names))
        lines.append(
            f"without a policy it tips over, however stiff it is: its feet carry it on a line, or a point{limp}"
        )
    elif factor > 1:
        stiffer = f"{two_digits(SURE * factor):g} times as stiff"
        lines.append(f"without a policy it tips over; {stiffer} it would stand, {names[weakest]} counts most")
    if robot.steps > 1:
        lines.append(f"soft joints do not get as far as told: steps rise and sway {robot.steps:g} times as far")
    if not robot.rests:
        lines.append("told to stand, it steps on the spot; rests: true in its YAML lets it stand still")
    if share[loaded] > 1:
        return [*lines, "no gains hold it: a motor is too weak, or home is no posture to stand in"]
    needed = np.maximum(torque / np.radians(SAGGED_DEG) - spring, stiffness)
    damped = np.maximum(RATIO * critical * np.sqrt(needed + spring) - own, damping)
    groups = [robot.kinds == kind for kind in np.unique(robot.kinds[(sag > SAG_DEG) | (ratio < LEAST_RATIO)])]
    gains = (
        ", ".join(f"{pattern(names[group])}: {two_digits(1.05 * values[group].max()):g}" for group in groups)
        for values in (needed, damped)  # to two digits, upwards
    )
    better = "stiffness: {{{}}}, damping: {{{}}}".format(*gains)
    words = f"too soft to hold it; {SAGGED_DEG:g} degrees and a damping ratio of {RATIO:g} take servo: {{{better}}}"
    return [*lines, words] if groups else lines
