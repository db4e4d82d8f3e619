"""Brax both ways: tasks under its wrappers, and its PPO on tasks, through the sweep command."""

import json
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.envs.wrappers import training as wrappers
from hypothesis import given, settings
from hypothesis import strategies as st
from probes import probe
from typer.testing import CliRunner

from humanoid_mjx import InputError, make_learner, make_task, sweep
from humanoid_mjx.cli import app
from humanoid_mjx.compute import rng
from humanoid_mjx.spec import traced
from humanoid_mjx.tasks import TASKS
from humanoid_mjx.tasks.base import Task
from humanoid_mjx.tasks.brax_env import BraxEnv, wrap
from humanoid_mjx.tasks.continuous import ContinuousTask, State, begin
from humanoid_mjx.training.sweep import Run


class Drift(ContinuousTask):
    """What is seen says which choices were made and when; starts and rewards are random. It ends above 2.5 by itself,
    and is cut off after `cap` steps."""

    bins: tuple[int, ...] = (3, 2)
    cap: int = traced(4)

    @property
    def observation_size(self):
        return 2 + len(self.bins)

    @property
    def action_bins(self):
        return self.bins

    def reset(self, key):
        start = jax.random.uniform(key)
        obs = jnp.concatenate([jnp.stack([start, 0.0]), -jnp.ones(len(self.bins))])
        return begin((start, jnp.int32(0)), obs, ("noise",))

    def step(self, state, action, key):
        place, count = state.data[0] + action[0] * 0.5, state.data[1] + 1
        obs = jnp.concatenate([jnp.stack([place, count.astype(float)]), action.astype(float)])
        noise = jax.random.uniform(key)
        over = place > 2.5
        cut = ~over & (count >= self.cap)
        return State((place, count), obs, noise, over, cut, over, obs, {"noise": noise})


def roll(env, commands, seed=0):
    """States of environments side by side, from the reset on; `commands` lead with (steps, envs)."""
    state = jax.jit(env.reset)(jax.random.split(jax.random.PRNGKey(seed), commands.shape[1]))
    step = jax.jit(env.step)
    states = [state]
    for command in commands:
        states.append(step(states[-1], command))
    return states


def column(states, take):
    return np.stack([np.asarray(take(state)) for state in states])


def random_commands(steps, envs, joints, seed=0):
    return np.random.default_rng(seed).uniform(-1.3, 1.3, (steps, envs, joints)).astype(np.float32)


@settings(max_examples=30, deadline=None)
@given(bins=st.lists(st.integers(1, 9), min_size=1, max_size=4), data=st.data())
def test_a_command_becomes_the_nearest_bin(bins, data):
    command = np.array([data.draw(st.floats(-1.5, 1.5, width=32)) for _ in bins])
    task = Drift(bins=tuple(bins))
    state = task.reset(rng.key(0))
    found = task.step_continuous(state, jnp.asarray(command, jnp.float32), rng.key(1)).obs[2:]
    for value, n, choice in zip(command, bins, np.asarray(found), strict=True):
        distance = np.abs(np.linspace(-1, 1, n) - np.clip(value, -1, 1))
        assert distance[int(choice)] <= distance.min() + 1e-6


@pytest.mark.parametrize("which", ["finite", "continuous"])
def test_under_brax_wrappers_a_task_does_what_it_does_alone(which):
    finite = make_task("joint_reach", joint=5, states=13, max_episode_steps=20)
    task = finite if which == "finite" else probe("delayed reward", joints=2)[0]
    env = BraxEnv(task)
    assert env.action_size == len(env.task.action_bins) == (1 if which == "finite" else 2)
    commands = random_commands(50, 3, env.action_size)
    wrapped = wrappers.AutoResetWrapper(wrappers.EpisodeWrapper(wrappers.VmapWrapper(env), 1000, 1))
    states = roll(wrapped, commands)
    assert states[0].obs.shape == (3, env.observation_size)
    ends = 0
    step = jax.jit(env.task.step)
    for e in range(3):
        # Both tasks are deterministic from a given start, to which Brax's wrapper returns: keys do not matter.
        first = jax.tree.map(lambda leaf, e=e: leaf[e], states[0].pipeline_state)
        own = first
        for t, state in enumerate(states[1:]):
            choice = jnp.asarray((commands[t, e] > 0).astype(np.int32))
            own = step(own, choice, rng.key(t))
            # Two programs: XLA may round each its own way; rewards are of order 1.
            np.testing.assert_allclose(state.reward[e], own.reward, atol=1e-6)
            np.testing.assert_allclose(state.info["final_obs"][e], own.final_obs, atol=1e-6)
            assert bool(state.done[e]) == bool(own.done)
            assert float(state.metrics["success"][e]) == float(own.done & own.success)
            ends += bool(own.done)
            own = first if own.done else own
            np.testing.assert_allclose(state.obs[e], own.obs, atol=1e-6)
    assert ends > 4


@pytest.mark.parametrize("name", TASKS)
def test_every_shipped_task_is_an_environment_of_brax(name):
    env = BraxEnv(make_task(name, **({"joint": 1} if name == "joint_reach" else {})))
    wrapped = wrappers.EvalWrapper(wrap(env))
    state = jax.eval_shape(wrapped.reset, jax.ShapeDtypeStruct((3, 2), jnp.uint32))
    after = jax.eval_shape(wrapped.step, state, jax.ShapeDtypeStruct((3, env.action_size), jnp.float32))
    assert state.obs.shape == (3, env.observation_size)
    # A scan over steps takes a state only where its successor is of the same shapes and types.
    assert jax.tree.structure(state) == jax.tree.structure(after)
    assert [(a.shape, a.dtype) for a in jax.tree.leaves(state)] == [(a.shape, a.dtype) for a in jax.tree.leaves(after)]


def test_commands_reach_a_task_of_set_points_as_they_are():
    env = BraxEnv(make_task("leg_reach", increment=5.0))
    state = jax.jit(env.reset)(jax.random.PRNGKey(0))
    command = np.array([0.1, -0.37, 0.0, 0.92, -1.7], np.float32)
    after = jax.jit(env.step)(state, command)
    moved = after.pipeline_state.data.setpoint - state.pipeline_state.data.setpoint
    np.testing.assert_allclose(moved, np.radians(5.0) * np.clip(command, -1, 1), atol=1e-6)


def test_what_a_task_cuts_off_is_a_truncation_and_its_last_observation_is_kept():
    env = BraxEnv(Drift(cap=4))
    # The first environment stays where it is until it is cut off, the second climbs by 1 a step beyond 2.5.
    commands = np.tile(np.array([[-1, 0], [1, 0]], np.float32), (9, 1, 1))
    states = roll(wrap(env), commands)[1:]
    done, cut = column(states, lambda s: s.done), column(states, lambda s: s.info["truncation"])
    np.testing.assert_array_equal(np.flatnonzero(done[:, 0]), [3, 7])
    np.testing.assert_array_equal(cut[:, 0], done[:, 0])
    assert done[:, 1].sum() >= 3 and not cut[:, 1].any()
    last = column(states, lambda s: s.info["final_obs"])
    obs = column(states, lambda s: s.obs)
    assert (last[:, 0, 1][done[:, 0] == 1] == 4).all() and (last[:, 1, 0][done[:, 1] == 1] > 2.5).all()
    assert (obs[..., 1][done == 1] == 0).all() and (obs == last).all(axis=-1)[done == 0].all()
    # Brax's own wrapper takes both for terminations; `time_out` still tells.
    states = roll(wrappers.EpisodeWrapper(wrappers.VmapWrapper(env), 1000, 1), commands[:4])
    assert states[-1].done[0] == 1 and states[-1].info["truncation"][0] == 0 and states[-1].info["time_out"][0] == 1
    # An episode shorter than the task's own is cut off, too.
    states = roll(wrap(env, 2), commands[:5])[1:]
    np.testing.assert_array_equal(column(states, lambda s: s.info["truncation"])[:, 0], [0, 1, 0, 1, 0])


def test_every_episode_begins_in_a_state_of_its_own_and_no_noise_repeats():
    env = BraxEnv(Drift(cap=2))
    commands = -np.ones((20, 5, 2), np.float32)
    states = roll(wrap(env), commands)
    starts = column(states[::2], lambda s: s.obs[:, 0])
    assert len(np.unique(starts)) == starts.size == 55
    noise = column(states[1:], lambda s: s.reward)
    assert len(np.unique(noise)) == noise.size == 100
    states = roll(wrappers.AutoResetWrapper(wrappers.EpisodeWrapper(wrappers.VmapWrapper(env), 1000, 1)), commands)
    assert len(np.unique(column(states[::2], lambda s: s.obs[:, 0]))) == 5
    noise = column(states[1:], lambda s: s.reward)
    assert len(np.unique(noise)) == noise.size


def test_brax_evaluates_a_task():
    env = wrappers.EvalWrapper(wrap(BraxEnv(Drift(cap=4))))
    commands = np.tile(np.array([[-1, 0], [1, 0]], np.float32), (8, 1, 1))
    states = roll(env, commands)
    found = states[-1].info["eval_metrics"]
    lengths = np.asarray(found.episode_steps).astype(int)
    assert lengths[0] == 4 and lengths[1] <= 3
    np.testing.assert_array_equal(found.episode_metrics["success"], [0, 1])
    rewards = column(states[1:], lambda s: s.reward)
    expected = [rewards[:length, e].sum() for e, length in enumerate(lengths)]
    np.testing.assert_allclose(found.episode_metrics["reward"], expected, rtol=1e-6)
    np.testing.assert_allclose(found.episode_metrics["noise"], expected, rtol=1e-6)


TINY = {
    "num_envs": 32,
    "unroll_length": 4,
    "batch_size": 16,
    "num_minibatches": 2,
    "policy_hidden_layer_sizes": [16],
    "value_hidden_layer_sizes": [16],
    "learning_rate": 0.01,
    "discounting": 0.5,
    "evaluations": 6,
}
CONFIG = {
    "name": "ppo",
    "task": {"name": "probes:NamedProbe", "which": "both"},
    "learner": {"name": "brax_ppo", **TINY},
    "sweep": {"axes": {"task.which": ["both", "delayed reward"]}},
    "total_steps": 32 * 4 * 90,
    "record": 6,
}


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ppo")
    (folder / "ppo.yaml").write_text(json.dumps(CONFIG))
    done = CliRunner().invoke(app, ["sweep", str(folder / "ppo.yaml"), "--out", str(folder / "run")])
    assert done.exit_code == 0, done.output
    return Run(folder / "run")


def test_ppo_solves_probes_through_the_sweep_command(swept):
    summary, results = swept.summary, swept.results
    assert summary["task.which"].tolist() == ["both", "delayed reward"]
    np.testing.assert_array_equal(summary["greedy_success"], [1, 1])
    np.testing.assert_array_equal(summary["greedy_return"], [1, 1])
    np.testing.assert_array_equal(summary["greedy_steps"], [1, 2])
    assert not summary["diverged"].any()
    # Of 64 random actions at the end a few may still be the other one.
    assert (summary["return"] > 0.7).all()
    assert results["step"][:6].tolist() == [1920 * (i + 1) for i in range(6)]
    for name in ("return", "steps", "success", "greedy_return", "greedy_steps", "greedy_success"):
        assert np.isfinite(results[name]).all()
    assert (swept.path / "figures/learning_curves.png").is_file()
    assert "brax" in json.loads((swept.path / "provenance.json").read_text())["versions"]


def test_a_run_can_start_from_what_an_earlier_one_learned(swept, tmp_path):
    learner = CONFIG["learner"] | {"start_from": str(swept.path), "learning_rate": 1e-9}
    run = sweep(CONFIG | {"learner": learner, "total_steps": 32 * 4, "record": 1}, tmp_path / "run")
    np.testing.assert_array_equal(run.summary["greedy_success"], [1, 1])


def test_an_update_learns_from_pieces_of_what_every_environment_saw():
    learner = make_learner("brax_ppo", Drift(cap=3), **(TINY | {"num_envs": 8}))
    carry = jax.jit(learner.init)(rng.key(0))
    envs, seen, totals = jax.jit(learner._collect)(carry, rng.key(1))
    assert seen.observation.shape == (32, 4, 4) and seen.reward.shape == (32, 4)
    going_on = np.asarray(seen.discount)[:, :-1] == 1
    after, before = np.asarray(seen.next_observation)[:, :-1], np.asarray(seen.observation)[:, 1:]
    assert 0.5 < going_on.mean() < 0.9
    np.testing.assert_array_equal(after[going_on], before[going_on])  # the next step begins where this one led to
    assert (before[~going_on][:, 1] == 0).all()  # or anew
    truncated = np.asarray(seen.extras["state_extras"]["truncation"])
    np.testing.assert_array_equal(truncated == 1, (seen.discount == 0) & (seen.next_observation[..., 0] <= 2.5))
    assert float(totals["episodes"]) == (np.asarray(seen.discount) == 0).sum() == int(envs.episode.sum())
    # An update from one minibatch moves the weights by at most a step of Adam each, and all of them together.
    (after, outcome) = jax.jit(learner.replace(num_minibatches=32 // 16, num_updates_per_batch=1).train_step)(carry)
    moved = [
        float(jnp.abs(x - y).max())
        for x, y in zip(*map(jax.tree.leaves, (after.policy.networks, carry.policy.networks)), strict=True)
    ]
    assert 0.0 < max(moved) <= 2.1 * TINY["learning_rate"]
    assert float(after.policy.moments.count) == float(outcome.done) + 128 == 128


def test_hyper_parameters_are_data_of_one_program():
    learners = [make_learner("brax_ppo", probe("both")[0], **(TINY | {"entropy_cost": cost})) for cost in (0.0, 0.1)]
    assert len({jax.tree.structure(learner) for learner in learners}) == 1


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"num_envs": 24}, r"num_envs must divide batch_size \* num_minibatches \(32\), got 24"),
        ({"value_hidden_layer_sizes": [16, 0]}, "a layer must have at least 1 unit"),
        ({"learning_rate": 0.0}, "learner.learning_rate must be greater than 0"),
        ({"discount": 0.9}, "learner.discount: unknown key; did you mean 'discounting'"),
    ],
)
def test_bad_values_get_a_sentence(values, words):
    with pytest.raises(InputError, match=words):
        make_learner("brax_ppo", probe("both")[0], **(TINY | values))


def test_what_a_task_cannot_be_for_brax_gets_a_sentence():
    with pytest.raises(InputError, match="takes a FiniteTask or a ContinuousTask, got a Task"):
        BraxEnv(Task())
    env = BraxEnv(probe("both")[0])
    with pytest.raises(InputError, match="action_repeat must be 1, got 2"):
        wrap(env, 100, 2)
    with pytest.raises(InputError, match="randomization_fn changes a Brax system"):
        wrap(env, randomization_fn=lambda system, rng: (system, system))


def test_without_brax_its_learner_gets_a_sentence(monkeypatch):
    for name in [name for name in sys.modules if name.partition(".")[0] == "brax"]:
        monkeypatch.delitem(sys.modules, name)
    for name in ("humanoid_mjx.learners.brax_ppo", "humanoid_mjx.tasks.brax_env"):
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "brax", None)
    with pytest.raises(InputError, match="'brax_ppo' needs the package 'brax', which is not installed"):
        make_learner("brax_ppo", probe("both")[0])
