# pyright: reportAttributeAccessIssue=false
"""A robot's MJCF in words: what it has, and everything of it that `physics: tree` cannot represent."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np

from humanoid_mjx.files import meant, refuse_pipe
from humanoid_mjx.mechanics.tree.refusing import faults, kinds_of, touching
from humanoid_mjx.robot.declared import bad_timestep
from humanoid_mjx.robot.description import motors_on
from humanoid_mjx.spec import InputError

JOINT = mujoco.mjtJoint


def read_model(path: str) -> mujoco.MjModel:
    """The compiled model of an MJCF file.

    Raises:
      InputError: there is no such file, MuJoCo cannot compile it, its time step is none, or nothing in it moves.
    """
    refuse_pipe(Path(path))
    if not Path(path).is_file():
        raise InputError(f"info: there is no file {path}{meant(path, 'model', 'robot')}.")
    try:
        model = mujoco.MjModel.from_xml_path(path)
    except ValueError as error:
        raise InputError(f"info: MuJoCo cannot read {path}: {' '.join(str(error).split())}.") from error
    if not model.nv:
        raise InputError(f"info: {path} has no joint, so nothing in it moves.")
    if fault := bad_timestep(model.opt.timestep):
        raise InputError(f"info: {path}: {fault}.")
    return model


def survey(model: mujoco.MjModel) -> tuple[list[str], bool]:
    """Lines that say what a compiled model has, and whether the tree takes it as it is."""
    free = bool((model.jnt_type == JOINT.mjJNT_FREE).any())
    pushed, contacts = set(), Counter()
    for pair in touching(model):
        kinds = kinds_of(model, pair)
        contacts[kinds] += 1
        pushed |= {int(model.geom_bodyid[pair.two])} if kinds[0] == "plane" else set()
    floor = bool((model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE).any())
    ends = (pushed if floor else set(range(model.nbody))) - {int(parent) for parent in model.body_parentid[1:]} - {0}
    feet = [model.body(body).name or f"body {body}" for body in sorted(ends)]
    joints = list(_joints(model))
    found = {
        "mass": f"{model.body_mass.sum():.4g} kg in {model.nbody - 1} bodies, {'a free' if free else 'no free'} base",
        "joints": f"{len(joints)}, {model.nu} actuators, {model.nv} degrees of freedom",
        "feet": f"{', '.join(feet) or 'none'}: ends of limbs{' that the ground can push' * floor}",
        "contacts": ", ".join(f"{count} of {one} and {two}" for (one, two), count in contacts.items()) or "none",
    }
    lines = [f"{name:13} {words}" for name, words in found.items()]
    lines[2:2] = joints
    hinges = [model.joint(int(joint)).name for joint in np.flatnonzero(model.jnt_type == JOINT.mjJNT_HINGE)]
    needs = {
        "one body with a <freejoint/>": (model.jnt_type == JOINT.mjJNT_FREE).sum() == 1,
        "hinges that have names": bool(hinges) and all(hinges),
    }
    if lacks := [what for what, has in needs.items() if not has]:
        lines.append(f"{'tasks':13} stand and walk need {' and '.join(lacks)}")
    wrong = faults(model)
    if not wrong:
        return [*lines, f"{'physics':13} tree takes it as it is"], True
    many = f"{len(wrong)} things" if len(wrong) > 1 else "one thing"
    words = f"tree cannot represent {many}; mjx-jax, mjx-warp and mujoco may:"
    if free and all(fault.of_contacts for fault in wrong):
        words = (
            "tree takes it through a robot's YAML with `contacts: feet`: only the contacts of the feet with the ground "
            f"remain (docs/your_robot.md). As it is, the tree cannot represent {many}:"
        )
    lines.append(f"{'physics':13} {words}")
    return lines + [f"  {fault.what}; to change: {fault.change}" for fault in wrong], False


def _joints(m: mujoco.MjModel) -> Iterator[str]:
    """A line for each joint but the free one."""
    for index, kind in enumerate(m.jnt_type):
        if kind == JOINT.mjJNT_FREE:
            continue
        name, slides = JOINT(int(kind)).name.removeprefix("mjJNT_").lower(), kind == JOINT.mjJNT_SLIDE
        low, high = m.jnt_range[index] * 1e3 if slides else np.degrees(m.jnt_range[index])
        limits = f"{low:.4g} to {high:.4g} {'mm' if slides else 'degrees'}" if m.jnt_limited[index] else "no limits"
        motors = [m.actuator(i).name or "an actuator" for i in motors_on(m, index)]
        yield f"  {m.joint(index).name or f'joint {index}'}: {name}, {limits}, {', '.join(motors) or 'no actuator'}"
