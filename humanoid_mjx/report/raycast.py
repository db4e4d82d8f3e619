# pyright: reportAttributeAccessIssue=false
"""Shaded pictures of a robot without OpenGL: MuJoCo finds what the ray through each pixel meets.

`mujoco.mj_multiRay` casts many rays from one point: first from the camera, then from a lamp so far away that its light
is almost parallel, to find shadows.
"""

import copy
from collections.abc import Callable
from functools import partial
from itertools import product

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int32, UInt8

from humanoid_mjx.report.scene import AMBIENT, DIFFUSE, HEADLIGHT, LIGHT, SKYLIGHT, Camera, Scene, colored, make_camera

OVERSAMPLED = 2
"""Rays across and down each pixel at an edge, whose mean smooths it."""

SKY, HORIZON = np.array([0.80, 0.86, 0.92]), np.ones(3)
GROUND, LINE = np.array([0.93, 0.93, 0.92]), np.array([0.74, 0.75, 0.76])
LINE = 0.02
"""Width of a line on the ground, as a share of the distance between two."""

SHADOW = 0.72
"""Share of the light that is left in the shadow."""

FAR = 30.0
"""The ground fades into the horizon from half as far to there, in distances between two lines."""

LAMP_M = 1000.0
"""Distance of the lamp from the torso, m."""

GRAZE_M = 1e-3
"""A surface does not shade points so little below it, m: they are its own."""

Frame = UInt8[np.ndarray, "height width 3"]
Picture = Float[np.ndarray, "height width 3"]
Rays = Float[np.ndarray, "height width rays 3"]
Vector = Float[np.ndarray, "3"]
Depths = Float[np.ndarray, " points"]
Points = Float[np.ndarray, "points 3"]
Values = Float[np.ndarray, "points values"]
Kinds = Int32[np.ndarray, " points"]
Shaded = Callable[[Points], Bool[np.ndarray, " points"]]


class Painter:
    """Paints frames of one scene; several threads may paint at once."""

    def __init__(self, scene: Scene, width: int, height: int):
        self.scene, self.size, self.camera = scene, (width, height), make_camera(height)
        self.rays = _rays(self.camera, width, height)
        self.middles = self.rays.mean(axis=2)
        self.sky = _sky(self.middles)
        self.ground = _Ground(self.rays, scene, self.camera) if scene.ground else None
        self.model = copy.copy(scene.model)
        self.model.geom_group[:] = 1
        self.model.geom_group[scene.shown] = 0
        self.colors = np.array([colored(scene.model, geom)[:3] for geom in range(scene.model.ngeom)])

    def paint(self, frame: int) -> Frame:
        """The picture of one frame."""
        middle, data = self.scene.middle[frame], mujoco.MjData(self.model)
        eye = self.camera.place(middle, self.scene.distance)
        data.qpos = self.scene.qpos[frame]
        mujoco.mj_kinematics(self.model, data)
        corners = self._corners(data)
        picture = self.sky.copy()
        if self.ground:
            picture[self.ground.first :] = self.ground.painted(middle, corners, partial(self._shaded, data))
        window = self._window(eye, corners)
        seen = _smooth(self.rays[window], self.middles[window], partial(self._look, data, eye))
        picture[window] += seen[..., :3] - seen[..., 3:] * picture[window]
        return (255 * np.clip(picture, 0, 1) + 0.5).astype(np.uint8)

    def _look(self, data: mujoco.MjData, eye: Vector, rays: Points) -> tuple[Values, Kinds]:
        """Red, green, blue and 1 where rays from the eye meet the robot, 0 elsewhere; and which surface, lit or not."""
        depth, geom, normal = self._cast(data, eye, rays)
        met = geom >= 0
        lamp, eyewards = -normal[met] @ LIGHT, -normal[met] @ self.camera.forward
        lit = lamp > 0
        lit[lit] = ~self._shaded(data, (eye + depth[met, None] * rays[met])[lit])
        ambient = AMBIENT * (1.0 + SKYLIGHT * normal[met, 2])
        light = ambient + DIFFUSE * lamp * lit + HEADLIGHT * np.maximum(0.0, eyewards)
        seen, kind = np.zeros((len(rays), 4)), 2 * geom
        seen[met, :3], seen[met, 3] = light[:, None] * self.colors[geom[met]], 1.0
        kind[met] += lit
        return seen, kind

    def _corners(self, data: mujoco.MjData) -> Points:
        """The corners of cubes along the camera's axes that hold the torso's origin and the geoms."""
        axes = np.stack([self.camera.right, self.camera.up, self.camera.forward])
        centers = np.vstack([data.xpos[1], data.geom_xpos[self.scene.shown]])
        radii = np.append(0.0, self.model.geom_rbound[self.scene.shown])
        unit = np.array(list(product((-1, 1), repeat=3))) @ axes
        return (centers[:, None] + radii[:, None, None] * unit).reshape(-1, 3)

    def _window(self, eye: Vector, corners: Points) -> tuple[slice, slice]:
        """The rows and columns that hold the robot."""
        pixels = self.camera.seen(corners, eye, self.size)
        low, high = (np.clip(end, 0, self.size).astype(int) for end in (pixels.min(axis=0), pixels.max(axis=0) + 1))
        return slice(low[1], high[1]), slice(low[0], high[0])

    def _shaded(self, data: mujoco.MjData, points: Points) -> Bool[np.ndarray, " points"]:
        """Whether the robot stands between points and the lamp."""
        lamp = data.xpos[1] - LAMP_M * LIGHT
        depth, geom, _ = self._cast(data, lamp, points - lamp)
        return (geom >= 0) & (depth < 1.0 - GRAZE_M / LAMP_M)

    def _cast(self, data: mujoco.MjData, origin: Vector, rays: Points) -> tuple[Depths, Kinds, Points]:
        """Cast rays from one point.

        Returns:
          how many times its own length each ray goes until it meets a geom; the number of that geom, -1 for none; and
          the unit vector that points outwards there.
        """
        count = len(rays)
        depth, geom, normal = np.empty(count), np.empty(count, np.int32), np.empty(3 * count)
        groups, far = np.array([1, 0, 0, 0, 0, 0], np.uint8), mujoco.mjMAXVAL
        flat = np.ascontiguousarray(rays).reshape(-1)
        mujoco.mj_multiRay(self.model, data, origin, flat, groups, True, -1, geom, depth, normal, count, far)
        return depth, geom, normal.reshape(-1, 3)


def _smooth(
    rays: Rays, middles: Picture, look: Callable[[Points], tuple[Values, Kinds]]
) -> Float[np.ndarray, "height width values"]:
    """Values of each pixel: of the ray through its middle, or, where a neighbour shows another kind of thing, the mean
    over all its rays."""
    shape = rays.shape[:2]
    values, kinds = look(middles.reshape(-1, 3))
    values, kinds, edges = values.reshape(*shape, -1), kinds.reshape(shape), np.zeros(shape, bool)
    for axis in (0, 1):
        differ = np.diff(kinds, axis=axis) != 0
        for place in (slice(1, None), slice(-1)):
            edges[(slice(None),) * axis + (place,)] |= differ
    fine, _ = look(rays[edges].reshape(-1, 3))
    values[edges] = fine.reshape(-1, rays.shape[2], values.shape[-1]).mean(axis=1)
    return values


class _Ground:
    """The plane z = 0 with its lines and the robot's shadow, fading with the distance.

    The camera keeps its direction and its height, so most of it is the same in all frames.
    """

    def __init__(self, rays: Rays, scene: Scene, camera: Camera):
        self.grid = scene.grid
        self.eye = camera.place(scene.middle[0] * [0, 0, 1], scene.distance)
        downwards = rays[:, 0, 0, 2] < -1e-4
        self.first = int(np.argmax(downwards)) if self.eye[2] > 0 and downwards.any() else len(rays)
        self.rays = rays[self.first :]
        self.middles = self.rays.mean(axis=2)
        depth = self.eye[2] / -self.middles[..., 2]
        self.points = (self.eye + depth[..., None] * self.middles)[..., :2]
        self.line = LINE * self.grid
        self.width = self.line + depth / camera.focus
        self.haze = np.clip(2.0 * np.linalg.norm(self.points, axis=-1) / (FAR * self.grid) - 1.0, 0.0, 1.0)[..., None]

    def painted(self, middle: Vector, corners: Points, shaded: Shaded) -> Picture:
        """The rows of the picture from the first below the horizon."""
        points = self.points + middle[:2]
        off = self.grid * np.minimum(*np.moveaxis(np.abs(points / self.grid - np.rint(points / self.grid)), -1, 0))
        lines = np.clip(1.3 - off / self.width, 0.0, 1.0) * np.sqrt(self.line / self.width)
        color = GROUND + lines[..., None] * (LINE - GROUND)
        thrown = (corners - corners[:, 2:] / LIGHT[2] * LIGHT)[:, :2]
        near = np.logical_and(*np.moveaxis((points > thrown.min(axis=0)) & (points < thrown.max(axis=0)), -1, 0))

        def look(rays: Points) -> tuple[Values, Kinds]:
            dark = shaded(self.eye + middle * [1, 1, 0] - self.eye[2] * rays / rays[:, 2:]).astype(np.int32)
            return dark[:, None].astype(float), dark

        if near.any():
            rows, columns = np.flatnonzero(near.any(axis=1)), np.flatnonzero(near.any(axis=0))
            window = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
            color[window] *= 1.0 - (1.0 - SHADOW) * _smooth(self.rays[window], self.middles[window], look)
        return color + self.haze * (HORIZON - color)


def _rays(camera: Camera, width: int, height: int) -> Rays:
    """Directions through each pixel, as long as it takes to go 1 m forwards."""
    within = (np.arange(OVERSAMPLED) + 0.5) / OVERSAMPLED
    rows, columns, down, across = np.meshgrid(np.arange(height), np.arange(width), within, within, indexing="ij")
    right, up = (columns + across - width / 2) / camera.focus, (height / 2 - rows - down) / camera.focus
    rays = right[..., None] * camera.right + up[..., None] * camera.up + camera.forward
    return rays.reshape(height, width, OVERSAMPLED**2, 3)


def _sky(rays: Picture) -> Picture:
    """White at the horizon, blue above."""
    up = rays[..., 2:] / np.linalg.norm(rays, axis=-1, keepdims=True)
    return HORIZON + np.clip(3.0 * up, 0.0, 1.0) * (SKY - HORIZON)
