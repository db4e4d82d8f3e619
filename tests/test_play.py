"""A stored run as a video, and what cannot be shown."""

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from humanoid_mjx.cli import app
from humanoid_mjx.spec import InputError
from humanoid_mjx.tasks.posture_switch import LEFT_SIGN
from humanoid_mjx.training.episode import HOLD_S, motion_of, play, robot_of, rows_of
from humanoid_mjx.training.policy import best_policy
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


def test_a_motion_is_that_of_the_task(switched):
    """The controller, followed step by step, takes the legs through the states of the task, and holds the last."""
    trained = best_policy(switched)
    played = play(trained)
    motion, task = motion_of(trained, played), trained.learner.task
    decisions, steps = len(played.actions), round(task.period / POSTURE["timestep"])
    assert played.success and decisions <= POSTURE["max_episode_steps"]
    assert len(motion.qpos) * POSTURE["timestep"] == pytest.approx(decisions * task.period + HOLD_S)
    for i in range(decisions):
        np.testing.assert_allclose(motion.qpos[(i + 1) * steps - 1], played.states[i + 1].world.qpos, atol=1e-5)
    right, left = np.split(motion.qpos, 2, axis=1)
    np.testing.assert_allclose(left, LEFT_SIGN * right, atol=0.05)
    np.testing.assert_allclose(right[-1], task.whole_body(task.grid[:, -1])[:5], atol=0.02)


def test_play_writes_an_animation(switched):
    done = CliRunner().invoke(app, ["play", str(switched)])
    assert done.exit_code == 0, done.output
    assert "succeeds in" in done.output
    with Image.open(switched / "figures" / "play.gif") as image:
        assert image.n_frames > 25 * HOLD_S


def test_a_task_that_is_not_known_here_is_played_by_its_decisions(tmp_path):
    """On native MuJoCo: a row at the start and after each of four decisions of 0.1 s."""
    leg = {"name": "leg_reach", "physics": "mujoco", "duration": 0.4}
    path = run(tmp_path / "leg", leg, learner={"name": "deep_q", "width": 8, "envs": 4, "rollout": 4}, total_steps=32)
    trained = best_policy(path)
    qpos, step_s = rows_of(trained, play(trained))
    assert qpos.shape == (5, robot_of(trained).nq) and step_s == 0.1
    done = CliRunner().invoke(app, ["play", str(path), "--out", str(tmp_path / "leg.gif")])
    assert done.exit_code == 0 and "4 decisions, 0.4 s" in done.output
    with Image.open(tmp_path / "leg.gif") as image:
        assert image.n_frames == 25 * 0.4 + 1


def test_what_cannot_be_played(tmp_path):
    reach = run(tmp_path / "reach", REACH, seeds=1, episodes=2)
    for path, sentence in (
        (tmp_path / "none", "neither a run folder nor a policy"),
        (tmp_path, "this is no run folder"),
        (reach, "its task joint_reach moves no robot; posture_switch is one that does"),
    ):
        done = CliRunner().invoke(app, ["play", str(path)])
        assert isinstance(done.exception, InputError) and sentence in str(done.exception)
