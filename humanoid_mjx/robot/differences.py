# pyright: reportAttributeAccessIssue=false
"""Everything in which a robot differs from its MJCF: names, values in the file, values here."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np

from humanoid_mjx.robot.description import Robot
from humanoid_mjx.robot.mjcf import checked
from humanoid_mjx.robot.motors import BIAS, ON_JOINTS, acting, bounds, gains, motor_limits, motors_on
from humanoid_mjx.robot.touching import FLAGS, GROUND, Touching, kind_of, named, soles_of, touching, word

HEADINGS = "differs from the MJCF", "in the file", "here"
ENUMS = {"cone": mujoco.mjtCone, "integrator": mujoco.mjtIntegrator, "solver": mujoco.mjtSolver}


class Difference(NamedTuple):
    """One thing in which a robot differs from its MJCF."""

    name: str
    in_file: str
    here: str


def differences_of(task: Any) -> tuple[Difference, ...]:
    """Return those of a task's robot with the task's time step; none where the task has no robot."""
    robot = getattr(task, "robot", None)
    return robot.differences(getattr(task, "timestep", None)) if isinstance(robot, Robot) else ()


def differences(
    file: mujoco.MjModel, here: mujoco.MjModel, robot: Any, turn: Sequence[float], key: str
) -> list[Difference]:
    """Compare the compiled model of an MJCF with that of its robot, a `Declared`. `turn`: orientation of the trunk at
    home in the file, a quaternion. `key`: the keyframe of its posture, if any."""
    soles = soles_of(file, robot.feet, robot.ground_geoms)
    pairs = touching(file)
    rows = [row for sole in soles for row in _of_sole(file, sole, pairs)]
    for name in sorted(name for name in dir(file.opt) if not name.startswith("_")):
        words = [_option(name, np.ravel(getattr(model.opt, name))) for model in (file, here)]
        rows += [("", f"option {name}", *words)] if words[0] != words[1] else []
    grounded = all(sole.one >= 0 for sole in soles)
    judge = file if grounded else checked(robot.in_file()[0].compile)[0]  # with a ground, where the file has none
    kept = {sole.two for sole in soles_of(judge, robot.feet, robot.ground_geoms) if sole.one >= 0}
    rows += [*_of_contacts(judge, kept, robot.contacts == "feet"), *_of_actuators(file, here, robot.servo)]
    if turn[0] != 1.0:
        angle = 2 * np.degrees(np.arccos(min(abs(turn[0]), 1.0)))
        rows.append((file.body(1).name, "frame of", f"turned by {angle:.3g} degrees at home", "upright at home"))
    rows += _of_keyframe(file, robot.joints, key) if key else ()
    groups: dict[tuple[str, ...], list[str]] = {}
    for element, *row in rows:
        groups.setdefault(tuple(row), []).append(element)
    more = {row: f" and {len(names) - 1} more" * (len(names) > 1) for row, names in groups.items()}
    return [Difference(f"{row[0]} {names[0]}{more[row]}".strip(), *row[1:]) for row, names in groups.items()]


Row = tuple[str, str, str, str]
"""An element of the model; what differs of it; the value in the file, and here."""


def _option(name: str, value: np.ndarray) -> str:
    if name == "disableflags":
        bits = [bit for bit in FLAGS.__members__.values() if "DSBL_" in bit.name and int(bit) & int(value[0])]
        return ", ".join(word(FLAGS, bit) for bit in bits) or "none"
    return word(ENUMS[name], value[0]) if name in ENUMS else " ".join(f"{part:g}" for part in value)


def _of_keyframe(file: mujoco.MjModel, driven: Sequence[str], key: str) -> Iterator[Row]:
    """Joints without a motor that the keyframe of the posture moves: episodes begin with them as they are drawn."""
    data = mujoco.MjData(file)
    mujoco.mj_resetDataKeyframe(file, data, file.key(key).id)
    for joint in map(file.joint, np.flatnonzero(file.jnt_type != mujoco.mjtJoint.mjJNT_FREE).tolist()):
        if joint.name not in driven and not np.allclose(data.joint(joint.id).qpos, joint.qpos0, atol=1e-6):
            yield joint.name or str(joint.id), "home of", "as the keyframe moves it", "as drawn: it has no motor"


def _of_sole(file: mujoco.MjModel, contact: Touching, pairs: Sequence[Touching]) -> Iterator[Row]:
    kind, name = kind_of(file, contact.two), named(file, contact.two)
    if contact.one < 0:
        here = f"the plane z = 0; friction {contact.friction[0]:g}, solref and solimp of the shape"
        body = file.geom_bodyid[contact.two]
        others = any(kind_of(file, pair.one) == "plane" and file.geom_bodyid[pair.two] == body for pair in pairs)
        yield name, "ground of", "no plane that it can touch" + ", as other shapes of its body can" * others, here
    if kind != "sphere":
        yield name, "shape of", kind, "2 balls, in its ends" if kind == "capsule" else "4 balls, in its corners"
    if contact.condim > 3:
        yield name, "condim of", f"{contact.condim}: resists twisting or rolling", "3: resists sliding"
    both = [geom for geom in (contact.one, contact.two) if geom >= 0]
    if contact.surplus and any(map(np.any, (file.geom_adhesion[both], file.geom_surfacevel[both], file.pair_adhesion))):
        yield name, "adhesion or surfacevel of", "set", "none"


def _of_contacts(file: mujoco.MjModel, kept: set[int], feet_only: bool) -> Iterator[Row]:
    """Contacts that go: with `feet_only` all but those of the feet with the ground, else those with the world."""
    for pair in touching(file):
        both = [pair.one, pair.two]
        static = (file.body_weldid[file.geom_bodyid[both]] == 0).any()
        if (static and not kept.intersection(both)) or (feet_only and not static):
            names = [named(file, geom) for geom in both]
            says = "on the ground that --unmodified adds" if repr(GROUND) in names else "as the model says"
            yield " and ".join(names), "contact of", says, "none"


def _of_actuators(file: mujoco.MjModel, here: mujoco.MjModel, servo: Any) -> Iterator[Row]:
    for joint, limit, *gain in zip(here.actuator_trnid[:, 0], motor_limits(here), *servo, strict=True):
        name, motor = here.joint(int(joint)).name, f"motor of {limit:g} N m"
        found = " + ".join(_of_motor(file, motor) for motor in motors_on(file, file.joint(name).id)) or "none"
        if found != motor:
            yield name, "actuator of", found, "{}, servo of {:g} N m/rad, {:g} N m s/rad".format(motor, *gain)
    driven = [file.joint(here.joint(int(joint)).name).id for joint in here.actuator_trnid[:, 0]]
    kept = np.isin(file.actuator_trntype, ON_JOINTS) & np.isin(file.actuator_trnid[:, 0], driven)
    for motor in np.flatnonzero(~kept).tolist():
        kind = word(mujoco.mjtTrn, file.actuator_trntype[motor])
        yield repr(file.actuator(motor).name or motor), "actuator", f"drives a {kind}", "none"


def _of_motor(m: mujoco.MjModel, motor: Any) -> str:
    """An actuator in words; a plain torque motor is a "motor of 20 N m"."""
    (stiffness, damping), (low, high) = gains(m, motor), bounds(m, motor)
    kind = word(mujoco.mjtGain, m.actuator_gaintype[motor]).replace("fixed", "motor")
    kind = "position" if stiffness > 0 else "damper" if damping > 0 else kind
    limit = f"{high:g}" if low == -high else f"{low:g} to {high:g}"
    values = {"delay": m.actuator_delay[motor], "dampingpoly": np.abs(m.actuator_dampingpoly[motor]).max()}
    values["bias"] = m.actuator_biasprm[motor, 0] * (m.actuator_biastype[motor] == BIAS.mjBIAS_AFFINE)
    filtered = f"{word(mujoco.mjtDyn, m.actuator_dyntype[motor])} of {m.actuator_dynprm[motor, 0]:g} s"
    parts = [f"{kind} of {limit} N m" if np.isfinite(high - low) else f"{kind} without limit"]
    parts += [f"{stiffness:g} N m/rad", f"{damping:g} N m s/rad"] * bool(stiffness or damping)
    parts += [filtered] * bool(m.actuator_dyntype[motor])
    words = ", ".join(parts + [f"{name} {value:g}" for name, value in values.items() if value])
    return words if acting(m)[motor] else f"disabled {words}"
