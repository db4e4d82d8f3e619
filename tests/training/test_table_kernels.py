"""Kernels that train tables equal the scan: a CPU's, and a GPU's in Pallas's interpreter, with tables in its memory.

`as_shipped/test_tables.py` compares a CPU's for any hyper-parameters, with the settings that users have.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from finite_mdp import random_task

from humanoid_mjx import make_learner, make_task
from humanoid_mjx.compute import rng
from humanoid_mjx.kernels import fallback, gpu_kernel
from humanoid_mjx.kernels.memory import THREADS
from humanoid_mjx.kernels.signature import called, signature_of_one
from humanoid_mjx.kernels.worlds import kernel, why_not
from humanoid_mjx.training import program
from humanoid_mjx.training.program import begin, train
from humanoid_mjx.training.programs import TRAIN, why_no_kernel

RUNS = 6
"""Fewer than a vector or a warp has."""

TASKS = {
    "standard": {"name": "joint_reach", "joint": 5, "states": 5, "action": 15.0},
    "truncated": {"name": "joint_reach", "joint": 1, "states": 17, "max_episode_steps": 9},
    "disobeyed": {"name": "joint_reach", "joint": 1, "action": 23.0, "states": 9, "success_rate": 0.75},
    "printed": {"name": "joint_reach", "joint": 1, "states": 5, "rules": "printed"},
    "grid": {"name": "navigate", "map": ("S..", ".#.", "..G"), "success_rate": 0.75, "step_reward": -0.25},
}


def runs_of(task, **own):
    """Learners side by side that differ in hyper-parameters, and their training before the first step.

    Products with powers of two are exact, and `TASKS` divide their angles by powers of two. So it makes no difference
    where a compiler contracts a product and a sum.
    """
    learner = make_learner("tabular_q", task, episodes=30, record=7, **own)
    learners = jax.tree.map(lambda x: jnp.full(RUNS, x), learner)
    values = {
        "epsilon": [1.0, 0.75, 0.5, 0.5, 0.25, 0.125],
        "epsilon_decay": [0.5, 1.0, 0.5, 0.25, 1.0, 0.5],
        "learning_rate": [0.25, 0.5, 0.25, 1.0, 0.5, 1.0],
        "discount": [0.5, 0.0, 0.25, 0.5, 0.125, 0.5],
    }
    learners = learners.replace(**{name: jnp.array(value) for name, value in values.items()})
    return learners, jax.jit(jax.vmap(begin))(learners, jax.random.split(rng.key(3), RUNS))


def interpreted(*args):
    """A GPU's kernel in Pallas's interpreter."""
    many = *[True] * len(jax.tree.leaves(args[:2])), False
    return called(signature_of_one(train, args, many), args, THREADS, partial(gpu_kernel.call, interpret=True))


OWN = [{"method": method, "decay": "step"} for method in ("double_q", "expected_sarsa", "sarsa", "n_step")]
OWN += [{"exploration": "boltzmann"}, {"exploration": "ucb"}]
"""Methods, beside plain Q-learning; not `step_size: visits`, as shares such as 1/3 make no exact products."""

SCAN = jax.vmap(train, in_axes=(0, 0, None))
KERNELS = {"cpu": jax.vmap(TRAIN, in_axes=(0, 0, None)), "gpu": interpreted}

CASES = [(case, back_end, {}) for case in TASKS for back_end in KERNELS]
CASES += [("grid", "gpu", own) for own in OWN]


@pytest.mark.parametrize(("case", "back_end", "own"), CASES)
def test_kernel_equals_scan_in_chunks_and_beyond_the_end_of_training(case, back_end, own):
    values = dict(TASKS[case])
    learners, start = runs_of(make_task(values.pop("name"), **values), **own)
    scan, kernel = jax.jit(SCAN), jax.jit(KERNELS[back_end])
    expected, found = start, start
    for steps in (32, 70, 200):
        expected = scan(learners, expected, steps)
        found = kernel(learners, found, jnp.int32(steps))
    assert expected.record[..., 0].sum() > RUNS  # so that records and restarts are compared too
    for wanted, got in zip(jax.tree.leaves(expected), jax.tree.leaves(found), strict=True):
        if jnp.issubdtype(wanted.dtype, jax.dtypes.prng_key):
            wanted, got = jax.random.key_data(wanted), jax.random.key_data(got)
        assert wanted.dtype == got.dtype
        np.testing.assert_array_equal(got, wanted)


def test_legs_move_in_a_kernel_as_by_xla(monkeypatch):
    """Sines are rounded otherwise than by XLA alone, so the legs' angles differ by rounding, tables and curves by
    nothing. A scan that calls the chain's kernel gives the same bits."""
    task = make_task("posture_switch", places=3, encoder_noise=2.0, tolerance=8.0, max_episode_steps=9)
    learners, start = runs_of(task)
    found, same = (jax.jit(each)(learners, start, jnp.int32(96)) for each in (KERNELS["cpu"], SCAN))
    monkeypatch.setattr(fallback, "given_up", ["of this test"])
    program._train_step.clear_cache()  # which has the kernel of the chain in it
    expected = jax.jit(lambda *given: SCAN(*given))(learners, start, jnp.int32(96))
    program._train_step.clear_cache()
    np.testing.assert_array_equal(found.record, expected.record)
    np.testing.assert_array_equal(found.carry.q_table, expected.carry.q_table)
    assert expected.record[..., 0].sum() > RUNS
    world, scanned, wanted = (each.carry.agents.state.world for each in (found, same, expected))
    np.testing.assert_array_equal(world.qpos, scanned.qpos)
    assert (world.qpos != wanted.qpos).any()  # else the reference is no other computation
    np.testing.assert_allclose(world.qpos, wanted.qpos, atol=1e-5)
    np.testing.assert_allclose(world.qvel, wanted.qvel, atol=1e-4)


def test_a_record_gets_in_each_world_what_is_not_zero():
    """A kernel of a CPU skips rows of zeros; sums with what is not finite, or with one number in a row, are not."""

    def count(record, values, place):
        def step(i, record):
            value = values[i]
            row = jnp.stack([value, jnp.where(value > 0, 2.0, 0.0), jnp.where(i == 3, 1.0, 0.0)])
            return record.at[(place + i) % 5].add(row, mode="promise_in_bounds")

        return jax.lax.fori_loop(0, 40, step, record)

    worlds = 37
    values = np.random.default_rng(0).choice([0, 0, 0, -0.0, 1.5, -3, np.inf, np.nan], (worlds, 40)).astype(np.float32)
    values[:, 6:20] = 0  # in some steps all worlds add nothing
    given = np.zeros((worlds, 5, 3), np.float32), values, np.arange(worlds, dtype=np.int32)
    assert why_not(count, given, (True, True, True)) is None
    found = jax.jit(jax.vmap(kernel(count)))(*given)
    np.testing.assert_array_equal(found, jax.jit(jax.vmap(count))(*given))


@pytest.mark.parametrize(
    ("task", "values", "words"),
    [
        (make_task("joint_reach"), {}, None),
        (make_task("joint_reach"), {"agents": 2}, "several agents"),
        (make_task("joint_reach"), {"evaluations": 3}, "along the way"),
        (make_task("joint_reach"), {"method": "q_lambda"}, "each step of q_lambda changes the whole table"),
        (random_task(0, 4, 2, 4), {}, "TableTask: threads index only by what is known"),
        (make_task("posture_switch"), {}, None),
        (make_task("squat"), {}, "Squat: threads do no"),
    ],
)
def test_what_no_kernel_trains(task, values, words):
    reason = why_no_kernel(make_learner("tabular_q", task, **values))
    assert reason is None if words is None else words in reason


def test_a_learner_without_a_table_is_trained_by_no_kernel():
    assert why_no_kernel(make_learner("deep_q", make_task("leg_reach"), total_steps=1000)) == "kernels train tables"


@pytest.mark.parametrize(
    ("values", "words"), [({"agents": 2}, "several agents"), ({"evaluations": 3}, "along the way")]
)
def test_the_scan_trains_what_the_kernel_of_a_gpu_cannot(values, words, monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert words in why_no_kernel(make_learner("tabular_q", make_task("joint_reach"), **values))


def test_a_gpu_leaves_kernels_to_xla_that_triton_compiles_for_minutes(monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(fallback, "why_none", lambda: None)
    assert "Triton takes minutes" in why_no_kernel(make_learner("tabular_q", make_task("posture_switch")))
    assert why_no_kernel(make_learner("tabular_q", make_task("joint_reach"), method="n_step")) is None
    room = make_task("navigate", map=("S" + "." * 79, *["." * 80] * 78, "." * 79 + "G"))
    assert why_no_kernel(make_learner("tabular_q", room)) is None  # constants take no operations


def test_without_a_gpu_of_nvidia_xla_trains(monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "rocm")
    assert "not for 'rocm'" in why_no_kernel(make_learner("tabular_q", make_task("joint_reach")))
