"""A CPU's kernel trains tables to the bits of the scan; tasks that it cannot do, the scan trains."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from humanoid_mjx import compute, make_learner, make_task
from humanoid_mjx.compute import rng
from humanoid_mjx.tasks.finite import FiniteTask
from humanoid_mjx.training.program import begin, train
from humanoid_mjx.training.programs import TRAIN, placement, why_no_kernel

RUNS = 21
"""More than a vector, and no whole number of vectors."""


class Drift(FiniteTask):
    """A walk on a ring with a wind that is drawn in each step, over a floor whose rewards stand in a table."""

    @property
    def num_states(self):
        return 12

    @property
    def num_actions(self):
        return 3

    def reset(self, key):
        return jax.random.randint(key, (), 0, 4)

    def step(self, state, action, key):
        wind = jnp.where(jax.random.bernoulli(jax.random.split(key, 3)[1], 0.3), 1, 0)
        state = (state + action + wind) % 12
        floor = jnp.asarray(np.linspace(-0.7, 0.4, 12, dtype=np.float32))
        return state, floor[state] / 3 + (0.7 + floor[state]) ** 7, state == 11


TASKS = {
    "joint1": lambda: make_task("joint_reach"),
    "truncated": lambda: make_task("joint_reach", joint=1, states=17, max_episode_steps=9),
    "disobeyed": lambda: make_task("joint_reach", action=23.0, states=9, success_rate=0.7, step_reward=-0.3),
    "printed": lambda: make_task("joint_reach", joint=1, states=5, rules="printed"),
    "room": lambda: make_task("navigate", step_reward=-0.23, success_rate=0.9),
    "own": Drift,
}

METHODS = (
    {"method": "sarsa", "exploration": "boltzmann", "temperature": 0.3, "decay": "step"},
    {"method": "expected_sarsa", "decay": "visit", "step_size": "visits"},
    {"method": "double_q", "exploration": "ucb"},
    {"method": "n_step", "steps": 3, "initial_value": 1.0},
)


def runs_of(task, **values):
    """Learners side by side that differ in all hyper-parameters, and their training before the first step."""
    learner, draw = make_learner("tabular_q", task, episodes=30, record=7, **values), np.random.default_rng(0)
    learners = jax.tree.map(lambda x: jnp.full(RUNS, x), learner)
    swept = {"epsilon": (0.1, 1), "epsilon_decay": (0.5, 1), "learning_rate": (0.1, 1), "discount": (0, 0.99)}
    drawn = {name: jnp.asarray(draw.uniform(low, high, RUNS), jnp.float32) for name, (low, high) in swept.items()}
    learners = learners.replace(**drawn)
    return learners, jax.jit(jax.vmap(begin))(learners, jax.random.split(rng.key(3), RUNS))


def words(leaf):
    return np.asarray(jax.random.key_data(leaf) if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key) else leaf)


CASES = [(case, {}) for case in TASKS] + [("room", values) for values in METHODS] + [("own", METHODS[0])]


@pytest.mark.parametrize(("case", "values"), CASES, ids=[" ".join([case, *map(str, v.values())]) for case, v in CASES])
def test_kernel_equals_scan_to_the_bit_in_chunks_and_beyond_the_end(case, values):
    """One table alone, of which a kernel computes scalars, too."""
    task = TASKS[case]()
    assert why_no_kernel(make_learner("tabular_q", task, **values)) is None
    learners, start = runs_of(task, **values)
    scan, kernel = (jax.jit(jax.vmap(each, in_axes=(0, 0, None))) for each in (train, TRAIN))
    last = partial(jax.tree.map, lambda leaf: leaf[-1:])
    expected, found, alone = start, start, last(start)
    for steps in (32, 70, 200):
        expected, found = scan(learners, expected, steps), kernel(learners, found, steps)
        alone = kernel(last(learners), alone, steps)
    assert expected.record[..., 0].sum() > (0 if values else RUNS / 4)  # so that records and restarts are compared too
    for wanted, got, one in zip(*map(jax.tree.leaves, (expected, found, alone)), strict=True):
        assert wanted.dtype == got.dtype == one.dtype
        np.testing.assert_array_equal(words(got), words(wanted))
        np.testing.assert_array_equal(words(one), words(last(wanted)))


def test_a_kernel_is_traced_again_after_caches_are_cleared():
    learners, start = runs_of(make_task("joint_reach", states=6))
    results = []
    for _ in range(2):
        results.append(jax.jit(jax.vmap(TRAIN, in_axes=(0, 0, None)))(learners, start, 64).carry.q_table)
        jax.clear_caches()
    np.testing.assert_array_equal(*results)


@pytest.mark.parametrize("values", [{"agents": 2}, {"evaluations": 3}, {"method": "q_lambda"}])
def test_the_scan_trains_what_a_kernel_cannot(values):
    learners, start = runs_of(make_task("joint_reach", states=6), **values)
    scan, tried = (jax.jit(jax.vmap(each, in_axes=(0, 0, None)))(learners, start, 64) for each in (train, TRAIN))
    np.testing.assert_array_equal(tried.carry.q_table, scan.carry.q_table)


def test_one_table_that_the_scan_trains_is_what_it_would_be_among_others():
    task = make_task("navigate", success_rate=0.9, step_reward=-0.23)
    learner = make_learner("tabular_q", task, learning_rate=0.3, initial_spread=1.0, evaluations=2)
    options = compute.compiler_options(task.arithmetic, learner.program)
    tables = []
    for runs in (1, 9):
        size, _ = placement(learner, runs, room=99)
        learners = jax.tree.map(lambda x, size=size: jnp.full(size, x), learner)
        start = jax.jit(jax.vmap(begin))(
            learners, jax.vmap(jax.random.fold_in, (None, 0))(rng.key(3), jnp.arange(size))
        )
        scan = jax.jit(jax.vmap(train, in_axes=(0, 0, None)), compiler_options=options)
        tables.append(scan(learners, start, 700).carry.q_table[0])
    np.testing.assert_array_equal(*tables)
