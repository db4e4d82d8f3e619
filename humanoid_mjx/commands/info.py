# pyright: reportAttributeAccessIssue=false
"""The command `info`."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from shlex import quote
from typing import Any

import mujoco
import numpy as np
from rich.filesize import decimal
from rich.table import Table

from humanoid_mjx import compute
from humanoid_mjx.commands import console
from humanoid_mjx.config import dump_yaml, load
from humanoid_mjx.files import meant, names, read_text, refuse_pipe
from humanoid_mjx.keys import keys_of
from humanoid_mjx.learners import LEARNERS, Learner
from humanoid_mjx.mechanics.tree.refusing import faults, robot_faults, sensors_of
from humanoid_mjx.robot import ROBOTS, make_robot
from humanoid_mjx.robot.declared import Declaration, bad_timestep, describes_robot
from humanoid_mjx.robot.description import IMU
from humanoid_mjx.robot.differences import HEADINGS, differences_of
from humanoid_mjx.robot.holding import in_words
from humanoid_mjx.robot.mjcf import GRAVITY, checked, falls, files_of, is_xml, place_of, read_spec
from humanoid_mjx.robot.motors import motors_on
from humanoid_mjx.robot.touching import kind_of, pairs_of, word
from humanoid_mjx.spec import InputError, Spec, find, known, modules_in
from humanoid_mjx.tasks import TASKS
from humanoid_mjx.tasks.base import Task
from humanoid_mjx.training.chunks import Here
from humanoid_mjx.training.cost import disk_bytes, training_bytes
from humanoid_mjx.training.pace import MEASURED_S, estimate, time_in_words
from humanoid_mjx.training.plan import make_plan
from humanoid_mjx.training.programs import why_no_kernel
from humanoid_mjx.training.progress import Bar, counted
from humanoid_mjx.training.sweep import check_later


def show_keys(name: str | None) -> None:
    """`humanoid-mjx info [NAME] --keys`: of a task, a learner, or both of a config; of all tasks and learners."""
    if name == "robot" or (name and describes_robot(name)):
        rows = [("key", "default", "values", "meaning")]
        keys = list(keys_of(Declaration, ""))
        _print_rows("robot", rows + [(key.name[1:], key.default, key.allowed, key.meaning) for key in keys])
        return
    kinds: dict[str, tuple[Mapping[str, str], type[Any]]] = {"task": (TASKS, Task), "learner": (LEARNERS, Learner)}
    config = None
    if name is None:
        chosen = [(kind, of) for kind, (registry, _) in kinds.items() for of in registry]
    elif name in TASKS or name in LEARNERS or ":" in name:
        chosen = [("learner" if issubclass(find("task", TASKS | LEARNERS, Spec, name), Learner) else "task", name)]
    else:
        _check_name(name)
        config = load(name)
        chosen = [("task", config.task["name"]), ("learner", config.learner["name"])]
    for kind, of in chosen:
        with modules_in(config.modules if config else None):
            cls = find(kind, *kinds[kind], of)
        rows = [("key", "default", "values", "in a sweep", "meaning")]
        for key in keys_of(cls, kind):
            rows.append((key.name, key.default, key.allowed, "traced" if key.traced else "static", key.meaning))
        _print_rows(f"{kind} {of}", rows)
    console.print("Sweeping a traced value compiles nothing; points that differ in static ones compile apart.")


JOINT = mujoco.mjtJoint

QUICK_LEGS = 0.4
"""Longest legs of a body on two feet that walks with the quick steps of the config `walk`, m (`docs/robots.md`)."""


def _check_name(name: str) -> None:
    """Raise an InputError for a name that stands for nothing."""
    there = [*TASKS, *LEARNERS, *ROBOTS, *names("robots", ".yaml"), *names("configs", ".yaml")]
    if name not in there and not Path(name).exists():
        instead = meant(name, "config", "robot", "model") or f"; {known(name, there, 'info')}"
        raise InputError(f"{name}: neither a task, a learner, a robot nor a config{instead}.")


def _show_robot(name: str) -> None:
    """`humanoid-mjx info ROBOT`: what follows from its files or its class, and which physics take it."""
    robot = make_robot(name)
    order, signs = robot.joint_images
    limited = robot.model.jnt_limited[robot.driven]
    rows = [("joint", "range, degrees", "home", "torque, N m", "N m/rad", "N m s/rad", "mirror image")]
    for k, joint in enumerate(robot.joints):
        low, high = np.degrees(robot.ranges_rad[k])
        image = f"{'' if signs[k] > 0 else '-'}{robot.joints[order[k]]}" if robot.mirror else ""
        stiffness, damping = (f"{gain[k]:g}" for gain in robot.servo) if robot.servo else ("", "")
        home, torque = f"{np.degrees(robot.posture[k]):g}", f"{robot.torque_limits[k]:g}"
        rows.append((joint, f"{low:.0f} to {high:.0f}" if limited[k] else "", home, torque, stiffness, damping, image))
    _print_rows(f"{name}: {len(robot.joints)} joints", rows)
    lines = {"feet": ", ".join(robot.feet), "mass": f"{robot.mass:.3g} kg"}
    uneven = []
    gains = zip(("stiffness", "damping"), robot.servo or (), strict=False)
    for what, values in {"home": np.degrees(robot.posture), "torque": robot.torque_limits, **dict(gains)}.items():
        asked = values[order] * (signs if what == "home" else 1.0)
        for k in np.flatnonzero(~np.isclose(values, asked, rtol=0.01, atol=0.01))[: bool(robot.mirror)]:
            image = f"by its image {robot.joints[order[k]]} it would be {asked[k]:g}"
            uneven.append(f"{what} of {robot.joints[k]} is {values[k]:g}; {image}")
    if uneven:
        lines["mirror"] = "\n          ".join(uneven)
    if robot.points:
        turns = zip(robot.feet, robot.phases, strict=True)
        lines["feet"] += f"; {counted(robot.points, 'point')} each"
        lines["gait"] = ", ".join(f"{foot} swings at {turn:g}" for foot, turn in turns)
        lines["legs"] = f"{robot.leg_length:.3g} m; a pace of {robot.pace:.3g} m/s is the unit of speeds"
    others = ", others as the model says" * (getattr(robot, "contacts", "") == "model")
    lines["contacts"] = f"{robot.model.npair} with the ground{others}"
    refused = [f"{fault.what} (take {fault.change})" for fault in faults(robot.model, IMU)]
    lines["physics"] = f"tree refuses {'; '.join(refused)}: take mujoco, or try mjx-jax" if refused else "tree takes it"
    if robot.servo and robot.points:
        lines["servo"] = "\n          ".join(in_words(robot))
        config = "walk_humanoid" if len(robot.feet) == 2 and robot.leg_length > QUICK_LEGS else "walk"
        changes = {f"task.robot={name}": True, "task.physics=mujoco": bool(refused)}
        changes |= {"task.symmetric=false": not robot.alternates}
        chosen = (f" --set {quote(change)}" for change, needed in changes.items() if needed)
        lines["training"] = f"humanoid-mjx sweep {config}{''.join(chosen)}"
    for key, value in lines.items():
        console.print(f"{key:9} {value}", soft_wrap=True)
    _print_rows("", [HEADINGS, *robot.differences()])


def _print_rows(title: str, rows: Sequence[tuple[str, ...]]) -> None:
    """A table with a heading; nothing without a title and rows."""
    if not title and len(rows) < 2:
        return
    table = Table(*rows[0], title=title, title_justify="left", box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for row in rows[1:]:
        table.add_row(*row)
    console.print(table)


def show_model(path: str) -> bool:
    """`humanoid-mjx info ROBOT.xml`; whether `physics: tree` takes it."""
    lines, taken = survey(path)
    for line in lines:
        console.print(line, soft_wrap=True)
    return taken


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


def check_plain(overrides: Sequence[str], timed: bool) -> None:
    """Raise an InputError if there are options of a config, where none is shown."""
    if overrides or timed:
        raise InputError(f"info {'--set' if overrides else '--time'}: name a config, and leave --keys out.")


def show_info(config: str | None, overrides: Sequence[str], timed: bool) -> None:
    """`humanoid-mjx info`."""
    compute.start()
    robot = config is not None and (config in ROBOTS or describes_robot(config))
    part = config in {*TASKS, *LEARNERS}.difference(names("configs", ".yaml"))
    if config is not None and not robot and not part:
        _check_name(config)
        _show_plan(config, overrides, timed)
        return
    check_plain(overrides, timed)
    if config is not None:
        _show_robot(config) if robot else show_keys(config)
        return
    for name, value in (compute.machine() | compute.versions()).items():
        console.print(f"{name:13} {value}")
    endings = {"configs": ".yaml", "policies": ".npz", "robots": ".yaml"}
    shipped = {kind: names(kind, ending) for kind, ending in endings.items()}
    for kind, all_names in {"tasks": TASKS, "learners": LEARNERS, **shipped}.items():
        console.print(f"{kind:13} {', '.join(all_names)}")


def _show_plan(config: str, overrides: Sequence[str], timed: bool) -> None:
    """A config in full, and what its sweep will take; where `timed` also how long."""
    plan = make_plan(load(config, overrides))
    check_later(plan.config)
    console.print(dump_yaml(plan.resolved()).rstrip())
    _print_rows("", [HEADINGS, *dict.fromkeys(row for own in plan.learners for row in differences_of(own.task))])
    size = sum(group.bytes * len(group.first_runs) for group in plan.groups)
    most = max(training_bytes(group) for group in plan.groups)
    together, refusal = [1] * len(plan.groups), None
    try:
        together = Here(plan).at_once
    except InputError as error:
        refusal = error
    if len(plan.rungs) > 1:
        rungs = ", ".join(f"{rung.points:,} with {rung.budget:,} {plan.unit}s" for rung in plan.rungs)
        console.print(
            f"\nhalving trains {rungs}: as much as {plan.work:,.1f} of all {len(plan.points):,} points to the end, "
            f"{plan.work / len(plan.points):.0%}",
            soft_wrap=True,
        )
    console.print(
        f"\n{counted(plan.num_runs // plan.config.seeds, 'point')} x {counted(plan.config.seeds, 'seed')} = "
        f"{counted(plan.num_runs, 'run')} in {counted(len(plan.groups), 'compiled program')}; "
        f"training state {decimal(size)} if all were held at once, "
        f"a run that trains an estimated {decimal(most)}"
    )
    console.print(f"on disk an estimated {decimal(disk_bytes(plan, together))}, without figures")
    if refusal:
        console.print(f"sweep refuses it here: {refusal}")
    points: Counter[str | None] = Counter()
    for group in plan.groups if plan.unit == "episode" else ():
        points[why_no_kernel(group.learner())] += len(group.first_runs) // group.seeds
    for reason, count in points.items():
        which = f"{counted(count, 'point')} " if len(points) > 1 else ""
        console.print(which + ("trained by a kernel" if reason is None else f"not trained by a kernel: {reason}"))
    if not timed:
        console.print(f"how long it takes here: humanoid-mjx info {config} --time measures a piece of it")
        return
    with Bar(console) as bar:
        bar.phase("compiling and training a piece of it")
        parts, measured = estimate(plan)
    words = ", ".join(f"{time_in_words(seconds)} of {part}" for part, seconds in parts.items())
    each = f" in each of {measured} programs" if len(plan.groups) > 1 else ""
    how, total = f"by {MEASURED_S:g} s of its training{each}", time_in_words(sum(parts.values()))
    console.print(f"about {total} on this machine, without figures: {words}; estimated {how}")
