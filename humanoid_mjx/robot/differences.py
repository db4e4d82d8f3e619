# pyright: reportAttributeAccessIssue=false
"""Everything in which a robot differs from its MJCF: names, values in the file, values here."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np

from humanoid_mjx.robot.description import Robot, motor_limits, motors_on
from humanoid_mjx.robot.motors import ON_JOINTS, bounds, gains
from humanoid_mjx.robot.soles import Sole
from humanoid_mjx.robot.touching import kind_of, named, touching

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
    file: mujoco.MjModel, here: mujoco.MjModel, robot: Any, turn: Sequence[float], soles: Sequence[Sole]
) -> list[Difference]:
    """Compare the compiled model of an MJCF with that of its robot.

    Args:
      file: the unmodified model.
      here: the robot's own.
      robot: a `Declared`.
      turn: orientation of the trunk at home in the file, a quaternion.
      soles: the shapes of the file on which the robot stands.
    """
    groups: dict[Difference, list[str]] = {}
    kept = {sole.geom for sole in soles if sole.contact.one >= 0}
    for element, row in [
        *(row for sole in soles for row in _of_sole(file, sole)),
        *(("", row) for row in _of_options(file, here)),
        *_of_contacts(file, kept, robot.contacts == "feet"),
        *_of_actuators(file, here, robot.servo),
    ]:
        groups.setdefault(row, []).append(element)
    if turn[0] != 1.0:
        angle = 2 * np.degrees(np.arccos(min(abs(turn[0]), 1.0)))
        groups[Difference("frame of", f"turned by {angle:.3g} degrees at home", "upright at home")] = [
            file.body(1).name
        ]
    more = {row: f" and {len(names) - 1} more" * (len(names) > 1) for row, names in groups.items()}
    return [row._replace(name=f"{row.name} {names[0]}{more[row]}".strip()) for row, names in groups.items()]


Row = tuple[str, Difference]
"""An element of the model, and what differs of it and of others."""


def _of_options(file: mujoco.MjModel, here: mujoco.MjModel) -> Iterator[Difference]:
    for name in sorted(name for name in dir(file.opt) if not name.startswith("_")):
        values = [np.ravel(getattr(model.opt, name)) for model in (file, here)]
        if not np.array_equal(values[0], values[1]):
            words = [" ".join(f"{value:g}" for value in each) for each in values]
            if name in ENUMS:
                words = [ENUMS[name](int(value[0])).name.split("_")[1].lower() for value in values]
            if name == "disableflags":
                flags = [bit for bit in mujoco.mjtDisableBit.__members__.values() if "DSBL_" in bit.name]
                each = [[bit.name[7:].lower() for bit in flags if int(bit) & int(value[0])] for value in values]
                words = [", ".join(names) or "none" for names in each]
            yield Difference(f"option {name}", *words)


def _of_sole(file: mujoco.MjModel, sole: Sole) -> Iterator[Row]:
    contact, kind, name = sole.contact, kind_of(file, sole.geom), named(file, sole.geom)
    if contact.one < 0:
        here = f"the plane z = 0; friction {contact.friction[0]:g}, solref and solimp of the shape"
        yield name, Difference("ground of", "no plane that it can touch", here)
    if kind != "sphere":
        yield (
            name,
            Difference("shape of", kind, "2 balls, in its ends" if kind == "capsule" else "4 balls, in its corners"),
        )
    if contact.condim > 3:
        yield name, Difference("condim of", f"{contact.condim}: resists twisting or rolling", "3: resists sliding")
    both = [geom for geom in (contact.one, contact.two) if geom >= 0]
    acting = [getattr(file, f"geom_{what}", np.zeros(file.ngeom))[both] for what in ("adhesion", "surfacevel")]
    if contact.surplus and any(map(np.any, [*acting, getattr(file, "pair_adhesion", 0)])):
        yield name, Difference("adhesion or surfacevel of", "set", "none")


def _of_contacts(file: mujoco.MjModel, kept: set[int], feet_only: bool) -> Iterator[Row]:
    """Contacts that go: with `feet_only` all but those of the feet with the ground, else those with the world."""
    for pair in touching(file):
        both = [pair.one, pair.two]
        static = (file.body_weldid[file.geom_bodyid[both]] == 0).any()
        if (static and not kept.intersection(both)) or (feet_only and not static):
            yield (
                " and ".join(named(file, geom) for geom in both),
                Difference("contact of", "as the model says", "none"),
            )


def _of_actuators(file: mujoco.MjModel, here: mujoco.MjModel, servo: Any) -> Iterator[Row]:
    for joint, limit, *gain in zip(here.actuator_trnid[:, 0], motor_limits(here), *servo, strict=True):
        name, motor = here.joint(int(joint)).name, f"motor of {limit:g} N m"
        found = " + ".join(_of_motor(file, motor) for motor in motors_on(file, file.joint(name).id)) or "none"
        if found != motor:
            yield (
                name,
                Difference("actuator of", found, "{}, servo of {:g} N m/rad, {:g} N m s/rad".format(motor, *gain)),
            )
    for motor in np.flatnonzero(~np.isin(file.actuator_trntype, ON_JOINTS)).tolist():
        kind = mujoco.mjtTrn(int(file.actuator_trntype[motor])).name.removeprefix("mjTRN_").lower()
        yield repr(file.actuator(motor).name), Difference("actuator", f"drives a {kind}", "none")


def _of_motor(m: mujoco.MjModel, motor: Any) -> str:
    """An actuator in words; a plain torque motor is a "motor of 20 N m"."""
    (stiffness, damping), (low, high) = gains(m, motor), bounds(m, motor)
    gain = mujoco.mjtGain(int(m.actuator_gaintype[motor])).name.removeprefix("mjGAIN_").lower()
    kind = "position" if stiffness > 0 else "damper" if damping > 0 else {"fixed": "motor"}.get(gain, gain)
    limit = f" of {high:g} N m" if low == -high else f" of {low:g} to {high:g} N m"
    parts = [f"{kind}" + (limit if np.isfinite(high - low) else " without limit")]
    parts += [f"{stiffness:g} N m/rad", f"{damping:g} N m s/rad"] if stiffness or damping else []
    if m.actuator_dyntype[motor] != mujoco.mjtDyn.mjDYN_NONE:
        kind = mujoco.mjtDyn(int(m.actuator_dyntype[motor])).name.removeprefix("mjDYN_").lower()
        parts.append(f"{kind} of {m.actuator_dynprm[motor, 0]:g} s")
    for name in ("delay", "dampingpoly"):
        if np.any(value := getattr(m, f"actuator_{name}", np.zeros(m.nu))[motor]):
            parts.append(f"{name} {np.ravel(value)[0]:g}")
    offset = m.actuator_biasprm[motor, 0] if m.actuator_biastype[motor] == mujoco.mjtBias.mjBIAS_AFFINE else 0.0
    return ", ".join(parts + [f"bias {offset:g}"] * bool(offset))
