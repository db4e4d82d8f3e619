# pyright: reportAttributeAccessIssue=false
"""The description of a robot, which physics, tasks, evaluation and rendering share.

A robot is a MuJoCo model with a torque motor for each driven joint, and the facts that a model does not hold: its feet,
its posture, and the mirror image of each side. Everything else follows from these. Thresholds of tasks are shares of
the robot's weight and of the length of its legs, so that they fit every robot.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import mujoco
import numpy as np
import pydantic
from jaxtyping import Bool, Float, Int
from pydantic import Field

from humanoid_mjx.robot.mirror import images
from humanoid_mjx.robot.mjcf import PLAIN, checked
from humanoid_mjx.robot.motors import motor_limits
from humanoid_mjx.spec import InputError, Named

AXIAL = np.array([-1.0, 1.0, -1.0])
"""Image of an axis of rotation in the plane of symmetry, x forward and z up."""


class Build(NamedTuple):
    """Measures of two legs built as the lower body's: hip pitch, yaw and roll about one point, knee, ankle."""

    hip_offset: float
    """From the middle of the body to a hip, sideways, m."""
    reach: float
    """From a hip to the ankle under it at home, m."""
    lean: float
    """Pitch of the hips at home, rad."""


class Servo(NamedTuple):
    """Gains of a servo of the joints' positions."""

    stiffness: Float[np.ndarray, " joints"]
    """N m/rad"""
    damping: Float[np.ndarray, " joints"]
    """N m s/rad"""


BEND = "bend of legs at home, as degrees of hip pitch: a gait's `lift` adds to it and so shortens two equal links"

STEPS = "factor on a gait's `lift` and `sway`: soft joints do not get as far as they are told"
RESTS = "stand still when told to stand; false: step on the spot, since it would tip over"
MOTION: dict[str, Any] = {"shares": (), "steps": 1.0, "rests": True}
"""Default values of a robot beside its model."""


def listed(description: str) -> Any:
    """Declare a field that holds a list, empty by default."""
    return Field(default=(), strict=False, description=description)


class Robot(Named):
    """Base of robots: derive from it, give `spec`, and fields of your own for what can be chosen."""

    feet: tuple[str, ...] = listed("bodies that stand on the ground")
    home: tuple[float, ...] = listed("angles of the joints of the standing robot, degrees; all 0")
    turns: tuple[float, ...] = listed("phase, 0 to 1, at which each foot's swing begins; empty: evenly spaced")
    shares: tuple[float, ...] = listed("factors on action_scale, by kind of joint; empty: 1")
    mirror: tuple[tuple[str, str], ...] = listed("parts of names that change sides")
    bend: float = Field(default=15.0, ge=0, lt=90, description=BEND)
    steps: float = Field(default=1.0, gt=0, le=10, description=STEPS)
    rests: bool = Field(default=True, description=RESTS)

    def __hash__(self) -> int:
        return hash((type(self), *self.__dict__.values()))

    def spec(self, timestep: float | None = None) -> mujoco.MjSpec:
        """The robot as a MuJoCo model that can still be changed; `timestep`, s, is by default its own.

        The ground is a plane that balls of the feet feel by explicit pairs, foot by foot. A gyroscope and an
        accelerometer have those names.
        """
        raise NotImplementedError

    def in_file(self) -> tuple[mujoco.MjSpec, str]:
        """Return the robot as its file has it but for an upright frame of its trunk, with no sensors but those of
        `IMU`; and the keyframe with the controls of all actuators, if any."""
        return self.spec(), ""

    def differences(self, timestep: float | None = None) -> tuple[Any, ...]:
        """Everything in which the robot with this time step, s, differs from the file that describes it: a
        `robot.differences.Difference` each."""
        return ()

    @pydantic.model_serializer(mode="wrap")
    def _as_chosen(self, handler: Any) -> dict[str, Any]:
        """Serialise the name and the fields that differ from their defaults."""
        own = self._unchanged()
        return {key: value for key, value in handler(self).items() if getattr(self, key) != own.get(key)} | {
            "name": self.name
        }

    def _unchanged(self) -> Mapping[str, Any]:
        """Values of the fields that a config does not set."""
        return {key: field.default for key, field in type(self).model_fields.items()}

    @property
    def servo(self) -> Servo | None:
        """Gains of the robot's own servo; None: it has none."""
        return None

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model. It is shared: change copies only."""
        return compiled(self, None)

    @property
    def driven(self) -> Int[np.ndarray, " joints"]:
        """Index in the model of the joint that each motor drives.

        Raises:
          InputError: a motor drives a body, a site or a tendon.
        """
        m = self.model
        if len(odd := np.flatnonzero(m.actuator_trntype != mujoco.mjtTrn.mjTRN_JOINT)):
            name = m.actuator(int(odd[0])).name or str(odd[0])
            raise InputError(f'robot: motor {name!r} drives no joint; take a <motor> with joint="..."')
        return m.actuator_trnid[:, 0]

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints that motors drive, in the motors' order."""
        return tuple(self.model.joint(joint).name for joint in self.driven)

    @property
    def ranges_rad(self) -> Float[np.ndarray, "joints 2"]:
        return self.model.jnt_range[self.driven]

    @property
    def torque_limits(self) -> Float[np.ndarray, " joints"]:
        """Largest torque of each motor, N m."""
        return motor_limits(self.model)

    @property
    def setpoint_limits(self) -> Float[np.ndarray, "2 joints"]:
        """Lowest and highest set-points that the joints take, rad; infinite: any."""
        return np.repeat([[-np.inf], [np.inf]], len(self.joints), axis=1)

    @property
    def posture(self) -> Float[np.ndarray, " joints"]:
        """Angles of the joints of the standing robot, rad."""
        return np.radians(self.home) if self.home else np.zeros(len(self.joints))

    @property
    def phases(self) -> Float[np.ndarray, " feet"]:
        """Phase of a gait's period at which each foot's swing begins."""
        return np.array(self.turns) if self.turns else np.arange(len(self.feet)) / max(len(self.feet), 1)

    @property
    def points(self) -> int:
        """Number of points by which each foot touches the ground."""
        return len(ground_points(self.model)[0]) // max(len(self.feet), 1)

    @property
    def point_sensors(self) -> tuple[str, ...]:
        """Names of the sensors of the ground's force on each point of the feet."""
        return tuple(f"{self.model.geom(ball).name}_contact" for ball in ground_points(self.model)[0])

    @property
    def build(self) -> Build | None:
        """Measures of its legs; None: they are not built as the lower body's."""
        return None

    @property
    def mass(self) -> float:
        """kg"""
        return float(self.model.body_mass.sum())

    @property
    def leg_length(self) -> float:
        """Height of the hips above the ground at home, m."""
        return _stance(self).leg_length

    @property
    def start_height(self) -> float:
        """Height of the torso at the start of an episode, m: less than a hundredth of the legs above the ground."""
        return round(_stance(self).height + 0.007 * self.leg_length, 3)

    @property
    def soles(self) -> Float[np.ndarray, "points 3"]:
        """The lowest points of the feet at home, against the torso, m."""
        return _stance(self).soles

    @property
    def pace(self) -> float:
        """The speed of Froude number 1, the unit of speeds, m/s."""
        return float(np.sqrt(np.linalg.norm(self.model.opt.gravity) * self.leg_length))

    @property
    def kinds(self) -> Int[np.ndarray, " joints"]:
        """Kind of each joint, as an index: a joint and its mirror image share one."""
        order = self.joint_images[0]
        return np.unique(np.minimum(order, np.arange(len(order))), return_inverse=True)[1]

    @property
    def momentum(self) -> float:
        """Momentum of the robot at its `pace`, N s: the unit of pushes."""
        return self.mass * self.pace

    def force(self, share: float) -> float:
        """A share of the weight, N, rounded to two digits, as all thresholds are."""
        return two_digits(share * self.mass * float(np.linalg.norm(self.model.opt.gravity)))

    def length(self, share: float) -> float:
        """A share of the legs' length, m, to two digits."""
        return two_digits(share * self.leg_length)

    def speed(self, share: float) -> float:
        """A share of `pace`, m/s, to two digits."""
        return two_digits(share * self.pace)

    def square(self, share: float) -> float:
        """A share of the square of `pace`, m^2/s^2."""
        return two_digits(share * self.pace**2)

    @property
    def joint_images(self) -> tuple[Int[np.ndarray, " joints"], Float[np.ndarray, " joints"]]:
        """Index of each joint's mirror image, and the sign of the angle there."""
        return _joint_images(self)

    @property
    def foot_images(self) -> Int[np.ndarray, " feet"]:
        """Index of each foot's mirror image."""
        return images("feet", self.feet, self.mirror, _names(self.model))

    @property
    def alternates(self) -> bool:
        """True if each foot swings half a period after its mirror image, as a `symmetric` task needs."""
        later = np.mod(self.phases[self.foot_images] - self.phases, 1.0)
        return bool(self.mirror) and np.allclose(later, 0.5)

    @property
    def foot_pairs(self) -> Int[np.ndarray, "pairs 2"]:
        """Pairs of feet on the ground that are each other's mirror images, the right foot first."""
        if not self.points:
            return np.empty((0, 2), int)
        data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, data)
        left = [data.body(foot).xpos[1] for foot in self.feet]
        pairs = [(one, other) for one, other in enumerate(self.foot_images) if left[one] < left[other]]
        return np.array(pairs, int).reshape(-1, 2)

    @pydantic.model_validator(mode="after")
    def _fits_its_model(self) -> "Robot":
        if (self.model.actuator_trntype != mujoco.mjtTrn.mjTRN_JOINT).any():
            return self  # each physics refuses it, and names all motors
        kinds = int(self.kinds.max(initial=-1)) + 1
        for key, count in {"home": len(self.joints), "turns": len(self.feet), "shares": kinds}.items():
            if (values := getattr(self, key)) and len(values) != count:
                raise ValueError(f"{key} must hold {count} numbers, got {len(values)}")
        balls, _ = ground_points(self.model)
        names = [self.model.body(self.model.geom_bodyid[ball]).name for ball in balls]
        if self.feet and names != [foot for foot in self.feet for _ in range(self.points)]:
            each = "a ball gives one, a capsule two, a box or mesh four; name geoms that give each foot as many"
            raise ValueError(f"feet must have equally many balls that feel the ground, got {names}: {each}")
        if self.feet:
            _stance(self)
            images("feet", self.feet, self.mirror, _names(self.model))
        return self


IMU = "gyroscope", "accelerometer"
"""Names of the sensors of the torso."""


@lru_cache
def compiled(robot: Robot, timestep: float | None) -> mujoco.MjModel:
    """The robot's model with this time step, s; also within jit."""
    if (plain := robot.model_copy(update=MOTION)) != robot:
        return compiled(plain, timestep)  # these are no part of the model
    with jax.ensure_compile_time_eval():
        return checked(sensing_spec(robot, timestep).compile)[0]


def sensing_spec(robot: Robot, timestep: float | None) -> mujoco.MjSpec:
    """The robot's model with a sensor of the force on each ball that a plane feels by an explicit pair."""
    spec = robot.spec(timestep)
    for pair in spec.pairs:
        one, two = sorted((spec.geom(pair.geomname1), spec.geom(pair.geomname2)), key=lambda geom: int(geom.type))
        if one.type == mujoco.mjtGeom.mjGEOM_PLANE:
            name, zone = f"{two.name}_contact", (1.5 * two.size[0] + 0.5 * pair.margin, 0.0, 0.0)
            two.parent.add_site(PLAIN, name=name, pos=two.pos, size=zone, group=3)
            site = {"objtype": mujoco.mjtObj.mjOBJ_SITE, "objname": name}
            spec.add_sensor(name=name, type=mujoco.mjtSensor.mjSENS_TOUCH, **site)
    return spec


def add_motors_and_imu(spec: mujoco.MjSpec, limits: Mapping[str, float], site: str) -> None:
    """Add a torque motor for each of these joints, with its largest torque, N m, and at a site the sensors of `IMU`."""
    for joint, limit in limits.items():
        motor = spec.add_actuator(PLAIN, name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
        motor.ctrllimited, motor.ctrlrange = mujoco.mjtLimited.mjLIMITED_TRUE, (-limit, limit)
    add_imu(spec, site)


def add_imu(spec: mujoco.MjSpec, site: str) -> None:
    """Add the sensors of `IMU` at a site."""
    for name, kind in zip(IMU, (mujoco.mjtSensor.mjSENS_GYRO, mujoco.mjtSensor.mjSENS_ACCELEROMETER), strict=True):
        spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=site)


@lru_cache
def below(model: mujoco.MjModel) -> Float[np.ndarray, "bodies bodies"]:
    """1 where the column's body is the row's, or hangs on it."""
    rows = np.eye(model.nbody, dtype=np.float32)
    for index in range(model.nbody - 1, 0, -1):
        rows[model.body_parentid[index]] += rows[index]
    return rows


@lru_cache
def ground_points(model: mujoco.MjModel) -> tuple[Int[np.ndarray, " points"], Bool[np.ndarray, "points nv"]]:
    """The balls that a plane feels by explicit pairs: their geoms, and which velocities move them."""
    pairs = np.stack([model.pair_geom1, model.pair_geom2], axis=1)
    balls = pairs[model.geom_type[pairs[:, 0]] == mujoco.mjtGeom.mjGEOM_PLANE, 1]
    return balls, below(model)[model.dof_bodyid, model.geom_bodyid[balls][:, None]] > 0


def lowest(model: mujoco.MjModel, centers: Any) -> Any:
    """Return the lowest points of the balls of `ground_points`, m, from their centers: (points, 3) each."""
    return centers - model.geom_size[ground_points(model)[0], :1] * np.array([0.0, 0.0, 1.0])


class _Stance(NamedTuple):
    height: float
    leg_length: float
    soles: Float[np.ndarray, "points 3"]


@lru_cache
def _stance(robot: Robot) -> _Stance:
    """Heights of the torso and of the hips above the lowest point of the feet, at home."""
    model = robot.model
    balls, _ = ground_points(model)
    data = mujoco.MjData(model)
    data.qpos[model.jnt_qposadr[robot.driven]] = robot.posture
    mujoco.mj_kinematics(model, data)
    places = lowest(model, data.geom_xpos[balls])
    ground = places[:, 2].min() if len(balls) else 0.0
    height, hips = float(data.xpos[1, 2] - ground), []
    for foot, joint in zip(robot.feet, _hips(model, robot.feet), strict=True) if len(balls) else ():
        own = model.geom_bodyid[balls] == model.body(foot).id
        hips.append(data.xanchor[joint, 2] if joint >= 0 else data.xpos[1, 2])
        if joint >= 0 and own.any() and hips[-1] <= (low := places[own, 2].min()):
            raise InputError(
                f"home: the feet are above the hips: {foot} is {low - ground:.3g} m above the ground, its hip "
                f"{model.joint(joint).name!r} {hips[-1] - ground:.3g} m; give the angles of a robot that stands"
            )
    return _Stance(height, float(np.mean(hips) - ground) if hips else height, places - data.xpos[1])


def _hips(model: mujoco.MjModel, feet: Sequence[str]) -> list[int]:
    """The first joint of each foot's limb, which begins at the lowest body where the way to another foot branches off;
    -1 where the foot has no joint."""
    ends, hips = [model.body(foot).id for foot in feet], []
    shared = below(model)[:, ends].sum(axis=1)
    for end in ends:
        first = -1
        for lower, upper in pairwise(np.flatnonzero(below(model)[1:, end])[::-1] + 1):
            first = model.body_jntadr[lower] if model.body_jntnum[lower] else first
            if first >= 0 and shared[upper] > shared[lower]:
                break
        hips.append(int(first))
    return hips


@lru_cache
def _names(model: mujoco.MjModel) -> frozenset[str]:
    return frozenset(model.names.decode(errors="replace").split("\0"))


@lru_cache
def _joint_images(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    joints, model = robot.joints, robot.model
    order = images("joints", joints, robot.mirror, _names(model))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    axes = data.xaxis[robot.driven]
    signs = np.round(np.sum(axes * AXIAL * axes[order], axis=1), 6)
    if robot.mirror and len(wrong := np.flatnonzero(np.abs(signs) != 1)):
        one, other = joints[wrong[0]], joints[order[wrong[0]]]
        raise InputError(f"mirror: the axis of {one} is no image of that of {other}.")
    return order, signs if robot.mirror else np.ones(len(joints))


def two_digits(value: float) -> float:
    """Round a number to two digits."""
    return float(f"{value:.2g}")
