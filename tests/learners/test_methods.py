"""The methods of tables equal the book's boxes, in plain Python, decision by decision."""

from dataclasses import asdict

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import textbook
from finite_mdp import random_task
from methods import car_lengths, numbers_of, process_of

from humanoid_mjx import InputError, make_learner, make_task
from humanoid_mjx.compute import rng

SEEDS, DECISIONS, MOST = 6, 60, 7
KEYS = jax.vmap(jax.random.fold_in, in_axes=(None, 0))(rng.key(5), jnp.arange(SEEDS))


@pytest.mark.parametrize(
    "values",
    [
        {"method": "q_learning", "exploration": "boltzmann", "decay": "step", "temperature": 0.5, "epsilon_decay": 0.9},
        {"method": "sarsa", "decay": "visit", "epsilon_decay": 0.75, "epsilon_min": 0.125},
        {"method": "expected_sarsa", "initial_value": 2.0, "epsilon_decay": 0.5},
        {"method": "expected_sarsa", "exploration": "ucb", "step_size": "visits", "confidence": 0.5},
        {"method": "double_q", "exploration": "ucb"},
        {"method": "double_q", "exploration": "boltzmann", "step_size": "visits"},
        {"method": "n_step", "steps": 3, "step_size": "visits"},
        {"method": "q_lambda", "trace_decay": 0.75, "step_size": "visits", "epsilon": 0.25},
    ],
    ids=lambda values: " ".join(word for word in values.values() if isinstance(word, str)),
)
def test_tables_are_those_of_the_book(values):
    """`experiments/methods.py` compares all of them over 4,096 seeds."""
    task = random_task(3, 6, 3, 6, max_episode_steps=MOST, success_rate=0.875)
    learner = make_learner("tabular_q", task, episodes=1000, discount=0.75, **values)

    @jax.jit
    @jax.vmap
    def train(key):
        last = jax.lax.scan(lambda carry, _: (learner.train_step(carry)[0], None), learner.init(key), length=DECISIONS)
        return learner.policy(last[0]), last[0].agents.episode

    tables, episodes = map(np.asarray, train(KEYS))
    numbers = np.asarray(jax.jit(jax.vmap(lambda key: numbers_of(key, DECISIONS)))(KEYS))
    for seed in range(SEEDS):
        settings = textbook.Settings(discount=0.75, **values)
        agent = textbook.Textbook(process_of(task), settings, numbers[seed].__getitem__, 0.875, MOST)
        agent.play(DECISIONS)
        np.testing.assert_allclose(tables[seed][np.asarray(task.rows)], agent.values(), rtol=0, atol=2e-6)
        assert episodes[seed] == agent.episode > 2


def test_the_books_agent_has_the_learners_keys():
    learner = make_learner("tabular_q", make_task("navigate"))
    assert {key: getattr(learner, key) for key in asdict(textbook.Settings())} == asdict(textbook.Settings())


def test_random_first_tables_are_uniform_around_the_tasks_own():
    values = {"initial_spread": 3.0, "initial_value": 1.0, "method": "double_q"}
    learner = make_learner("tabular_q", make_task("joint_reach", states=500), **values)
    one, other = (np.asarray(learner.init(rng.key(seed)).q_table) for seed in (0, 1))
    own = np.tile(np.asarray(learner.task.initial_q()) + 1.0, 2)
    # The same seed draws the same table, another seed and the other table of double_q others.
    np.testing.assert_array_equal(one, learner.init(rng.key(0)).q_table)
    assert not np.isclose(one, other).any() and not np.isclose((one - own)[:, :2], (one - own)[:, 2:]).any()
    assert np.abs(one - own).max() < 3.0
    # Of 2,000 uniform numbers: four standard errors.
    assert np.mean(one - own) == pytest.approx(0.0, abs=4 * 3 / np.sqrt(3 * 2000))
    assert np.var(one - own) == pytest.approx(3.0, rel=0.1)


def test_double_q_starts_both_tables_from_a_policy():
    learner = make_learner("tabular_q", make_task("joint_reach", states=6), method="double_q", step_size="visits")
    policy = jnp.arange(12.0).reshape(6, 2)
    carry = learner.init(rng.key(0), policy)
    assert carry.q_table.shape == (6, 8) and (learner.policy(carry) == policy).all()


@pytest.mark.parametrize(
    ("task", "values", "words"),
    [
        ({}, {"trace_decay": 0.5}, "learner: trace_decay is not read with method q_learning; leave it out, or set"),
        ({}, {"method": "sarsa", "steps": 3}, "learner.method=n_step"),
        ({}, {"exploration": "ucb", "epsilon": 0.1}, "learner.exploration=epsilon_greedy"),
        ({}, {"temperature": 0.1}, "learner.exploration=boltzmann"),
        ({}, {"step_size": "visits", "learning_rate": 0.1}, "learner.step_size=constant"),
        ({}, {"method": "n_step", "steps": 17}, "steps must be at most 16, got 17"),
        ({}, {"method": "watkins"}, "method must be one of 'q_learning', "),
        ({}, {"initial_value": 1.0, "start_from": "runs/a"}, "initial_value is not read with start_from"),
        ({}, {"initial_spread": 1.0, "start_from": "runs/a"}, "initial_spread is not read with start_from"),
        ({"rules": "printed"}, {"method": "sarsa"}, "takes method q_learning and"),
        ({}, {"agents": 2, "method": "n_step"}, "agents must be 1 with method sarsa, n_step"),
        ({}, {"agents": 2, "decay": "visit"}, "agents must be 1 with method sarsa, n_step"),
    ],
)
def test_keys_that_nothing_reads_are_refused(task, values, words):
    with pytest.raises(InputError) as refusal:
        make_learner("tabular_q", make_task("joint_reach", **task), **values)
    assert words in str(refusal.value)


def test_tiles_drive_the_mountain_car_as_the_books_do():
    """Figure 10.2: episodes 2 to 6, by other random numbers. `experiments/methods.py` drives 500."""
    lengths = car_lengths(0.5, 6, 16, 8_000), textbook.mountain_car(0.5, 6, 16, sarsa=False)
    found, expected = (each[:, 1:].mean() for each in lengths)
    # Three standard errors of the difference are 17 %; two fifths of the step size make episodes longer by a half.
    assert found == pytest.approx(expected, rel=0.25)
