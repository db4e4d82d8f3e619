# pyright: reportAttributeAccessIssue=false
"""Shaded pictures of a robot without OpenGL: MuJoCo finds what the ray through each pixel meets.

`mujoco.mj_multiRay` casts many rays from one point: first from the camera, then from a lamp so far away that its light
is almost parallel, to find shadows.
"""

import copy
from functools import partial

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int32, UInt8

from humanoid_mjx.report.scene import AMBIENT, DIFFUSE, HEADLIGHT, LIGHT, SKYLIGHT, Camera, Scene, colored, make_camera

OVERSAMPLED = 2
"""Rays across and down each pixel at an edge, whose mean smooths it."""

SKY, HORIZON = np.array([0.80, 0.86, 0.92]), np.ones(3)
GROUND, INK = np.array([0.93, 0.93, 0.92]), np.array([0.74, 0.75, 0.76])
LINE = 0.02
"""Width of a line on the ground, as a share of the distance between two."""

SHADOW = 0.72
"""Share of the light that is left in the shadow."""

FAR = 30.0
"""The ground fades into the horizon from half as far to there, in distances between two lines."""

LAMP_M = 1000.0
"""Distance of the lamp from the torso, m."""

MARCH, REFINED = 24, 8
"""Places along a ray at which a shaped ground is looked for, and halvings of the distance between two of them."""

GRAZE_M = 1e-3
"""A surface does not shade points so little below it, m: they are its own."""

Frame = UInt8[np.ndarray, "height width 3"]
Vector = Float[np.ndarray, "3"]
Rays = Float[np.ndarray, "*pixels 3"]
Colors = Float[np.ndarray, "*pixels 3"]
Depths = Float[np.ndarray, " rays"]
Kinds = Int32[np.ndarray, " rays"]
Flags = Bool[np.ndarray, " rays"]


class Painter:
    """Paints frames of one scene; several threads may paint at once."""

    def __init__(self, scene: Scene, width: int, height: int):
        self.scene, self.camera = scene, make_camera(height)
        self.rays = _rays(self.camera, width, height)
        self.middles = self.rays.mean(axis=2)
        self.model = copy.copy(scene.model)
        self.model.geom_group[:] = 1
        self.model.geom_group[scene.shown] = 0
        self.colors = np.array([colored(scene.model, geom)[:3] for geom in range(scene.model.ngeom)])

    def paint(self, frame: int) -> Frame:
        """Return the picture of one frame: of the ray through the middle of each pixel, or, where a neighbour shows
        another kind of thing, the mean over all rays of the pixel."""
        data, middle = mujoco.MjData(self.model), self.scene.middle[frame]
        data.qpos = self.scene.qpos[frame]
        mujoco.mj_kinematics(self.model, data)
        look = partial(self._look, data, self.camera.place(middle, self.scene.distance))
        shape = self.middles.shape
        picture, kinds = (seen.reshape(*shape[:2], -1) for seen in look(self.middles.reshape(-1, 3)))
        edges = np.zeros(shape[:2], bool)
        for axis in (0, 1):
            differ = np.diff(kinds[..., 0], axis=axis) != 0
            for place in (slice(1, None), slice(-1)):
                edges[(slice(None),) * axis + (place,)] |= differ
        fine, _ = look(self.rays[edges].reshape(-1, 3))
        picture[edges] = fine.reshape(-1, OVERSAMPLED**2, 3).mean(axis=1)
        return (255 * np.clip(picture, 0, 1) + 0.5).astype(np.uint8)

    def _look(self, data: mujoco.MjData, eye: Vector, rays: Rays) -> tuple[Colors, Kinds]:
        """Colours of the surfaces that rays from the eye meet, and numbers of these surfaces, others in the shadow."""
        depth, geom, normal = self._cast(data, eye, rays)
        met, color = geom >= 0, np.empty_like(rays)
        below = np.zeros(len(rays), bool)
        if self.scene.ground:
            reached = self._meets(eye, rays)
            below = ~met & (reached > 0)
            depth[below] = reached[below]
        lamp, eyewards = -normal[met] @ LIGHT, -normal[met] @ self.camera.forward
        points = eye + depth[:, None] * rays
        lit = below.copy()
        lit[met] = lamp > 0
        reached = lit & (np.abs(points - data.xpos[1]).max(axis=1) < self.scene.view)
        lit[reached] = ~self._shaded(data, points[reached])
        ambient = AMBIENT * (1.0 + SKYLIGHT * normal[met, 2])
        light = ambient + DIFFUSE * lamp * lit[met] + HEADLIGHT * np.maximum(0.0, eyewards)
        color[~(met | below)] = _sky(rays[~(met | below)])
        color[met] = light[:, None] * self.colors[geom[met]]
        color[below] = self._ground(points[below], eye, depth[below], lit[below])
        return color, (4 * geom + 2 * below + lit).astype(np.int32)

    def _meets(self, eye: Vector, rays: Rays) -> Depths:
        """Distance to the ground along each ray, in units of the ray's length; -1 where the ray misses it.

        A shaped ground lies between two planes: of `MARCH` places between them the first below it is refined.
        """
        terrain, depth = self.scene.terrain, np.full(len(rays), -1.0)
        rise, most = terrain.bounds if terrain else (np.zeros(2), 0.0)
        down, high = rays[:, :2] @ rise - rays[:, 2], eye[2] - eye[:2] @ rise
        meets = (down > 1e-4) & (high > most)
        rays, low, end = rays[meets], (high - most) / down[meets], (high + most) / down[meets]
        if terrain:
            x, y, z = rays.T
            below = lambda at: eye[2] + at * z < terrain.level(eye[0] + at * x, eye[1] + at * y)  # noqa: E731
            places = low + np.linspace(0.0, 1.0, MARCH)[:, None] * (end - low)
            first, each = np.argmax(below(places), axis=0).clip(1), np.arange(len(rays))
            low, end = places[first - 1, each], places[first, each]
            for _ in range(REFINED):
                middle = (low + end) / 2
                under = below(middle)
                low, end = np.where(under, low, middle), np.where(under, middle, end)
        depth[meets] = end
        return depth

    def _ground(self, points: Rays, eye: Vector, depth: Depths, lit: Flags) -> Colors:
        """The ground with its lines, in the distance as white as the horizon."""
        grid, points = self.scene.grid, points[:, :2]
        line, width = LINE * grid, LINE * grid + depth / self.camera.focus
        off = grid * np.abs(points / grid - np.rint(points / grid)).min(axis=1)
        lines = np.clip(1.3 - off / width, 0.0, 1.0) * np.sqrt(line / width)
        haze = np.clip(2.0 * np.linalg.norm(points - eye[:2], axis=1) / (FAR * grid) - 1.0, 0.0, 1.0)[:, None]
        light = np.where(lit, 1.0, SHADOW) * self._slant(points)
        color = (GROUND + lines[:, None] * (INK - GROUND)) * light[:, None]
        return color + haze * (HORIZON - color)

    def _slant(self, points: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, " points"]:
        """Light on the ground, as a share of that on a level plane; every other step of stairs is darker."""
        x, y, terrain = *points.T, self.scene.terrain
        if terrain is None or terrain.stairs:
            return 1.0 - 0.12 * (terrain.step(x, y, np) % 2 if terrain else np.zeros(len(points)))
        level = terrain.level
        by_x, by_y = (level(x + GRAZE_M, y) - level(x - GRAZE_M, y)), (level(x, y + GRAZE_M) - level(x, y - GRAZE_M))
        normal = np.stack([-by_x, -by_y, np.full(len(x), 2 * GRAZE_M)])
        return np.clip(LIGHT @ normal / np.linalg.norm(normal, axis=0) / LIGHT[2], 0.6, 1.2)

    def _shaded(self, data: mujoco.MjData, points: Rays) -> Flags:
        """True for points that the robot shades from the lamp."""
        lamp = data.xpos[1] - LAMP_M * LIGHT
        depth, geom, _ = self._cast(data, lamp, points - lamp)
        return (geom >= 0) & (depth < 1.0 - GRAZE_M / LAMP_M)

    def _cast(self, data: mujoco.MjData, origin: Vector, rays: Rays) -> tuple[Depths, Kinds, Rays]:
        """Cast rays from one point: how many times its own length each ray goes until it meets a geom; the number of
        that geom, -1 for none; and the unit vector that points outwards there."""
        count = len(rays)
        depth, geom, normal = np.empty(count), np.empty(count, np.int32), np.empty(3 * count)
        groups, far = np.array([1, 0, 0, 0, 0, 0], np.uint8), mujoco.mjMAXVAL
        flat = np.ascontiguousarray(rays).reshape(-1)
        mujoco.mj_multiRay(self.model, data, origin, flat, groups, True, -1, geom, depth, normal, count, far)
        return depth, geom, normal.reshape(-1, 3)


def _rays(camera: Camera, width: int, height: int) -> Float[np.ndarray, "height width rays 3"]:
    """Directions through each pixel, as long as it takes to go 1 m forwards."""
    within = (np.arange(OVERSAMPLED) + 0.5) / OVERSAMPLED
    rows, columns, down, across = np.meshgrid(np.arange(height), np.arange(width), within, within, indexing="ij")
    right, up = (columns + across - width / 2) / camera.focus, (height / 2 - rows - down) / camera.focus
    rays = right[..., None] * camera.right + up[..., None] * camera.up + camera.forward
    return rays.reshape(height, width, OVERSAMPLED**2, 3)


def _sky(rays: Rays) -> Colors:
    """White at the horizon, blue above."""
    up = rays[:, 2:] / np.linalg.norm(rays, axis=-1, keepdims=True)
    return HORIZON + np.clip(3.0 * up, 0.0, 1.0) * (SKY - HORIZON)
