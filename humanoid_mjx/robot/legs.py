# pyright: reportAttributeAccessIssue=false
"""Chains as MuJoCo models, and the legs of Table 4.1 on a fixed torso: drawn as capsules, without contacts.

The legs' world has x forward, y left and z up; the torso's middle is its origin. Joints are named and ordered as those
of the lower body, the right leg first, and equal values of both legs are a posture that is its own mirror image.
"""

import math
from collections.abc import Sequence
from typing import Any, Literal

import jax
import mujoco
import numpy as np
from pydantic import Field

from humanoid_mjx.robot.chain import Chain
from humanoid_mjx.robot.description import Robot, add_motors_and_imu
from humanoid_mjx.robot.leg import FRAME_0, HIP_DIAMETER, MIRROR, SHANK_DIAMETER, Leg
from humanoid_mjx.robot.lower_body import JOINTS, SIDES, Ranges
from humanoid_mjx.thesis.leg import GRAVITY, JOINT_NAMES, JOINT_RANGES

SMALLEST_INERTIA = 1e-13
"""Inertia added where a link has none about some axis, such as a thin rod, kg m^2: MuJoCo requires inertias above
1e-15."""


def add_chain(parent: Any, chain: Chain, joint_names: Sequence[str], prefix: str = "", mirrored: bool = False) -> Any:
    """Add a chain's bodies, called `prefix`link1, link2, ..., to the body that is its frame 0; the last of them.

    A mirrored chain is the chain's image across the plane y = 0 of its frame 0; equal angles are images of each other.
    """
    structure, body = chain.structure, parent
    side = np.array([1.0, -1.0 if mirrored else 1.0, 1.0])
    # A reflection turns rotations the other way: what is an axis for points is its opposite for angles.
    turn = -side if mirrored else side
    inertias, offsets, lengths = (np.asarray(x, np.float64) for x in (chain.pseudo_inertia, chain.d, chain.a))
    dh = zip(joint_names, offsets, lengths, structure.theta_offset, structure.alpha, strict=True)
    for i, (name, d, a, start, alpha) in enumerate(dh):
        body = body.add_body(name=f"{prefix}link{i + 1}")
        body.pos = side * [a * math.cos(start), a * math.sin(start), d]
        # A turn by `start` about z, then by `alpha` about the new x.
        about_z, about_x = (np.array([math.cos(angle / 2), math.sin(angle / 2)]) for angle in (start, alpha))
        body.quat = np.r_[1.0, turn] * np.outer(about_z, about_x).reshape(-1)[[0, 1, 3, 2]]
        axis = np.array([0.0, math.sin(alpha), math.cos(alpha)])
        body.add_joint(name=name, axis=turn * axis, pos=side * [-a, -d * axis[1], -d * axis[2]])
        _set_inertia(body, inertias[i] * np.outer(np.r_[side, 1.0], np.r_[side, 1.0]))
    return body


def _set_inertia(body: Any, pseudo_inertia: np.ndarray) -> None:
    mass = pseudo_inertia[3, 3]
    center = pseudo_inertia[:3, 3] / mass
    second = pseudo_inertia[:3, :3] - mass * np.outer(center, center)
    inertia = np.trace(second) * np.eye(3) - second
    if np.linalg.eigvalsh(inertia)[0] < SMALLEST_INERTIA:
        inertia += SMALLEST_INERTIA * np.eye(3)
    body.explicitinertial, body.mass, body.ipos = True, mass, center
    body.fullinertia = inertia[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]


TIMESTEP = 0.002

TORQUE_LIMIT = 2.0
"""Limit of every joint's torque, N m. Table 4.7's maxima (0.28 and less) are of a leg that hangs. Balancing on one leg
takes 0.69 at the hip's roll, and a squat on one leg with the thigh level 1.35 at the knee; 2.0 leaves a motion half as
much again."""

LOOKS = {"right": (0.35, 0.6, 0.85, 1.0), "left": (0.9, 0.55, 0.3, 1.0)}
"""Colours in MuJoCo's renderer, those of the lower body."""


class Legs(Robot):
    """Both legs of Table 4.1 on a fixed torso. Nothing stops a joint: postures of section 6.4 lie beyond Table 3.2."""

    name: Literal["legs", "leg"] = "legs"
    ranges: Ranges = Field(default="proposed", description="column of Table 3.2")
    feet: tuple[str, ...] = ("right_foot", "left_foot")
    mirror: tuple[tuple[str, str], ...] = (SIDES,)

    @property
    def sides(self) -> tuple[str, ...]:
        """The sides that have a leg."""
        return SIDES[: len(self.feet)]

    def spec(self, timestep: float | None = None) -> mujoco.MjSpec:
        with jax.ensure_compile_time_eval():  # a task may make its robot within jit
            leg = Leg.physical()
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        spec.option.timestep = TIMESTEP if timestep is None else timestep
        spec.option.gravity = (0.0, 0.0, -GRAVITY)
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        torso = spec.worldbody.add_body(name="torso")
        torso.add_site(name="imu", size=(0.003, 0.003, 0.003))
        for side in self.sides:
            mirrored = side == "left"
            quat = np.empty(4)
            mujoco.mju_mat2Quat(quat, (MIRROR @ FRAME_0 @ MIRROR if mirrored else FRAME_0).reshape(-1))
            names = [f"{side}_{name}" for name in JOINT_NAMES]
            add_chain(torso.add_body(name=f"{side}_hip", quat=quat), leg, names, f"{side}_", mirrored)
            for name, span in zip(names, np.radians(JOINT_RANGES[self.ranges]), strict=True):
                spec.joint(name).range, spec.joint(name).limited = span, mujoco.mjtLimited.mjLIMITED_FALSE
            for i in range(leg.num_joints):  # a capsule from the frame before a link's to its own
                link, diameter = spec.body(f"{side}_link{i + 1}"), HIP_DIAMETER if i < 3 else SHANK_DIAMETER
                ends, size = (*link.first_joint().pos, 0.0, 0.0, 0.0), (diameter / 2, 0.0, 0.0)
                looks = {"contype": 0, "conaffinity": 0, "mass": 0.0, "rgba": LOOKS[side]}
                link.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=ends, size=size, **looks)
        motors = (name for name in JOINTS if name.startswith(self.sides))
        add_motors_and_imu(spec, dict.fromkeys(motors, TORQUE_LIMIT), "imu")
        return spec


class SingleLeg(Legs):
    """The right leg alone."""

    name: Literal["leg"] = "leg"
    feet: tuple[str, ...] = ("right_foot",)
    mirror: tuple[tuple[str, str], ...] = ()
