# pyright: reportAttributeAccessIssue=false
"""Motions as pictures and videos."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float

from humanoid_mjx.compute import cores
from humanoid_mjx.evaluation.film import Film
from humanoid_mjx.report.overlay import annotate
from humanoid_mjx.report.raycast import Frame, Painter
from humanoid_mjx.report.scene import Scene, make_scene
from humanoid_mjx.report.video import check_file, write_frames
from humanoid_mjx.types import AnyArray

WIDTH, HEIGHT = 480, 360
STRIP = 6
"""Frames side by side where a motion becomes one picture."""

FPS = 25.0


def render_film(
    film: Film,
    path: Path,
    fps: float = FPS,
    size: tuple[int, int] | None = None,
    tell: Callable[[int, int], None] = lambda done, total: None,
) -> Path:
    """Write a film to a file: .gif, .mp4 or .webm as a video, .png as up to six of its frames side by side.

    Args:
      film: what is shown.
      path: the file.
      fps: frames a second.
      size: width and height, pixels; by default 480 x 360.
      tell: called for each frame with the number painted and the number of all frames.

    Raises:
      InputError: another kind of file, one that cannot be written, or .mp4 and .webm without the extra `video`.
    """
    check_file(path)
    qpos, times = film.at(fps)
    if path.suffix == ".png":
        chosen = np.unique(np.linspace(0, len(qpos) - 1, STRIP).astype(int))
        qpos, times = qpos[chosen], times[chosen]
    write_frames(_annotated(film, qpos, times, tell, size=size), path, fps)
    return path


def strip(film: Film) -> list[tuple[Frame, float]]:
    """`STRIP` frames of a film, evenly spaced from first to last, without title and clock, and their times, s."""
    qpos, times = film.at(FPS)
    chosen = np.unique(np.linspace(0, len(qpos) - 1, STRIP).astype(int))
    frames = _annotated(film._replace(title=""), qpos[chosen], times[chosen], lambda done, total: None, clock=False)
    return list(zip(frames, times[chosen].tolist(), strict=True))


def draw(model: mujoco.MjModel, qpos: Float[AnyArray, "frames nq"]) -> list[Frame]:
    """A picture of each posture."""
    return list(_paint(make_scene(model, qpos)))


def _annotated(
    film: Film,
    qpos: Float[np.ndarray, "frames nq"],
    times: Float[np.ndarray, " frames"],
    tell: Callable[[int, int], None],
    clock: bool = True,
    size: tuple[int, int] | None = None,
) -> Iterator[Frame]:
    scene = make_scene(film.model, qpos, film.terrain)
    for number, (frame, seconds) in enumerate(zip(_paint(scene, size), times, strict=True)):
        yield annotate(frame, film, scene, number, float(seconds), clock)
        tell(number + 1, len(qpos))


def _paint(scene: Scene, size: tuple[int, int] | None = None) -> Iterator[Frame]:
    """The frames of a scene, painted by a thread a core a few at a time."""
    painter = Painter(scene, *(size or (WIDTH, HEIGHT)))
    with ThreadPoolExecutor(cores()) as threads:
        for first in range(0, len(scene.qpos), 8 * cores()):
            yield from threads.map(painter.paint, range(first, min(first + 8 * cores(), len(scene.qpos))))
