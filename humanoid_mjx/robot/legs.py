# pyright: reportAttributeAccessIssue=false
"""The legs of Table 4.1 on a fixed torso as MuJoCo models: links as chains, drawn as capsules, without contacts.

The world has x forward, y left and z up; the torso's middle is its origin. Joints are named and ordered as those of the
lower body, the right leg first, and equal values of both legs are a posture that is its own mirror image.
"""

from typing import Any, Literal

import mujoco
import numpy as np
from pydantic import Field

from humanoid_mjx.robot.description import Robot, add_motors_and_imu
from humanoid_mjx.robot.leg import FRAME_0, HIP_DIAMETER, MIRROR, SHANK_DIAMETER, Leg
from humanoid_mjx.robot.lower_body import JOINTS, SIDES, Ranges
from humanoid_mjx.robot.mjcf import add_chain
from humanoid_mjx.thesis.leg import GRAVITY, JOINT_NAMES, JOINT_RANGES

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
        leg, spec = Leg.physical(), mujoco.MjSpec()
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
            for i in range(leg.num_joints):
                _draw(spec.body(f"{side}_link{i + 1}"), HIP_DIAMETER if i < 3 else SHANK_DIAMETER, LOOKS[side])
        motors = (name for name in JOINTS if name.startswith(self.sides))
        add_motors_and_imu(spec, dict.fromkeys(motors, TORQUE_LIMIT), "imu")
        return spec


class SingleLeg(Legs):
    """The right leg alone."""

    name: Literal["leg"] = "leg"
    feet: tuple[str, ...] = ("right_foot",)
    mirror: tuple[tuple[str, str], ...] = ()


def _draw(body: Any, diameter: float, color: tuple[float, ...]) -> None:
    """A capsule from the frame before a link's to its own."""
    before = body.first_joint().pos
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        fromto=(*before, 0.0, 0.0, 0.0),
        size=(diameter / 2, 0.0, 0.0),
        contype=0,
        conaffinity=0,
        mass=0.0,
        rgba=color,
    )
