"""The adapters of docs/ten_lines.md: gymnax's environments as tasks, tasks as environments of Brax."""

import importlib
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from docs_reader import blocks

from humanoid_mjx import key, make_learner, make_task, train
from humanoid_mjx.tasks.check import check_task

PAGE = Path(__file__).parent.parent.parent / "docs" / "ten_lines.md"


def adapter(name, folder, monkeypatch):
    (text,) = (block.text for block in blocks(PAGE.read_text(encoding="utf-8")) if block.title == f"{name}.py")
    assert len(text.splitlines()) <= 60
    (folder / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(folder)
    monkeypatch.delitem(sys.modules, name, raising=False)
    return importlib.import_module(name)


def test_deep_q_learns_the_cart_pole_of_gymnax(tmp_path, monkeypatch):
    gymnax = pytest.importorskip("gymnax")
    task = adapter("gymnax_task", tmp_path, monkeypatch).Gymnax(env="CartPole-v1")
    check_task(task)
    env, params = gymnax.make("CartPole-v1")
    state = task.reset(key(0))
    for number in range(5):
        obs, _, reward, *_ = env.step_env(key(number), state.data, jnp.int32(number % 2), params)
        state = task.step(state, jnp.array([number % 2]), key(number))
        np.testing.assert_array_equal(state.obs, obs)
        assert state.reward == reward and not state.done
    values = {"discount": 0.98, "epsilon_decay": 0.99, "learning_rate": 0.001, "envs": 32, "width": 64}
    learner = make_learner("deep_q", task, total_steps=50_000, evaluations=1, **values)
    trained = train(learner, key(0))
    assert trained.scores["greedy_steps"] > 80  # a random agent stays up for some 20 steps


def test_brax_steps_a_task(tmp_path, monkeypatch):
    """Brax's wrappers reset, cut off and step a task in a batch, and rewards are those of the task."""
    training = importlib.import_module("brax.envs.wrappers.training")
    task = make_task("joint_reach", joint=4, states=25, max_episode_steps=200)
    env = training.wrap(adapter("brax_env", tmp_path, monkeypatch).TaskEnv(task), episode_length=30, action_repeat=1)
    state = jax.jit(env.reset)(jax.random.split(jax.random.PRNGKey(0), 3))
    assert state.obs.shape == (3, env.observation_size) == (3, 1) and env.action_size == 1
    step, rewards, ends = jax.jit(env.step), [], []
    for _ in range(30):
        state = step(state, jnp.array([[1.0], [1.0], [-1.0]]))  # to move, to move, to stay
        rewards.append(np.asarray(state.reward))
        ends.append(np.asarray(state.done))
    moves = np.argmax(np.array(ends), axis=0) + 1
    assert moves.tolist() == [24, 24, 30]  # 120 degrees in steps of 5; the wrapper cuts the third off
    assert state.info["truncation"].tolist() == [0, 0, 1]
    expected, inner = [], task.reset(key(0))
    for _ in range(24):
        inner, reward, _ = task.step(inner, jnp.int32(1), key(0))
        expected.append(float(reward))
    np.testing.assert_allclose(np.array(rewards)[:24, 0], expected, rtol=1e-6)
