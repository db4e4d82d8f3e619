"""A stored run as a video, and what cannot be shown."""

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from humanoid_mjx.cli import app
from humanoid_mjx.spec import InputError
from humanoid_mjx.tasks.posture_switch import LEFT_SIGN
from humanoid_mjx.training.episode import HOLD_S, best_policy, greedy_episode
from humanoid_mjx.training.sweep import sweep

POSTURE = {"name": "posture_switch", "places": 2, "timestep": 0.02, "max_episode_steps": 10}
REACH = {"name": "joint_reach", "joint": 4, "states": 11, "max_episode_steps": 9}


def run(path, task, **options):
    sweep({"name": "tiny", "task": task, "learner": {"name": "tabular_q"}, "record": 1} | options, path)
    return path


@pytest.fixture(scope="module")
def switched(tmp_path_factory):
    return run(tmp_path_factory.mktemp("play") / "run", POSTURE, seeds=4, episodes=30)


@pytest.fixture(autouse=True)
def no_opengl(monkeypatch):
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.delenv("DISPLAY", raising=False)


def test_an_episode_is_the_one_that_training_evaluated(switched):
    trained = best_policy(switched)
    episode = greedy_episode(trained)
    task, rows = trained.learner.task, len(episode.motion.qpos)
    assert episode.arrived and episode.decisions <= POSTURE["max_episode_steps"]
    assert rows * POSTURE["timestep"] == pytest.approx(episode.decisions * task.period + HOLD_S)
    right, left = np.split(episode.motion.qpos, 2, axis=1)
    np.testing.assert_allclose(left, LEFT_SIGN * right, atol=0.05)
    np.testing.assert_allclose(right[-1], task.whole_body(task.grid[:, -1])[:5], atol=0.02)


def test_play_writes_an_animation(switched):
    done = CliRunner().invoke(app, ["play", str(switched)])
    assert done.exit_code == 0, done.output
    assert "reaches its goal in" in done.output
    with Image.open(switched / "figures" / "play.gif") as image:
        assert image.n_frames > 25 * HOLD_S


def test_what_cannot_be_played(tmp_path):
    reach = run(tmp_path / "reach", REACH, seeds=1, episodes=2)
    for path, sentence in (
        (tmp_path / "none", "this is no run folder"),
        (reach, "its task JointReach moves no robot; of the tasks posture_switch does"),
    ):
        done = CliRunner().invoke(app, ["play", str(path)])
        assert isinstance(done.exception, InputError) and sentence in str(done.exception)
