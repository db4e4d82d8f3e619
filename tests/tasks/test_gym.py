"""Tasks as environments of Gymnasium: its own checker, and what the task itself does."""

import warnings

import jax
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from hop import Hop

from humanoid_mjx import InputError, make_task
from humanoid_mjx.tasks.base import Task
from humanoid_mjx.tasks.gym_env import TaskEnv, TaskVectorEnv


@pytest.fixture(params=["joint_reach", "hop, choices", "hop, numbers"])
def made(request):
    """A task and the kind of its actions."""
    if request.param == "joint_reach":
        return make_task("joint_reach", joint=1, max_episode_steps=30), None
    return Hop(), request.param.split()[1]


def test_gymnasiums_own_checker_is_content(made):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*Box observation space m.*imum value is.*infinity")
        warnings.filterwarnings("ignore", message=".*not registered.*|.*env.spec.*|.*render.*")
        check_env(TaskEnv(*made), skip_render_check=True)


def test_arrays_are_of_the_spaces_and_episodes_begin_anew_in_the_same_step(made):
    env = TaskVectorEnv(made[0], 16, made[1])
    assert env.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
    observations, infos = env.reset(seed=3)
    env.action_space.seed(3)
    assert env.observation_space.contains(observations) and infos == {}
    ended = 0
    for _ in range(40):
        before = observations.copy()
        observations, rewards, terminated, truncated, infos = env.step(env.action_space.sample())
        assert env.observation_space.contains(observations)
        assert rewards.shape == terminated.shape == truncated.shape == infos["success"].shape == (16,)
        done = terminated | truncated
        assert not (terminated & truncated).any() and ("final_obs" in infos) == done.any()
        assert (infos["success"] <= terminated).all()
        if done.any():
            assert (infos["_final_obs"] == done).all() and infos["final_obs"].shape == observations.shape
            # Where an episode goes on it is what was observed.
            np.testing.assert_array_equal(infos["final_obs"][~done], observations[~done])
            assert (infos["final_obs"][done] != observations[done]).any()
        ended += int(done.sum())
        assert not np.shares_memory(before, observations)
    assert ended >= 16


def test_a_seed_gives_the_same_episodes_and_another_gives_others(made):
    def played(seed):
        env = TaskVectorEnv(made[0], 4, made[1])
        first, _ = env.reset(seed=seed)
        env.action_space.seed(0)
        return np.stack([first, *(env.step(env.action_space.sample())[0] for _ in range(8))])

    np.testing.assert_array_equal(played(1), played(1))
    assert isinstance(made[0], Hop) is bool((played(1) != played(2)).any())  # joint_reach begins and moves the same


def test_what_is_no_environment_gets_a_sentence():
    with pytest.raises(InputError, match="takes a FiniteTask or a ContinuousTask, got a Task"):
        TaskVectorEnv(Task(), 2)


@pytest.mark.parametrize(
    ("kind", "actions"),
    [("choices", each) for each in ([0, 2], [-1, 0], [0, 0.5], [0], [0, 1, 1, 0], ["a", "b"], [None, 0])]
    + [("numbers", each) for each in ([0.0, np.nan], [0.0], [[0.0, 0.1], [0.2, 0.3]])],
)
def test_what_is_no_action_gets_a_sentence(kind, actions):
    env = TaskVectorEnv(Hop(), 2, kind)
    with pytest.raises(InputError, match="step: call reset first"):
        env.step([0, 0])
    env.reset(seed=0)
    with pytest.raises(InputError, match="step: each action must be of"):
        env.step(actions)
    env.step([0, 1])


def test_a_step_is_that_of_the_task():
    task = Hop(stride=0.3)
    env = TaskEnv(task, "choices")
    place, _ = env.reset(seed=5)
    key = jax.random.key(0)
    state = task.reset(key)._replace(data=(place, np.int32(0)), obs=place)
    for action in (1, 0, 1, 1):
        state = task.step(state, np.int32(action), key)
        observation, reward, terminated, truncated, info = env.step(action)
        np.testing.assert_allclose(observation, state.obs, rtol=1e-6)
        assert (reward, terminated, truncated) == (float(state.reward), bool(state.terminated), bool(state.truncated))
        assert info["ahead"] == pytest.approx(float(state.metrics["ahead"]))
    with pytest.raises(InputError, match=r"step: each action must be of Discrete\(2\), got 9"):
        env.step(9)
