# pyright: reportAttributeAccessIssue=false
"""A robot's MJCF in words: what it has, and everything of it that `physics: tree` cannot represent."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np

from humanoid_mjx.files import meant, read_text, refuse_pipe
from humanoid_mjx.mechanics.tree.refusing import faults, robot_faults, sensors_of
from humanoid_mjx.robot.declared import bad_timestep
from humanoid_mjx.robot.description import IMU
from humanoid_mjx.robot.mjcf import GRAVITY, checked, falls, files_of, is_xml, place_of, read_spec
from humanoid_mjx.robot.motors import motors_on
from humanoid_mjx.robot.touching import kind_of, pairs_of, word
from humanoid_mjx.spec import InputError

JOINT = mujoco.mjtJoint


def survey(path: str) -> tuple[list[str], bool]:
    """Return lines that say what an MJCF has, a file or package:NAME/PATH, and whether the tree takes it as it is.

    Raises:
      InputError: there is no such package or file, MuJoCo cannot compile it, its time step is none, or nothing moves.
    """
    path = str(place_of(path, Path("info")))
    refuse_pipe(Path(path))
    if not Path(path).is_file():
        raise InputError(f"info: there is no file {path}{meant(path, 'model', 'robot')}.")
    for file in filter(is_xml, files_of(Path(path))):
        read_text(file)  # MuJoCo takes other encodings, and then has names that Python cannot read
    what = f"info: MuJoCo cannot read {path}"
    (spec, missing), noted = checked(lambda: read_spec(path), what)
    model, warned = checked(spec.compile, what)
    if not model.nv:
        raise InputError(f"info: {path} has no joint, so nothing in it moves.")
    if fault := bad_timestep(model.opt.timestep):
        raise InputError(f"info: {path}: {fault}.")
    free, hinges = ((model.jnt_type == kind).sum() for kind in (JOINT.mjJNT_FREE, JOINT.mjJNT_HINGE))
    planes, (_, (one, two)) = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE, pairs_of(model)
    kinds = [kind_of(model, geom) for geom in range(model.ngeom)]
    contacts = Counter((kinds[i], kinds[j]) for i, j in zip(one.tolist(), two.tolist(), strict=True))
    pushed, floor = set(model.geom_bodyid[two[planes[one]]].tolist()), bool(planes.any())
    ends = (pushed if floor else set(range(model.nbody))) - {int(parent) for parent in model.body_parentid[1:]} - {0}
    feet = [model.body(body).name or f"body {body}" for body in sorted(ends)]
    joints = list(_joints(model))
    named = all(model.joint(joint).name for joint in np.flatnonzero(model.jnt_type == JOINT.mjJNT_HINGE).tolist())
    needs = {"one body with a <freejoint/>": free == 1, "hinges that have names": hinges and named}
    needs[GRAVITY] = falls(model)
    rows = [
        ("mass", f"{model.body_mass.sum():.4g} kg in {model.nbody - 1} bodies, {'a free' if free else 'no free'} base"),
        ("joints", f"{len(joints)}, {len(model.actuator_trntype)} actuators, {model.nv} degrees of freedom"),
        *joints,
        ("feet", f"{', '.join(feet) or 'none'}: ends of limbs{' that the ground can push' * floor}"),
        ("contacts", ", ".join(f"{count} of {one} and {two}" for (one, two), count in contacts.items()) or "none"),
        *(("MuJoCo warns", warning) for warning in dict.fromkeys((*noted, *warned))),
        *[("looks", f"files of {missing} meshes are missing")] * bool(missing),
    ]
    if lacks := [what for what, has in needs.items() if not has]:
        rows.append(("tasks", f"stand and walk need {' and '.join(lacks)}"))
    wrong = faults(model, sensors_of(model, IMU)) + robot_faults(model)
    many, of = f"{len(wrong)} things" if len(wrong) > 1 else "one thing", {fault.of for fault in wrong}
    words = f"tree cannot represent {many}{'; mjx-jax, mjx-warp and mujoco may' * (not of & {'motors', 'numbers'})}:"
    if free and of <= {"contacts", "motors"}:
        feet = " with `contacts: feet`", ", and only the contacts of the feet with the ground remain"
        how, what = feet if "contacts" in of else ("", "")
        words = (
            f"tree takes it through a robot's YAML{how}: torque motors take the place of its own{what} "
            f"(docs/your_robot.md). As it is, the tree cannot represent {many}:"
        )
    rows.append(("physics", words if wrong else "tree takes it as it is"))
    rows += [f"  {fault.what}; to change: {fault.change}" for fault in wrong]
    return [row if isinstance(row, str) else "{:13} {}".format(*row) for row in rows], not wrong


def _joints(m: mujoco.MjModel) -> Iterator[str]:
    """A line for each joint but the free one."""
    for index, kind in enumerate(m.jnt_type):
        if kind == JOINT.mjJNT_FREE:
            continue
        name, slides = word(JOINT, kind), kind == JOINT.mjJNT_SLIDE
        low, high = m.jnt_range[index] * 1e3 if slides else np.degrees(m.jnt_range[index])
        limits = f"{low:.4g} to {high:.4g} {'mm' if slides else 'degrees'}" if m.jnt_limited[index] else "no limits"
        motors = [m.actuator(i).name or "an actuator" for i in motors_on(m, index)]
        yield f"  {m.joint(index).name or f'joint {index}'}: {name}, {limits}, {', '.join(motors) or 'no actuator'}"
