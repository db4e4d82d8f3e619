# pyright: reportAttributeAccessIssue=false
"""Postures of the lower body on the ground as solid bodies, in space, without OpenGL."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from humanoid_mjx.report.style import COLORS, figure
from humanoid_mjx.robot.lower_body import lower_body_model

TILE_M = 0.05
"""Side of the squares on the ground, m."""

TILES = 3
"""Squares from the middle to each side."""

LIGHT = np.array([0.5, -0.6, 0.62])
"""Direction from which the light comes, a unit vector."""

ROUND = 16
"""Faces around a link."""


def draw_postures(path: Path, title: str, postures: Sequence[tuple[str, Float[np.ndarray, " angles"]]]) -> None:
    """A panel for each posture, its lowest point on the ground.

    Args:
      path: of the figure.
      title: its heading.
      postures: words, and the ten joints, the right leg's first, rad, of an upright body, or `qpos` of any.
    """
    with figure(path, 1, len(postures), size=(3.5, 4.4), subplot_kw={"projection": "3d"}) as (fig, axes):
        for panel, (words, joints) in zip(axes[0], postures, strict=True):
            _draw(panel, joints)
            panel.set_title(words, loc="center", fontsize=8.5)
        fig.suptitle(
            f"{title}\nRight leg blue, left leg orange, forwards is to the right; squares of {1e3 * TILE_M:g} mm",
            x=0.02,
            ha="left",
            fontsize="medium",
        )


def _draw(panel: Any, angles: Float[np.ndarray, " angles"]) -> None:
    model = lower_body_model()
    data = mujoco.MjData(model)
    data.qpos[model.nq - len(angles) :] = angles
    mujoco.mj_kinematics(model, data)
    faces, colors = _ground()
    solid = [(_color(model, geom), face) for geom in range(model.ngeom) for face in _faces(model, data, geom)]
    lowest = np.array([0.0, 0.0, min(face[:, 2].min() for _, face in solid)])
    faces += [face - lowest for _, face in solid]
    colors += [_shaded(face, color) for color, face in solid]
    panel.add_collection3d(Poly3DCollection(faces, facecolors=colors, edgecolors="none", zsort="average"))
    side = TILES * TILE_M
    panel.set(xlim=(-side, side), ylim=(-side, side), zlim=(-0.01, 2 * side - 0.01))
    panel.set_box_aspect((1, 1, 1), zoom=1.3)
    panel.view_init(elev=10, azim=-52)
    panel.set_axis_off()


def _color(model: mujoco.MjModel, geom: int) -> Any:
    name = model.body(int(model.geom_bodyid[geom])).name
    return COLORS[0] if name.startswith("right") else COLORS[1] if name.startswith("left") else "#8c8c8c"


def _ground() -> tuple[list[np.ndarray], list[Any]]:
    """Squares in two greys, just below the soles."""
    places = range(-TILES, TILES)
    square = TILE_M * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    faces = [square + np.array([i * TILE_M, j * TILE_M, -1e-3]) for i in places for j in places]
    return faces, ["0.93" if (i + j) % 2 else "0.85" for i in places for j in places]


def _shaded(face: np.ndarray, color: Any) -> Any:
    from matplotlib.colors import to_rgb

    normal = np.cross(face[1] - face[0], face[2] - face[0])
    bright = abs(normal @ LIGHT) / (np.linalg.norm(normal) + 1e-12)
    return tuple(np.array(to_rgb(color)) * (0.55 + 0.45 * bright))


def _faces(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> list[np.ndarray]:
    """The polygons of a box or a capsule in the world; geoms that only make contact are left out."""
    kind, name = model.geom_type[geom], model.geom(geom).name
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        c = _corners(model, data, geom)
        return [c[[0, 1, 3, 2]], c[[4, 5, 7, 6]], c[[0, 1, 5, 4]], c[[2, 3, 7, 6]], c[[0, 2, 6, 4]], c[[1, 3, 7, 5]]]
    if kind == mujoco.mjtGeom.mjGEOM_PLANE or name.endswith("sole") or "corner" in name:
        return []
    radius, half = model.geom_size[geom][0], model.geom_size[geom][1] if kind == mujoco.mjtGeom.mjGEOM_CAPSULE else 0.0
    around, up = np.linspace(0, 2 * np.pi, ROUND + 1), np.linspace(-np.pi / 2, np.pi / 2, ROUND // 2 + 1)
    heights = radius * np.sin(up) + np.where(up > 0, half, -half)
    rings = np.stack(
        [
            np.outer(radius * np.cos(up), np.cos(around)),
            np.outer(radius * np.cos(up), np.sin(around)),
            np.repeat(heights[:, None], ROUND + 1, axis=1),
        ],
        axis=-1,
    )
    rings = data.geom_xpos[geom] + rings @ data.geom_xmat[geom].reshape(3, 3).T
    return [
        np.array([rings[i, j], rings[i, j + 1], rings[i + 1, j + 1], rings[i + 1, j]])
        for i in range(len(up) - 1)
        for j in range(ROUND)
    ]


def _corners(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> Float[np.ndarray, "8 3"]:
    """Corners of a box in the world, m; the last axis changes fastest."""
    signs = np.stack(np.meshgrid(*[(-1, 1)] * 3, indexing="ij"), axis=-1).reshape(8, 3)
    return data.geom_xpos[geom] + (signs * model.geom_size[geom]) @ data.geom_xmat[geom].reshape(3, 3).T
