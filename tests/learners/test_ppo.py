"""PPO on tasks, through the sweep command; commands in [-1, 1] and the choices that they stand for."""

import json
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from command_line import told
from hypothesis import given, settings
from hypothesis import strategies as st
from probes import probe

from humanoid_mjx import InputError, make_learner, sweep
from humanoid_mjx.compute import rng
from humanoid_mjx.spec import traced
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


@settings(max_examples=30)
@given(bins=st.lists(st.integers(1, 9), min_size=1, max_size=4), data=st.data())
def test_a_command_becomes_the_nearest_bin(bins, data):
    command = np.array([data.draw(st.floats(-1.5, 1.5, width=32)) for _ in bins])
    task = Drift(bins=tuple(bins))
    state = jax.jit(task.reset)(rng.key(0))
    found = task.step_continuous(state, jnp.asarray(command, jnp.float32), rng.key(1)).obs[2:]
    for value, n, choice in zip(command, bins, np.asarray(found), strict=True):
        distance = np.abs(np.linspace(-1, 1, n) - np.clip(value, -1, 1))
        assert distance[int(choice)] <= distance.min() + 1e-6


TINY = {"num_envs": 32, "unroll_length": 4, "batch_size": 16, "num_minibatches": 2, "learning_rate": 0.01}
TINY |= {"policy_hidden_layer_sizes": [16], "value_hidden_layer_sizes": [16], "discounting": 0.5, "evaluations": 6}
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
    told("sweep", folder / "ppo.yaml", "--out", folder / "run")
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


def test_an_update_longer_than_the_training_stands_in_the_last_row(tmp_path):
    """The row says the steps that were made, and holds the evaluation."""
    short = {"sweep": None, "total_steps": 101, "record": 3, "task": {"name": "probes:NamedProbe", "which": "both"}}
    results = sweep(CONFIG | short, tmp_path / "run", quiet=True).results
    assert results["step"].tolist() == [34, 67, 32 * 4]
    assert np.isfinite(results["greedy_return"]).tolist() == [False, False, True]


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


def test_without_brax_its_learner_gets_a_sentence(monkeypatch):
    for name in [name for name in sys.modules if name.partition(".")[0] == "brax"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delitem(sys.modules, "humanoid_mjx.learners.brax_ppo")
    monkeypatch.setitem(sys.modules, "brax", None)
    with pytest.raises(InputError, match="'brax_ppo' needs the package 'brax', which is not installed"):
        make_learner("brax_ppo", probe("both")[0])
