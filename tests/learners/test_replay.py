"""The learner with a memory on docs/own_parts.md: it remembers, copies no memory, and learns."""

import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from docs_reader import blocks

from humanoid_mjx import InputError, key, make_learner, make_task, train
from humanoid_mjx.training import program

PAGE = Path(__file__).parents[2] / "docs/own_parts.md"
SMALL = {"total_steps": 10_000, "width": 8, "layers": 1, "batch": 16, "evaluations": 1}


@pytest.fixture(autouse=True)
def module(tmp_path, monkeypatch):
    (block,) = (block for block in blocks(PAGE.read_text(encoding="utf-8")) if block.title == "replay.py")
    (tmp_path / "replay.py").write_text(block.text)
    monkeypatch.syspath_prepend(tmp_path)
    import replay

    return replay


def test_the_memory_holds_the_last_transitions():
    task = make_task("joint_reach", joint=1, max_episode_steps=7)
    learner = make_learner("replay:ReplayQ", task, capacity=20, envs=3, **SMALL)
    carry, step, seen = jax.jit(learner.init)(key(0)), jax.jit(learner.train_step), []
    for update in range(15):
        before, now = carry.envs.state, carry
        carry, _ = step(carry)
        rows = (3 * update + np.arange(3)) % 20
        seen += [(row, obs) for row, obs in zip(rows.tolist(), np.asarray(before.obs), strict=True)]
        new, old = jax.tree.map(np.asarray, (carry.memory, now.memory))
        others = np.setdiff1d(np.arange(20), rows)
        jax.tree.map(lambda new, old, rows=others: np.testing.assert_array_equal(new[rows], old[rows]), new, old)
        for name in ("reward", "terminated", "final_obs"):
            np.testing.assert_array_equal(getattr(new, name)[rows], getattr(carry.envs.state, name))
        np.testing.assert_array_equal(new.action[rows], carry.envs.state.executed)
    for row, obs in dict(seen).items():
        np.testing.assert_array_equal(np.asarray(carry.memory.obs)[row], obs)
    assert len(dict(seen)) == 20


@pytest.mark.parametrize("lap", [1, 16])
def test_the_memory_is_written_in_place(lap, module):
    """The compiled training neither copies nor selects arrays of the memory's shape; with a lap of 1 it does."""
    kind = type("Kind", (module.ReplayQ,), {"lap": lap, "__annotations__": {}, "__module__": "replay"})
    learner = kind(task=make_task("joint_reach", joint=1), capacity=4321, envs=3, **SMALL)
    runs = jax.eval_shape(jax.vmap(lambda key: program.begin(learner, key)), jax.random.split(key(0), 2))
    steps = jax.jit(jax.vmap(lambda run: program.train(learner, run, jnp.int32(64))), donate_argnums=0)
    found = re.findall(r"\[2,4321\S* (copy|select)\(", steps.lower(runs).compile().as_text())
    assert bool(found) == (lap == 1)


def test_it_learns_to_reach_postures():
    """All five joints to within 12 degrees."""
    task = make_task("leg_reach", tolerance=12.0)
    options = {"discount": 0.8, "epsilon": 0.3, "epsilon_decay": 0.9, "evaluation_envs": 128}
    options |= {"learning_rate": 6e-3, "batch": 128, "target_every": 25}
    learner = make_learner("replay:ReplayQ", task, total_steps=60_000, record=10, evaluations=1, **options)
    trained = train(learner, key(0))
    success = np.asarray(trained.curve["success"])
    assert trained.scores["greedy_success"] > 0.25 and success[0] < 0.05 < success[-1]


def test_it_stops_at_its_end_and_refuses_what_cannot_be():
    task = make_task("joint_reach", joint=1)
    learner = make_learner("replay:ReplayQ", task, capacity=20, envs=3, **SMALL | {"total_steps": 30})
    carry, step = jax.jit(learner.init)(key(0)), jax.jit(learner.train_step)
    for _ in range(10):
        carry, outcome = step(carry)
    after, nothing = step(carry)
    same = jax.tree.map(
        np.array_equal, *(each._replace(memory=None, key=None) for each in jax.device_get((after, carry)))
    )
    assert all(jax.tree.leaves(same)) and outcome.done == 27.0 and nothing.episodes == 0.0
    with pytest.raises(InputError, match=r"learner\.capacity must be at least 1, got 0"):
        make_learner("replay:ReplayQ", task, capacity=0)
