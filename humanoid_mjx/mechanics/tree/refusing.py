# pyright: reportAttributeAccessIssue=false
"""What of a MuJoCo model a tree of hinges cannot represent, less what its contacts may be (see `reading`)."""

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

JOINT = mujoco.mjtJoint


def first_fault(model: mujoco.MjModel) -> str | None:
    """What makes a model impossible here, in words that end a sentence; None where nothing does."""
    return next((words for wrong, words in _faults(model) if wrong), None)


def _faults(m: mujoco.MjModel) -> Iterator[tuple[Any, str]]:
    """Whether something is there, and what to call it."""
    option, flags = m.opt, mujoco.mjtDisableBit
    harmless = flags.mjDSBL_EULERDAMP | flags.mjDSBL_AUTORESET | flags.mjDSBL_WARMSTART | flags.mjDSBL_REFSAFE
    harmless |= flags.mjDSBL_FILTERPARENT | flags.mjDSBL_CLAMPCTRL
    yield option.integrator != mujoco.mjtIntegrator.mjINT_EULER, "an integrator other than Euler"
    yield option.cone != mujoco.mjtCone.mjCONE_PYRAMIDAL and (_condims(m) > 1).any(), "elliptic friction cones"
    yield option.disableflags & ~int(harmless), "a model with parts of its physics disabled"
    yield option.enableflags & ~int(mujoco.mjtEnableBit.mjENBL_ENERGY), "a model with optional physics enabled"
    yield option.density or option.viscosity or np.any(option.wind), "a fluid"
    yield option.noslip_iterations, "noslip iterations"
    yield m.neq, "equality constraints"
    yield m.ntendon, "tendons"
    yield m.nflex, "flexible bodies"
    yield m.nplugin, "plugins"
    yield m.nmocap, "mocap bodies"
    yield m.na, "actuators with activation"
    yield np.any(m.body_gravcomp), "gravity compensation"
    yield np.any(m.dof_frictionloss), "dry friction of joints"
    yield from _faulty_joints(m)
    yield from _faulty_actuators(m)


def _faulty_joints(m: mujoco.MjModel) -> Iterator[tuple[Any, str]]:
    for kind in ("SLIDE", "BALL"):
        found = np.flatnonzero(m.jnt_type == getattr(JOINT, f"mjJNT_{kind}"))
        yield len(found), f"{kind.lower()} joints, as {m.joint(found[0]).name!r}" if len(found) else ""
    free = np.flatnonzero(m.jnt_type == JOINT.mjJNT_FREE)
    yield len(free) > 1, "more than one free body"
    if len(free):
        yield m.jnt_dofadr[free[0]] != 0, "a free body that is not the first that moves"
        base = m.jnt_bodyid[free[0]]
        moving = m.body_weldid[1:] != 0
        yield np.any(m.body_rootid[1:][moving] != base), "moving bodies beside a free one"
        dofs = slice(0, 6)
        yield m.dof_damping[dofs].any() or m.dof_armature[dofs].any(), "damping or armature of a free joint"
    for name in ("jnt_stiffnesspoly", "dof_dampingpoly", "jnt_springyield", "jnt_actgravcomp", "jnt_actfrclimited"):
        yield np.any(getattr(m, name, 0)), f"what {name} sets"
    width = m.jnt_range[:, 1] - m.jnt_range[:, 0]
    narrow = np.flatnonzero((m.jnt_limited != 0) & (width <= 2.0 * m.jnt_margin))
    yield len(narrow), "joint ranges that are no wider than twice their margin"


def _faulty_actuators(m: mujoco.MjModel) -> Iterator[tuple[Any, str]]:
    if not m.nu:
        return
    transmission, gain, bias = mujoco.mjtTrn, mujoco.mjtGain, mujoco.mjtBias
    yield np.any(m.actuator_trntype != transmission.mjTRN_JOINT), "actuators of anything but joints"
    if (m.actuator_trntype == transmission.mjTRN_JOINT).all():
        yield np.any(m.jnt_type[m.actuator_trnid[:, 0]] != JOINT.mjJNT_HINGE), "actuators of anything but hinges"
    yield np.any(m.actuator_dyntype != mujoco.mjtDyn.mjDYN_NONE), "actuators with dynamics of their own"
    yield np.any(m.actuator_gaintype != gain.mjGAIN_FIXED), "actuators whose gain is not fixed"
    known = np.isin(m.actuator_biastype, (int(bias.mjBIAS_NONE), int(bias.mjBIAS_AFFINE)))
    yield not known.all(), "actuators whose bias is not affine"
    for name in ("actuator_damping", "actuator_armature", "actuator_delay", "actuator_dampingpoly"):
        yield np.any(getattr(m, name, 0)), f"what {name} sets"


def _condims(m: mujoco.MjModel) -> np.ndarray:
    """Dimensions of the contacts of everything that may touch."""
    return np.concatenate([m.pair_dim, m.geom_condim[(m.geom_contype | m.geom_conaffinity) != 0]])
