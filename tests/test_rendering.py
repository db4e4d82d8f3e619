"""Pictures of motions: a file of the kind asked for, with OpenGL or without."""

import numpy as np
import pytest
from PIL import Image

from humanoid_mjx.report.rendering import HEIGHT, STRIP, WIDTH, draw, render
from humanoid_mjx.report.robots import draw_robots
from humanoid_mjx.robot.lower_body import lower_body_model
from humanoid_mjx.spec import InputError

MODEL = lower_body_model()


@pytest.fixture(autouse=True)
def no_opengl(monkeypatch):
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.delenv("DISPLAY", raising=False)


@pytest.fixture
def motion():
    """A knee that bends."""
    qpos = np.tile(MODEL.qpos0, (8, 1))
    qpos[:, 10] = np.linspace(0.0, 1.0, 8)
    return qpos


def test_a_strip_of_frames(tmp_path, motion):
    with Image.open(render(MODEL, motion, tmp_path / "new" / "knee.png")) as image:
        assert image.size == (STRIP * WIDTH, HEIGHT)


def test_an_animation(tmp_path, motion):
    with Image.open(render(MODEL, motion[:3], tmp_path / "knee.gif", fps=10)) as image:
        assert (image.size, image.n_frames, image.info["duration"]) == ((WIDTH, HEIGHT), 3, 100)


def test_pictures_show_the_motion(motion):
    first, last = draw(MODEL, motion[[0, -1]])
    assert (first != last).any()


@pytest.mark.parametrize(
    ("name", "sentence"),
    [("knee.jpeg", "must end in .gif, .mp4 or .png"), ("knee.mp4", "needs the program ffmpeg, which is not installed")],
)
def test_files_that_cannot_be_made(tmp_path, motion, name, sentence, monkeypatch):
    monkeypatch.setenv("PATH", "")
    with pytest.raises(InputError, match=sentence):
        render(MODEL, motion, tmp_path / name)


def test_the_robots_are_drawn(tmp_path):
    with Image.open(draw_robots(tmp_path / "robots.png")) as image:
        colors = {color for _, color in image.convert("RGB").getcolors(1 << 20)}
    for joint in ((0, 0x72, 0xB2), (0xD5, 0x5E, 0), (0, 0x9E, 0x73), (0xCC, 0x79, 0xA7), (0xE6, 0x9F, 0)):
        assert joint in colors
