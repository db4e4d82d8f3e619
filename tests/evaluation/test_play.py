"""A stored run as a video."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from command_line import told
from PIL import Image
from small_sweep import SWITCHING

from humanoid_mjx.compute import rng
from humanoid_mjx.evaluation.episode import HOLD_S, motion_of, play, robot_of, rows_of
from humanoid_mjx.evaluation.film import film_of, show
from humanoid_mjx.evaluation.policy import find_policy
from humanoid_mjx.spec import InputError
from humanoid_mjx.tasks import make_task
from humanoid_mjx.tasks.posture_switch import LEFT_SIGN
from humanoid_mjx.training.progress import Reporter
from humanoid_mjx.training.sweep import Run, sweep

reset = jax.jit(lambda task, key: task.reset(key))
step = jax.jit(lambda task, *args: task.step(*args))


def run(path, task, **options):
    sweep({"name": "tiny", "task": task, "learner": {"name": "tabular_q"}, "record": 1} | options, path)
    return path


@pytest.fixture(scope="module")
def switched(tmp_path_factory):
    return sweep(SWITCHING, tmp_path_factory.mktemp("play") / "run").path


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """Frames of a few rays: what they look like is test_rendering.py's."""
    monkeypatch.setattr("humanoid_mjx.report.rendering.WIDTH", 64)
    monkeypatch.setattr("humanoid_mjx.report.rendering.HEIGHT", 48)


def test_a_sweep_learns_to_switch(switched):
    summary = Run(switched).summary
    assert summary["greedy_success"].mean() == 1.0
    assert summary["greedy_steps"].max() < 20


def test_a_motion_is_that_of_the_task(switched):
    """The controller, followed step by step, takes the legs through the states of the task, and holds the last."""
    trained = find_policy(switched)
    played = play(trained)
    motion, task = motion_of(trained, played), trained.learner.task
    decisions, steps = len(played.actions), round(task.period / task.timestep)
    assert played.success and decisions < 20
    assert len(motion.qpos) * task.timestep == pytest.approx(decisions * task.period + HOLD_S)
    for i in range(decisions):
        np.testing.assert_allclose(motion.qpos[(i + 1) * steps - 1], played.states[i + 1].world.qpos, atol=1e-5)
    right, left = np.split(motion.qpos, 2, axis=1)
    np.testing.assert_allclose(left, LEFT_SIGN * right, atol=0.05)
    np.testing.assert_allclose(right[-1], task.whole_body(task.grid[:, -1])[:5], atol=0.02)


def test_play_writes_an_animation(switched):
    output = told("play", switched, "--fps", 50, "--size", "64x80")
    for words in ("loading", "simulating", "rendering", "succeeds in"):
        assert words in output
    with Image.open(switched / "figures" / "play.gif") as image:
        assert image.n_frames > 50 * HOLD_S and image.size == (64, 80)


def test_play_shows_a_changed_world(switched, tmp_path):
    def played(*more):
        return " ".join(told("play", switched, "--out", tmp_path / "play.png", *more).split())

    assert "succeeds in 4 decisions" in played()
    assert "does not succeed in 1 decisions" in played("--set", "task.max_episode_steps=1")
    with pytest.raises(InputError, match="a policy stays as it is"):
        played("--set", "learner.epsilon=0.1")


def test_the_file_is_looked_at_before_any_work(switched, tmp_path, monkeypatch):
    monkeypatch.setattr("humanoid_mjx.evaluation.policy.find_policy", lambda name: pytest.fail("it was loaded"))
    for arguments, sentence in (
        (["--out", str(tmp_path / "x.avi")], "must end in .gif, .mp4, .webm or .png"),
        (["--out", str(tmp_path / "none" / "x.gif")], "there is no folder"),
        (["--out", str(tmp_path / "x.gif"), "--view"], "choose one"),
        (["--size", "640x480", "--view"], "choose one"),
        (["--size", "640"], "write WIDTHxHEIGHT, such as 640x480: even numbers from 64 to 4096"),
        (["--size", "641x480"], "even numbers"),
        (["--port", "8000"], "only --view has a server"),
        (["--view", "--set", "task.terrain.slope=8"], "--out shows a terrain"),
        (["--physics", "tree", "--view"], "native MuJoCo; leave this out"),
    ):
        with pytest.raises(InputError, match=re.escape(sentence)):
            told("play", switched, *arguments)


def test_between_long_decisions_a_leg_is_shown_step_by_step(tmp_path):
    """Four decisions of 0.1 s and the second after, on native MuJoCo in steps of 5 ms; each decision ends where the
    task says that it does."""
    leg = {"name": "leg_reach", "physics": "mujoco", "duration": 0.4}
    path = run(tmp_path / "leg", leg, learner={"name": "deep_q", "width": 8, "envs": 4, "rollout": 4}, total_steps=32)
    trained = find_policy(path)
    played = play(trained)
    qpos, step_s = rows_of(trained, played)
    assert step_s == pytest.approx(0.005)
    assert qpos.shape == (round((0.4 + HOLD_S) / step_s), robot_of(trained).nq)
    for i in range(4):
        np.testing.assert_allclose(qpos[20 * (i + 1) - 1], played.states[i + 1].world.qpos, atol=1e-5)
    assert "4 decisions, 0.4 s" in told("play", path, "--out", tmp_path / "leg.gif", "--episode", 1)
    second = show(trained, Reporter(), 1)[0]
    assert second.title.endswith(", episode 1") and not np.array_equal(second.qpos[0], qpos[0])
    with Image.open(tmp_path / "leg.gif") as image:
        assert image.n_frames == 25 * (0.4 + HOLD_S)


def test_a_task_of_ones_own_is_played(tmp_path):
    """Its state is a dict with a world in it; it says what pushes the body and what the body is told."""
    learner = {"name": "deep_q", "width": 8, "envs": 4, "rollout": 4, "evaluation_envs": 2}
    trained = find_policy(run(tmp_path / "own", {"name": "sway:Sway"}, learner=learner, total_steps=32))
    played = play(trained)
    film = film_of(trained, played, trained.name)
    assert film.step_s == 0.04 and len(film.qpos) == 11
    np.testing.assert_allclose(film.qpos[-1], played.states[-1]["robot"][0].qpos)
    assert film.asked(0.0) == "lean 0.10 rad" and film.asked(0.39) == "lean 0.20 rad"
    (push,) = film.pushes
    assert (push.start, push.words) == (pytest.approx(0.12), "push 0.16 N s")
    np.testing.assert_allclose(push.force, [0.0, 2.0, 0.0])
    assert push.seconds == pytest.approx(0.08)


def test_pushes_of_legged_tasks_are_those_that_their_steps_carry_out():
    """A push that is due moves the body its way; without one the same step does not."""
    task = make_task("stand", physics="mujoco", push={"every": 0.1})
    key = rng.key(3)
    state = reset(task, key)
    number = jnp.ceil(state.data.first_push / task.period).astype(jnp.int32)
    due = state._replace(data=state.data._replace(decisions=number))
    force = np.asarray(task.push_on(due.data, key))
    assert np.linalg.norm(force) == pytest.approx(0.2 / task.period, rel=1e-4)
    calm = task.replace(push=task.push.replace(impulse=0.0))
    pushed, still = (step(t, due, jnp.ones(10, int), key).data.world.qvel[:3] for t in (task, calm))
    # 0.2 N s on 1.7 kg are 0.12 m/s, of which the feet take some.
    assert 0.03 < (pushed - still) @ force / np.linalg.norm(force) < 0.15
