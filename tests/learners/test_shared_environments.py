"""Devices that share the environments of a run: together they learn what one would of all they see."""

from collections import deque

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import PartitionSpec
from probes import probe
from test_approximate import build

from humanoid_mjx import sweep
from humanoid_mjx.compute import rng
from humanoid_mjx.config import parse
from humanoid_mjx.learners.approximate import Batch
from humanoid_mjx.learners.base import ENVS
from humanoid_mjx.training import programs
from humanoid_mjx.training.plan import make_plan
from humanoid_mjx.training.pool import Pool
from humanoid_mjx.training.programs import mesh_of

SIZE, STEPS = 16, 16 * 4 * 200
CONFIG = {
    "name": "shared",
    "task": {"name": "probes:NamedProbe", "which": "both"},
    "learner": {"name": "deep_q", "width": 32, "layers": 1, "envs": SIZE, "rollout": 4, "evaluation_envs": 4}
    | {"discount": 0.5, "epsilon_decay": 1.0, "learning_rate": 0.01, "learning_rate_end": 0.1},
    "total_steps": STEPS,
    "record": 4,
}


@pytest.fixture
def devices():
    return jax.local_devices()[:2]


def on_both(function, devices):
    """The function on two devices, each with one half of its last argument; results of each, one after the other."""
    half, same = PartitionSpec(ENVS), PartitionSpec()
    spread = jax.shard_map(
        lambda first, last: jax.tree.map(lambda x: jnp.asarray(x)[None], function(first, last)),
        mesh=mesh_of(devices, 2), in_specs=(same, half), out_specs=half, check_vma=False,
    )  # fmt: skip
    return jax.jit(spread)


@pytest.mark.parametrize("kind", ["tiles", "deep"])
def test_one_step_of_learning_is_that_of_the_whole_batch(kind, devices):
    whole = build(kind, probe("both", 2)[0], **({"minibatches": 1, "epochs": 1} if kind == "deep" else {}))
    value, optimizer = whole.init_value(rng.key(0))
    key, draw = rng.key(1), np.random.default_rng(0)
    batch = Batch(
        jnp.asarray(draw.choice([-1.0, 1.0], (64, 1)), jnp.float32),
        jnp.asarray(draw.integers(0, 2, (64, 2)), jnp.int32),
        jnp.asarray(draw.normal(size=64), jnp.float32),
    )
    expected, _, error = whole.learn(jnp.float32(0.1), value, optimizer, batch, key)
    part = whole.split_over(2)
    found, errors = on_both(
        lambda old, batch: part.learn(jnp.float32(0.1), *old, batch, key)[::2], devices
    )((value, optimizer), batch)  # fmt: skip
    for both, one in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(both[0], both[1])
        np.testing.assert_allclose(both[0], one, rtol=1e-4, atol=1e-6)  # sums of 64 numbers in another order
    np.testing.assert_allclose(errors.mean(), error, rtol=1e-5)


def trained(pool):
    pool.fill()
    while pool.progress[0] < 1.0:
        pool.train()
    return {name: np.asarray(x)[0] for name, x in pool.finish()["curve"].items()}


def test_a_run_on_two_devices_learns_and_can_go_on_with_one(devices):
    (group,) = make_plan(parse(CONFIG)).groups
    shared = Pool(group, deque([0]), 1, devices, 0, share=2)
    curve = trained(shared)
    # Every episode of this probe is one step, and greedy choices are always right.
    assert curve["greedy_success"][-1] == 1.0 and curve["steps"][-1] == 1.0
    weights, envs = shared.training.carry.weights, shared.training.carry.envs
    for leaf in jax.tree.leaves(weights):
        a, b = (np.asarray(shard.data) for shard in leaf.addressable_shards)
        np.testing.assert_array_equal(a, b)
    assert float(weights.moments.count[0]) == STEPS
    assert float(shared.training.record[0, :, 0].sum()) == STEPS  # episodes of both devices
    assert {shard.data.shape for shard in envs.episode.addressable_shards} == {(1, SIZE // 2)}
    a, b = (np.asarray(shard.data) for shard in envs.state.obs.addressable_shards)
    assert (a != b).any()  # they draw starts of their own
    alone = Pool(group, deque([0]), 1, devices[:1], 0)
    alone.restore(shared.state(), "memory")
    np.testing.assert_array_equal(trained(alone)["greedy_success"], curve["greedy_success"])


def test_a_sweep_shares_environments_where_there_are_more_gpus_than_runs(tmp_path, monkeypatch):
    assert programs.devices_of_a_run(make_plan(parse(CONFIG)).groups[0].learners, 1) == 1  # on a CPU
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    learners = make_plan(parse(CONFIG)).groups[0].learners
    assert programs.devices_of_a_run(learners, 1) == 2 and programs.devices_of_a_run(learners, 2) == 1
    assert programs.devices_of_a_run(learners.replace(envs=15), 1) == 1
    tables = {"task": {"name": "joint_reach"}, "learner": {"name": "tabular_q"}, "episodes": 5}
    assert programs.devices_of_a_run(make_plan(parse({"name": "tables"} | tables)).groups[0].learners, 1) == 1
    monkeypatch.undo()
    monkeypatch.setattr(programs, "devices_of_a_run", lambda learners, runs: 2)
    run = sweep(CONFIG, tmp_path / "run")
    assert run.summary["greedy_success"].tolist() == [1.0]
