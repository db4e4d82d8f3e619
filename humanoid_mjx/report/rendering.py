# pyright: reportAttributeAccessIssue=false
"""Motions as pictures and videos: words and arrows on the frames of a film, and the files that hold them."""

import subprocess
import tempfile
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import lru_cache
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float
from matplotlib.font_manager import FontProperties, findfont
from PIL import Image, ImageDraw, ImageFont

from humanoid_mjx.compute import cores
from humanoid_mjx.evaluation.film import Film, Push
from humanoid_mjx.files import refusing, whole_file
from humanoid_mjx.report.raycast import Frame, Painter
from humanoid_mjx.report.scene import Scene, make_camera, make_scene
from humanoid_mjx.spec import InputError, check_folder, package
from humanoid_mjx.types import AnyArray

INK, ALARM = (32, 32, 32), (193, 18, 31)

MARGIN = 10
"""pixels"""


def annotate(frame: Frame, film: Film, scene: Scene, number: int, seconds: float, clock: bool = True) -> Frame:
    """A frame of a film with its words and arrows, and the time if a `clock` is wanted."""
    image = Image.fromarray(frame)
    width, height = image.size
    draw, letter = ImageDraw.Draw(image), max(9, height // 26)
    for push in film.pushes:
        if push.start <= seconds + 1e-9 < push.start + push.shown:
            _draw_push(draw, letter, push, scene, number, (width, height))
    if film.title:
        room = width - 2 * MARGIN - 5 * letter
        _write(draw, letter, (MARGIN, MARGIN), film.title, "la", bold=True, room=room)
    if clock:
        _write(draw, letter, (width - MARGIN, MARGIN), f"{seconds:.2f} s", "ra")
    if words := film.asked(seconds):
        _write(draw, letter, (MARGIN, height - MARGIN), words, "ld", room=width - 2 * MARGIN)
    return np.asarray(image)


def _draw_push(draw: Any, letter: int, push: Push, scene: Scene, number: int, size: tuple[int, int]) -> None:
    """An arrow whose head is at the torso."""
    camera, torso = make_camera(size[1]), scene.torso[number]
    direction = push.force / np.linalg.norm(push.force)
    ends = np.stack([torso - scene.arrow * direction, torso])
    tail, head = camera.seen(ends, camera.place(scene.middle[number], scene.distance), size)
    along = (head - tail) / max(float(np.linalg.norm(head - tail)), 1e-6)
    across = np.array([-along[1], along[0]])
    barbs = np.stack([head, head - 14 * along + 7 * across, head - 14 * along - 7 * across])
    draw.line([*tail.tolist(), *(head - 10 * along).tolist()], fill=ALARM, width=4)
    draw.polygon(barbs.ravel().tolist(), fill=ALARM)
    # Behind the tail, so that the words cover neither arrow nor robot.
    anchor, ahead = ("r", 1.0) if along[0] > 0.5 else ("l", 0.0) if along[0] < -0.5 else ("m", 0.5)
    length = _font(letter, False).getlength(push.words)
    low, high = MARGIN + ahead * length, size[0] - MARGIN - (1.0 - ahead) * length
    x, y = np.clip(tail - letter * along, [low, 40], [max(low, high), size[1] - 40]).tolist()
    _write(draw, letter, (x, y), push.words, f"{anchor}m", ALARM)


def _write(
    draw: Any,
    letter: int,
    place: tuple[float, float],
    text: str,
    anchor: str,
    color: tuple[int, int, int] = INK,
    bold: bool = False,
    room: float = np.inf,
) -> None:
    """Text with a white rim, readable on everything, its end cut off where it is wider than `room`, pixels."""
    line, font = " ".join(text.split()), _font(letter, bold)
    if font.getlength(line) > room:
        while line and font.getlength(line + "…") > room:
            line = line[:-1]
        line += "…"
    draw.text(place, line, color, font, anchor, stroke_width=2, stroke_fill=(255, 255, 255))


@lru_cache
def _font(letter: int, bold: bool) -> ImageFont.FreeTypeFont:
    """The font that matplotlib brings."""
    look = FontProperties(family="DejaVu Sans", weight="bold" if bold else "normal")
    return ImageFont.truetype(findfont(look), letter)


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
      size: width and height, pixels; by default 480 x 360.
      tell: called for each frame with the number painted and the number of all frames.

    Raises:
      InputError: another kind of file, one that cannot be written, or .mp4 and .webm without the extra `video`.
    """
    check_file(path)
    write_frames((frame for frame, _ in _frames(film, fps, path.suffix == ".png", size, tell)), path, fps)
    return path


def strip(film: Film) -> list[tuple[Frame, float]]:
    """`STRIP` frames of a film, evenly spaced from first to last, without title and clock, and their times, s."""
    return list(_frames(film._replace(title=""), FPS, few=True, clock=False))


def draw(model: mujoco.MjModel, qpos: Float[AnyArray, "frames nq"]) -> list[Frame]:
    """A picture of each posture."""
    return list(_paint(make_scene(model, qpos)))


def _frames(
    film: Film,
    fps: float,
    few: bool,
    size: tuple[int, int] | None = None,
    tell: Callable[[int, int], None] = lambda done, total: None,
    clock: bool = True,
) -> Iterator[tuple[Frame, float]]:
    """Frames of a film with what is written on them, and their times, s; where `few`, `STRIP` evenly spaced ones."""
    qpos, times = film.at(fps)
    chosen = np.unique(np.linspace(0, len(qpos) - 1, STRIP if few else len(qpos)).astype(int))
    scene = make_scene(film.model, qpos[chosen], film.terrain)
    for number, (frame, seconds) in enumerate(zip(_paint(scene, size), times[chosen].tolist(), strict=True)):
        yield annotate(frame, film, scene, number, seconds, clock), seconds
        tell(number + 1, len(chosen))


def _paint(scene: Scene, size: tuple[int, int] | None = None) -> Iterator[Frame]:
    """The frames of a scene, painted by a thread a core a few at a time."""
    painter = Painter(scene, *(size or (WIDTH, HEIGHT)))
    with ThreadPoolExecutor(cores()) as threads:
        for first in range(0, len(scene.qpos), 8 * cores()):
            yield from threads.map(painter.paint, range(first, min(first + 8 * cores(), len(scene.qpos))))


FILMS = (".gif", ".mp4", ".webm")
"""Endings of films."""

CODECS = {
    ".mp4": ("-pix_fmt", "yuv420p", "-movflags", "+faststart"),
    ".webm": ("-c:v", "libvpx-vp9", "-pix_fmt", "yuv420p", "-crf", "32", "-b:v", "0", "-cpu-used", "5"),
}
"""Options of ffmpeg for videos that browsers play."""


def check_file(path: Path) -> None:
    """Raise an InputError, before any work, if no file of this name can be made: its ending is neither .png nor a
    film's, there is no such folder, or its kind needs a package that is missing."""
    if path.suffix not in (*FILMS, ".png"):
        raise InputError(f"{path}: the file must end in {', '.join(FILMS)} or .png.")
    check_folder(path)
    if path.suffix in CODECS:
        package("imageio_ffmpeg", "video", f"{path}: .gif needs no package, {path.suffix}")


def write_frames(frames: Iterable[Frame], path: Path, fps: float) -> None:
    """Write frames into the file that `check_file` has passed: .png side by side, the others one after another. Raise
    an InputError if it cannot be written."""
    with refusing(path), whole_file(path) as temporary:
        if path.suffix == ".png":
            Image.fromarray(np.concatenate(list(frames), axis=1)).save(temporary)
        elif path.suffix == ".gif":
            first, *rest = map(Image.fromarray, frames)
            first.save(temporary, save_all=True, append_images=rest, duration=1000 / fps, loop=0)
        else:
            _encode(frames, temporary, fps)


def _encode(frames: Iterable[Frame], path: Path, fps: float) -> None:
    rest = iter(frames)
    first = next(rest)
    size = f"{first.shape[1]}x{first.shape[0]}"
    raw = "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", str(fps), "-i", "-"
    ffmpeg, options = import_module("imageio_ffmpeg").get_ffmpeg_exe(), CODECS[path.suffix]
    command = [ffmpeg, "-y", "-loglevel", "error", *raw, *options, str(path)]
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
