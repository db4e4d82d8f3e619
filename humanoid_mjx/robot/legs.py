# pyright: reportAttributeAccessIssue=false
"""The legs of Table 4.1 on a fixed torso as MuJoCo models: links as chains, drawn as capsules, without contacts.

The world has x forward, y left and z up; the torso's middle is its origin. Joints are named and ordered as those of the
lower body, the right leg first, and equal values of both legs are a posture that is its own mirror image.
"""

from collections.abc import Sequence
from typing import Any, Literal

import mujoco
import numpy as np
from pydantic import Field

from humanoid_mjx.robot.description import Robot, add_motors_and_imu
from humanoid_mjx.robot.leg import FRAME_0, HIP_DIAMETER, MIRROR, SHANK_DIAMETER, Leg
from humanoid_mjx.robot.lower_body import JOINTS, SIDES, Ranges
from humanoid_mjx.robot.mjcf import add_chain
from humanoid_mjx.robot.ranges import TORQUE_LIMIT, joint_ranges
from humanoid_mjx.thesis.leg import GRAVITY, JOINT_NAMES

TIMESTEP = 0.002

LOOKS = {"right": (0.35, 0.6, 0.85, 1.0), "left": (0.9, 0.55, 0.3, 1.0)}
"""Colours in MuJoCo's renderer, those of the lower body."""


class Legs(Robot):
    """Both legs of Table 4.1 on a fixed torso."""

    name: Literal["legs", "leg"] = "legs"
    ranges: Ranges = Field(default="proposed", description="column of Table 3.2")
    feet: tuple[str, ...] = ("right_foot", "left_foot")
    mirror: tuple[tuple[str, str], ...] = (SIDES,)

    @property
    def sides(self) -> tuple[str, ...]:
        """The sides that have a leg."""
        return SIDES[: len(self.feet)]

    def spec(self, timestep: float | None = None) -> mujoco.MjSpec:
        return legs_spec(self.ranges, timestep, self.sides)


class SingleLeg(Legs):
    """The right leg alone."""

    name: Literal["leg"] = "leg"
    feet: tuple[str, ...] = ("right_foot",)
    mirror: tuple[tuple[str, str], ...] = ()


def legs_spec(
    ranges: str = "proposed",
    timestep: float | None = None,
    sides: Sequence[str] = SIDES,
    leg: Leg | None = None,
) -> mujoco.MjSpec:
    """Both legs with their motors and sensors, as a MuJoCo model that can still be changed.

    Args:
      ranges: a column of Table 3.2. Nothing stops a joint there: postures of section 6.4 lie beyond it.
      timestep: s; by default `TIMESTEP`.
      sides: which legs to build.
      leg: the chain of the right leg; by default `Leg.physical()`.

    Raises:
      InputError: unknown ranges, or a leg without mass.
    """
    leg = leg or Leg.physical()
    spec = mujoco.MjSpec()
    spec.modelname = "legs" if len(sides) > 1 else "leg"
    spec.compiler.degree = False
    spec.option.timestep = TIMESTEP if timestep is None else timestep
    spec.option.gravity = (0.0, 0.0, -GRAVITY)
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    body = spec.worldbody.add_body(name="torso")
    body.add_site(name="imu", size=(0.003, 0.003, 0.003))
    limits = joint_ranges(ranges)
    for side in sides:
        mirrored = side == "left"
        frame = MIRROR @ FRAME_0 @ MIRROR if mirrored else FRAME_0
        quat = np.empty(4)
        mujoco.mju_mat2Quat(quat, frame.reshape(-1))
        root = body.add_body(name=f"{side}_hip", quat=quat)
        names = [f"{side}_{name}" for name in JOINT_NAMES]
        add_chain(root, leg, names, f"{side}_", mirrored)
        for name, span in zip(names, limits, strict=True):
            spec.joint(name).range, spec.joint(name).limited = span, mujoco.mjtLimited.mjLIMITED_FALSE
        for i in range(leg.num_joints):
            _draw(spec.body(f"{side}_link{i + 1}"), HIP_DIAMETER if i < 3 else SHANK_DIAMETER, LOOKS[side])
    add_motors_and_imu(spec, {name: TORQUE_LIMIT for name in JOINTS if name.startswith(tuple(sides))}, "imu")
    return spec


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
