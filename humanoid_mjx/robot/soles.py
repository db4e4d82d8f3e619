# pyright: reportAttributeAccessIssue=false
"""Shapes of a user's model that stand on the ground: MuJoCo's own contact of each, and the balls that stand for it."""

from collections.abc import Sequence

import mujoco
import numpy as np
from jaxtyping import Float

from humanoid_mjx.robot.touching import Touching, kind_of, named, touching
from humanoid_mjx.spec import InputError

CORNER = 0.25
"""Largest radius of the balls in a box's corners, as a share of half its shorter side."""

LEVEL = 1e-4
"""Largest height, m, and tilt, degrees, of a plane that counts as z = 0."""

GEOM = mujoco.mjtGeom


def soles_of(model: mujoco.MjModel, feet: Sequence[str], chosen: Sequence[str]) -> list[Touching]:
    """Return the contacts of the shapes on which these bodies stand, body by body: of the geoms named, else of those
    that can touch the ground, else of those that can touch anything.

    `one` is the ground and `two` the shape. Where no plane of the file can touch it, `one` is -1 and the contact has
    the shape's own parameters.

    Raises:
      InputError: a body has no such shape, or the ground under one is no level plane at z = 0.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    ground, found, masks = {}, [], model.geom_contype | model.geom_conaffinity
    geoms = [np.flatnonzero(model.geom_bodyid == model.body(foot).id).tolist() for foot in feet]
    if chosen:
        geoms = [[geom for geom in own if model.geom(geom).name in chosen] for own in geoms]
    for pair in touching(model):
        for base, geom in ((pair.one, pair.two), (pair.two, pair.one)):
            if any(geom in own for own in geoms) and not model.body_weldid[model.geom_bodyid[base]]:
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
            raise InputError(f"feet: {foot} has no geom that touches")
        found += [ground.get(geom) or _alone(model, geom) for geom in used]
    return found


def _fault(model: mujoco.MjModel, data: mujoco.MjData, base: int) -> str:
    """Words for a shape of the world that is no level plane at z = 0; none for one."""
    if model.geom_type[base] != GEOM.mjGEOM_PLANE:
        return f"a {kind_of(model, base)} in the world"
    up, height = data.geom_xmat[base, 8], data.geom_xpos[base, 2]
    tilt = np.degrees(np.arccos(np.clip(up, -1.0, 1.0)))
    words = f"at z = {height:.3g} m" if abs(height) > LEVEL else ""
    return f"tilted by {tilt:.3g} degrees" if tilt > LEVEL else words


def _alone(m: mujoco.MjModel, geom: int) -> Touching:
    """Contact parameters of a shape with a plane that decides nothing."""
    softness = m.geom_margin[geom], m.geom_solref[geom], m.geom_solimp[geom]
    return Touching(-1, geom, 3, m.geom_friction[geom, [0, 0]], *softness, False)


def balls_of(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> list[tuple[Float[np.ndarray, "3"], float]]:
    """Return the balls of a shape that the ground can push: their places in the body's frame and their radius, m.

    Raises:
      InputError: the shape is no ball, capsule or box.
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
    elif kind != GEOM.mjGEOM_SPHERE:
        foot = model.body(model.geom_bodyid[geom]).name
        what = f"{foot} has a {kind_of(model, geom)}, {model.geom(geom).name!r}"
        raise InputError(f"feet: {what}; name geoms that are balls, capsules or boxes")
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    return [(place, radius) for place in model.geom_pos[geom] + centers @ rotation.reshape(3, 3).T]


def strip(spec: mujoco.MjSpec, feet_only: bool) -> None:
    """Remove what the package replaces: actuators, sensors, keyframes, planes, contacts with the world and, with
    `feet_only`, all others; the integrator, the cone, a solver that stops early, and what is switched off."""
    world = {geom.name for geom in spec.worldbody.geoms}
    pairs = [pair for pair in spec.pairs if feet_only or {pair.geomname1, pair.geomname2} & world]
    planes = [geom for geom in spec.worldbody.geoms if geom.type == GEOM.mjGEOM_PLANE]
    for element in [*spec.actuators, *spec.sensors, *spec.keys, *pairs, *planes]:
        spec.delete(element)
    for geom in spec.geoms if feet_only else spec.worldbody.geoms:
        geom.contype = geom.conaffinity = 0
    option = spec.option
    option.integrator, option.cone = mujoco.mjtIntegrator.mjINT_EULER, mujoco.mjtCone.mjCONE_PYRAMIDAL
    option.solver, option.disableactuator = mujoco.mjtSolver.mjSOL_NEWTON, 0
    option.iterations, option.ls_iterations = max(option.iterations, 100), max(option.ls_iterations, 50)
    option.tolerance, option.ls_tolerance = min(option.tolerance, 1e-8), min(option.ls_tolerance, 0.01)
    option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_ACTUATION)
