# pyright: reportAttributeAccessIssue=false
"""From a compiled MuJoCo model to a `Tree`, or one sentence on what a tree cannot represent."""

from collections.abc import Callable, Iterator
from typing import Any

import mujoco
import numpy as np

from humanoid_mjx.mechanics.tree import structure as st
from humanoid_mjx.mechanics.tree.refusing import first_fault
from humanoid_mjx.spec import InputError

SMALLEST = 1e-14
"""Numbers of order one below this are rounding of the model's compiler."""

IMPEDANCES = 1e-4, 1.0 - 1e-4
"""MuJoCo's bounds on `dmin`, `dmax` and the midpoint (mjMINIMP, mjMAXIMP)."""

JOINT, GEOM = mujoco.mjtJoint, mujoco.mjtGeom


def read_tree(model: mujoco.MjModel) -> st.Tree:
    """The structure and constants of a compiled model.

    Raises:
      InputError: the model has something that a tree of hinges with plane and capsule contacts does not.
    """
    if fault := first_fault(model):
        raise InputError(f"physics: the tree cannot represent {fault}.")
    free = np.flatnonzero(model.jnt_type == JOINT.mjJNT_FREE)
    ground, pairs = _contacts(model)
    damped = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_EULERDAMP
    x, y, z = (float(part) for part in model.opt.gravity)
    return st.Tree(
        bodies=tuple(_body(model, index) for index in range(model.nbody)),
        free=int(model.jnt_bodyid[free[0]]) if len(free) else None,
        coordinates=tuple((index,) for index in range(model.nq)),
        dofs=tuple((index,) for index in range(model.nv)),
        lanes=1,
        body_places=tuple((index,) for index in range(model.nbody)),
        ground=tuple(ground),
        pairs=tuple(pairs),
        motors=tuple(_motor(model, index) for index in range(model.nu)),
        gyroscopes=_sites(model, mujoco.mjtSensor.mjSENS_GYRO),
        accelerometers=_sites(model, mujoco.mjtSensor.mjSENS_ACCELEROMETER),
        touch_sensors=_sites(model, mujoco.mjtSensor.mjSENS_TOUCH),
        gravity=(x, y, z),
        timestep=float(model.opt.timestep),
        implicit_damping=bool(damped and (model.dof_damping > 0).any()),
    )


def _body(m: mujoco.MjModel, index: int) -> st.Body:
    first, count = m.body_jntadr[index], m.body_jntnum[index]
    hinges = [j for j in range(first, first + count) if m.jnt_type[j] == JOINT.mjJNT_HINGE]
    moment, extra = _moments(m.body_inertia[index], _axes(m.body_iquat[index]))
    return st.Body(
        parent=int(m.body_parentid[index]),
        position=_triple(m.body_pos[index]),
        axes=_axes(m.body_quat[index]),
        mass=float(m.body_mass[index]),
        center=_triple(m.body_ipos[index]),
        moment=moment,
        extra=extra,
        hinges=tuple(_hinge(m, joint) for joint in hinges),
    )


def _moments(moments: np.ndarray, axes: st.Axes) -> tuple[float, tuple[tuple[float, st.Triple], ...]]:
    """The moment that most principal axes share, and by how much those about the others exceed it."""
    same = np.abs(moments[:, None] - moments) <= 1e-12 * moments.max()
    base = float(moments[same.sum(axis=1).argmax()])
    more = [(float(moment) - base, axis) for moment, axis in zip(moments, axes, strict=True)]
    return base, tuple((extra, axis) for extra, axis in more if abs(extra) > 1e-12 * moments.max())


def _hinge(m: mujoco.MjModel, joint: int) -> st.Hinge:
    dof, qpos = int(m.jnt_dofadr[joint]), int(m.jnt_qposadr[joint])
    limit = None
    if m.jnt_limited[joint]:
        lower, upper = (float(x) for x in m.jnt_range[joint])
        softness = _softness(m, m.jnt_solref[joint], m.jnt_solimp[joint])
        limit = st.Limit(lower, upper, float(m.jnt_margin[joint]), float(m.dof_invweight0[dof]), softness)
    return st.Hinge(
        coordinate=qpos,
        dof=dof,
        axis=_triple(m.jnt_axis[joint]),
        anchor=_triple(m.jnt_pos[joint]),
        reference=float(m.qpos0[qpos]),
        armature=float(m.dof_armature[dof]),
        damping=float(m.dof_damping[dof]),
        stiffness=float(np.ravel(m.jnt_stiffness[joint])[0]),
        spring=float(m.qpos_spring[qpos]),
        limit=limit,
    )


def _motor(m: mujoco.MjModel, index: int) -> st.Motor:
    joint = m.actuator_trnid[index, 0]
    affine = m.actuator_biastype[index] == mujoco.mjtBias.mjBIAS_AFFINE
    clamped = m.actuator_ctrllimited[index] and not m.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL
    return st.Motor(
        qpos=int(m.jnt_qposadr[joint]),
        dof=int(m.jnt_dofadr[joint]),
        gear=float(m.actuator_gear[index, 0]),
        gain=float(m.actuator_gainprm[index, 0]),
        bias=_triple(m.actuator_biasprm[index, :3] if affine else np.zeros(3)),
        control=_bounds(m.actuator_ctrlrange[index]) if clamped else None,
        force=_bounds(m.actuator_forcerange[index]) if m.actuator_forcelimited[index] else None,
    )


def _sites(m: mujoco.MjModel, kind: Any) -> tuple[st.Site, ...]:
    """Where the model has sensors of a kind, in their order."""
    found = []
    for index in m.sensor_objid[m.sensor_type == kind]:
        shape, box = m.site_type[index], m.site_type[index] == GEOM.mjGEOM_BOX
        if kind == mujoco.mjtSensor.mjSENS_TOUCH and not box and shape != GEOM.mjGEOM_SPHERE:
            name = m.site(index).name
            raise InputError(f"physics: the tree cannot represent a touch sensor that is no box or ball, as {name!r}.")
        place, axes = _triple(m.site_pos[index]), _axes(m.site_quat[index])
        x, y, z = (float(half) for half in m.site_size[index])
        found.append(st.Site(int(m.site_bodyid[index]), place, axes, bool(box), (x, y, z)))
    return tuple(found)


def _contacts(m: mujoco.MjModel) -> tuple[list[st.GroundPoints], list[st.Pairs]]:
    ground: list[st.GroundPoints] = []
    pairs: list[st.Pairs] = []
    for one, two, surface in [*_explicit_pairs(m), *_implicit_pairs(m)]:
        # As MuJoCo: the plane first, then balls, then capsules.
        one, two = sorted((one, two), key=lambda geom: m.geom_type[geom])
        kinds, name = (m.geom_type[one], m.geom_type[two]), f"{m.geom(one).name}-{m.geom(two).name}"
        round_ones = (int(GEOM.mjGEOM_SPHERE), int(GEOM.mjGEOM_CAPSULE))
        if kinds[0] == GEOM.mjGEOM_PLANE and kinds[1] in round_ones:
            if m.body_weldid[m.geom_bodyid[one]] != 0:
                raise InputError(f"physics: the tree cannot represent a plane that moves, as {m.geom(one).name!r}.")
            ground += _ground_points(m, one, two, surface, len(ground))
        elif kinds[0] in round_ones and kinds[1] in round_ones:
            pairs.append(st.Pairs((_capsule(m, one),), (_capsule(m, two),), surface))
        else:
            words = " and a ".join(GEOM(int(kind)).name.removeprefix("mjGEOM_").lower() for kind in kinds)
            raise InputError(f"physics: the tree cannot represent contacts of a {words}, as those of {name!r}.")
    return ground, pairs


Touching = tuple[int, int, st.Surface]


def _explicit_pairs(m: mujoco.MjModel) -> Iterator[Touching]:
    for i in range(m.npair):
        one, two = int(m.pair_geom1[i]), int(m.pair_geom2[i])
        if np.any(m.pair_gap[i]) or np.any(getattr(m, "pair_adhesion", np.zeros(m.npair))[i]):
            raise InputError("physics: the tree cannot represent a gap or adhesion of contacts.")
        if m.body_weldid[m.geom_bodyid[one]] or m.body_weldid[m.geom_bodyid[two]]:
            values = m.pair_margin[i], m.pair_solref[i], m.pair_solimp[i]
            yield one, two, _surface(m, one, two, int(m.pair_dim[i]), m.pair_friction[i, :2], *values)


def _implicit_pairs(m: mujoco.MjModel) -> Iterator[Touching]:
    """By `contype` and `conaffinity`, less those of one body, of parent and child, and those that are excluded."""
    listed = {frozenset(pair) for pair in zip(m.pair_geom1.tolist(), m.pair_geom2.tolist(), strict=True)}
    excluded = {int(signature) for signature in m.exclude_signature}
    for one in range(m.ngeom):
        for two in range(one + 1, m.ngeom):
            if frozenset((one, two)) in listed or not _may_touch(m, one, two, excluded):
                continue
            if m.geom_gap[[one, two]].any() or np.any(getattr(m, "geom_adhesion", np.zeros(m.ngeom))[[one, two]]):
                raise InputError("physics: the tree cannot represent a gap or adhesion of contacts.")
            mixed: Callable[..., st.Surface] = _mixed_surface
            yield one, two, mixed(m, one, two)


def _may_touch(m: mujoco.MjModel, one: int, two: int, excluded: set[int]) -> bool:
    masks = (m.geom_contype[one] & m.geom_conaffinity[two]) or (m.geom_contype[two] & m.geom_conaffinity[one])
    bodies = sorted(int(m.geom_bodyid[geom]) for geom in (one, two))
    welds = [int(m.body_weldid[body]) for body in bodies]
    if not masks or welds[0] == welds[1] or (bodies[0] << 16) + bodies[1] in excluded:
        return False
    parents = [int(m.body_weldid[m.body_parentid[weld]]) for weld in welds]
    related = all(welds) and (parents[0] == welds[1] or parents[1] == welds[0])
    return not related or bool(m.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)


def _mixed_surface(m: mujoco.MjModel, one: int, two: int) -> st.Surface:
    """What two shapes without an explicit pair agree on: the higher priority's, or a mixture."""
    first, second = sorted((one, two), key=lambda geom: -m.geom_priority[geom])
    margin = m.geom_margin[one] + m.geom_margin[two]
    if m.geom_priority[first] > m.geom_priority[second]:
        values = m.geom_solref[first], m.geom_solimp[first]
        friction, condim = m.geom_friction[first, 0], m.geom_condim[first]
    else:
        weights = m.geom_solmix[[one, two]]
        share = (
            weights[0] / weights.sum() if (weights >= 1e-15).all() else float(np.sign(weights[0] - weights[1]) + 1) / 2
        )
        refs, imps = m.geom_solref[[one, two]], m.geom_solimp[[one, two]]
        solref = share * refs[0] + (1 - share) * refs[1] if (refs[:, 0] > 0).all() else refs.min(axis=0)
        values = solref, share * imps[0] + (1 - share) * imps[1]
        friction, condim = m.geom_friction[[one, two], 0].max(), m.geom_condim[[one, two]].max()
    return _surface(m, one, two, int(condim), np.full(2, friction), margin, *values)


def _surface(
    m: Any, one: int, two: int, condim: int, friction: Any, margin: Any, solref: Any, solimp: Any
) -> st.Surface:
    if condim not in (1, 3):
        name = f"{m.geom(one).name}-{m.geom(two).name}"
        raise InputError(f"physics: the tree cannot represent contacts that resist twisting or rolling, as {name!r}.")
    weight = sum(float(m.body_invweight0[m.geom_bodyid[geom], 0]) for geom in (one, two))
    rough = (
        None if condim == 1 else (max(float(friction[0]), st.FRICTIONLESS), max(float(friction[1]), st.FRICTIONLESS))
    )
    return st.Surface(rough, weight, float(margin), float(m.opt.impratio), _softness(m, solref, solimp))


def _softness(m: mujoco.MjModel, solref: np.ndarray, solimp: np.ndarray) -> st.Softness:
    """MuJoCo's documentation, "Solver parameters": from time constant and damping ratio, or from both directly."""
    time, ratio = (float(x) for x in solref)
    low, high = IMPEDANCES
    dmin, dmax, middle = (min(max(float(solimp[i]), low), high) for i in (0, 1, 3))
    width, power = max(float(solimp[2]), 0.0), max(float(solimp[4]), 1.0)
    if (time > 0) != (ratio > 0):
        raise InputError("physics: both values of a solref must be positive, or neither.")
    if time > 0:
        if not m.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_REFSAFE:
            time = max(time, 2.0 * float(m.opt.timestep))
        return st.Softness(1.0 / (dmax * time * ratio) ** 2, 2.0 / (dmax * time), dmin, dmax, width, middle, power)
    return st.Softness(-time / dmax**2, -ratio / dmax, dmin, dmax, width, middle, power)


def _capsule(m: mujoco.MjModel, geom: int) -> st.Capsule:
    half = float(m.geom_size[geom, 1]) if m.geom_type[geom] == GEOM.mjGEOM_CAPSULE else 0.0
    axis, radius = _axes(m.geom_quat[geom])[2], float(m.geom_size[geom, 0])
    return st.Capsule(int(m.geom_bodyid[geom]), _triple(m.geom_pos[geom]), axis, radius, half)


def _ground_points(
    m: mujoco.MjModel, plane: int, geom: int, surface: st.Surface, first: int
) -> Iterator[st.GroundPoints]:
    data = mujoco.MjData(m)
    mujoco.mj_kinematics(m, data)
    normal = data.geom_xmat[plane].reshape(3, 3)[:, 2]
    shape = _capsule(m, geom)
    ends = (1.0, -1.0) if m.geom_type[geom] == GEOM.mjGEOM_CAPSULE else (0.0,)
    for number, end in enumerate(ends):
        yield st.GroundPoints(
            body=shape.body,
            center=_triple(m.geom_pos[geom] + end * shape.half_length * np.array(shape.axis)),
            radius=shape.radius,
            normal=_triple(normal),
            height=float(normal @ data.geom_xpos[plane]),
            along=shape.axis if end else None,
            surface=surface,
            order=(first + number,),
        )


def _bounds(pair: np.ndarray) -> tuple[float, float]:
    return float(pair[0]), float(pair[1])


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
