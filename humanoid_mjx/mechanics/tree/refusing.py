# pyright: reportAttributeAccessIssue=false
"""Everything of a MuJoCo model that a tree cannot represent."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np

from humanoid_mjx.robot.touching import FLAGS, Touching, kinds_of, named, touching

JOINT = mujoco.mjtJoint

GROUND_SHAPES = ("sphere", "capsule", "box", "cylinder", "ellipsoid")
"""Shapes that a plane of the world can push."""

PAIRS = (("sphere", "sphere"), ("sphere", "capsule"), ("capsule", "capsule"), ("box", "box"))
"""Shapes that can push each other."""


class Fault(NamedTuple):
    """One thing that a tree cannot represent."""

    what: str
    """Words that end the sentence "the tree cannot represent"."""
    change: str
    """Change of the MJCF that removes the fault."""
    of_contacts: bool
    """True if it is gone where only balls of feet touch the ground, as with `contacts: feet` of a robot's YAML."""


def faults(model: mujoco.MjModel, sensors: Sequence[str] = ()) -> list[Fault]:
    """All that keeps a compiled model from being a tree, of whose sensors these are read; empty if nothing does."""
    found = [(check, False) for check in (*_of_options(model), *_of_joints(model))]
    for sensor in (model.sensor(name) for name in sensors):
        found.append(((sensor.cutoff[0], f"the cutoff of a sensor, as {sensor.name!r}", 'cutoff="0"'), False))
    found += [(check, True) for check in _of_contacts(model)]
    return [Fault(what, change, of_contacts) for (wrong, what, change), of_contacts in found if wrong]


Check = tuple[Any, str, str]
"""True if the model has it; what it is; what would have to change."""


def _of_options(m: mujoco.MjModel) -> Iterator[Check]:
    option = m.opt
    implicit = option.integrator == mujoco.mjtIntegrator.mjINT_IMPLICIT
    yield implicit, "the implicit integrator", 'integrator="implicitfast"'
    off = option.disableflags & FLAGS.mjDSBL_ACTUATION or option.disableactuator
    yield off, "disabled motors", "no actuation flag, no actuatorgroupdisable"
    allowed = int(mujoco.mjtEnableBit.mjENBL_ENERGY | mujoco.mjtEnableBit.mjENBL_FWDINV)
    yield option.enableflags & ~allowed, "optional physics that a flag enables", "no flag enabled but energy and fwdinv"
    yield option.density or option.viscosity, "a fluid", "density and viscosity 0"
    yield option.noslip_iterations, "noslip iterations", 'noslip_iterations="0"'
    unheld = m.neq and not option.disableflags & int(FLAGS.mjDSBL_CONSTRAINT | FLAGS.mjDSBL_EQUALITY)
    yield unheld, "equality constraints", "no <equality>"
    names = ("limited", "actfrclimited", "stiffness", "stiffnesspoly", "damping", "dampingpoly", "frictionloss")
    busy = any(np.any(getattr(m, f"tendon_{name}", 0)) for name in (*names, "armature"))
    busy = busy or np.any(getattr(m, "tendon_plasticadr", np.full(1, -1)) >= 0)
    yield busy, "tendons", "no <tendon> that is limited, springs, damps, rubs or is driven"
    yield m.nflex, "flexible bodies", "no <flex>"
    yield m.nplugin, "plugins", "no <plugin>"
    yield m.nmocap, "mocap bodies", 'no mocap="true"'
    yield np.any(m.body_gravcomp), "gravity compensation", 'gravcomp="0"'


def _of_joints(m: mujoco.MjModel) -> Iterator[Check]:
    balls = np.flatnonzero(m.jnt_type == JOINT.mjJNT_BALL)
    name = f", as {m.joint(balls[0]).name!r}" if len(balls) and m.joint(balls[0]).name else ""
    yield len(balls), f"ball joints{name}", "three hinges in their place"
    free = np.flatnonzero(m.jnt_type == JOINT.mjJNT_FREE)
    yield len(free) > 1, "more than one free body", "one <freejoint>"
    if len(free):
        first = "the free body before all others"
        yield m.jnt_dofadr[free[0]] != 0, "a free body that is not the first that moves", first
        base, moving = m.jnt_bodyid[free[0]], m.body_weldid[1:] != 0
        beside = np.any(m.body_rootid[1:][moving] != base)
        yield beside, "moving bodies beside a free one", "all joints on the free body"
        resisting = m.dof_damping[:6].any() or m.dof_armature[:6].any() or m.dof_frictionloss[:6].any()
        yield resisting, "damping, armature or friction of a free joint", "a <freejoint/> without a class"
    for name in ("jnt_stiffnesspoly", "dof_dampingpoly", "jnt_springyield", "jnt_actgravcomp"):
        yield np.any(getattr(m, name, 0)), f"what {name} sets", f"no {name.split('_')[1]} of joints"
    plastic = getattr(m, "jnt_plasticadr", np.full(1, -1))
    yield np.any(plastic >= 0), "plastic springs of joints", "elastic springs"
    narrow = (m.jnt_limited != 0) & (m.jnt_range[:, 1] - m.jnt_range[:, 0] <= 2.0 * m.jnt_margin)
    yield narrow.any(), "joint ranges that are no wider than twice their margin", "a wider range or a smaller margin"


def _of_contacts(m: mujoco.MjModel) -> Iterator[Check]:
    rough = any(pair.condim > 1 for pair in touching(m))
    elliptic = m.opt.cone != mujoco.mjtCone.mjCONE_PYRAMIDAL and rough
    yield elliptic, "elliptic friction cones", 'cone="pyramidal"'
    said: dict[str, tuple[str, list[str]]] = {}
    for pair in touching(m):
        name = " and ".join(named(m, geom) for geom in (pair.one, pair.two))
        for what, change in _of_pair(m, pair):
            said.setdefault(what, (change, []))[1].append(name)
    for what, (change, names) in said.items():
        count = f" ({len(names)})" if len(names) > 1 else ""
        yield True, f"{what}, as those of {names[0]}{count}", change


def _of_pair(m: mujoco.MjModel, pair: Touching) -> Iterator[tuple[str, str]]:
    one, two = kinds_of(m, pair)
    if one == "plane" and m.body_weldid[m.geom_bodyid[pair.one]] != 0:
        yield "contacts of a plane that moves", "planes in the world alone"
    if (two not in GROUND_SHAPES) if one == "plane" else ((one, two) not in PAIRS):
        shapes = ", ".join(GROUND_SHAPES) if one == "plane" else "spheres and capsules"
        masks = "contype and conaffinity that keep them apart"
        yield f"contacts of {_a(one)} and {_a(two)}", f"{shapes} in their place, or {masks}"
    if pair.condim not in (1, 3):
        yield "contacts that resist twisting or rolling", 'condim="3"'
    if pair.surplus:
        yield "a gap, adhesion or surface velocity of contacts", "gap, adhesion and surfacevel 0"
    if (pair.solref[0] > 0) != (pair.solref[1] > 0):
        yield "a solref of which one value is positive", "two positive values of solref, or none"


def _a(shape: str) -> str:
    return f"an {shape}" if shape == "ellipsoid" else f"a {shape}"
