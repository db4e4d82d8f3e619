"""Words and arrows on the pictures of a film: title, time, what the robot is asked for, pushes."""

from functools import lru_cache

import numpy as np
from jaxtyping import Float
from matplotlib.font_manager import FontProperties, findfont
from PIL import Image, ImageDraw, ImageFont

from humanoid_mjx.evaluation.film import Film, Push
from humanoid_mjx.report.raycast import Frame
from humanoid_mjx.report.scene import Scene, make_camera

INK, ALARM = (32, 32, 32), (193, 18, 31)

MARGIN = 10
"""pixels"""


def letter_of(height: int) -> int:
    """Height of a letter on a picture of so many pixels from top to bottom."""
    return max(9, height // 26)


def annotate(frame: Frame, film: Film, scene: Scene, number: int, seconds: float, clock: bool = True) -> Frame:
    """A frame of a film with its words and arrows, and the time if a `clock` is wanted."""
    image = Image.fromarray(frame)
    draw = ImageDraw.Draw(image)
    width, height = image.size
    letter = letter_of(height)
    for push in film.pushes:
        if push.start <= seconds + 1e-9 < push.start + push.shown:
            _draw_push(draw, push, scene, number, (width, height))
    if film.title:
        title = _fitting(film.title, width - 2 * MARGIN - 5 * letter, letter, bold=True)
        _write(draw, (MARGIN, MARGIN), title, "la", letter, bold=True)
    if clock:
        _write(draw, (width - MARGIN, MARGIN), f"{seconds:.2f} s", "ra", letter)
    if words := film.asked(seconds):
        words = _fitting(words, width - 2 * MARGIN, letter, bold=False)
        _write(draw, (MARGIN, height - MARGIN), words, "ld", letter)
    return np.asarray(image)


def _draw_push(draw: ImageDraw.ImageDraw, push: Push, scene: Scene, number: int, size: tuple[int, int]) -> None:
    """An arrow whose head is at the torso."""
    camera = make_camera(size[1])
    torso = scene.torso[number]
    direction = push.force / np.linalg.norm(push.force)
    ends = np.stack([torso - scene.arrow * direction, torso])
    tail, head = camera.seen(ends, camera.place(scene.middle[number], scene.distance), size)
    along = (head - tail) / max(float(np.linalg.norm(head - tail)), 1e-6)
    across = np.array([-along[1], along[0]])
    barbs = [head, head - 14 * along + 7 * across, head - 14 * along - 7 * across]
    draw.line([_pixel(tail), _pixel(head - 10 * along)], fill=ALARM, width=4)
    draw.polygon([_pixel(point) for point in barbs], fill=ALARM)
    letter = letter_of(size[1])
    # Behind the tail, so that the words cover neither arrow nor robot.
    anchor, ahead = ("r", 1.0) if along[0] > 0.5 else ("l", 0.0) if along[0] < -0.5 else ("m", 0.5)
    length = _font(letter, False).getlength(push.words)
    low, high = MARGIN + ahead * length, size[0] - MARGIN - (1.0 - ahead) * length
    place = np.clip(tail - letter * along, [low, 40], [max(low, high), size[1] - 40])
    _write(draw, _pixel(place), push.words, f"{anchor}m", letter, ALARM)


def _pixel(point: Float[np.ndarray, "2"]) -> tuple[float, float]:
    return float(point[0]), float(point[1])


def _write(
    draw: ImageDraw.ImageDraw,
    place: tuple[float, float],
    text: str,
    anchor: str,
    letter: int,
    color: tuple[int, int, int] = INK,
    bold: bool = False,
) -> None:
    """Text with a white rim, readable on everything."""
    draw.text(place, text, color, _font(letter, bold), anchor, stroke_width=2, stroke_fill=(255, 255, 255))


def _fitting(text: str, width: float, letter: int, bold: bool) -> str:
    """A text, its end cut off where it is wider than so many pixels."""
    line, font = " ".join(text.split()), _font(letter, bold)
    if font.getlength(line) <= width:
        return line
    while line and font.getlength(line + "…") > width:
        line = line[:-1]
    return line + "…"


@lru_cache
def _font(letter: int, bold: bool) -> ImageFont.FreeTypeFont:
    """The font that matplotlib brings."""
    return ImageFont.truetype(
        findfont(FontProperties(family="DejaVu Sans", weight="bold" if bold else "normal")), letter
    )
