"""Pictures of motions: a file of the kind asked for."""

import os
import subprocess
import sys

import mujoco
import numpy as np
import pytest
from PIL import Image

from humanoid_mjx.evaluation.film import Film, Push, in_words, merged
from humanoid_mjx.mechanics.terrain import Terrain
from humanoid_mjx.report import rendering
from humanoid_mjx.report.raycast import GROUND, SHADOW, Painter
from humanoid_mjx.report.rendering import HEIGHT, STRIP, WIDTH, render_film
from humanoid_mjx.report.scene import LIGHT, make_camera, make_scene
from humanoid_mjx.robot.lower_body import LowerBody
from humanoid_mjx.spec import InputError

MODEL = LowerBody().model


@pytest.fixture
def motion():
    """A knee that bends."""
    qpos = np.tile(MODEL.qpos0, (8, 1))
    qpos[:, 10] = np.linspace(0.0, 1.0, 8)
    return qpos


@pytest.fixture(scope="module")
def shapes():
    """Paint a red ball of 5 cm radius 15 cm above the ground, and a geom that is not shown."""
    model = mujoco.MjModel.from_xml_string("""<mujoco>
      <statistic extent="0.32"/>
      <worldbody>
        <geom type="plane" size="0 0 1"/>
        <body pos="0 0 0.15">
          <geom size="0.05" rgba="1 0 0 1"/>
          <geom type="box" size="0.2 0.2 0.2" group="3"/>
        </body>
      </worldbody></mujoco>""")
    scene = make_scene(model, np.zeros((1, 0)))
    return scene, Painter(scene, WIDTH, HEIGHT).paint(0).astype(int)


def pixels(scene, points):
    """Where the camera sees points, to the right and downwards."""
    camera = make_camera(HEIGHT)
    return camera.seen(np.atleast_2d(points), camera.place(scene.middle[0], scene.distance), (WIDTH, HEIGHT))


def test_a_ball_covers_the_disc_that_the_camera_sees(shapes):
    scene, picture = shapes
    red = (picture[..., 0] > 100) & (picture[..., 1] < 60)
    radius = make_camera(HEIGHT).focus * 0.05 / np.sqrt(scene.distance**2 - 0.05**2)
    # Its edge is as long as 6 radii, and a pixel there counts or not.
    assert red.sum() == pytest.approx(np.pi * radius**2, abs=4 * radius)
    rows, columns = np.nonzero(red)
    np.testing.assert_allclose((columns.mean() + 0.5, rows.mean() + 0.5), pixels(scene, [0, 0, 0.15])[0], atol=0.3)


def test_shadows_lie_where_the_light_falls(shapes):
    """The ball's shadow on the ground, which is 10 cm wide, and its side that faces the light."""
    scene, picture = shapes
    ball, across = np.array([0.0, 0.0, 0.15]), np.cross(LIGHT, [0.0, 0.0, 1.0])
    middle, across = ball - ball[2] / LIGHT[2] * LIGHT, across / np.linalg.norm(across)
    for away, share in ((-0.06, 1.0), (-0.04, SHADOW), (0.0, SHADOW), (0.04, SHADOW), (0.06, 1.0)):
        column, row = pixels(scene, middle + away * across)[0].astype(int)
        # The brightest of pixels that a line of the grid may cross.
        brightest = picture[row - 1 : row + 2, column - 1 : column + 2].max(axis=(0, 1))
        np.testing.assert_allclose(brightest, 255 * share * GROUND, atol=2)
    (right, high), (left, low) = pixels(scene, ball + [[-0.04], [0.04]] * LIGHT).astype(int)
    assert picture[high, right, 0] > picture[low, left, 0] + 50 and not picture[[high, low], [right, left], 1:].any()


@pytest.mark.parametrize("told", ["none-such", "osmesa"])
def test_commands_run_where_mujoco_refuses_what_the_environment_says(told, tmp_path):
    """MuJoCo cannot be imported where MUJOCO_GL names a way that it does not know, or whose library is missing."""
    call = [sys.executable, "-m", "humanoid_mjx", "export", "leg", str(tmp_path / "leg.xml")]
    done = subprocess.run(call, env=os.environ | {"MUJOCO_GL": told}, capture_output=True, text=True)
    assert done.returncode == 0 and not done.stderr, done.stderr
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "leg.xml")).nq == 5


def test_a_strip_of_frames(tmp_path, motion):
    with Image.open(render_film(Film(MODEL, motion, 0.04), tmp_path / "knee.png")) as image:
        assert image.size == (STRIP * WIDTH, HEIGHT)


def test_an_animation_runs_at_the_speed_of_the_motion(tmp_path, motion):
    told = []
    film, tell = Film(MODEL, motion[:3], 0.1), lambda *so: told.append(so)
    path = render_film(film, tmp_path / "knee.gif", fps=10, size=(96, 64), tell=tell)
    with Image.open(path) as image:
        assert (image.size, image.n_frames, image.info["duration"]) == ((96, 64), 3, 100)
    assert told == [(1, 3), (2, 3), (3, 3)]


@pytest.mark.parametrize(("ending", "mark"), [(".mp4", b"ftyp"), (".webm", b"\x1a\x45\xdf\xa3")])
def test_videos(tmp_path, motion, ending, mark):
    path = render_film(Film(MODEL, motion, 0.04), tmp_path / f"knee{ending}")
    assert mark in path.read_bytes()[:12] and len(list(tmp_path.iterdir())) == 1


def test_a_video_that_cannot_be_made(tmp_path, motion, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    monkeypatch.setattr(rendering, "_paint", lambda *arguments: pytest.fail("it was painted"))
    words = r"\.gif needs no package, \.mp4 needs the package imageio_ffmpeg; pip install 'humanoid-mjx\[video\]'"
    with pytest.raises(InputError, match=words):
        render_film(Film(MODEL, motion, 0.04), tmp_path / "knee.mp4")


def test_words_of_a_film(motion):
    film = Film(MODEL, motion, 0.2, told=((0.0, "a"), (0.6, "b")))
    assert [film.asked(0.2 * i) for i in range(5)] == ["a", "a", "a", "b", "b"]
    assert in_words({"forward, m/s": 0.3, "turn, rad/s": -1.0}) == "forward 0.30 m/s; turn -1.00 rad/s"
    assert in_words({"left, m/s": -0.06, "turn left, rad/s": 0.5}) == "right 0.06 m/s; turn left 0.50 rad/s"
    forces = np.zeros((6, 3))
    forces[1:3, 0], forces[4, 2] = 2.0, 5.0
    assert [(p.start, p.seconds, p.words) for p in merged(forces, 0.02)] == [
        (0.02, 0.04, "push 0.08 N s"),
        (0.08, 0.02, "push 0.1 N s"),
    ]
    assert Push(0.0, 1.0, np.array([3.0, 4.0, 0.0])).words == "push 5 N"


@pytest.mark.parametrize(
    "terrain", [Terrain(rough=0.02), Terrain(stairs=0.03, direction=30.0), Terrain(slope=8.0, direction=200.0)]
)
def test_rays_meet_the_ground_where_it_is(terrain):
    scene = make_scene(MODEL, MODEL.qpos0[None], terrain)
    painter = Painter(scene, 48, 36)
    eye, rays = painter.camera.place(scene.middle[0], scene.distance), painter.middles.reshape(-1, 3)
    depth = painter._meets(eye, rays)
    x, y, z = (eye + depth[:, None] * rays)[depth > 0].T
    assert 200 < len(x) < len(rays)
    # Of a place on the edge of a step the height is that of either.
    off = np.abs(z - terrain.level(x, y))
    assert np.quantile(off, 0.8) < 1e-4 and off.max() < 0.031 + 1e-4


def test_the_ground_of_a_level_world_is_the_terrain_turned():
    """Places on a slope with waves, turned so that the z axis points against gravity."""
    terrain, (u, v) = Terrain(slope=10.0, direction=50.0, rough=0.02), np.random.default_rng(0).uniform(-2, 2, (2, 100))
    turn = np.empty(4)
    mujoco.mju_quatZ2Vec(turn, terrain.up(np))
    axes = np.empty(9)
    mujoco.mju_quat2Mat(axes, turn)
    x, y, z = axes.reshape(3, 3).T @ np.stack([u, v, terrain.height(u, v, np)])
    np.testing.assert_allclose(terrain.level(x, y), z, atol=1e-4)  # three steps of an iteration
