# pyright: reportAttributeAccessIssue=false
"""Motions as pictures and videos, and their files: animations, videos, strips."""

import subprocess
import tempfile
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from importlib.util import find_spec
from itertools import chain
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float
from PIL import Image

from humanoid_mjx.compute import cores
from humanoid_mjx.evaluation.film import Film
from humanoid_mjx.files import refusing, whole_file
from humanoid_mjx.report.overlay import annotate
from humanoid_mjx.report.raycast import Frame, Painter
from humanoid_mjx.report.scene import Scene, make_scene
from humanoid_mjx.spec import InputError, check_folder
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


ENDINGS = (".gif", ".mp4", ".webm", ".png")

CODECS = {
    ".mp4": ("-pix_fmt", "yuv420p", "-movflags", "+faststart"),
    ".webm": ("-c:v", "libvpx-vp9", "-pix_fmt", "yuv420p", "-crf", "32", "-b:v", "0", "-cpu-used", "5"),
}
"""Options of ffmpeg for videos that browsers play."""


def check_file(path: Path) -> None:
    """Check, before any work, that a file of this name can be made.

    Raises:
      InputError: its ending is none of `ENDINGS`, there is no such folder, or its kind needs a package that is missing.
    """
    if path.suffix not in ENDINGS:
        raise InputError(f"{path}: the file must end in .gif, .mp4, .webm or .png.")
    check_folder(path)
    if path.suffix in CODECS and find_spec("imageio_ffmpeg") is None:
        raise InputError(
            f"{path}: {path.suffix} needs the package imageio-ffmpeg: pip install 'humanoid-mjx[video]' brings it; "
            ".gif needs nothing."
        )


def write_frames(frames: Iterable[Frame], path: Path, fps: float) -> None:
    """Write frames into the file that `check_file` has passed: .png side by side, the others one after another.

    Raises:
      InputError: the file cannot be written.
    """
    with refusing(path), whole_file(path) as temporary:
        if path.suffix == ".png":
            Image.fromarray(np.concatenate(list(frames), axis=1)).save(temporary)
        elif path.suffix == ".gif":
            first, *rest = map(Image.fromarray, frames)
            first.save(temporary, save_all=True, append_images=rest, duration=1000 / fps, loop=0)
        else:
            _encode(frames, temporary, fps)


def _encode(frames: Iterable[Frame], path: Path, fps: float) -> None:
    """Let ffmpeg make a video."""
    import imageio_ffmpeg  # pyright: ignore[reportMissingImports]

    rest = iter(frames)
    first = next(rest)
    size = f"{first.shape[1]}x{first.shape[0]}"
    raw = "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", str(fps), "-i", "-"
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error", *raw, *CODECS[path.suffix], str(path)]
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=errors)
        assert process.stdin is not None
        with suppress(BrokenPipeError), process:
            for frame in chain([first], rest):
                process.stdin.write(frame.tobytes())
        if process.returncode:
            errors.seek(0)
            words = " ".join(errors.read().decode(errors="replace").split())
            raise InputError(f"{path}: ffmpeg could not write it: {words[-300:]}.")
