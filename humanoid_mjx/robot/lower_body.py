# pyright: reportAttributeAccessIssue=false
"""The lower body: torso, two legs of five joints, feet on the ground. Table 3.1 at 1:4, in `robots/lower_body.xml`.

World and torso have x forward, y left and z up. At `qpos = 0` (joints) the body stands upright with its feet flat on
the ground plane z = 0. Joints come in the order of `JOINTS`: the right leg's five, then the left's. Positive is

    hip_pitch    flexion: the leg swings forward
    hip_yaw      external rotation: the toes turn outwards
    hip_roll     abduction: the leg swings outwards
    knee_pitch   flexion: the shank swings back
    ankle_pitch  plantar flexion: the toes go down

on both sides, so equal values are a posture that is its own mirror image. With these signs the human column of
Table 3.2 is a human's: hip extension 15 and flexion 130 degrees, adduction 30 and abduction 45, dorsiflexion 20 and
plantar flexion 50. They are also those of the right leg of Table 4.1, with x0 forward, y0 up and z0 to the right: there
the ankle turns about the knee's axis, in the same sense. A foot is flat where hip_pitch = knee_pitch + ankle_pitch.

Hip pitch, yaw and roll turn about one point; the 40 mm hip links of the chain are `Leg`'s, not this body's.
"""

from typing import Literal

import mujoco
import numpy as np
from pydantic import Field

from humanoid_mjx.files import folder
from humanoid_mjx.robot.description import Build, Robot
from humanoid_mjx.thesis import leg as thesis

Torso = Literal["free", "fixed"]
Ranges = Literal["proposed", "human"]

SIDES = ("right", "left")
JOINTS = tuple(f"{side}_{joint}" for side in SIDES for joint in thesis.JOINT_NAMES)
"""The order of joints and motors."""

TIMESTEPS = {"free": 0.004, "fixed": 0.002}
"""s. In the air 2 ms keeps the first-order error of computed torque at 1.6e-4 rad. On the ground 4 ms is stable, twice
as fast, and within the differences that soft contacts make in any case."""

HOME = (15.0, 0.0, 0.0, 30.0, -15.0) * 2
"""Degrees. Knees bent a little, so that legs can give way and stretch; the feet are flat under the hips."""

SHORTENED = np.array([1.0, 0.0, 0.0, 2.0, -1.0])
"""Change of a leg's joints that shortens the leg under its hip while its foot stays level."""

LEFTWARDS = np.array([-1.0, 1.0])
"""The sense in which the right and the left hip's yaw and roll turn a leg: positive is outwards on both sides."""


class LowerBody(Robot):
    """The lower body at 1:4: a torso, two legs of five joints, feet with four corners."""

    name: Literal["lower_body"] = "lower_body"
    torso: Torso = Field(default="free", description="on the ground, or fixed in the air without any")
    ranges: Ranges = Field(default="proposed", description="column of Table 3.2")
    feet: tuple[str, ...] = ("right_foot", "left_foot")
    home: tuple[float, ...] = Field(default=HOME, strict=False)
    shares: tuple[float, ...] = Field(default=(1.5, 0.8, 0.6, 1.6, 1.4), strict=False)
    mirror: tuple[tuple[str, str], ...] = (SIDES,)

    def spec(self, timestep: float | None = None) -> mujoco.MjSpec:
        spec = mujoco.MjSpec.from_file(str(folder("robots") / "lower_body.xml"))
        spec.option.timestep = timestep or TIMESTEPS[self.torso]
        for joint, span in zip(JOINTS, thesis.JOINT_RANGES[self.ranges] * 2, strict=True):
            spec.joint(joint).range = span
        if self.torso == "fixed":
            on_ground = [pair for pair in spec.pairs if pair.geomname1 == "ground"]
            for element in (*on_ground, spec.geom("ground"), spec.joint("torso")):
                spec.delete(element)
        return spec

    @property
    def build(self) -> Build:
        hip, shank, foot = (self.model.body(f"left_{name}").pos for name in ("pitch_link", "shank", "foot"))
        lean = self.posture[0]
        return Build(float(hip[1]), -(shank[2] + foot[2]) * np.cos(lean), lean)
