"""Shaded pictures of a robot without OpenGL: a ray through each pixel meets the nearest of its shapes.

In a shape's own axes a quadratic or linear equation gives where a ray `o + t d` meets a sphere, a capsule, a cylinder,
an ellipsoid or a box; `d` keeps its length there, so that `t` is the same for all. Only the pixels inside the sphere
around a shape are tested. Rays towards the light find the ground's shadow.
"""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8

from humanoid_mjx.report.scene import GRID_M, LIGHT, Camera, Scene, Shape, make_camera

OVERSAMPLED = 2
"""Rays across and down each pixel, whose mean smooths the edges."""

AMBIENT, DIFFUSE = 0.5, 0.55
SKY, HORIZON = np.array([0.80, 0.86, 0.92], np.float32), np.ones(3, np.float32)
GROUND, LINE = np.array([0.93, 0.93, 0.92], np.float32), np.array([0.74, 0.75, 0.76], np.float32)
LINE_M = 0.002
SHADOW = 0.72
"""Share of the light that is left in the shadow."""

FAR_M = 3.0
"""The ground fades into the horizon from half as far to there."""

Frame = UInt8[np.ndarray, "height width 3"]
Picture = Float[np.ndarray, "height width 3"]
Rays = Float[np.ndarray, "height width 3"]
Points = Float[np.ndarray, "pixels 3"]
Scalars = Float[np.ndarray, " pixels"]


class Painter:
    """Paints frames of one scene."""

    def __init__(self, scene: Scene, width: int, height: int):
        self.scene, self.size = scene, (height * OVERSAMPLED, width * OVERSAMPLED)
        self.camera: Camera = make_camera(self.size[0])
        self.rays = _rays(self.camera, self.size)
        coarse = _rays(make_camera(height), (height, width))
        self.sky = _sky(coarse)
        self.ground = _Ground(coarse, scene) if scene.ground else None

    def paint(self, frame: int) -> Frame:
        """The picture of one frame."""
        scene = self.scene
        place = self.camera.place(scene.middle[frame], scene.distance)
        behind = self.ground.painted(frame, self.sky) if self.ground else self.sky
        picture = behind.repeat(OVERSAMPLED, axis=0).repeat(OVERSAMPLED, axis=1)
        nearest = np.full(self.size, np.inf, np.float32)
        for shape, position, rotation in zip(scene.shapes, scene.position[frame], scene.rotation[frame], strict=True):
            self._paint_shape(picture, nearest, shape, position, rotation, place)
        smooth = picture.reshape(self.size[0] // OVERSAMPLED, OVERSAMPLED, self.size[1] // OVERSAMPLED, OVERSAMPLED, 3)
        return (255 * np.clip(smooth.mean(axis=(1, 3)), 0, 1) + 0.5).astype(np.uint8)

    def _paint_shape(
        self, picture: Any, nearest: Any, shape: Shape, position: Any, rotation: Any, place: Float[np.ndarray, "3"]
    ) -> None:
        window = self._window(position - place, float(np.linalg.norm(half_extent(shape))))
        if window is None:
            return
        rays = self.rays[window].reshape(-1, 3)
        turn = rotation.astype(np.float32)
        origin = np.broadcast_to((place - position).astype(np.float32) @ turn, rays.shape)
        depth, normal = meet(shape, origin, rays @ turn)
        depth = depth.reshape(nearest[window].shape)
        seen = depth < nearest[window]
        light = AMBIENT + DIFFUSE * np.maximum(0.0, -(normal @ turn.T) @ LIGHT.astype(np.float32))
        picture[window][seen] = light.reshape(depth.shape)[seen][:, None] * shape.color
        nearest[window][seen] = depth[seen]

    def _window(self, away: Float[np.ndarray, "3"], radius: float) -> tuple[slice, slice] | None:
        """The rows and columns that a sphere may cover; nothing where it is outside the picture."""
        depth = float(away @ self.camera.forward)
        if depth < 1.05 * radius:
            return (slice(None), slice(None)) if depth > -radius else None
        half = self.camera.focus * radius / np.sqrt(depth**2 - radius**2) * 1.1 + 1
        column = self.size[1] / 2 + self.camera.focus * (away @ self.camera.right) / depth
        row = self.size[0] / 2 - self.camera.focus * (away @ self.camera.up) / depth
        ends = zip((row, column), self.size, strict=True)
        (top, bottom), (left, right) = ((int(max(0, x - half)), int(min(end, x + half + 1))) for x, end in ends)
        return None if top >= bottom or left >= right else (slice(top, bottom), slice(left, right))


class _Ground:
    """The plane z = 0 with its lines and the robot's shadow, fading with the distance.

    The camera keeps its direction and its height, so most of it is the same in all frames.
    """

    def __init__(self, rays: Rays, scene: Scene):
        self.scene = scene
        camera = make_camera(len(rays))
        height = np.float32(camera.place(scene.middle[0], scene.distance)[2])
        downwards = rays[:, 0, 2] < -1e-4
        self.first = int(np.argmax(downwards)) if height > 0 and downwards.any() else len(rays)
        rays = rays[self.first :]
        depth = height / -rays[..., 2]
        behind = camera.place(np.zeros(3), scene.distance)[:2].astype(np.float32)
        self.points = behind + depth[..., None] * rays[..., :2]
        away = np.linalg.norm(self.points, axis=-1)
        self.near = away < scene.view
        self.width = (LINE_M + depth / np.float32(camera.focus)).astype(np.float32)
        self.strength = np.sqrt(LINE_M / self.width)
        self.haze = np.clip(2.0 * away / FAR_M - 1.0, 0.0, 1.0)[..., None].astype(np.float32)

    def painted(self, frame: int, sky: Picture) -> Picture:
        """The sky with the ground below it."""
        points = self.points + self.scene.middle[frame, :2].astype(np.float32)
        cells = points / np.float32(GRID_M)
        off = np.abs(cells - np.rint(cells)).min(axis=-1) * np.float32(GRID_M)
        lines = np.clip(np.float32(1.3) - off / self.width, 0.0, 1.0) * self.strength
        color = GROUND + lines[..., None] * (LINE - GROUND)
        shaded = np.zeros(self.near.shape, bool)
        shaded[self.near] = self._in_shadow(points[self.near], frame)
        color[shaded] *= SHADOW
        picture = sky.copy()
        picture[self.first :] = color + self.haze * (HORIZON - color)
        return picture

    def _in_shadow(self, points: Float[np.ndarray, "pixels 2"], frame: int) -> Bool[np.ndarray, " pixels"]:
        """Whether a shape stands between points on the ground and the light."""
        points = np.concatenate([points, np.zeros((len(points), 1), np.float32)], axis=1)
        dark, scene, light = np.zeros(len(points), bool), self.scene, -LIGHT.astype(np.float32)
        for shape, position, rotation in zip(scene.shapes, scene.position[frame], scene.rotation[frame], strict=True):
            away = position.astype(np.float32) - points
            close = np.sum(away**2, axis=1) - (away @ light) ** 2 < np.sum(half_extent(shape) ** 2)
            turn = rotation.astype(np.float32)
            rays = np.broadcast_to(light @ turn, (int(close.sum()), 3))
            dark[close] |= np.isfinite(meet(shape, -away[close] @ turn, rays)[0])
        return dark


def _rays(camera: Camera, size: tuple[int, int]) -> Rays:
    """A direction for each pixel, as long as it takes to go 1 m forwards."""
    rows, columns = np.indices(size, dtype=np.float32)
    across = (columns + 0.5 - size[1] / 2) / camera.focus
    upwards = (size[0] / 2 - rows - 0.5) / camera.focus
    rays = across[..., None] * camera.right + upwards[..., None] * camera.up + camera.forward
    return rays.astype(np.float32)


def _sky(rays: Rays) -> Picture:
    """White at the horizon, blue above."""
    up = rays[..., 2:] / np.linalg.norm(rays, axis=-1, keepdims=True)
    return (HORIZON + np.clip(3.0 * up, 0.0, 1.0) * (SKY - HORIZON)).astype(np.float32)


def meet(shape: Shape, origin: Points, rays: Points) -> tuple[Scalars, Points]:
    """Where rays first meet a shape, in its own axes.

    Returns:
      how many times its own length a ray goes until there, infinite where it does not meet the shape; and the unit
      vectors that point outwards there.
    """
    start = -np.sum(origin * rays, axis=1) / np.sum(rays**2, axis=1)
    # From where a ray is nearest to the shape's middle: squares of large distances would leave few digits.
    depth, normal = _meet(shape, origin + start[:, None] * rays, rays)
    depth = start + depth
    return np.where(depth > 0, depth, np.float32(np.inf)), normal


def _meet(shape: Shape, origin: Points, rays: Points) -> tuple[Scalars, Points]:
    """Like `meet`, but counts from an origin near the shape, and also meets what lies behind it."""
    size = shape.size.astype(np.float32)
    if shape.kind == "box":
        return _meet_box(size, origin, rays)
    if shape.kind == "ellipsoid":
        depth, normal = _meet_ball(origin / size, rays / size)
        return depth, _unit(normal / size)
    if shape.kind == "sphere":
        return _meet_ball(origin / size[0], rays / size[0])
    ends = _meet_ends(size, origin, rays, flat=shape.kind == "cylinder")
    return _nearer(_meet_side(size, origin, rays), *ends)


def _meet_ball(origin: Points, rays: Points) -> tuple[Scalars, Points]:
    """The unit sphere."""
    depth = _root(np.sum(rays**2, axis=1), np.sum(origin * rays, axis=1), np.sum(origin**2, axis=1) - 1.0)
    return depth, origin + np.where(np.isfinite(depth), depth, 0.0)[:, None] * rays


def _meet_side(size: Any, origin: Points, rays: Points) -> tuple[Scalars, Points]:
    """The round side of a capsule or a cylinder."""
    o, d = origin[:, :2], rays[:, :2]
    depth = _root(np.sum(d**2, axis=1), np.sum(o * d, axis=1), np.sum(o**2, axis=1) - size[0] ** 2)
    at = origin + np.where(np.isfinite(depth), depth, 0.0)[:, None] * rays
    depth = np.where(np.abs(at[:, 2]) <= size[1], depth, np.float32(np.inf))
    return depth, at * np.array([1.0, 1.0, 0.0], np.float32) / size[0]


def _meet_ends(size: Any, origin: Points, rays: Points, flat: bool) -> list[tuple[Scalars, Points]]:
    """The two ends of a capsule, or of a cylinder, whose ends are flat."""
    found = []
    for side in (-1.0, 1.0):
        end = np.array([0.0, 0.0, side * size[1]], np.float32)
        if not flat:
            found.append(_meet_ball((origin - end) / size[0], rays / size[0]))
            continue
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = (end[2] - origin[:, 2]) / rays[:, 2]
            at = origin[:, :2] + depth[:, None] * rays[:, :2]
            met = np.sum(at**2, axis=1) <= size[0] ** 2
        normal = np.broadcast_to(np.array([0.0, 0.0, side], np.float32), rays.shape)
        found.append((np.where(met, depth, np.float32(np.inf)), normal))
    return found


def _meet_box(size: Any, origin: Points, rays: Points) -> tuple[Scalars, Points]:
    """The latest of the entries between pairs of faces, if it is before the first exit."""
    safe = np.where(np.abs(rays) < 1e-9, np.float32(1e-9), rays)
    entries, exits = (-np.sign(safe) * size - origin) / safe, (np.sign(safe) * size - origin) / safe
    face, depth = entries.argmax(axis=1), entries.max(axis=1)
    met = depth <= exits.min(axis=1)
    normal = np.zeros_like(rays)
    index = np.arange(len(rays))
    normal[index, face] = -np.sign(safe[index, face])
    return np.where(met, depth, np.float32(np.inf)), normal


def _root(a: Scalars, half_b: Scalars, c: Scalars) -> Scalars:
    """The smaller root of a t^2 + 2 half_b t + c; infinite where there is none."""
    inside = half_b**2 - a * c
    with np.errstate(divide="ignore", invalid="ignore"):
        root = (-half_b - np.sqrt(np.maximum(inside, 0.0))) / a
    return np.where((inside >= 0) & (a > 0), root, np.float32(np.inf)).astype(np.float32)


def _nearer(*found: tuple[Scalars, Points]) -> tuple[Scalars, Points]:
    """The first of several things that rays meet."""
    depth, normal = found[0]
    for other_depth, other_normal in found[1:]:
        first = other_depth < depth
        depth, normal = np.where(first, other_depth, depth), np.where(first[:, None], other_normal, normal)
    return depth, normal


def _unit(vectors: Points) -> Points:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), np.float32(1e-12))


def half_extent(shape: Shape) -> Float[np.ndarray, "3"]:
    """Half the sides of the box around a shape, m."""
    if shape.kind in ("capsule", "cylinder"):
        radius, half = shape.size[:2]
        return np.array([radius, radius, half + (radius if shape.kind == "capsule" else 0.0)])
    return shape.size
