# pyright: reportAttributeAccessIssue=false
"""A terrain as shapes of native MuJoCo: stairs as boxes, waves as a height field.

MuJoCo collides a ball with every prism of a height field that the ball overlaps, and prisms are flat. So a field is not
the same ground as the heights that it samples: with its cells of 25 mm, normals differ by a degree or two, heights by
up to 0.03 of `rough` where `wavelength` is 0.3 m, and a ball near the edge of a prism has several contacts.
"""

import mujoco
import numpy as np

from humanoid_mjx.mechanics.terrain import Terrain

HALF = 20.0
"""Half the edge of the height field, m: farther than any gait walks in an episode of 20 s."""

CELLS = 1600
"""Along an edge of the height field."""

STEPS = 80
"""Boxes on each side of the origin."""

BENEATH = 1000.0
"""How far down the plane is that a terrain replaces, m."""


def add_terrain(spec: mujoco.MjSpec, terrain: Terrain) -> None:
    """Replace the planes of a model by a terrain of plain numbers; what felt a plane feels the terrain as it did.

    A slope is left to `option.gravity`.
    """
    if terrain.stairs is not None:
        shapes = [_step(terrain, index) for index in range(-STEPS, STEPS)]
    else:
        places = np.linspace(-HALF, HALF, CELLS + 1)
        heights = terrain.height(places, places[:, None], np)
        low, size = heights.min(), (HALF, HALF, max(np.ptp(heights), 1e-9), 1.0)
        spec.add_hfield(name="terrain", nrow=CELLS + 1, ncol=CELLS + 1, size=size, userdata=heights.ravel())
        shapes = [{"type": mujoco.mjtGeom.mjGEOM_HFIELD, "hfieldname": "terrain", "pos": (0.0, 0.0, low)}]
    pairs = list(spec.pairs)
    for plane in [geom for geom in spec.geoms if geom.type == mujoco.mjtGeom.mjGEOM_PLANE]:
        for index, shape in enumerate(shapes):
            name = f"{plane.name}_{index}"
            _copied(plane, spec.worldbody.add_geom(name=name, **shape), GEOM)
            for pair in pairs:
                names = [name if own == plane.name else own for own in (pair.geomname1, pair.geomname2)]
                if name in names:
                    _copied(pair, spec.add_pair(geomname1=names[0], geomname2=names[1]), PAIR)
        plane.pos = np.subtract(plane.pos, (0.0, 0.0, BENEATH))


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
