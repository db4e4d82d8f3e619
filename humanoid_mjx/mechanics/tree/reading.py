# pyright: reportAttributeAccessIssue=false
"""From a compiled MuJoCo model to a `Tree`, or a sentence on all that a tree cannot represent."""

from collections.abc import Iterator, Sequence
from typing import Any

import mujoco
import numpy as np

from humanoid_mjx.mechanics.tree import structure as st
from humanoid_mjx.mechanics.tree.boxes import CONTACTS, PLACES
from humanoid_mjx.mechanics.tree.refusing import faults
from humanoid_mjx.robot.touching import FLAGS, Touching, kind_of, touching
from humanoid_mjx.spec import InputError

SMALLEST = 1e-14
"""Numbers of order one below this are rounding of the model's compiler."""

IMPEDANCES = 1e-4, 1.0 - 1e-4
"""MuJoCo's bounds on `dmin`, `dmax` and the midpoint (mjMINIMP, mjMAXIMP)."""

JOINT, GEOM = mujoco.mjtJoint, mujoco.mjtGeom


def read_tree(model: mujoco.MjModel, sensors: Sequence[str] = (), feet: Sequence[int] | None = None) -> st.Tree:
    """The structure and constants of a compiled model, whose solver's settings are of no use here.

    `sensors`: names of the gyroscopes and accelerometers to read, in this order. `feet`: geoms whose contacts with the
    ground are reported; by default all that have any.

    Raises:
      InputError: the model has something that a tree cannot represent; the sentence names all of it.
    """
    if found := faults(model, sensors):
        what = "; ".join(fault.what for fault in found)
        raise InputError(f"physics: the tree cannot represent {what}: take mujoco, or try mjx-jax.")
    free = np.flatnonzero(model.jnt_type == JOINT.mjJNT_FREE)
    ground, geoms, pairs = _contacts(model)
    feet = tuple(dict.fromkeys(geoms)) if feet is None else feet
    x, y, z = (0.0,) * 3 if _off(model, FLAGS.mjDSBL_GRAVITY) else (float(part) for part in model.opt.gravity)
    bodies = tuple(_body(model, index) for index in range(model.nbody))
    joints = [joint for body in bodies for joint in body.joints]
    of_joints = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    return st.Tree(
        bodies=bodies,
        free=int(model.jnt_bodyid[free[0]]) if len(free) else None,
        drag=(drag := _drag(model) if len(free) else None),
        coordinates=tuple((index,) for index in range(model.nq)),
        dofs=tuple((index,) for index in range(model.nv)),
        lanes=1,
        body_places=tuple((index,) for index in range(model.nbody)),
        ground=tuple(ground),
        feet=tuple(tuple(i for i, geom in enumerate(geoms) if geom == foot) for foot in feet),
        pairs=tuple(pairs),
        motors=tuple(model.jnt_dofadr[model.actuator_trnid[of_joints, 0]].tolist()),
        gyroscopes=_sites(model, sensors, mujoco.mjtSensor.mjSENS_GYRO),
        accelerometers=_sites(model, sensors, mujoco.mjtSensor.mjSENS_ACCELEROMETER),
        gravity=(x, y, z),
        timestep=float(model.opt.timestep),
        integrator=_integrator(model, any(each.damping for each in (*joints, *([drag] if drag else ())))),
    )


def _integrator(m: mujoco.MjModel, damped: bool) -> st.Integrator:
    if m.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        return "RK4"
    fast = m.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return "damped" if damped and (fast or not _off(m, FLAGS.mjDSBL_EULERDAMP)) else "explicit"


def _body(m: mujoco.MjModel, index: int) -> st.Body:
    first, count = m.body_jntadr[index], m.body_jntnum[index]
    joints = [j for j in range(first, first + count) if m.jnt_type[j] != JOINT.mjJNT_FREE]
    moment, extra = _moments(m.body_inertia[index], _axes(m.body_iquat[index]))
    return st.Body(
        parent=int(m.body_parentid[index]),
        position=_triple(m.body_pos[index]),
        axes=_axes(m.body_quat[index]),
        mass=float(m.body_mass[index]),
        center=_triple(m.body_ipos[index]),
        moment=moment,
        extra=extra,
        joints=tuple(_joint(m, joint) for joint in joints),
    )


def _moments(moments: np.ndarray, axes: st.Axes) -> tuple[float, tuple[tuple[float, st.Triple], ...]]:
    """The moment that most principal axes share, and by how much those about the others exceed it."""
    same = np.abs(moments[:, None] - moments) <= 1e-12 * moments.max()
    base = float(moments[same.sum(axis=1).argmax()])
    more = [(float(moment) - base, axis) for moment, axis in zip(moments, axes, strict=True)]
    return base, tuple((extra, axis) for extra, axis in more if abs(extra) > 1e-12 * moments.max())


def _joint(m: mujoco.MjModel, joint: int) -> st.Joint:
    dof, qpos = int(m.jnt_dofadr[joint]), int(m.jnt_qposadr[joint])
    limit = None
    if m.jnt_limited[joint] and not _off(m, FLAGS.mjDSBL_CONSTRAINT | FLAGS.mjDSBL_LIMIT):
        lower, upper = (float(x) for x in m.jnt_range[joint])
        softness = _softness(m, m.jnt_solref[joint], m.jnt_solimp[joint])
        limit = st.Limit(lower, upper, float(m.jnt_margin[joint]), float(m.dof_invweight0[dof]), softness)
    return st.Joint(
        coordinate=qpos,
        dof=dof,
        slides=bool(m.jnt_type[joint] == JOINT.mjJNT_SLIDE),
        axis=_triple(m.jnt_axis[joint]),
        anchor=_triple(m.jnt_pos[joint]),
        reference=float(m.qpos0[qpos]),
        armature=float(m.dof_armature[dof]),
        damping=_damping(m, dof),
        stiffness=0.0 if _off(m, FLAGS.mjDSBL_SPRING) else float(m.jnt_stiffness[joint]),
        spring=float(m.qpos_spring[qpos]),
        limit=limit,
        dry=_dry(m, dof),
    )


def _damping(m: mujoco.MjModel, dof: int) -> float:
    return 0.0 if _off(m, FLAGS.mjDSBL_DAMPER) else float(m.dof_damping[dof])


def _dry(m: mujoco.MjModel, dof: int) -> st.Dry | None:
    most = float(m.dof_frictionloss[dof])
    if not most or _off(m, FLAGS.mjDSBL_CONSTRAINT | FLAGS.mjDSBL_FRICTIONLOSS):
        return None
    return st.Dry(most, float(m.dof_invweight0[dof]), _softness(m, m.dof_solref[dof], m.dof_solimp[dof]))


def _drag(m: mujoco.MjModel) -> st.Drag | None:
    """Read the resistance of a free body. Its six degrees of freedom are the first, and have one value of each kind."""
    dry = tuple(found for dof in (0, 3) if (found := _dry(m, dof)))
    drag = st.Drag(float(m.dof_armature[0]), _damping(m, 0), dry)
    return drag if drag != (0.0, 0.0, ()) else None


def _sites(m: mujoco.MjModel, sensors: Sequence[str], kind: Any) -> tuple[st.Site, ...]:
    """The places of those sensors that are of a kind, in their order."""
    found = []
    for sensor in (m.sensor(name) for name in sensors):
        if sensor.type[0] != kind:
            continue
        index = int(sensor.objid[0])
        place, axes = _triple(m.site_pos[index]), _axes(m.site_quat[index])
        found.append(st.Site(int(m.site_bodyid[index]), place, axes))
    return tuple(found)


def _contacts(m: mujoco.MjModel) -> tuple[list[st.GroundPoints], list[int], list[st.Pairs]]:
    """The points that planes push, the shape that each is of, and the pairs."""
    ground: list[st.GroundPoints] = []
    geoms: list[int] = []
    pairs: list[st.Pairs] = []
    for pair in touching(m):
        surface = _surface(m, pair)
        if kind_of(m, pair.one) == "plane":
            ground += _ground_points(m, pair.one, pair.two, surface, len(ground))
            geoms += [pair.two] * (len(ground) - len(geoms))
        else:
            one, two = _shape(m, pair.one), _shape(m, pair.two)
            boxes = isinstance(one, st.Box), isinstance(two, st.Box)
            count = CONTACTS if all(boxes) else PLACES if any(boxes) and one.half_length else 1
            pairs.append(st.Pairs((one,) * count, (two,) * count, surface))
    return ground, geoms, pairs


def _surface(m: mujoco.MjModel, pair: Touching) -> st.Surface:
    weight = sum(float(m.body_invweight0[m.geom_bodyid[geom], 0]) for geom in (pair.one, pair.two))
    one, two = (max(float(part), st.FRICTIONLESS) for part in pair.friction)
    rough = None if pair.condim == 1 else (one, two)
    softness = _softness(m, pair.solref, pair.solimp)
    elliptic = m.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    return st.Surface(rough, weight, float(pair.margin), float(m.opt.impratio), softness, elliptic)


def _softness(m: mujoco.MjModel, solref: np.ndarray, solimp: np.ndarray) -> st.Softness:
    """MuJoCo's documentation, "Solver parameters": from time constant and damping ratio, or from both directly."""
    time, ratio = (float(x) for x in solref)
    low, high = IMPEDANCES
    dmin, dmax, middle = (min(max(float(solimp[i]), low), high) for i in (0, 1, 3))
    width, power = max(float(solimp[2]), 0.0), max(float(solimp[4]), 1.0)
    if time > 0:
        if not _off(m, FLAGS.mjDSBL_REFSAFE):
            time = max(time, 2.0 * float(m.opt.timestep))
        return st.Softness(1.0 / (dmax * time * ratio) ** 2, 2.0 / (dmax * time), dmin, dmax, width, middle, power)
    return st.Softness(-time / dmax**2, -ratio / dmax, dmin, dmax, width, middle, power)


def _shape(m: mujoco.MjModel, geom: int) -> st.Capsule | st.Box:
    axes, (x, y, z) = _axes(m.geom_quat[geom]), (float(part) for part in m.geom_size[geom])
    at = int(m.geom_bodyid[geom]), _triple(m.geom_pos[geom])
    if m.geom_type[geom] == GEOM.mjGEOM_BOX:
        return st.Box(*at, axes, (x, y, z))
    return st.Capsule(*at, axes[2], x, y if m.geom_type[geom] == GEOM.mjGEOM_CAPSULE else 0.0)


def _ground_points(
    m: mujoco.MjModel, plane: int, geom: int, surface: st.Surface, first: int
) -> Iterator[st.GroundPoints]:
    data = mujoco.MjData(m)
    mujoco.mj_kinematics(m, data)
    normal = data.geom_xmat[plane].reshape(3, 3)[:, 2]
    for number, (offset, radius, along, shape) in enumerate(_lowest(m, geom)):
        yield st.GroundPoints(
            body=int(m.geom_bodyid[geom]),
            center=_triple(m.geom_pos[geom] + offset),
            radius=radius,
            normal=_triple(normal),
            height=float(normal @ data.geom_xpos[plane]),
            along=along,
            surface=surface,
            order=(first + number,),
            shape=shape,
        )


def _lowest(m: mujoco.MjModel, geom: int) -> Iterator[tuple[np.ndarray, float, st.Triple | None, Any]]:
    """The points of a shape that a plane pushes: where they are from its middle, their radius, and how they move."""
    kind, axes, still = m.geom_type[geom], _axes(m.geom_quat[geom]), np.zeros(3)
    x, y, z = (float(part) for part in m.geom_size[geom])
    if kind == GEOM.mjGEOM_SPHERE:
        yield still, x, None, None
    elif kind == GEOM.mjGEOM_CAPSULE:
        for end in (1.0, -1.0):
            yield end * y * np.array(axes[2]), x, axes[2], None
    elif kind == GEOM.mjGEOM_BOX:
        for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            half = np.array([x * signs[0], y * signs[1], z]) @ np.array(axes)
            yield still, 0.0, None, st.Corner(_triple(half))
    elif kind == GEOM.mjGEOM_CYLINDER:
        for which in ("lowest", "opposite", "left", "right"):
            yield still, 0.0, None, st.Rim(which, axes[2], axes[0], y, x)
    else:
        yield still, 0.0, None, st.Lowest(axes, (x, y, z))


def _off(m: mujoco.MjModel, flags: Any) -> bool:
    """True if the model disables any of these parts of its physics."""
    return bool(m.opt.disableflags & int(flags))


def _triple(values: np.ndarray) -> st.Triple:
    x, y, z = (0.0 if abs(value) < SMALLEST else float(value) for value in values)
    return x, y, z


def _axes(quaternion: np.ndarray) -> st.Axes:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(quaternion, float) / np.linalg.norm(quaternion))
    whole = np.round(matrix)
    matrix = np.where(np.abs(matrix - whole) < SMALLEST, whole, matrix).reshape(3, 3)
    x, y, z = (_triple(column) for column in matrix.T)
    return x, y, z
