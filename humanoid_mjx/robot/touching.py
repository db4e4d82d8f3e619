# pyright: reportAttributeAccessIssue=false
"""Pairs of shapes of a MuJoCo model that may touch, their contact parameters, and the shapes that a robot stands on."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from humanoid_mjx.robot.mjcf import PLAIN, any_of_rows
from humanoid_mjx.spec import InputError, known

FLAGS, GEOM = mujoco.mjtDisableBit, mujoco.mjtGeom
NO_CONTACTS = int(FLAGS.mjDSBL_CONSTRAINT | FLAGS.mjDSBL_CONTACT)
SURPLUS = "gap", "adhesion"
SURPLUS_WORDS = "a gap, adhesion or surface velocity of contacts"

CORNER = 0.25
"""Largest radius of the balls in a box's corners, as a share of half its shorter side."""

GROUND = "package_ground"
"""Name of the plane of a file without one."""

LEVEL = 1e-4
"""Largest height, m, and tilt, degrees, of a plane that counts as z = 0."""


class Touching(NamedTuple):
    """Two shapes that may touch."""

    one: int
    two: int
    """Geoms, in the order in which MuJoCo's collision functions take them."""
    condim: int
    friction: Any
    """Along both tangents."""
    margin: float
    solref: Any
    solimp: Any
    rubbing: Any
    """`solreffriction`, which acts in elliptic cones."""
    surplus: bool
    """True if the model sets a gap, adhesion or a velocity of the surface."""


def touching(m: mujoco.MjModel) -> list[Touching]:
    """The contact parameters of the pairs of `pairs_of`, in its order."""
    own, (one, two) = pairs_of(m)
    pairs = m.pair_dim, m.pair_friction[:, :2], m.pair_margin, m.pair_solref, m.pair_solimp, m.pair_solreffriction
    mixed, pairs = _mixed(m, one[len(own) :], two[len(own) :]), (*pairs, _any(m, "pair", *SURPLUS))
    *columns, surplus = (np.concatenate([part[own], more]) for part, more in zip(pairs, mixed, strict=True))
    surplus |= _any(m, "geom", "surfacevel")[[one, two]].any(axis=0)
    return [Touching(*row) for row in zip(one.tolist(), two.tolist(), *columns, surplus, strict=True)]


def pairs_of(m: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """The explicit pairs of shapes that may touch, and the geoms of these and of all others, (2, pairs).

    The others are those by `contype` and `conaffinity` less those of parent and child and those that are excluded. None
    are of one body, where they move nothing. There are none where the model's contacts are disabled.
    """
    if m.opt.disableflags & NO_CONTACTS:
        return np.zeros(0, int), np.zeros((2, 0), int)
    body, listed = m.geom_bodyid, np.stack([m.pair_geom1, m.pair_geom2])
    weld, related = m.body_weldid[body], not m.opt.disableflags & FLAGS.mjDSBL_FILTERPARENT
    parent, found = m.body_weldid[m.body_parentid[weld]], [np.zeros((2, 0), int)]
    for one in range(m.ngeom):
        may = ((m.geom_contype[one] & m.geom_conaffinity) | (m.geom_contype & m.geom_conaffinity[one])) != 0
        may &= weld != weld[one]
        if related and weld[one]:
            may &= (weld == 0) | ((weld != parent[one]) & (parent != weld[one]))
        two = one + np.flatnonzero(may[one:])
        found.append(np.stack([np.full_like(two, one), two]))
    others = np.concatenate(found, axis=1)
    low, high = np.sort(body[others], axis=0)
    left_out = np.isin((low << 16) + high, m.exclude_signature)
    left_out |= np.isin(m.ngeom * others[0] + others[1], m.ngeom * listed.min(axis=0) + listed.max(axis=0))
    own = np.flatnonzero(weld[listed[0]] != weld[listed[1]])
    geoms = np.concatenate([listed[:, own], others[:, ~left_out]], axis=1)
    return own, np.where(m.geom_type[geoms[0]] <= m.geom_type[geoms[1]], geoms, geoms[::-1])


def kind_of(m: mujoco.MjModel, geom: int) -> str:
    """The shape of a geom: plane, sphere, capsule, box and so on."""
    return word(GEOM, m.geom_type[geom]).replace("hfield", "height field")


def a(shape: str) -> str:
    """A shape with its article."""
    return f"an {shape}" if shape == "ellipsoid" else f"a {shape}"


def word(kind: Any, value: Any) -> str:
    """A value of one of MuJoCo's enumerations: `mjGEOM_SPHERE` is "sphere"."""
    return kind(int(value)).name.partition("_")[2].lower()


def named(m: mujoco.MjModel, geom: int) -> str:
    """A geom by its own name, or by its body's."""
    body = int(m.geom_bodyid[geom])
    return repr(m.geom(geom).name or m.body(body).name or f"body {body}")


def _mixed(m: mujoco.MjModel, one: np.ndarray, two: np.ndarray) -> Iterator[Any]:
    """Columns of `Touching` of pairs that are not explicit: the higher priority's, or mixtures."""
    margin, ahead = m.geom_margin[one] + m.geom_margin[two], m.geom_priority[one] - m.geom_priority[two]
    surplus = _any(m, "geom", *SURPLUS)[[one, two]].any(axis=0)
    both = np.stack([np.where(ahead < 0, two, one), np.where(ahead > 0, one, two)])
    weights = m.geom_solmix[both]
    share = np.sign(weights[0] - weights[1]) / 2.0 + 0.5
    np.divide(weights[0], weights.sum(axis=0), out=share, where=weights.min(axis=0) >= mujoco.mjMINVAL)
    refs, imps = m.geom_solref[both], m.geom_solimp[both]
    solref, solimp = (share[:, None] * first + (1.0 - share[:, None]) * second for first, second in (refs, imps))
    solref = np.where((refs[:, :, :1] <= 0).any(axis=0), refs.min(axis=0), solref)
    yield from (m.geom_condim[both].max(axis=0), m.geom_friction[both, :1].max(axis=0).repeat(2, axis=1))
    yield from (margin, solref, solimp, np.zeros_like(solref), surplus)


def _any(m: mujoco.MjModel, kind: str, *names: str) -> np.ndarray:
    """True for elements where one of these fields is not 0."""
    return np.any([any_of_rows(getattr(m, f"{kind}_{name}")) for name in names], axis=0)


def soles_of(model: mujoco.MjModel, feet: Sequence[str], chosen: Sequence[str]) -> list[Touching]:
    """Return the contacts of the shapes on which these bodies stand, body by body: of the geoms named, else of those
    that can touch the ground, else of those that can touch anything. `one` is the ground and `two` the shape; where no
    plane of the file can touch it, `one` is -1 and the contact has the shape's own parameters.

    Raises:
      InputError: a body has no such shape, or the ground under one is no level plane at z = 0.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    ground, found, masks = {}, [], model.geom_contype | model.geom_conaffinity
    bodies = [model.body(body).name for body in range(model.nbody)]
    if strange := [foot for foot in feet if foot not in bodies]:
        raise InputError(f"feet: the model has no body {strange[0]!r}; {known(strange[0], bodies)}")
    geoms = [np.flatnonzero(model.geom_bodyid == model.body(foot).id).tolist() for foot in feet]
    if chosen:
        geoms = [[geom for geom in own if model.geom(geom).name in chosen] for own in geoms]
    for pair in touching(model):
        for base, geom in ((pair.one, pair.two), (pair.two, pair.one)):
            if any(geom in own for own in geoms) and not model.body_weldid[model.geom_bodyid[base]]:
                if geom in ground and base in ground[geom][:2]:
                    both = f"{named(model, base)} and {named(model, geom)}"
                    raise InputError(f"model: two <pair> are of {both}; keep one of them")
                fault = _fault(model, data, base) or (geom in ground and "the second ground that it can touch")
                if fault:
                    raise InputError(
                        f"model: {named(model, geom)} can touch {named(model, base)}, {fault}; the ground is one "
                        'level plane at z = 0: move this there, or write contype="0" conaffinity="0" for it'
                    )
                ground[geom] = pair
    for foot, own in zip(feet, geoms, strict=True):
        used = own if chosen else [geom for geom in own if geom in ground] or [geom for geom in own if masks[geom]]
        if not used:
            named_ones = ", ".join(filter(None, (model.geom(geom).name for geom in own))) or "none has a name"
            raise InputError(f"feet: {foot} has no geom that touches; name its geom that is to: {named_ones}")
        found += [ground.get(geom) or _alone(model, geom) for geom in used]
    return found


def _fault(model: mujoco.MjModel, data: mujoco.MjData, base: int) -> str:
    """Words for a shape of the world that is no level plane at z = 0; none for one."""
    if model.geom_type[base] != GEOM.mjGEOM_PLANE:
        return f"{a(kind_of(model, base))} in the world"
    up, height = data.geom_xmat[base, 8], data.geom_xpos[base, 2]
    tilt = np.degrees(np.arccos(np.clip(up, -1.0, 1.0)))
    words = f"at z = {height:.3g} m" if abs(height) > LEVEL else ""
    return f"tilted by {tilt:.3g} degrees" if tilt > LEVEL else words


def _alone(m: mujoco.MjModel, geom: int) -> Touching:
    """Contact parameters of a shape with a plane that decides nothing but that there is friction."""
    condim = max(int(m.geom_condim[geom]), 3)
    softness = m.geom_margin[geom], m.geom_solref[geom], m.geom_solimp[geom], np.zeros(2)
    return Touching(-1, geom, condim, m.geom_friction[geom, [0, 0]], *softness, False)


def balls_of(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> list[tuple[Float[np.ndarray, "3"], float]]:
    """Return the balls of a shape that the ground can push: their places in the body's frame and their radius, m.

    Raises:
      InputError: the shape is no ball, capsule, box or mesh.
    """
    size, kind = model.geom_size[geom], model.geom_type[geom]
    radius, centers = float(size[0]), np.zeros((1, 3))
    if kind == GEOM.mjGEOM_CAPSULE:
        centers = np.array([[0.0, 0.0, size[1]], [0.0, 0.0, -size[1]]])
    elif kind == GEOM.mjGEOM_BOX:
        upright = data.geom_xmat[geom].reshape(3, 3)[2]
        down = int(np.abs(upright).argmax())
        others = [axis for axis in range(3) if axis != down]
        radius = float(min(CORNER * size[others].min(), size[down]))
        corners = np.full((4, 3), -np.sign(upright[down]))
        corners[:, others] = [(1, 1), (1, -1), (-1, 1), (-1, -1)]
        centers = corners * (size - radius)
    elif kind == GEOM.mjGEOM_MESH:
        return _under_hull(model, data, geom)
    elif kind != GEOM.mjGEOM_SPHERE:
        foot = model.body(model.geom_bodyid[geom]).name
        what = f"{foot} has {a(kind_of(model, geom))}, {model.geom(geom).name!r}"
        raise InputError(f"feet: {what}; name geoms that are balls, capsules, boxes or meshes")
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    return [(place, radius) for place in model.geom_pos[geom] + centers @ rotation.reshape(3, 3).T]


def _under_hull(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> list[tuple[np.ndarray, float]]:
    """Balls in the four outermost places, fore and aft, left and right, of the lowest tenth of a mesh at home."""
    mesh, body = model.geom_dataid[geom], model.geom_bodyid[geom]
    own = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
    points = own @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
    ground, signs = points[:, 2].min(), np.array([(1, 1), (1, -1), (-1, 1), (-1, -1)])
    low = points[points[:, 2] <= ground + 0.1 * np.ptp(points[:, 2]), :2]
    corners = np.array([low[(low @ sign).argmax()] for sign in signs])
    radius = CORNER * max(np.ptp(corners, axis=0).min(), 0.1 * np.ptp(points, axis=0).min()) / 2
    centers = np.column_stack([corners - radius * signs, np.full(4, ground + radius)])
    return [(place, radius) for place in (centers - data.xpos[body]) @ data.xmat[body].reshape(3, 3)]


def strip(spec: mujoco.MjSpec, feet_only: bool) -> None:
    """Remove what the package replaces: actuators, sensors, keyframes, planes, contacts with the world and, with
    `feet_only`, all others; the integrator, a solver that stops early, and what is switched off."""
    world = {geom.name for geom in spec.worldbody.geoms}
    pairs = [pair for pair in spec.pairs if feet_only or {pair.geomname1, pair.geomname2} & world]
    planes = [geom for geom in spec.worldbody.geoms if geom.type == GEOM.mjGEOM_PLANE]
    for element in [*spec.actuators, *spec.sensors, *spec.keys, *pairs, *planes]:
        spec.delete(element)
    for geom in spec.geoms if feet_only else spec.worldbody.geoms:
        geom.contype = geom.conaffinity = 0
    option, off = spec.option, mujoco.mjtDisableBit
    if option.integrator in (mujoco.mjtIntegrator.mjINT_IMPLICIT, mujoco.mjtIntegrator.mjINT_IMPLICITFAST):
        option.disableflags &= ~int(off.mjDSBL_EULERDAMP)  # these damp the joints implicitly
    option.integrator, option.solver = mujoco.mjtIntegrator.mjINT_EULER, mujoco.mjtSolver.mjSOL_NEWTON
    option.disableactuator = 0
    option.iterations, option.ls_iterations = max(option.iterations, 100), max(option.ls_iterations, 50)
    option.tolerance, option.ls_tolerance = min(option.tolerance, 1e-8), min(option.ls_tolerance, 0.01)
    option.disableflags &= ~int(
        off.mjDSBL_CONTACT | off.mjDSBL_ACTUATION | off.mjDSBL_CONSTRAINT | off.mjDSBL_CLAMPCTRL
    )


def add_ground(spec: mujoco.MjSpec, model: mujoco.MjModel, soles: Sequence[Touching]) -> None:
    """Add a plane z = 0 to a file without one. All that can touch anything touches it, and the soles, which rub on it
    whatever their condim; its own contact parameters count nothing."""
    shapes = [next(shape for shape in spec.geoms if shape.id == sole.two) for sole in soles]
    plane = {"type": GEOM.mjGEOM_PLANE, "size": (0.0, 0.0, 0.05), "priority": int(model.geom_priority.min()) - 1}
    spec.worldbody.add_geom(PLAIN, name=GROUND, contype=(1 << 31) - 1, conaffinity=(1 << 31) - 1, **plane)
    for index, (shape, sole) in enumerate(zip(shapes, soles, strict=True)):
        if not shape.contype | shape.conaffinity or shape.condim < sole.condim:
            shape.name = shape.name or f"sole{index}"
            pair = spec.add_pair(PLAIN, geomname1=GROUND, geomname2=shape.name, margin=shape.margin, gap=shape.gap)
            pair.condim, pair.friction = sole.condim, model.geom_friction[sole.two][[0, 0, 1, 2, 2]]
            pair.solref, pair.solimp = shape.solref, shape.solimp
