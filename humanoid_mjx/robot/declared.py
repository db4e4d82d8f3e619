# pyright: reportAttributeAccessIssue=false
"""Robots that a user declares by a YAML beside an MJCF. The YAML holds the facts that the model lacks.

The model's joints, masses, limits and looks stay. Torque motors take the place of its actuators, and sensors of the
package that of its own. The ground is the plane z = 0, which the feet feel through balls: a ball as it is, one in each
end of a capsule, one in each lower corner of a box.
"""

import hashlib
import json
import re
from collections.abc import Sequence
from functools import lru_cache
from math import inf, isfinite
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple
from xml.etree import ElementTree

import mujoco
import numpy as np
import pydantic
from jaxtyping import Float
from pydantic import Field

from humanoid_mjx.config import Config, parse_yaml
from humanoid_mjx.files import folder, meant, read_text, refuse_pipe
from humanoid_mjx.robot.description import BEND, Robot, Servo, add_motors_and_imu, image, motors_on
from humanoid_mjx.spec import InputError, Spec, known, search_folders, sentence

DAMPING = 0.03
"""Servo damping by stiffness where a description gives none, s."""

CORNER = 0.25
"""Largest radius of the balls in a box's corners, as a share of half its shorter side."""

SLACK_DEG = 1.0
"""Largest distance of a posture beyond the range of a joint, degrees."""

JOINT, GEOM = mujoco.mjtJoint, mujoco.mjtGeom


def _numbers(given: Any) -> Any:
    """Return numbers by patterns of joint names; a single number is for all joints."""
    numbers = given if isinstance(given, dict) else {".*": given}
    if any(isinstance(x, bool) or not isinstance(x, (int, float)) or not isfinite(x) for x in numbers.values()):
        raise ValueError(f"a number, or numbers by patterns of joints' names, are needed, got {given!r}")
    for pattern in numbers:
        try:
            re.compile(pattern)
        except re.error as error:
            raise ValueError(f"{pattern!r} is no regular expression: {error}") from error
    return {pattern: float(number) for pattern, number in numbers.items()}


ByJoint = Annotated[dict[str, float], pydantic.BeforeValidator(_numbers)]
"""A number for all joints, or numbers by regular expressions of whole names, of which the first that fits counts."""

Posture = Annotated[
    str | dict[str, float], pydantic.BeforeValidator(lambda given: given if isinstance(given, str) else _numbers(given))
]


class DeclaredServo(Spec):
    """Gains of the servo that drives the joints."""

    stiffness: ByJoint | None = Field(
        None, description="N m/rad, by joint; by default that of the model's position actuators, else the torque limit"
    )
    damping: ByJoint | None = Field(
        None, description="N m s/rad, by joint; by default as the stiffness, else 0.03 s times it"
    )


class Declaration(Spec):
    """Keys of a robot's YAML. `by joint` is one number, or numbers by regular expressions of joints' names."""

    model: str = Field(description="the MJCF, a path from the YAML")
    feet: list[str] = Field(min_length=1, description="geoms or bodies that stand on the ground")
    home: Posture = Field("", description="how it stands: a keyframe, or degrees by joint; by default all joints at 0")
    servo: DeclaredServo = Field(DeclaredServo.model_validate({}), description="gains of its joints' servo")
    torque: ByJoint | None = Field(None, description="largest torque by joint, N m; by default the model's")
    shares: ByJoint | None = Field(None, description="factors on action_scale, by joint; by default 1")
    turns: list[float] = Field([], description="phase, 0 to 1, at which each foot's swing begins; by default even")
    mirror: dict[str, str] = Field({}, description="parts of names on the right, and what stands for them on the left")
    bend: float = Field(15.0, ge=0, lt=90, description=BEND)
    contacts: Literal["feet", "model"] = Field(
        "feet", description="what touches: the feet the ground and nothing else, or also all bodies as the model says"
    )


class Declared(Robot):
    """A robot as its YAML and its MJCF describe it."""

    name: str = Field(description="path of the YAML, or the name of a robot that ships")
    content: str = Field("", description="digest of both files: a run takes no other robot of the same name")
    ground_geoms: tuple[str, ...] = Field(default=(), strict=False, description="geoms of the feet; all that touch")
    torque: tuple[float, ...] = Field(default=(), strict=False, description="largest torques, N m")
    stiffness: tuple[float, ...] = Field(default=(), strict=False, description="of the servo, N m/rad")
    damping: tuple[float, ...] = Field(default=(), strict=False, description="of the servo, N m s/rad")
    contacts: Literal["feet", "model"] = Field("feet", description="what touches")

    @property
    def servo(self) -> Servo:
        return Servo(np.array(self.stiffness), np.array(self.damping))

    def _unchanged(self) -> dict[str, Any]:
        own = _read(find(self.name)).values
        return {key: value for key, value in own.items() if key not in ("name", "content")}

    def spec(self, timestep: float | None = None) -> mujoco.MjSpec:
        source = _read(find(self.name))
        spec = _load(source.model)
        model = spec.compile()
        data = mujoco.MjData(model)
        for joint, angle in zip(source.joints, np.radians(self.home or [0.0] * len(source.joints)), strict=True):
            data.qpos[model.joint(joint).qposadr[0]] = angle
        mujoco.mj_kinematics(model, data)
        touching = [
            (spec.body(foot), geom.id)
            for foot in self.feet
            for geom in spec.body(foot).geoms
            if (geom.name in self.ground_geoms if self.ground_geoms else geom.contype or geom.conaffinity)
        ]
        balls = [(foot, geom, *_balls_of(model, data, geom, foot.name)) for foot, geom in touching]
        rough = model.geom_friction[model.geom_type == GEOM.mjGEOM_PLANE, 0].max(initial=0.0)
        # Remove what the package replaces: actuators, sensors, keyframes, the ground and, with `feet`, all contacts.
        feet_only = self.contacts == "feet"
        doomed = [*spec.actuators, *spec.sensors, *spec.keys, *(spec.pairs if feet_only else ())]
        for element in [*doomed, *(geom for geom in spec.worldbody.geoms if geom.type == GEOM.mjGEOM_PLANE)]:
            spec.delete(element)
        for geom in spec.geoms if feet_only else spec.worldbody.geoms:
            geom.contype = geom.conaffinity = 0
        spec.option.timestep = timestep or model.opt.timestep
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
        spec.option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
        ground = spec.worldbody.add_geom(
            name="ground", type=GEOM.mjGEOM_PLANE, size=(0.0, 0.0, 0.05), contype=0, conaffinity=0, rgba=(0.9,) * 4
        )
        looks = {"mass": 0.0, "contype": 0, "conaffinity": 0, "group": 3, "type": GEOM.mjGEOM_SPHERE}
        each = [(foot, geom, place, radius) for foot, geom, places, radius in balls for place in places]
        for index, (foot, geom, place, radius) in enumerate(each):
            ball = foot.add_geom(name=f"{foot.name}_point{index}", size=(radius, 0.0, 0.0), pos=place, **looks)
            pair = spec.add_pair(name=ball.name, geomname1=ground.name, geomname2=ball.name, condim=3)
            pair.friction[:2] = max(rough, model.geom_friction[geom, 0])
            pair.solref, pair.solimp = model.geom_solref[geom], model.geom_solimp[geom]
        spec.worldbody.first_body().add_site(name="package_imu", group=3)
        add_motors_and_imu(spec, dict(zip(source.joints, self.torque, strict=True)), "package_imu")
        return spec


def _balls_of(
    model: mujoco.MjModel, data: mujoco.MjData, geom: int, foot: str
) -> tuple[Float[np.ndarray, "balls 3"], float]:
    """The balls of a foot's geom that the ground can push: their places in the foot's frame and their radius, m."""
    size, kind = model.geom_size[geom], model.geom_type[geom]
    radius, centers = float(size[0]), np.zeros((1, 3))
    if kind == GEOM.mjGEOM_CAPSULE:
        centers = np.array([[0.0, 0.0, size[1]], [0.0, 0.0, -size[1]]])
    elif kind == GEOM.mjGEOM_BOX:
        upright = data.geom_xmat[geom].reshape(3, 3)[2]
        down = int(np.abs(upright).argmax())
        others = [axis for axis in range(3) if axis != down]
        radius = float(min(CORNER * size[others].min(), size[down]))
        corners = np.full((4, 3), -np.sign(upright[down]))
        corners[:, others] = [(1, 1), (1, -1), (-1, 1), (-1, -1)]
        centers = corners * (size - radius)
    elif kind != GEOM.mjGEOM_SPHERE:
        word = GEOM(int(kind)).name.removeprefix("mjGEOM_").lower()
        raise InputError(
            f"feet: {foot} has a {word}, {model.geom(geom).name!r}; name geoms that are balls, capsules or boxes"
        )
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    return model.geom_pos[geom] + centers @ rotation.reshape(3, 3).T, radius


class Source(NamedTuple):
    """Content of the two files of a robot."""

    model: str
    joints: tuple[str, ...]
    values: dict[str, Any]
    """Fields of `Declared`."""


def make_declared(name: str, **values: Any) -> Declared:
    """Build the robot of a YAML, or one that ships, by name.

    Raises:
      InputError: no such file, an unknown key, a value that does not fit the model, or another content than that asked
        for, in one sentence that names the file.
    """
    path = find(name)
    source = _read(path)
    asked = values.get("content") or source.values["content"]
    if asked != source.values["content"]:
        raise InputError(f"robot: {name} has changed since this run; --set task.robot={name} takes it as it is now.")
    try:
        return Declared.model_validate(source.values | values | {"name": name if is_shipped(name) else str(path)})
    except pydantic.ValidationError as error:
        raise InputError(f"{path.name}: {sentence(error, '', Declared)}") from error


def is_shipped(name: str) -> bool:
    """Return whether a robot of this name ships."""
    return (folder("robots") / f"{name}.yaml").is_file()


def describes_robot(name: str) -> bool:
    """Return whether this is a robot that ships, or a YAML with more keys of a robot than of a config."""
    path = Path(name)
    if is_shipped(name) or path.suffix not in (".yaml", ".yml") or not path.is_file():
        return is_shipped(name)
    data = parse_yaml(read_text(path), name)
    keys = data.keys() if isinstance(data, dict) else set()
    return len(keys & Declaration.model_fields.keys()) > len(keys & Config.model_fields.keys())


def find(name: str) -> Path:
    """Find the YAML of a robot: a shipped one, or a path. The path, or else its file name alone, is looked up in the
    config's folder and in the working directory.

    Raises:
      InputError: there is no such file.
    """
    if is_shipped(name):
        return folder("robots") / f"{name}.yaml"
    for place in (name, Path(name).name):
        for beside in search_folders():
            if (path := Path(beside) / place).is_file():
                return path.resolve()
    other = meant(name, "robot", folders=search_folders())
    raise InputError(
        f"robot: there is no file {name}, and none of this name in {' or '.join(search_folders())}{other}."
    )


def _read(path: Path) -> Source:
    """Read both files of a robot; unchanged files are parsed once."""
    try:
        text = read_text(path)
        data = parse_yaml(text, path.name)
        if not isinstance(data, dict):
            raise InputError(f"{path.name}: a robot is a mapping of keys such as model and feet.")
        declared = Declaration(**data)
        model = path.parent / declared.model
        refuse_pipe(model)
        return _understood(path, text, str(model), model.read_text(encoding="utf-8"))
    except pydantic.ValidationError as error:
        raise InputError(f"{path.name}: {sentence(error, '', Declaration)}") from error
    except OSError as error:
        raise InputError(f"{path.name}: {error.filename} cannot be read: {error.strerror}.") from error


@lru_cache
def _understood(path: Path, text: str, file: str, model_text: str) -> Source:
    """Parse the texts of both files."""
    data = parse_yaml(text, path.name)
    declared = Declaration(**data)
    try:
        spec = _load(file)
        model = spec.compile()
        joints = _driven(model)
        home = _home(declared.home, model, joints)
        torque = _by_joint("torque", declared.torque, joints, _own_torques(model, joints))
        if wrong := [joint for joint, limit in zip(joints, torque, strict=True) if not 0 < limit < inf]:
            lacks = "the model has no limit" if torque[joints.index(wrong[0])] else "the limit is 0"
            raise InputError(f"torque: {lacks} for {wrong[0]}; write its N m as torque: {{{wrong[0]}: 20}}")
        stiffness, damping = _own_servo(model, joints, torque)
        stiffness = _by_joint("servo.stiffness", declared.servo.stiffness, joints, stiffness)
        if declared.servo.stiffness is not None:
            damping = DAMPING * stiffness
        damping = _by_joint("servo.damping", declared.servo.damping, joints, damping)
        feet, geoms = _feet(declared.feet, spec)
        feet, turns = _in_bodies_order(feet, declared.turns, model)
        mirror = tuple(declared.mirror.items())
        values = {"feet": feet, "home": tuple(home), "turns": turns, "mirror": mirror, "bend": declared.bend}
        values |= {"torque": tuple(torque), "stiffness": tuple(stiffness), "damping": tuple(damping)}
        # A digest of what both files say, whatever their layout and comments.
        plain = json.dumps(dict(sorted(data.items()))) + ElementTree.canonicalize(model_text, strip_text=True)
        content = hashlib.sha256(plain.encode()).hexdigest()[:16]
        values |= {"ground_geoms": geoms, "contacts": declared.contacts, "content": content}
        if declared.shares is not None:
            shares = _by_joint("shares", declared.shares, joints, np.ones(len(joints)))
            values["shares"] = _by_kind(mirror, joints, shares)
    except InputError as error:
        message = str(error).rstrip(".")
        raise InputError(f"{path.name}: {message}.") from error
    return Source(file, joints, values)


def _by_kind(mirror: Any, joints: Sequence[str], shares: np.ndarray) -> tuple[float, ...]:
    """Return the shares by kind of joint from the shares by joint."""
    images = [image(joint, mirror) for joint in joints]
    first = [min(k, joints.index(image) if image in joints else k) for k, image in enumerate(images)]
    if uneven := [joint for k, joint in enumerate(joints) if shares[k] != shares[first[k]]]:
        raise InputError(f"shares: {uneven[0]} and its mirror image must have the same")
    return tuple(shares[sorted(set(first))].tolist())


def _load(file: str) -> mujoco.MjSpec:
    try:
        spec = mujoco.MjSpec.from_file(file)
        for index, body in enumerate(spec.bodies):
            body.name = body.name or f"body{index}"
        spec.compile()
    except ValueError as error:
        raise InputError(
            f"model: {Path(file).name} is no MJCF that MuJoCo takes: {' '.join(str(error).split())}"
        ) from error
    bodies = [body.name for body in spec.worldbody.bodies]
    free = [joint for joint in spec.joints if joint.type == JOINT.mjJNT_FREE]
    if len(bodies) != 1 or len(free) != 1 or free[0].parent.name != bodies[0]:
        there = ", ".join(bodies) or "none"
        raise InputError(f"model: a robot is one body with a free joint, and its child bodies; the bodies are: {there}")
    if fault := bad_timestep(spec.option.timestep):
        raise InputError(f"model: {fault}")
    return spec


def bad_timestep(seconds: float) -> str | None:
    """Return the fault of a model's time step, or None."""
    return None if 0.0 < seconds < inf else f"<option timestep> is {seconds:g}; it must be a number of seconds above 0"


def _driven(model: mujoco.MjModel) -> tuple[str, ...]:
    """The hinges that motors drive, in the motors' order; all hinges of a model without motors."""
    of_joint = np.isin(model.actuator_trntype, (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    driven = model.actuator_trnid[of_joint, 0] if model.nu else np.flatnonzero(model.jnt_type == JOINT.mjJNT_HINGE)
    names = tuple(dict.fromkeys(model.joint(int(joint)).name for joint in driven))
    if not names or "" in names:
        raise InputError("model: no motor drives a hinge that has a name")
    if wrong := [name for name in names if model.joint(name).type[0] != JOINT.mjJNT_HINGE]:
        raise InputError(f"model: the motor of {wrong[0]} drives no hinge")
    return names


def _home(home: Any, model: mujoco.MjModel, joints: Sequence[str]) -> Float[np.ndarray, " joints"]:
    """Angles of the joints, degrees."""
    keys, angles = [model.key(index).name for index in range(model.nkey)], np.zeros(len(joints))
    if isinstance(home, dict):
        angles = _by_joint("home", home, joints, angles, least=-inf)
    elif home and home not in keys:
        raise InputError(f"home: the model has no keyframe {home!r}; {known(home, keys) if keys else 'it has none'}")
    elif home:
        angles = np.degrees([model.key(home).qpos[model.joint(joint).qposadr[0]] for joint in joints])
    for joint, angle in zip(map(model.joint, joints), angles, strict=True):
        low, high = np.degrees(joint.range)
        if model.jnt_limited[joint.id] and not low - SLACK_DEG <= angle <= high + SLACK_DEG:
            default = "" if home else "; without this key all joints are at 0"
            raise InputError(
                f"home: {joint.name} at {angle:g} degrees is beyond its range, {low:g} to {high:g}{default}"
            )
    return angles


def _feet(names: Sequence[str], spec: mujoco.MjSpec) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Bodies of the feet, and the geoms that stand for them where such are named."""
    bodies, geoms = [], []
    for name in names:
        geom, body = spec.geom(name), spec.body(name)
        if geom is None and body is None:
            all_names = [part.name for part in (*spec.bodies, *spec.geoms) if part.name]
            raise InputError(f"feet: the model has no geom or body {name!r}; {known(name, all_names)}")
        bodies.append(geom.parent.name if geom is not None else body.name)
        chosen = [geom] if geom is not None else [g for g in body.geoms if g.contype or g.conaffinity]
        if not chosen:
            raise InputError(f"feet: {name} has no geom that touches")
        geoms += [geom.name] if geom is not None else []
    if geoms and len(geoms) != len(names):
        raise InputError("feet: name geoms or bodies, not some of each")
    return tuple(dict.fromkeys(bodies)), tuple(geoms)


def _in_bodies_order(
    feet: tuple[str, ...], turns: Sequence[float], model: mujoco.MjModel
) -> tuple[tuple[str, ...], tuple[float, ...]]:
    """Feet and their turns in the order of the bodies, in which MuJoCo sorts the contacts."""
    order = sorted(range(len(feet)), key=lambda k: model.body(feet[k]).id)
    if order == list(range(len(feet))) or len(turns) not in (0, len(feet)):
        return feet, tuple(turns)
    phases = turns or [k / len(feet) for k in range(len(feet))]
    return tuple(feet[k] for k in order), tuple(phases[k] for k in order)


def _own_torques(model: mujoco.MjModel, joints: Sequence[str]) -> Float[np.ndarray, " joints"]:
    """The model's limits of the torques, N m; infinite where it has none."""
    limits = np.full(len(joints), np.inf)
    for index, joint in enumerate(joints):
        row = model.joint(joint).id
        if model.jnt_actfrclimited[row]:
            limits[index] = np.abs(model.jnt_actfrcrange[row]).max()
        for motor in motors_on(model, row):
            gear = abs(model.actuator_gear[motor, 0])
            if model.actuator_forcelimited[motor]:
                limits[index] = min(limits[index], gear * np.abs(model.actuator_forcerange[motor]).max())
            elif model.actuator_ctrllimited[motor] and model.actuator_biastype[motor] == mujoco.mjtBias.mjBIAS_NONE:
                force = abs(model.actuator_gainprm[motor, 0]) * np.abs(model.actuator_ctrlrange[motor]).max()
                limits[index] = min(limits[index], gear * force)
    return limits


def _own_servo(
    model: mujoco.MjModel, joints: Sequence[str], torque: np.ndarray
) -> tuple[Float[np.ndarray, " joints"], Float[np.ndarray, " joints"]]:
    """Stiffness and damping of the model's position actuators; else the torque limit a radian, and `DAMPING` of it."""
    stiffness, damping = torque.copy(), DAMPING * torque
    for index, joint in enumerate(joints):
        for motor in motors_on(model, model.joint(joint).id):
            if model.actuator_biastype[motor] == mujoco.mjtBias.mjBIAS_AFFINE and model.actuator_biasprm[motor, 1] < 0:
                _, position, speed = (0.0 - model.actuator_biasprm[motor, :3]) * model.actuator_gear[motor, 0] ** 2
                stiffness[index], damping[index] = position, speed
    return stiffness, damping


def _by_joint(
    key: str, given: dict[str, float] | None, joints: Sequence[str], otherwise: np.ndarray, least: float = 0.0
) -> Float[np.ndarray, " joints"]:
    """Numbers of the joints from those by patterns, `otherwise` where none fits.

    Raises:
      InputError: a pattern fits no joint, or its number is below `least`.
    """
    values = otherwise.astype(float)
    for pattern, number in reversed((given or {}).items()):
        fits = [bool(re.fullmatch(pattern, joint)) for joint in joints]
        if not any(fits):
            raise InputError(f"{key}: {pattern!r} fits no joint; {known(pattern, joints)}")
        if number < least:
            raise InputError(f"{key}: must be at least {least:g}, got {number:g}")
        values[fits] = number
    return values
