# pyright: reportAttributeAccessIssue=false
"""A terrain as shapes of native MuJoCo: stairs as boxes, waves as planes that follow the feet.

Each ball of a foot has a plane of its own, which touches the waves below it. A height field is no such ground: a ball
collides with the prisms under it, whose sides are walls. On cells of 25 mm a corner of the lower body's feet, a ball of
0.5 mm that is 1 mm deep, is pushed off the true normal by more than 15 degrees in 15% of all places.
"""

import mujoco
import numpy as np
from jaxtyping import Float

from humanoid_mjx.mechanics.terrain import Terrain
from humanoid_mjx.robot.mjcf import PLAIN

HALF = 20.0
"""Half the width of the stairs, m: farther than any gait walks in an episode of 20 s."""

STEPS = 80
"""Boxes on each side of the origin."""

BENEATH = 1000.0
"""Depth to which the plane is moved that a terrain replaces, m."""


def add_terrain(spec: mujoco.MjSpec, terrain: Terrain) -> None:
    """Replace the planes of a model by a terrain of plain numbers; contacts with a plane become those with the terrain.

    A slope is left to `option.gravity`, and the places of the planes that follow balls to `follow`.
    """
    pairs = list(spec.pairs)
    for plane in [geom for geom in spec.geoms if geom.type == mujoco.mjtGeom.mjGEOM_PLANE]:
        felt = [
            (pair, both[both[0] == plane.name])
            for pair in pairs
            if plane.name in (both := (pair.geomname1, pair.geomname2))
        ]
        if terrain.stairs is None:
            for pair, ball in felt:
                name = f"below_{ball}"
                spec.worldbody.add_geom(PLAIN, name=name, type=plane.type, size=plane.size, contype=0, conaffinity=0)
                _copied(pair, spec.add_pair(PLAIN, geomname1=name, geomname2=ball), PAIR)
        for index in range(-STEPS, STEPS) if terrain.stairs is not None else ():
            name = f"{plane.name}_{index}"
            _copied(plane, spec.worldbody.add_geom(PLAIN, name=name, **_step(terrain, index)), GEOM)
            for pair, ball in felt:
                _copied(pair, spec.add_pair(PLAIN, geomname1=name, geomname2=ball), PAIR)
        plane.pos = np.subtract(plane.pos, (0.0, 0.0, BENEATH))


def follow(model: mujoco.MjModel, data: mujoco.MjData, qpos: Float[np.ndarray, " nq"], terrain: Terrain) -> None:
    """Put the planes of a model under the balls of a world, where they touch the waves."""
    names = [model.geom(index).name for index in range(model.ngeom)]
    planes = [index for index, name in enumerate(names) if name.startswith("below_")]
    balls = [names.index(names[plane].removeprefix("below_")) for plane in planes]
    data.qpos = qpos
    mujoco.mj_kinematics(model, data)
    x, y = data.geom_xpos[balls, :2].T
    height, along_x, along_y = terrain.waves(x, y, np)
    model.geom_sameframe[planes] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
    model.geom_pos[planes] = np.stack([x, y, height], axis=1)
    for plane, normal in zip(planes, np.stack([-along_x, -along_y, np.ones(len(x))], axis=1), strict=True):
        mujoco.mju_quatZ2Vec(model.geom_quat[plane], normal)


GEOM = "contype", "conaffinity", "condim", "priority", "friction", "solmix", "solref", "solimp", "margin", "gap", "rgba"
PAIR = "condim", "friction", "solref", "solreffriction", "solimp", "margin", "gap"


def _copied(source: object, target: object, names: tuple[str, ...]) -> None:
    for name in names:
        setattr(target, name, getattr(source, name))


def _step(terrain: Terrain, index: int) -> dict[str, object]:
    """The box under the step of this number, which is deeper than a body can fall."""
    width, height, angle = float(terrain.width), index * float(terrain.stairs or 0.0), np.radians(terrain.direction)
    along, deep = (index + 0.5) * width, 1.0
    return {
        "type": mujoco.mjtGeom.mjGEOM_BOX,
        "size": (width / 2, HALF, deep),
        "pos": (along * np.cos(angle), along * np.sin(angle), height - deep),
        "quat": (np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)),
    }
