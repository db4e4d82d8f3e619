# pyright: reportAttributeAccessIssue=false
"""The lower body as a MuJoCo model: torso, two legs of five joints, feet on the ground. Table 3.1 at 1:4.

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

import math
from collections.abc import Sequence
from typing import Literal, get_args

import mujoco
import numpy as np
from pydantic import Field

from humanoid_mjx.robot.description import Build, Robot
from humanoid_mjx.robot.ranges import TORQUE_LIMIT
from humanoid_mjx.spec import InputError, known
from humanoid_mjx.thesis import leg as thesis

Torso = Literal["free", "fixed"]
Ranges = Literal["proposed", "human"]

SIDES = ("right", "left")
JOINTS = tuple(f"{side}_{joint}" for side in SIDES for joint in thesis.JOINT_NAMES)
"""The order of joints, actuators and encoders."""

_METRES = {name: mm * 1e-3 * thesis.SCALE for name, mm in thesis.BODY_MM.items()}
HIP_OFFSET = _METRES["torso_length"] / 2
"""From the middle of the torso to a hip, m: the torso's length is its extent from hip to hip."""

TORSO_DEPTH = _METRES["torso_width"]
THIGH_LENGTH, THIGH_RADIUS = _METRES["upper_leg_height"], _METRES["upper_leg_circumference"] / (2 * math.pi)
SHANK_LENGTH, SHANK_RADIUS = _METRES["lower_leg_height"], _METRES["lower_leg_circumference"] / (2 * math.pi)
FOOT_LENGTH, FOOT_WIDTH, FOOT_HEIGHT = _METRES["foot_length"], _METRES["foot_width"], _METRES["foot_height"]

HIP_HEIGHT = THIGH_LENGTH + SHANK_LENGTH + FOOT_HEIGHT
"""Height of the standing body's hips, m; also of the torso's frame, whose origin is the middle between the hips."""

TORSO_MASS = 1.02
"""Mass of the torso, kg: the load of 10 N on the script's leg. The source gives it no mass."""

TORSO_HEIGHT = 0.060
"""m, from the hips up. Left open: a pelvis somewhat less high than wide, which puts the load 30 mm above the hips."""

ANKLE_FROM_HEEL = 0.020
"""m. Left open: a third of the foot, so that weight can shift both ways, and further forward as on a human foot."""

CORNER_RADIUS = 0.0005
"""m, of the balls in the lower corners of the foot box by which it touches the ground. They stand for the box because
MJX's own contact of a box with a plane leaves out corners that lie 1 mm above the deepest: on tilted feet it differs
from MuJoCo's by 0.1 m/s in a step, where the balls agree to rounding. They are also cheaper."""

ARMATURE = 0.001
"""kg m^2. Left open: a rotor of 2.5e-8 behind a gear of 200. The foot's own 4e-5 would ask for steps under 1 ms."""

DAMPING = 0.02
"""N m s/rad. Left open: it brings a joint without torque to rest in about 0.1 s, and costs 1% of the torque limit at 1
rad/s. A step of 4 ms may treat it explicitly, since timestep x damping / armature = 0.08 is far below 1."""

FRICTION = 1.0
"""Coefficient of friction between feet and ground: rubber on dry floors. MuJoCo has one coefficient; the source names a
static and a kinetic one and prints neither. Torsion and rolling are MuJoCo's defaults."""

TIMESTEPS = {"free": 0.004, "fixed": 0.002}
"""s. In the air 2 ms keeps the first-order error of computed torque at 1.6e-4 rad. On the ground 4 ms is stable, twice
as fast, and within the differences that soft contacts make in any case."""

_AXES = {
    "hip_pitch": (0.0, -1.0, 0.0),
    "hip_yaw": (0.0, 0.0, -1.0),
    "hip_roll": (-1.0, 0.0, 0.0),
    "knee_pitch": (0.0, 1.0, 0.0),
    "ankle_pitch": (0.0, 1.0, 0.0),
}
"""Joint axes of the right leg. The left leg's are their mirror images: yaw and roll turn the other way."""

LOOKS = {
    "ground": (0.9, 0.9, 0.9, 1.0),
    "torso": (0.6, 0.6, 0.6, 1.0),
    "right": (0.35, 0.6, 0.85, 1.0),
    "left": (0.9, 0.55, 0.3, 1.0),
}
"""Colours of the parts in MuJoCo's renderer."""

CORNERS = ((1, 1), (1, -1), (-1, 1), (-1, -1))
"""Corners of a foot: towards the toe or the heel, towards the left or the right."""

_LEG_CONTACTS = (("thigh", "thigh"), ("shank", "shank"), ("sole", "sole"), ("shank", "sole"), ("sole", "shank"))
"""Parts of the right and the left leg that cannot pass through each other; all are capsules, one contact a pair."""


HOME = (15.0, 0.0, 0.0, 30.0, -15.0) * 2
"""Degrees. Knees bent a little, so that legs can give way and stretch; the feet are flat under the hips."""


class LowerBody(Robot):
    """The lower body at 1:4: a torso, two legs of five joints, feet with four corners."""

    name: Literal["lower_body"] = "lower_body"
    torso: Torso = Field(default="free", description="on the ground, or fixed in the air without any")
    ranges: Ranges = Field(default="proposed", description="column of Table 3.2")
    feet: tuple[str, ...] = ("right_foot", "left_foot")
    home: tuple[float, ...] = Field(HOME, strict=False)
    shares: tuple[float, ...] = Field((1.5, 0.8, 0.6, 1.6, 1.4), strict=False)
    mirror: tuple[tuple[str, str], ...] = (SIDES,)

    def spec(self, timestep: float | None = None) -> mujoco.MjSpec:
        return lower_body_spec(self.torso, self.ranges, timestep)

    @property
    def build(self) -> Build:
        lean = self.posture[0]
        return Build(HIP_OFFSET, (THIGH_LENGTH + SHANK_LENGTH) * np.cos(lean), lean)


def lower_body_model(torso: str = "free", ranges: str = "proposed", timestep: float | None = None) -> mujoco.MjModel:
    """`lower_body_spec`, compiled."""
    return lower_body_spec(torso, ranges, timestep).compile()


def lower_body_spec(torso: str = "free", ranges: str = "proposed", timestep: float | None = None) -> mujoco.MjSpec:
    """The lower body, ten torque motors and its sensors, as a MuJoCo model that can still be changed.

    Args:
      torso: "free" to stand on the ground, or "fixed" to hang in the air without any.
      ranges: of the joints: a column of Table 3.2.
      timestep: s; by default that of `TIMESTEPS`.

    Raises:
      InputError: an unknown name, or a time step that is not positive.
    """
    for kind, name, names in (("torso", torso, get_args(Torso)), ("ranges", ranges, get_args(Ranges))):
        if name not in names:
            raise InputError(f"{kind}: unknown name {name!r}; {known(name, names)}.")
    step = TIMESTEPS[torso] if timestep is None else timestep
    if not 0 < step < math.inf:
        raise InputError(f"timestep must be a positive number of seconds, got {timestep!r}.")
    spec = mujoco.MjSpec()
    spec.modelname = "lower_body"
    spec.compiler.degree = False
    spec.option.timestep = step
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_EULERDAMP
    _add_light(spec)
    body = _add_torso(spec, torso)
    for side in SIDES:
        _add_leg(spec, body, side, np.radians(thesis.JOINT_RANGES[ranges]))
    for right, left in _LEG_CONTACTS:
        spec.add_pair(name=f"{right}_{left}", geomname1=f"right_{right}", geomname2=f"left_{left}", condim=1)
    if torso == "free":
        _add_ground(spec)
    add_motors_and_sensors(spec)
    if torso == "free":
        _add_corner_sensors(spec)
    return spec


def _add_light(spec: mujoco.MjSpec) -> None:
    """A bright sky, which MuJoCo's renderer would otherwise leave black."""
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = (0.45,) * 3, (0.6,) * 3
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=(1.0, 1.0, 1.0),
        rgb2=(0.8, 0.85, 0.9),
        width=64,
        height=384,
    )


def _add_torso(spec: mujoco.MjSpec, torso: str) -> mujoco.MjsBody:
    body = spec.worldbody.add_body(name="torso", pos=(0.0, 0.0, HIP_HEIGHT))
    if torso == "free":
        body.add_freejoint(name="torso")
    body.add_geom(
        name="torso",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=(0.0, 0.0, TORSO_HEIGHT / 2),
        size=(TORSO_DEPTH / 2, HIP_OFFSET, TORSO_HEIGHT / 2),
        mass=TORSO_MASS,
        rgba=LOOKS["torso"],
        contype=0,
        conaffinity=0,
    )
    body.add_site(name="imu", size=(0.003, 0.003, 0.003))
    return body


def _add_leg(spec: mujoco.MjSpec, torso: mujoco.MjsBody, side: str, ranges: np.ndarray) -> None:
    """Links with the masses of Table 4.3, in solid shapes: two balls at the hip, two capsules, a box."""
    ball, capsule, box = (getattr(mujoco.mjtGeom, f"mjGEOM_{name}") for name in ("SPHERE", "CAPSULE", "BOX"))
    outwards = -HIP_OFFSET if side == "right" else HIP_OFFSET
    thigh, shank = (0.0, 0.0, 0.0, 0.0, 0.0, -THIGH_LENGTH), (0.0, 0.0, 0.0, 0.0, 0.0, -SHANK_LENGTH)
    foot_size = (FOOT_LENGTH / 2, FOOT_WIDTH / 2, FOOT_HEIGHT / 2)
    foot_pos = (FOOT_LENGTH / 2 - ANKLE_FROM_HEEL, 0.0, -FOOT_HEIGHT / 2)
    links = (
        ("pitch_link", (0.0, outwards, 0.0), {"type": ball, "size": (THIGH_RADIUS, 0.0, 0.0)}),
        ("yaw_link", (0.0, 0.0, 0.0), {"type": ball, "size": (THIGH_RADIUS, 0.0, 0.0)}),
        ("thigh", (0.0, 0.0, 0.0), {"type": capsule, "fromto": thigh, "size": (THIGH_RADIUS, 0.0, 0.0)}),
        ("shank", (0.0, 0.0, -THIGH_LENGTH), {"type": capsule, "fromto": shank, "size": (SHANK_RADIUS, 0.0, 0.0)}),
        ("foot", (0.0, 0.0, -SHANK_LENGTH), {"type": box, "pos": foot_pos, "size": foot_size}),
    )
    body = torso
    for (link, pos, shape), joint, limits, mass in zip(
        links, thesis.JOINT_NAMES, ranges, thesis.LINK_MASSES, strict=True
    ):
        body = body.add_body(name=f"{side}_{link}", pos=pos)
        mirrored = side == "left" and joint in ("hip_yaw", "hip_roll")
        body.add_joint(
            name=f"{side}_{joint}",
            axis=-np.array(_AXES[joint]) if mirrored else _AXES[joint],
            range=limits,
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
            damping=DAMPING,
            armature=ARMATURE,
        )
        body.add_geom(name=f"{side}_{link}", mass=mass, contype=0, conaffinity=0, rgba=LOOKS[side], **shape)
    _add_foot_contact(body, side, np.array(foot_pos), np.array(foot_size))


def _add_foot_contact(foot: mujoco.MjsBody, side: str, pos: np.ndarray, size: np.ndarray) -> None:
    """Massless shapes in the foot box: corners for the ground, a capsule for the other leg, a site that senses."""
    ball, capsule, box = mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_BOX
    silent = {"mass": 0.0, "contype": 0, "conaffinity": 0, "group": 3}
    for index, corner in enumerate(CORNERS):
        center = pos + (*corner, -1) * (size - CORNER_RADIUS)
        foot.add_geom(name=f"{side}_corner{index}", type=ball, pos=center, size=(CORNER_RADIUS, 0.0, 0.0), **silent)
        foot.add_site(name=f"{side}_corner{index}", type=box, pos=center, size=(3 * CORNER_RADIUS,) * 3, group=3)
    along = np.array([size[0] - size[1], 0.0, 0.0])
    fromto = (*(pos - along), *(pos + along))
    foot.add_geom(name=f"{side}_sole", type=capsule, fromto=fromto, size=(size[1], 0.0, 0.0), **silent)
    foot.add_site(name=f"{side}_foot", type=box, pos=pos, size=size + 0.005, group=3)


def _add_ground(spec: mujoco.MjSpec) -> None:
    """The plane z = 0, which only the feet feel: a body that touches it with anything else has fallen."""
    spec.worldbody.add_geom(
        name="ground",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=(0.0, 0.0, 0.05),
        contype=0,
        conaffinity=0,
        rgba=LOOKS["ground"],
    )
    for side in SIDES:
        for index in range(len(CORNERS)):
            corner = f"{side}_corner{index}"
            pair = spec.add_pair(name=f"{corner}_ground", geomname1="ground", geomname2=corner, condim=3)
            pair.friction[:2] = FRICTION


def _add_corner_sensors(spec: mujoco.MjSpec) -> None:
    """Sensors of each corner's force on the ground, in the order of the pairs with the ground."""
    touch, site = mujoco.mjtSensor.mjSENS_TOUCH, mujoco.mjtObj.mjOBJ_SITE
    for side in SIDES:
        for index in range(len(CORNERS)):
            corner = f"{side}_corner{index}"
            spec.add_sensor(name=f"{corner}_contact", type=touch, objtype=site, objname=corner)


def add_motors_and_sensors(spec: mujoco.MjSpec, joints: Sequence[str] = JOINTS, sides: Sequence[str] = SIDES) -> None:
    """A torque motor and an encoder for each joint; gyroscope and accelerometer at "imu"; touch at "SIDE_foot"."""
    for joint in joints:
        motor = spec.add_actuator(
            name=joint,
            target=joint,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            ctrllimited=mujoco.mjtLimited.mjLIMITED_TRUE,
            ctrlrange=(-TORQUE_LIMIT, TORQUE_LIMIT),
        )
        motor.set_to_motor()
    kinds = mujoco.mjtSensor
    sensors = [(f"{joint}_encoder", kinds.mjSENS_JOINTPOS, mujoco.mjtObj.mjOBJ_JOINT, joint) for joint in joints]
    sensors += [
        ("gyroscope", kinds.mjSENS_GYRO, mujoco.mjtObj.mjOBJ_SITE, "imu"),
        ("accelerometer", kinds.mjSENS_ACCELEROMETER, mujoco.mjtObj.mjOBJ_SITE, "imu"),
    ]
    sensors += [(f"{s}_foot_contact", kinds.mjSENS_TOUCH, mujoco.mjtObj.mjOBJ_SITE, f"{s}_foot") for s in sides]
    for name, kind, objtype, objname in sensors:
        spec.add_sensor(name=name, type=kind, objtype=objtype, objname=objname)
