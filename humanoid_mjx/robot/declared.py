# pyright: reportAttributeAccessIssue=false
"""Robots that a user declares by a YAML beside an MJCF. The YAML holds the facts that the model lacks.

The model's joints, masses, limits and looks stay. Torque motors take the place of its actuators, and sensors of the
package that of its own. The ground is the plane z = 0, which the feet feel through balls: a ball as it is, one in each
end of a capsule, one in each lower corner of a box.
"""

import re
from collections.abc import Sequence
from functools import lru_cache
from math import inf, isfinite
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import mujoco
import numpy as np
import pydantic
from jaxtyping import Float
from pydantic import Field

from humanoid_mjx.config import Config, parse_yaml
from humanoid_mjx.files import folder, meant, read_text
from humanoid_mjx.robot import mjcf
from humanoid_mjx.robot.description import (
    BEND,
    MOTION,
    RESTS,
    STEPS,
    Robot,
    Servo,
    add_imu,
    add_motors_and_imu,
    listed,
    two_digits,
)
from humanoid_mjx.robot.differences import Difference, differences
from humanoid_mjx.robot.mirror import images
from humanoid_mjx.robot.motors import ON_JOINTS, driven, joint_limits, own_drives, setpoint_limits
from humanoid_mjx.robot.touching import add_ground, balls_of, soles_of, strip
from humanoid_mjx.spec import InputError, Spec, known, search_folders, sentence

OWN = re.compile(r"(package_)?ground|package_imu|.*_point\d+(_contact)?")
"""Names of geoms, sites and pairs that the package adds."""

DAMPING = 0.03
"""Servo damping by stiffness where a description gives none, s."""

SMALLEST, LARGEST = 1e-6, 1e6
"""Sizes of the numbers of a YAML, N m and the like."""

TIMESTEPS_S = 1e-6, 1.0
"""Time steps of a model; a physics may take shorter ones than the longest."""

SLACK_DEG = 1.0
"""Largest distance of a posture beyond the range of a joint, degrees."""

JOINT, GEOM = mujoco.mjtJoint, mujoco.mjtGeom


def _numbers(given: Any) -> Any:
    """Return numbers by patterns of joint names; a single number is for all joints."""
    numbers = given if isinstance(given, dict) else {".*": given}
    if any(isinstance(x, bool) or not isinstance(x, (int, float)) or not isfinite(x) for x in numbers.values()):
        raise ValueError(f"a number, or numbers by patterns of joints' names, are needed, got {given!r}")
    if odd := [x for x in numbers.values() if x and not SMALLEST <= abs(x) <= LARGEST]:
        raise ValueError(f"a number must be 0 or from {SMALLEST:g} to {LARGEST:g} in size, got {odd[0]:g}")
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

REACH, LIFT = 0.6, 0.4
"""Powers of the factor of `tipping` by which set-points reach and steps rise farther, from trainings of G1, T1 and
Apollo with the gains of their files (docs/robots.md)."""


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

    model: str = Field(description="the MJCF or a scene of it: a path from the YAML, or package:NAME/PATH")
    feet: list[str] = Field(min_length=1, description="geoms or bodies that stand on the ground")
    home: Posture = Field("", description="how it stands: a keyframe, or degrees by joint; by default all joints at 0")
    servo: DeclaredServo = Field(DeclaredServo.model_validate({}), description="gains of its joints' servo")
    torque: ByJoint | None = Field(None, description="largest torque by joint, N m; by default the model's")
    shares: ByJoint | None = Field(
        None, description="factors on action_scale, by joint; by default 1, or more where the servo is soft"
    )
    steps: float | None = Field(None, gt=0, le=10, description=f"{STEPS}; by default as soft as they are")
    rests: bool | None = Field(None, description=f"{RESTS}, as by default")
    turns: list[Annotated[float, Field(ge=0, le=1)]] = Field(
        [], description="phase, 0 to 1, at which each foot's swing begins; by default even"
    )
    mirror: dict[str, str] = Field({}, description="parts of names on the right, and what stands for them on the left")
    bend: float = Field(15.0, ge=0, lt=90, description=BEND)
    contacts: Literal["feet", "model"] = Field(
        "feet", description="what touches: the feet the ground and nothing else, or also all bodies as the model says"
    )
    cone: Literal["pyramidal", "elliptic"] = Field("pyramidal", description="friction cones; elliptic ones take longer")


class Declared(Robot):
    """A robot as its YAML and its MJCF describe it."""

    name: str = Field(description="path of the YAML, or the name of a robot that ships")
    content: str = Field("", description="digest of both files: a run takes no other robot of the same name")
    ground_geoms: tuple[str, ...] = listed("geoms of the feet; all that touch")
    torque: tuple[Annotated[float, Field(gt=0)], ...] = listed("largest torques, N m")
    stiffness: tuple[Annotated[float, Field(ge=0)], ...] = listed("of the servo, N m/rad")
    damping: tuple[Annotated[float, Field(ge=0)], ...] = listed("of the servo, N m s/rad")
    contacts: Literal["feet", "model"] = Field("feet", description="what touches")
    cone: Literal["pyramidal", "elliptic"] = Field("pyramidal", description="friction cones")

    @property
    def servo(self) -> Servo:
        return Servo(np.array(self.stiffness), np.array(self.damping))

    @property
    def setpoint_limits(self) -> Float[np.ndarray, "2 joints"]:
        return _limits(self.name, self.content)

    def _unchanged(self) -> dict[str, Any]:
        own = _read(find(self.name)).values
        return MOTION | {key: value for key, value in own.items() if key != "content"}

    def _upright(self) -> tuple["Source", mujoco.MjSpec, mujoco.MjModel]:
        """The files, and the MJCF with an upright trunk."""
        source = _read(find(self.name))
        spec = _load(source.model)[0]
        mjcf.set_upright(spec, source.turn)
        return source, spec, mjcf.checked(spec.compile)[0]

    def in_file(self) -> tuple[mujoco.MjSpec, str]:
        source, spec, model = self._upright()
        felt = np.isin(np.arange(model.ngeom), [model.pair_geom1, model.pair_geom2])
        felt |= (model.geom_contype | model.geom_conaffinity) != 0
        if not (felt & (model.geom_type == GEOM.mjGEOM_PLANE)).any():
            add_ground(spec, model, soles_of(model, self.feet, self.ground_geoms))
        for sensor in spec.sensors:
            spec.delete(sensor)
        spec.worldbody.first_body().add_site(mjcf.PLAIN, name="package_imu")
        add_imu(spec, "package_imu")
        return spec, source.key

    def differences(self, timestep: float | None = None) -> tuple[Difference, ...]:
        source = _read(find(self.name))
        _, file, notes = _load(source.model)
        found = differences(file, mjcf.checked(self.spec(timestep).compile)[0], self, source.turn, source.key)
        return (*found, *notes)

    def spec(self, timestep: float | None = None) -> mujoco.MjSpec:
        source, spec, model = self._upright()
        for key in ("torque", "stiffness", "damping"):
            if (count := len(getattr(self, key))) != len(source.joints):
                raise InputError(f"{key}: must hold {len(source.joints)} numbers, got {count}")
        data = mujoco.MjData(model)
        for joint, angle in zip(source.joints, np.radians(self.home or [0.0] * len(source.joints)), strict=True):
            data.qpos[model.joint(joint).qposadr[0]] = angle
        for motor in np.flatnonzero(np.isin(model.actuator_trntype, ON_JOINTS)):
            row, squared = model.actuator_trnid[motor, 0], model.actuator_gear[motor, 0] ** 2
            joint, dof = spec.joint(model.joint(row).name), model.jnt_dofadr[row]
            if any(joint.springdamper):  # the compiler would put its own damping in the place of any other
                joint.stiffness[0], joint.damping[0] = model.jnt_stiffness[row], model.dof_damping[dof]
                joint.springdamper = 0, 0
            joint.armature += squared * model.actuator_armature[motor]
            joint.damping[0] += squared * model.actuator_damping[motor]
        limits = np.minimum(self.torque, joint_limits(model, source.joints)).tolist()
        for joint in map(spec.joint, source.joints):
            if not joint.actgravcomp:  # else the limit is one of motor and compensation together
                joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
        mujoco.mj_kinematics(model, data)
        balls = [
            (spec.body(model.body(model.geom_bodyid[contact.two]).name), contact, *ball)
            for contact in soles_of(model, self.feet, self.ground_geoms)
            for ball in balls_of(model, data, contact.two)
        ]
        strip(spec, self.contacts == "feet")
        spec.option.cone = getattr(mujoco.mjtCone, f"mjCONE_{self.cone.upper()}")
        spec.option.timestep = timestep or model.opt.timestep
        looks = {"mass": 0.0, "contype": 0, "conaffinity": 0, "group": 3, "type": GEOM.mjGEOM_SPHERE}
        plane = looks | {"type": GEOM.mjGEOM_PLANE, "group": 0, "size": (0.0, 0.0, 0.05), "rgba": (0.9,) * 4}
        ground = spec.worldbody.add_geom(mjcf.PLAIN, name="ground", **plane)
        for index, (foot, contact, place, radius) in enumerate(balls):
            ball = foot.add_geom(mjcf.PLAIN, name=f"{foot.name}_point{index}", size=(radius, 0, 0), pos=place, **looks)
            pair = spec.add_pair(mjcf.PLAIN, name=ball.name, geomname1=ground.name, geomname2=ball.name)
            pair.condim, pair.friction[:2], pair.margin = min(contact.condim, 3), contact.friction, contact.margin
            pair.solref, pair.solimp, pair.solreffriction = contact.solref, contact.solimp, contact.rubbing
        spec.worldbody.first_body().add_site(mjcf.PLAIN, name="package_imu", group=3)
        add_motors_and_imu(spec, dict(zip(source.joints, limits, strict=True)), "package_imu")
        return spec


class Source(NamedTuple):
    """Content of the two files of a robot."""

    model: str
    joints: tuple[str, ...]
    turn: mjcf.Quat
    """Orientation of the trunk at home in the file."""
    key: str
    """Keyframe of the posture; none: it is given by angles."""
    limits: Float[np.ndarray, "2 joints"]
    """Lowest and highest set-points, rad."""
    values: dict[str, Any]
    """Fields of `Declared`."""


def make_declared(name: str, **values: Any) -> Declared:
    """Build the robot of a YAML, or one that ships, by name.

    Raises:
      InputError: no such file, an unknown key, a value that does not fit the model, or another content than that asked
        for, in one sentence that names the file.
    """
    path, stored = find(name), "content" in values  # in the config of a run, with all that is not as by default
    source = _read(path)
    asked = values.get("content") or source.values["content"]
    if asked != source.values["content"]:
        now = f"sweep, play and evaluate take it as it is now by --set task.robot={name}"
        raise InputError(f"robot: {name} has changed since this run, its YAML or a file of its model; {now}.")
    values = source.values | values | {"name": name if is_shipped(name) else str(path)}
    try:
        robot = Declared.model_validate(values)
        if stored or MOTION.keys() <= values.keys() or not robot.points:
            return robot
        from humanoid_mjx.robot.holding import MOST_FACTOR, tipping  # scipy.linalg is slow to import

        factor, kinds = tipping(robot)[0], len(set(robot.kinds.tolist()))
        if factor <= 1:
            return robot
        found: dict[str, Any] = {"rests": False}
        if factor <= MOST_FACTOR:
            found |= {"shares": (two_digits(factor**REACH),) * kinds, "steps": two_digits(factor**LIFT)}
        return Declared.model_validate(found | values)
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
        model = mjcf.place_of(declared.model, path)
        if "\0" in declared.model or model.is_dir():
            raise InputError(f"{path.name}: model must be the path of an MJCF, got {declared.model!r}.")
        return _understood(path, text, str(model), mjcf.content_of(data, model))
    except pydantic.ValidationError as error:
        raise InputError(f"{path.name}: {sentence(error, '', Declaration)}") from error
    except OSError as error:
        raise InputError(f"{path.name}: {error.filename} cannot be read: {error.strerror}.") from error


@lru_cache
def _limits(name: str, content: str) -> Float[np.ndarray, "2 joints"]:
    """The limits of set-points of a robot, by the name and the digest of its files; tracing asks often."""
    return _read(find(name)).limits


@lru_cache
def _understood(path: Path, text: str, file: str, content: str) -> Source:
    """Parse both files; `content` is their digest."""
    data = parse_yaml(text, path.name)
    declared = Declaration(**data)
    try:
        spec, model, _ = _load(file)
        joints = driven(model)
        home = _home(declared.home, model, joints)
        key = declared.home if isinstance(declared.home, str) else ""
        turn = mjcf.turn_at_home(model, key)
        torque, stiffness, damping = own_drives(model, joints)
        torque = np.minimum(_by_joint("torque", declared.torque, joints, torque), joint_limits(model, joints))
        if wrong := [joint for joint, limit in zip(joints, torque, strict=True) if not 0 < limit < inf]:
            lacks = "the model has no limit" if torque[joints.index(wrong[0])] else "the limit is 0"
            example = f"{{{mjcf.pattern(wrong[:1])}: 20}}"
            raise InputError(f"torque: {lacks} for {wrong[0]}; write its N m as torque: {example}")
        servo, stiffness = declared.servo, np.where(np.isnan(stiffness), torque, stiffness)
        stiffness = _by_joint("servo.stiffness", servo.stiffness, joints, stiffness)
        damping = np.where(np.isnan(damping) | (servo.stiffness is not None), DAMPING * stiffness, damping)
        damping = _by_joint("servo.damping", servo.damping, joints, damping)
        feet, geoms = _feet(declared.feet, spec)
        soles_of(model, feet, geoms)
        turns, order = tuple(declared.turns), sorted(range(len(feet)), key=lambda k: model.body(feet[k]).id)
        if order != sorted(order) and len(turns) in (0, len(feet)):  # MuJoCo sorts contacts in the bodies' order
            turns = turns or tuple(k / len(feet) for k in range(len(feet)))
            feet, turns = (tuple(part[k] for k in order) for part in (feet, turns))
        mirror = tuple(declared.mirror.items())
        parts = [part.name for part in (*spec.bodies, *spec.joints, *spec.geoms)]
        if idle := [old for old in declared.mirror if not old or not any(old in part for part in parts)]:
            raise InputError(f"mirror: no body, joint or geom has {idle[0]!r} in its name")
        values = {"feet": feet, "home": tuple(home), "turns": turns, "mirror": mirror, "bend": declared.bend}
        values |= {"torque": tuple(torque), "stiffness": tuple(stiffness), "damping": tuple(damping)}
        values |= {"ground_geoms": geoms, "contacts": declared.contacts, "cone": declared.cone, "content": content}
        if declared.shares is not None:
            shares = _by_joint("shares", declared.shares, joints, np.ones(len(joints)))
            first = np.minimum(images("joints", joints, mirror, joints), np.arange(len(joints))).tolist()
            if uneven := [joint for k, joint in enumerate(joints) if shares[k] != shares[first[k]]]:
                raise InputError(f"shares: {uneven[0]} and its mirror image must have the same")
            values["shares"] = tuple(shares[sorted(set(first))].tolist())  # by kind of joint
        values |= {key: value for key in ("steps", "rests") if (value := getattr(declared, key)) is not None}
    except InputError as error:
        message = str(error).rstrip(".")
        raise InputError(f"{path.name}: {message}.") from error
    return Source(file, joints, turn, key, setpoint_limits(model, joints), values)


def _load(file: str) -> tuple[mujoco.MjSpec, mujoco.MjModel, list[Difference]]:
    """Return the spec of an MJCF, every body named, its model, and what was noted."""
    what = f"model: {Path(file).name} is no MJCF that MuJoCo takes"
    (spec, missing), noted = mjcf.checked(lambda: mjcf.read_spec(file), what)
    mjcf.name_bodies(spec)
    ours = (part.name for part in (*spec.geoms, *spec.sites, *spec.pairs) if OWN.fullmatch(part.name))
    if taken := [name for name in ours if (plane := spec.geom(name)) is None or plane.type != GEOM.mjGEOM_PLANE]:
        raise InputError(f"model: the package adds an element of the name {taken[0]!r}; rename that of the MJCF")
    model, warned = mjcf.checked(spec.compile, what)
    bodies = [body.name for body in spec.worldbody.bodies]
    free = [joint for joint in spec.joints if joint.type == JOINT.mjJNT_FREE]
    if len(bodies) != 1 or len(free) != 1 or free[0].parent.name != bodies[0]:
        alone = f"{bodies[0]} has none; write <freejoint/> into it" if len(bodies) == 1 else "leave one in the file"
        there = f"the bodies are: {', '.join(bodies) or 'none'}; {alone}"
        raise InputError(f"model: a robot is one body with a free joint, and its child bodies; {there}")
    if fault := bad_timestep(spec.option.timestep):
        raise InputError(f"model: {fault}")
    for what, _ in mjcf.no_numbers(model):
        raise InputError(f"model: {what} must be {mjcf.A_NUMBER}")
    if not mjcf.falls(model):
        raise InputError(f"model: no gravity pulls down in {Path(file).name}; write {mjcf.GRAVITY}")
    if any("NaN" in words for words in noted):  # MuJoCo takes a mass of NaN for none
        raise InputError(f"model: {Path(file).name} holds a NaN; write a number in its place")
    notes = [Difference("MuJoCo warns", words, "") for words in dict.fromkeys((*noted, *warned))]
    return spec, model, notes + [Difference(f"{missing} meshes", "for looks", "none: no such files")] * bool(missing)


def bad_timestep(seconds: float) -> str | None:
    """Return the fault of a model's time step, or None."""
    shortest, longest = TIMESTEPS_S
    if shortest <= seconds <= longest:
        return None
    return f"<option timestep> is {seconds:g}; it must be from {shortest:g} to {longest:g} s"


def _home(home: Any, model: mujoco.MjModel, joints: Sequence[str]) -> Float[np.ndarray, " joints"]:
    """Angles of the joints, degrees."""
    keys, angles = [key for index in range(model.nkey) if (key := model.key(index).name)], np.zeros(len(joints))
    if isinstance(home, dict):
        angles = _by_joint("home", home, joints, angles, least=-inf)
    elif home and home not in keys:
        raise InputError(f"home: the model has no keyframe {home!r}; {known(home, keys) if keys else 'it has none'}")
    elif home:
        angles = np.degrees([model.key(home).qpos[model.joint(joint).qposadr[0]] for joint in joints])
    default = "" if home else "; without this key all joints are at 0"
    rows = [model.joint(joint).id for joint in joints]
    ranges = np.where(model.jnt_limited[rows, None], model.jnt_range[rows], [-inf, inf]).T
    for what, ends in {"its range": ranges, "set-points of its actuators": setpoint_limits(model, joints)}.items():
        low, high = np.degrees(ends)
        for k in np.flatnonzero((angles < low - SLACK_DEG) | (angles > high + SLACK_DEG)).tolist():
            within = f"{low[k]:g} to {high[k]:g}{default}"
            raise InputError(f"home: {joints[k]} at {angles[k]:g} degrees is beyond {what}, {within}")
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
        geoms += [geom.name] if geom is not None else []
    if geoms and len(geoms) != len(names):
        raise InputError("feet: name geoms or bodies, not some of each")
    if twice := [name for name in names if names.count(name) > 1]:
        raise InputError(f"feet: {twice[0]!r} stands there twice")
    return tuple(dict.fromkeys(bodies)), tuple(geoms)


def _by_joint(
    key: str, given: dict[str, float] | None, joints: Sequence[str], otherwise: np.ndarray, least: float = 0.0
) -> Float[np.ndarray, " joints"]:
    """Numbers of the joints from those by patterns, `otherwise` where none fits. Raise an InputError if a pattern
    fits no joint or its number is below `least`."""
    values = otherwise.astype(float)
    for pattern, number in reversed((given or {}).items()):
        fits = [bool(re.fullmatch(pattern, joint)) for joint in joints]
        if not any(fits):
            raise InputError(f"{key}: {pattern!r} fits no joint; {known(pattern, joints)}")
        if number < least:
            raise InputError(f"{key}: must be at least {least:g}, got {number:g}")
        values[fits] = number
    return values
