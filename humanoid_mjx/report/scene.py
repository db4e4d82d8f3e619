# pyright: reportAttributeAccessIssue=false
"""A robot to be drawn: its shapes and their places in each frame, the camera, the light; and the same as a piece of a
web page that is played in the browser, seen from any side (`player.js`)."""

import json
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any, NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from humanoid_mjx.evaluation.film import Film
from humanoid_mjx.mechanics.terrain import Terrain
from humanoid_mjx.robot.description import two_digits
from humanoid_mjx.types import AnyArray

VIEW = 1.12
"""Least height of a picture, as a share of the robot's extent: all of it and some room."""

AZIMUTH, ELEVATION = 130.0, -12.0
"""Direction in which the camera looks, degrees: from the right and the front of the robot, a little downwards."""

FIELD_OF_VIEW = 45.0
"""Degrees from top to bottom, as MuJoCo's own camera has."""

LIGHT = np.array([-0.5, 0.25, -0.85]) / np.linalg.norm([-0.5, 0.25, -0.85])
"""Direction in which the light falls."""

AMBIENT, DIFFUSE, HEADLIGHT, SKYLIGHT = 0.5, 0.45, 0.2, 0.2
"""Brightness of a surface: everywhere, where the light falls at right angles, and where it faces the camera; and by
what share the first is more where it faces up, and less where down."""

GRID, ARROW = 0.31, 0.336
"""Distance between the lines on the ground, which show how far a robot goes, and length of a push's arrow, as shares of
the robot's extent. The arrow's words say how hard a push is, as a reader could only guess a length."""

VISIBLE_GROUPS = 3
"""Geoms of groups below this are drawn, as in MuJoCo's own viewer; the others serve contacts."""

_KINDS = {
    mujoco.mjtGeom.mjGEOM_SPHERE: "sphere",
    mujoco.mjtGeom.mjGEOM_CAPSULE: "capsule",
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: "ellipsoid",
    mujoco.mjtGeom.mjGEOM_CYLINDER: "cylinder",
    mujoco.mjtGeom.mjGEOM_BOX: "box",
}


class Scene(NamedTuple):
    """A motion of shapes, and the camera that follows it."""

    model: mujoco.MjModel
    qpos: Float[np.ndarray, "frames nq"]
    shown: list[int]
    """The geoms that are drawn, but for planes: one for each shape."""
    position: Float[np.ndarray, "frames shapes 3"]
    """Positions of the shapes, m, world: x forward, y to the left, z up."""
    rotation: Float[np.ndarray, "frames shapes 3 3"]
    """Rotations from each shape's axes to the world's."""
    middle: Float[np.ndarray, "frames 3"]
    """Point that the camera looks at, m."""
    torso: Float[np.ndarray, "frames 3"]
    """Point at which a push acts, m."""
    view: float
    """Metres from top to bottom in which every posture has room."""
    ground: bool
    terrain: Terrain | None = None
    """The shape of the ground; none: a level plane."""

    @property
    def grid(self) -> float:
        """Distance between the lines on the ground, m; 0 without a ground."""
        return _share(self.model, GRID) if self.ground else 0.0

    @property
    def arrow(self) -> float:
        """Length of a push's arrow, m."""
        return _share(self.model, ARROW)

    @property
    def distance(self) -> float:
        """From the camera to where it looks, m."""
        return 0.58 * self.view / np.tan(np.radians(FIELD_OF_VIEW / 2))


def make_scene(model: mujoco.MjModel, qpos: Float[AnyArray, "frames nq"], terrain: Terrain | None = None) -> Scene:
    """The shapes of a robot in each posture. Meshes appear as the boxes around them."""
    rows, data = np.asarray(qpos, np.float64), mujoco.MjData(model)
    planes, frames = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE, []
    solid, grounded = np.flatnonzero(~planes).tolist(), bool(planes.any())
    shown = [g for g in solid if model.geom_group[g] < VISIBLE_GROUPS]
    if not {*model.geom_bodyid[shown]} >= {1} & {*model.geom_bodyid[solid]}:  # the looks of the torso are not there
        shown = solid
    for row in rows:
        data.qpos = row
        mujoco.mj_kinematics(model, data)
        frames.append((*posed(model, data, shown), data.xpos[1].copy()))
    position, turns, torso = map(np.stack, zip(*frames, strict=True))
    middle = torso.copy()
    below = terrain.level(*middle[:, :2].T) if terrain else np.zeros(len(rows))
    above = position - below[:, None, None] * [0.0, 0.0, 1.0]
    view, middle[:, 2] = _framing(model, above, middle, model.geom_rbound[shown], grounded)
    middle[:, 2] += below
    return Scene(model, rows, shown, position, turns, middle, torso, view, grounded, terrain)


def _framing(
    model: mujoco.MjModel,
    position: Float[np.ndarray, "frames shapes 3"],
    torso: Float[np.ndarray, "frames 3"],
    radius: Float[np.ndarray, " shapes"],
    grounded: bool,
) -> tuple[float, float]:
    """Metres from top to bottom in which every posture has room between the words above and below, and the height of
    the middle: it follows the robot over the ground, not up and down, or hangs below it."""
    high, low = (position[..., 2] + radius).max(), (position[..., 2] - radius).min()
    wide = (np.abs(position[..., :2] - torso[:, None, :2]) + radius[:, None]).max()
    hangs = float(model.body_pos[1][2])
    needed = high / 0.88 if grounded else max((hangs - low) / 0.9, (high - hangs) / 0.17)
    view = max(_share(model, VIEW), float(needed), float(wide) / 0.7)
    return view, 0.42 * view if grounded else hangs - 0.33 * view


def posed(
    model: mujoco.MjModel, data: mujoco.MjData, shown: Sequence[int]
) -> tuple[Float[np.ndarray, "shapes 3"], Float[np.ndarray, "shapes 3 3"]]:
    """Positions and rotations of the shapes of some geoms, as the data has them."""
    turns, known = data.geom_xmat[shown].reshape(-1, 3, 3).copy(), [int(kind) for kind in _KINDS]
    is_box = ~np.isin(model.geom_type[shown], known)[:, None]  # around a mesh, whose place is not the box's middle
    offsets = np.where(is_box, model.geom_aabb[shown, :3], 0.0)
    return data.geom_xpos[shown] + np.einsum("sij,sj->si", turns, offsets), turns


def colored(model: mujoco.MjModel, geom: int) -> tuple[float, ...]:
    """The colour of a geom."""
    rgba = model.geom_rgba[geom] if model.geom_matid[geom] < 0 else model.mat_rgba[model.geom_matid[geom]]
    return tuple(rgba.tolist())


def _share(model: mujoco.MjModel, share: float) -> float:
    """A share of the extent of a robot, m, to two digits."""
    return two_digits(share * model.stat.extent)


def shape_of(model: mujoco.MjModel, geom: int) -> dict[str, Any]:
    """A geom as `player.js` draws it: kind, size as MuJoCo has it (radius and half lengths, m), and colour, 0 to 1."""
    kind = _KINDS.get(mujoco.mjtGeom(model.geom_type[geom]))
    size = model.geom_size[geom] if kind else model.geom_aabb[geom, 3:]
    size = size[[0, 0, 0]] if kind == "sphere" else size
    return {"kind": kind or "box", "size": rounded(size), "color": rounded(colored(model, geom)[:3])}


class Camera(NamedTuple):
    """A pinhole camera that looks in a fixed direction."""

    right: Float[np.ndarray, "3"]
    up: Float[np.ndarray, "3"]
    forward: Float[np.ndarray, "3"]
    focus: float
    """Pixels on the picture for a unit of the tangent."""

    def place(self, middle: Float[np.ndarray, "3"], distance: float) -> Float[np.ndarray, "3"]:
        """Position of the camera, m, that looks at `middle` from a distance."""
        return middle - distance * self.forward

    def seen(
        self, points: Float[np.ndarray, "points 3"], place: Float[np.ndarray, "3"], size: tuple[int, int]
    ) -> Float[np.ndarray, "points 2"]:
        """Pixels, to the right and downwards, of points in the world on a picture of (width, height)."""
        away = points - place
        depth = np.maximum(away @ self.forward, 1e-6)
        across, upwards = away @ self.right / depth, away @ self.up / depth
        return np.stack([size[0] / 2 + self.focus * across, size[1] / 2 - self.focus * upwards], axis=1)


def make_camera(height: int) -> Camera:
    """The camera of `AZIMUTH`, `ELEVATION` and `FIELD_OF_VIEW` for pictures of so many pixels from top to bottom."""
    azimuth, elevation = np.radians(AZIMUTH), np.radians(ELEVATION)
    forward = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    focus = height / 2 / np.tan(np.radians(FIELD_OF_VIEW / 2))
    return Camera(right, np.cross(right, forward), forward, float(focus))


PLAYER_FPS = 25.0
"""Postures per second that a page holds; the player draws what lies between."""


def player(data: dict[str, Any], still: str = "") -> str:
    """The HTML that `player.js` makes a player of; `still` is what stands there without JavaScript, as HTML."""
    text = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    return (
        f'<figure class="player"><div class="stage">{still}</div>'
        f'<script type="application/json">{text}</script><figcaption>{escape(data["title"])}</figcaption></figure>'
    )


def scene_data(motion: Scene, title: str) -> dict[str, Any]:
    """Return what `player.js` reads of any robot: light and camera, and shapes."""
    return {
        "title": title,
        "yaw": np.radians(AZIMUTH),
        "pitch": np.radians(ELEVATION),
        "field": np.tan(np.radians(FIELD_OF_VIEW / 2)),
        "distance": motion.distance,
        "light": LIGHT.tolist(),
        "brightness": [AMBIENT, DIFFUSE, HEADLIGHT, SKYLIGHT],
        "middle": float(motion.middle[0, 2]),
        "grid": motion.grid,
        "arrow": motion.arrow,
        "shapes": [shape_of(motion.model, geom) for geom in motion.shown],
    }


def film_data(film: Film) -> dict[str, Any]:
    """Return what `player.js` reads of a film: the scene, and for each frame a position, m, and a quaternion (w x y z)
    of each shape."""
    motion = make_scene(film.model, film.at(PLAYER_FPS)[0], film.terrain)
    pushes = [{"start": p.start, "seconds": p.shown, "force": p.force.tolist(), "words": p.words} for p in film.pushes]
    return scene_data(motion, film.title) | {
        "fps": PLAYER_FPS,
        "frames": [poses(*frame) for frame in zip(motion.position, motion.rotation, strict=True)],
        "torso": [rounded(place) for place in motion.torso],
        "told": [list(each) for each in film.told],
        "pushes": pushes,
    }


def poses(places: Float[np.ndarray, "shapes 3"], turns: Float[np.ndarray, "shapes 3 3"]) -> list[list[float]]:
    """Positions and quaternions, side by side."""
    quaternions = np.empty((len(turns), 4))
    for quaternion, turn in zip(quaternions, turns, strict=True):
        mujoco.mju_mat2Quat(quaternion, turn.reshape(-1))
    return [[*rounded(place), *rounded(turn)] for place, turn in zip(places, quaternions, strict=True)]


def rounded(values: Iterable[float]) -> list[float]:
    """To a tenth of a millimetre, or what turns a leg's end by as much."""
    return [round(float(value), 4) for value in values]
