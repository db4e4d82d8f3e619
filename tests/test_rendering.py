"""Pictures of motions: a file of the kind asked for, with OpenGL or without."""

import os
import subprocess
import sys

import mujoco
import numpy as np
import pytest
from PIL import Image

from humanoid_mjx.report import opengl, rendering, ways
from humanoid_mjx.report.film import Film, Push, in_words, merged
from humanoid_mjx.report.overlay import ALARM, annotate
from humanoid_mjx.report.raycast import Painter, meet
from humanoid_mjx.report.rendering import HEIGHT, STRIP, WIDTH, draw, render_film
from humanoid_mjx.report.robots import draw_robots
from humanoid_mjx.report.scene import Shape, make_camera, make_scene
from humanoid_mjx.report.video import ffmpeg
from humanoid_mjx.robot import robot_spec
from humanoid_mjx.robot.lower_body import LOOKS, lower_body_model
from humanoid_mjx.spec import InputError

MODEL = lower_body_model()


@pytest.fixture
def no_opengl(monkeypatch):
    monkeypatch.setattr(opengl, "ways", list)


@pytest.fixture
def motion():
    """A knee that bends."""
    qpos = np.tile(MODEL.qpos0, (8, 1))
    qpos[:, 10] = np.linspace(0.0, 1.0, 8)
    return qpos


def test_rays_meet_shapes_where_those_of_mujoco_do():
    """Balls, capsules and boxes of the robot, a cylinder and an ellipsoid, from all sides."""
    rng = np.random.default_rng(0)
    spec = robot_spec("lower_body")
    for kind, size in (
        (mujoco.mjtGeom.mjGEOM_CYLINDER, (0.02, 0.05, 0)),
        (mujoco.mjtGeom.mjGEOM_ELLIPSOID, (0.02, 0.03, 0.06)),
    ):
        spec.worldbody.add_geom(type=kind, size=size, pos=rng.uniform(0.05, 0.15, 3), quat=rng.normal(size=4))
    model = spec.compile()
    qpos = model.qpos0.copy()
    qpos[7:] = rng.uniform(-0.8, 0.8, 10)
    data, scene = mujoco.MjData(model), make_scene(model, qpos[None])
    data.qpos = qpos
    mujoco.mj_kinematics(model, data)
    model.geom_group[model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE] = 3
    group, geom, hits = np.array([1, 1, 1, 0, 0, 0], np.uint8), np.zeros(1, np.int32), 0
    for _ in range(400):
        origin = rng.normal(size=3)
        ray = rng.normal((0.0, 0.0, 0.15), 0.08) - origin
        # MuJoCo looks at what is inside of a geom, too, but no ray starts there.
        wanted = mujoco.mj_ray(model, data, origin, ray, group, 1, -1, geom)
        found, outwards = np.inf, None
        for shape, place, turn in zip(scene.shapes, scene.position[0], scene.rotation[0], strict=True):
            local = ((origin - place) @ turn).astype(np.float32)[None], (ray @ turn).astype(np.float32)[None]
            depth, normal = meet(shape, *local)
            if depth[0] < found:
                found, outwards = float(depth[0]), turn @ normal[0]
        assert (wanted < 0) == np.isinf(found)
        if wanted > 0:
            hits += 1
            # Single precision of coordinates about 2 m; grazing rays magnify it.
            assert found == pytest.approx(wanted, abs=1e-3)
            assert np.linalg.norm(outwards) == pytest.approx(1.0, abs=1e-3) and outwards @ ray < 1e-2
    assert hits > 100


def test_a_ball_covers_the_disc_that_the_camera_sees():
    scene = make_scene(MODEL, MODEL.qpos0[None])
    ball = Shape("sphere", np.repeat(0.05, 3), np.array([1.0, 0.0, 0.0]))
    scene = scene._replace(shapes=[ball], position=scene.middle[:, None], rotation=np.eye(3)[None, None], ground=False)
    picture = Painter(scene, WIDTH, HEIGHT).paint(0)
    red = (picture[..., 0] > 100) & (picture[..., 1] < 60)
    focus = make_camera(HEIGHT).focus
    radius = focus * 0.05 / np.sqrt(scene.distance**2 - 0.05**2)
    # Its edge is as long as 6 radii, and a pixel there counts or not.
    assert red.sum() == pytest.approx(np.pi * radius**2, abs=4 * radius)
    rows, columns = np.nonzero(red)
    np.testing.assert_allclose((rows.mean(), columns.mean()), (HEIGHT / 2 - 0.5, WIDTH / 2 - 0.5), atol=0.3)


def test_both_renderers_show_the_same_body(motion):
    scene = make_scene(MODEL, motion[-1:])
    painted = opengl.paint(MODEL, motion[-1:], scene, WIDTH, HEIGHT)
    if painted is None:
        pytest.skip("there is no OpenGL here")
    pictures = [next(painted), Painter(scene, WIDTH, HEIGHT).paint(0)]
    painted.close()
    colored = [np.ptp(picture.astype(int), axis=-1) > 40 for picture in pictures]
    both, either = colored[0] & colored[1], colored[0] | colored[1]
    # The legs' pixels, but for their edges.
    assert either.sum() > 5000 and both.sum() > 0.95 * either.sum()


@pytest.mark.parametrize("way", ["none-such", "osmesa"])
def test_a_way_to_opengl_that_does_not_work_is_no_noise(way, motion, monkeypatch, capfd):
    monkeypatch.setattr(opengl, "ways", lambda: [way])
    painted = opengl.paint(MODEL, motion[:1], make_scene(MODEL, motion[:1]), 32, 24)
    if painted is not None:
        assert next(painted).shape == (24, 32, 3)
        painted.close()
    assert way == "osmesa" or painted is None
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("told", "display", "tried"),
    [
        (None, None, ["egl", "osmesa"]),
        (None, ":0", ["egl", "glfw", "osmesa"]),
        ("osmesa", None, ["osmesa", "egl"]),
        (" GLX", None, ["glfw", "egl", "osmesa"]),
        ("none-such", ":0", ["none-such", "egl", "glfw", "osmesa"]),
        ("off", ":0", []),
    ],
)
@pytest.mark.parametrize("taken", [False, True], ids=["in the environment", "taken out of it"])
def test_what_the_environment_says_is_tried_first(told, display, tried, taken, monkeypatch):
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setattr(ways, "_told", [])
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    for name, value in (("MUJOCO_GL", told), ("DISPLAY", display)):
        monkeypatch.delenv(name, raising=False)
        if value is not None:
            monkeypatch.setenv(name, value)
    if taken:
        ways.take_over()
        assert "MUJOCO_GL" not in os.environ
    assert ways.ways() == tried


@pytest.mark.parametrize("told", ["none-such", "osmesa"])
def test_commands_run_where_mujoco_refuses_what_the_environment_says(told, tmp_path):
    """MuJoCo cannot be imported where MUJOCO_GL names a way that it does not know, or whose library is missing."""
    call = [sys.executable, "-m", "humanoid_mjx", "export", "leg", str(tmp_path / "leg.xml")]
    done = subprocess.run(call, env=os.environ | {"MUJOCO_GL": told}, capture_output=True, text=True)
    assert done.returncode == 0 and not done.stderr, done.stderr
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "leg.xml")).nq == 5


def test_a_strip_of_frames(tmp_path, motion, no_opengl):
    with Image.open(render_film(Film(MODEL, motion, 0.04), tmp_path / "knee.png")) as image:
        assert image.size == (STRIP * WIDTH, HEIGHT)


def test_an_animation_runs_at_the_speed_of_the_motion(tmp_path, motion, no_opengl):
    told = []
    path = render_film(Film(MODEL, motion[:3], 0.1), tmp_path / "knee.gif", fps=10, tell=lambda *so: told.append(so))
    with Image.open(path) as image:
        assert (image.size, image.n_frames, image.info["duration"]) == ((WIDTH, HEIGHT), 3, 100)
    assert told == [(1, 3), (2, 3), (3, 3)]


@pytest.mark.parametrize(("ending", "mark"), [(".mp4", b"ftyp"), (".webm", b"\x1a\x45\xdf\xa3")])
def test_videos(tmp_path, motion, ending, mark, no_opengl):
    if ffmpeg() is None:
        pytest.skip("there is no ffmpeg here; the extra `video` brings one")
    path = render_film(Film(MODEL, motion, 0.04), tmp_path / f"knee{ending}")
    assert mark in path.read_bytes()[:12] and len(list(tmp_path.iterdir())) == 1


def test_pictures_show_the_motion(motion, no_opengl):
    first, last = draw(MODEL, motion[[0, -1]])
    assert (first != last).any()


def test_legs_without_colours_have_those_of_their_sides():
    model = robot_spec("legs").compile()
    colors = {tuple(shape.color) for shape in make_scene(model, model.qpos0[None]).shapes}
    assert colors == {LOOKS["right"][:3], LOOKS["left"][:3]}


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("knee.jpeg", "must end in .gif, .mp4, .webm or .png"),
        ("knee.mp4", r"needs ffmpeg, which is not installed: pip install 'humanoid-mjx\[video\]' brings one"),
        ("none/knee.gif", "there is no folder"),
    ],
)
def test_files_that_cannot_be_made(tmp_path, motion, name, sentence, monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr("humanoid_mjx.report.video.find_spec", lambda name: None)
    monkeypatch.setattr(rendering, "_paint", lambda *arguments: pytest.fail("it was painted"))
    with pytest.raises(InputError, match=sentence):
        render_film(Film(MODEL, motion, 0.04), tmp_path / name)


def test_a_push_is_drawn_while_it_can_be_seen(motion):
    scene = make_scene(MODEL, motion)
    film = Film(MODEL, motion, 0.2, "title", (), (Push(0.4, 0.02, np.array([0.0, 10.0, 0.0])),))
    white = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
    red = [(annotate(white, film, scene, i, 0.2 * i) == ALARM).all(axis=-1).sum() for i in range(8)]
    assert [count > 100 for count in red] == [False, False, True, True, True, False, False, False]


def test_words_of_a_film(motion):
    film = Film(MODEL, motion, 0.2, told=((0.0, "a"), (0.6, "b")))
    assert [film.asked(0.2 * i) for i in range(5)] == ["a", "a", "a", "b", "b"]
    assert in_words({"forward, m/s": 0.3, "turn, rad/s": -1.0}) == "forward 0.30 m/s; turn -1.00 rad/s"
    forces = np.zeros((6, 3))
    forces[1:3, 0], forces[4, 2] = 2.0, 5.0
    assert [(p.start, p.seconds, p.words) for p in merged(forces, 0.02)] == [
        (0.02, 0.04, "push 0.08 N s"),
        (0.08, 0.02, "push 0.1 N s"),
    ]
    assert Push(0.0, 1.0, np.array([3.0, 4.0, 0.0])).words == "push 5 N"


def test_the_robots_are_drawn(tmp_path):
    with Image.open(draw_robots(tmp_path / "robots.png")) as image:
        colors = {color for _, color in image.convert("RGB").getcolors(1 << 20)}
    for joint in ((0, 0x72, 0xB2), (0xD5, 0x5E, 0), (0, 0x9E, 0x73), (0xCC, 0x79, 0xA7), (0xE6, 0x9F, 0)):
        assert joint in colors
