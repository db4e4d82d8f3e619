# pyright: reportAttributeAccessIssue=false
"""Everything of a MuJoCo model that a tree cannot represent.

`tests/mechanics/test_model_fields.py` lists each field of a model: computed, refused here, or without effect.
"""

import itertools
from collections.abc import Iterator, Sequence
from typing import Any, Literal, NamedTuple

import mujoco
import numpy as np

from humanoid_mjx.robot.description import below
from humanoid_mjx.robot.mjcf import A_NUMBER, any_of_rows, no_numbers, of_field
from humanoid_mjx.robot.touching import FLAGS, SURPLUS_WORDS, Touching, a, kind_of, named, pairs_of, touching, word

JOINT = mujoco.mjtJoint

GROUND_SHAPES = ("sphere", "capsule", "box", "cylinder", "ellipsoid")
"""Shapes that a plane of the world can push."""

PAIRS = list(itertools.combinations_with_replacement(("sphere", "capsule", "box"), 2))
"""Shapes that can push each other."""

MOST_PAIRS = 20_000
"""Pairs of shapes that may touch; each takes time in every step."""

PARALLEL = 1e-4
"""rad: MuJoCo 4 makes two contacts of capsules whose axes are nearer to parallel, the tree one. Of a capsule that is
parallel to a face of a box MuJoCo makes one or two, as numbers are rounded."""


class Fault(NamedTuple):
    """One thing that a tree cannot represent."""

    what: str
    """Words that end the sentence "the tree cannot represent"."""
    change: str
    """Change of the MJCF that removes the fault."""
    of: Literal["model", "contacts", "motors", "numbers"] = "model"
    """A robot's YAML replaces motors, and with `contacts: feet` all contacts but those of feet with the ground. Motors
    and numbers are faults for every physics."""


def faults(m: mujoco.MjModel, sensors: Sequence[str] = ()) -> list[Fault]:
    """All that keeps a compiled model from being a tree, of whose sensors these are read, beside `robot_faults`."""
    read, kinds = np.isin(np.arange(m.nsensor), [m.sensor(name).id for name in sensors]), mujoco.mjtSensor
    limited, wide = m.jnt_limited != 0, m.jnt_range[:, 1] - m.jnt_range[:, 0] > 2.0 * m.jnt_margin
    imu = np.isin(m.sensor_type, (kinds.mjSENS_GYRO, kinds.mjSENS_ACCELEROMETER))
    fields = UNUSED | {
        "body_mocapid": (m.body_mocapid >= 0, 'mocap="false"'),
        "jnt_range": (limited & ~wide, "a range wider than twice the margin"),
        "jnt_solref": (limited & _mixed_signs(m.jnt_solref), ONE_SIGN),
        "dof_solref": ((m.dof_frictionloss != 0) & _mixed_signs(m.dof_solref), ONE_SIGN),
        "sensor_type": (read & ~imu, "a gyro or an accelerometer"),
    }
    for name in ("cutoff", "delay", "interval"):
        used = any_of_rows(getattr(m, f"sensor_{name}", np.zeros(m.nsensor)))
        fields[f"sensor_{name}"] = read & used, f'{name}="0"'
    found = [Fault(what, change) for wrong, what, change in _of_structure(m, bool(sensors)) if wrong]
    contacts = [Fault(what, change, "contacts") for wrong, what, change in _of_contacts(m) if wrong]
    rubbing = (m.pair_dim > 1) & (m.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC) & any_of_rows(m.pair_solreffriction)
    contacts += _of_fields(m, {"pair_solreffriction": (rubbing, 'solreffriction="0 0"')}, "contacts")
    return found + _of_fields(m, fields) + contacts


def sensors_of(m: mujoco.MjModel, names: Sequence[str]) -> tuple[str, ...]:
    """Those of these sensors that a model has."""
    return tuple(name for name in names if mujoco.mj_name2id(m, mujoco.mjtObj.mjOBJ_SENSOR, name) >= 0)


def robot_faults(m: mujoco.MjModel) -> list[Fault]:
    """All that keeps a model from every physics: numbers that are not finite, and motors that are no torques of hinges
    or slides, at once and bounded alike both ways."""
    rows, kinds = np.arange(len(m.actuator_trntype)), np.append(m.jnt_type, 0)
    control, output = getattr(m, "actuator_ctrladr", rows), getattr(m, "actuator_outadr", rows)
    limited, clamped = m.actuator_forcelimited != 0, m.actuator_ctrllimited[control] != 0
    joint = np.where(m.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT, m.actuator_trnid[:, 0], -1)
    unclamped = bool(m.opt.disableflags & FLAGS.mjDSBL_CLAMPCTRL)
    servos, alike = "<motor> in the place of <position> and its like", "bounds that are the same both ways"
    motors: Fields = {
        "actuator_trntype": 'joint="..." in the place of a tendon, site or body',
        "actuator_gaintype": servos,
        "actuator_biastype": servos,
        "actuator_dyntype": 'dyntype="none"',
        "actuator_delay": 'delay="0"',
        "actuator_trnid": ((joint >= 0) & (kinds[joint] < int(JOINT.mjJNT_SLIDE)), "a hinge or a slide"),
        "actuator_gainprm": (m.actuator_gainprm[:, 0] == 0, "a gain that is not 0"),
        "actuator_gear": (m.actuator_gear[output, 0] == 0, "a gear that is not 0"),
        "actuator_ctrlrange": (clamped & (m.actuator_ctrlrange[control].sum(axis=1) != 0), alike),
        "actuator_forcerange": (limited & (m.actuator_forcerange.sum(axis=1) != 0), alike),
        "actuator_ctrllimited": (clamped & unclamped, 'clampctrl="enable"'),
    }
    odd = [Fault(what, A_NUMBER, "motors" if "actuator" in field else "numbers") for what, field in no_numbers(m)]
    return odd + _of_fields(m, motors)


Check = tuple[Any, str, str]
"""True if the model has it; what it is; what would have to change."""

Fields = dict[str, Any]
"""By field: what would have to change where it is not 0; or a mask of wrong entries, and what would have to change.
Older versions of MuJoCo lack some."""

TENDONS, ONE_SIGN = "no <tendon> that acts or is driven", "two positive values of solref, or none"
UNUSED: Fields = {
    "body_gravcomp": 'gravcomp="0"',
    "jnt_springyield": 'springyield="0"',
    "jnt_stiffnesspoly": "one number as stiffness",
    "dof_dampingpoly": "one number as damping",
    **dict.fromkeys(("actuator_damping", "actuator_dampingpoly", "actuator_armature"), "that of the joint instead"),
    **dict.fromkeys(("tendon_limited", "tendon_actfrclimited", "tendon_frictionloss", "tendon_armature"), TENDONS),
    **{f"tendon_{name}": TENDONS for name in ("stiffness", "stiffnesspoly", "damping", "dampingpoly")},
}
"""Fields that act where they are not 0, and that a tree does not compute."""


def _mixed_signs(solref: np.ndarray) -> Any:
    """True where MuJoCo takes its default instead, with a warning."""
    return (solref[..., 0] > 0) != (solref[..., 1] > 0)


def _of_fields(m: mujoco.MjModel, fields: Fields, of: Any = "model") -> list[Fault]:
    found = []
    for field, entry in fields.items():
        wrong, change = (getattr(m, field, ()), entry) if isinstance(entry, str) else entry
        if what := of_field(m, field, wrong):
            found.append(Fault(what, change, "motors" if "actuator" in field else of))
    return found


def _of_structure(m: mujoco.MjModel, sensing: bool) -> Iterator[Check]:
    option, integrators = m.opt, mujoco.mjtIntegrator
    known = integrators.mjINT_EULER, integrators.mjINT_RK4, integrators.mjINT_IMPLICITFAST
    name = word(integrators, option.integrator)
    yield option.integrator not in known, f"the {name} integrator", 'integrator="implicitfast"'
    off = option.disableflags & FLAGS.mjDSBL_ACTUATION or option.disableactuator
    yield off, "disabled motors", "no actuation flag, no actuatorgroupdisable"
    yield sensing and option.disableflags & FLAGS.mjDSBL_SENSOR, "disabled sensors", 'sensor="enable"'
    for flag, bit in mujoco.mjtEnableBit.__members__.items():
        name = flag.removeprefix("mjENBL_").lower()
        on = name not in ("energy", "fwdinv", "invdiscrete", "mjnenable") and option.enableflags & int(bit)
        yield on, f"the flag {name}", f'{name}="disable"'
    yield option.density or option.viscosity, "a fluid", "density and viscosity 0"
    yield option.noslip_iterations, "noslip iterations", 'noslip_iterations="0"'
    unheld = m.neq and not option.disableflags & int(FLAGS.mjDSBL_CONSTRAINT | FLAGS.mjDSBL_EQUALITY)
    yield unheld, "equality constraints", "no <equality>"
    yield m.nflex, "flexible bodies", "no <flex>"
    yield m.nplugin, "plugins", "no <plugin>"
    balls, free = (np.flatnonzero(m.jnt_type == kind) for kind in (JOINT.mjJNT_BALL, JOINT.mjJNT_FREE))
    name = f", as {m.joint(balls[0]).name!r}" if len(balls) and m.joint(balls[0]).name else ""
    yield len(balls), f"ball joints{name}", "three hinges in their place"
    yield len(free) > 1, "more than one free body", "one <freejoint>"
    if len(free):
        late, moving = m.jnt_dofadr[free[0]] != 0, m.body_weldid[1:] != 0
        yield late, "a free body that is not the first that moves", "the free body before all others"
        beside = np.any(m.body_rootid[1:][moving] != m.jnt_bodyid[free[0]])
        yield beside, "moving bodies beside a free one", "all joints on the free body"
        uneven = any(np.ptp(of[:6]) for of in (m.dof_damping, m.dof_armature, m.dof_frictionloss))
        yield uneven, "damping, armature or friction that differs along a free joint", "one value of each"
        sprung = m.jnt_stiffness[free[0]] and not option.disableflags & int(FLAGS.mjDSBL_SPRING)
        yield sprung, "a spring of a free joint", "a <freejoint/> without a class"
        alone = m.nv == 6 and option.integrator == integrators.mjINT_IMPLICITFAST
        yield alone, "the implicitfast integrator of a free body without joints", 'integrator="Euler"'


def _of_contacts(m: mujoco.MjModel) -> Iterator[Check]:
    many = pairs_of(m)[1].shape[1]
    crowd = f"{many:,} pairs of shapes that may touch, more than {MOST_PAIRS:,}"
    yield many > MOST_PAIRS, crowd, "contype and conaffinity that keep shapes apart"
    pairs = touching(m) if many <= MOST_PAIRS else []
    said: dict[str, tuple[str, list[str]]] = {}
    data = mujoco.MjData(m)
    mujoco.mj_kinematics(m, data)
    for pair in pairs:
        name = " and ".join(named(m, geom) for geom in (pair.one, pair.two))
        for what, change in _of_pair(m, data, pair):
            said.setdefault(what, (change, []))[1].append(name)
    for what, (change, names) in said.items():
        count = f" ({len(names)})" if len(names) > 1 else ""
        yield True, f"{what}, as those of {names[0]}{count}", change


def _of_pair(m: mujoco.MjModel, data: mujoco.MjData, pair: Touching) -> Iterator[tuple[str, str]]:
    one, two = (kind_of(m, geom) for geom in (pair.one, pair.two))
    if one == "plane" and m.body_weldid[m.geom_bodyid[pair.one]] != 0:
        yield "contacts of a plane that moves", "planes in the world alone"
    if (two not in GROUND_SHAPES) if one == "plane" else ((one, two) not in PAIRS):
        shapes = ", ".join(GROUND_SHAPES) if one == "plane" else "spheres, capsules and boxes"
        masks = "contype and conaffinity that keep them apart"
        yield f"contacts of {a(one)} and {a(two)}", f"{shapes} in their place, or {masks}"
    if one == "capsule" and two in ("capsule", "box") and _stay_parallel(m, data, pair):
        stays = "a capsule that stays parallel to a face of a box"
        what = f"contacts of {stays}" if two == "box" else "two contacts of capsules that stay parallel"
        yield what, "one of them turned by a hundredth of a degree"
    if pair.condim not in (1, 3):
        yield "contacts that resist twisting or rolling", 'condim="3"'
    if pair.surplus:
        yield SURPLUS_WORDS, "gap, adhesion and surfacevel 0"
    if _mixed_signs(pair.solref):
        yield "a solref of which one value is positive", ONE_SIGN


def _stay_parallel(m: mujoco.MjModel, data: mujoco.MjData, pair: Touching) -> bool:
    """True if no joint can turn the axis of a capsule, which is parallel to another's or to faces of a box, away."""
    one, two = data.geom_xmat[[pair.one, pair.two]].reshape(2, 3, 3).swapaxes(1, 2)
    moves = below(m)[m.jnt_bodyid[:, None], m.geom_bodyid[[pair.one, pair.two]]]
    between = np.flatnonzero(moves[:, 0] != moves[:, 1])
    turning = between[m.jnt_type[between] != JOINT.mjJNT_SLIDE]
    box, axis = kind_of(m, pair.two) == "box", one[2]
    sides = two if box else two[2:]
    level = [side for side in sides if np.abs(side @ axis if box else np.cross(axis, side)).max() < PARALLEL]
    kept = [(np.abs(np.cross(way, data.xaxis[turning])) < PARALLEL).all() for way in (axis, *level)]
    return bool(len(level) and (m.jnt_type[turning] == JOINT.mjJNT_HINGE).all() and any(kept))
