# pyright: reportAttributeAccessIssue=false
"""Motions as pictures and videos."""

from collections.abc import Callable, Iterator
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float

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
    film: Film, path: Path, fps: float = FPS, tell: Callable[[int, int], None] = lambda done, total: None
) -> Path:
    """Write a film to a file: .gif, .mp4 or .webm as a video, .png as up to six of its frames side by side.

    Args:
      film: what is shown.
      path: the file.
      fps: frames a second.
      tell: called for each frame with the number painted and the number of all frames.

    Raises:
      InputError: another kind of file, one that cannot be written, or .mp4 and .webm where there is no ffmpeg.
    """
    check_file(path)
    qpos, times = film.at(fps)
    if path.suffix == ".png":
        chosen = np.unique(np.linspace(0, len(qpos) - 1, STRIP).astype(int))
        qpos, times = qpos[chosen], times[chosen]
    write_frames(_annotated(film, qpos, times, tell), path, fps)
    return path


def render_motion(model: mujoco.MjModel, qpos: Float[AnyArray, "rows nq"], step_s: float, path: Path) -> Path:
    """`render_film` of a motion without words, given a row every `step_s`, s."""
    return render_film(Film(model, qpos, step_s), path)


def strip(film: Film, count: int = STRIP) -> list[tuple[Frame, float]]:
    """Evenly spaced frames of a film from its first to its last, without title and clock, and their times, s."""
    qpos, times = film.at(FPS)
    chosen = np.unique(np.linspace(0, len(qpos) - 1, count).astype(int))
    frames = _annotated(film._replace(title=""), qpos[chosen], times[chosen], lambda done, total: None, clock=False)
    return list(zip(frames, times[chosen].tolist(), strict=True))


def draw(model: mujoco.MjModel, qpos: Float[AnyArray, "frames nq"]) -> list[Frame]:
    """A picture of each posture."""
    return list(_paint(model, np.asarray(qpos, np.float64), make_scene(model, qpos)))


def _annotated(
    film: Film,
    qpos: Float[np.ndarray, "frames nq"],
    times: Float[np.ndarray, " frames"],
    tell: Callable[[int, int], None],
    clock: bool = True,
) -> Iterator[Frame]:
    scene = make_scene(film.model, qpos)
    for number, (frame, seconds) in enumerate(zip(_paint(film.model, qpos, scene), times, strict=True)):
        yield annotate(frame, film, scene, number, float(seconds), clock)
        tell(number + 1, len(qpos))


def _paint(model: mujoco.MjModel, qpos: Float[np.ndarray, "frames nq"], scene: Scene) -> Iterator[Frame]:
    painter = Painter(scene, WIDTH, HEIGHT)
    for number in range(len(qpos)):
        yield painter.paint(number)
