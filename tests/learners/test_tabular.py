"""Tabular Q-learning: equal to a slow Python version step by step, and right in the limit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from finite_mdp import q_learning, random_task, value_iteration
from hypothesis import given, settings
from hypothesis import strategies as st

from humanoid_mjx import make_learner, make_task
from humanoid_mjx.compute import rng
from humanoid_mjx.compute.ways import add_at, ways
from humanoid_mjx.learners import tabular
from humanoid_mjx.learners.rollout import greedy, rollout
from humanoid_mjx.tasks.navigate import shortest_path
from humanoid_mjx.training.program import advance, begin, curve, measures

STEPS = 120


@jax.jit
def train_and_keep(learner, key):
    """The first carry and those after each of STEPS steps."""
    first = learner.init(key)
    _, carries = jax.lax.scan(lambda c, _: (learner.train_step(c)[0],) * 2, first, length=STEPS)
    return first, carries


@jax.jit
def all_draws(key):
    return jax.random.uniform(key, (3 * (STEPS + 1),)).reshape(-1, 3)


@settings(max_examples=30)
@given(
    seed=st.integers(0, 10**6),
    printed=st.booleans(),
    rows=st.sampled_from([6, 3]),
    epsilon=st.floats(0, 1, width=32, allow_subnormal=False),
    epsilon_decay=st.sampled_from([0.5, 0.875, 1.0]),
    epsilon_min=st.sampled_from([0.0, 0.25]),
    learning_rate=st.sampled_from([0.25, 0.5, 1.0]),
    discount=st.sampled_from([0.0, 0.5, 0.75]),
    success_rate=st.sampled_from([1.0, 0.75]),
    max_episode_steps=st.integers(1, 20),
)
def test_scan_equals_python_step_by_step(seed, printed, rows, success_rate, max_episode_steps, **values):
    task = random_task(
        seed, 6, 3, rows, printed=printed, success_rate=success_rate, max_episode_steps=max_episode_steps
    )
    learner = make_learner("tabular_q", task, episodes=20, record=20, **values)
    key = rng.key(seed)
    first, carries = jax.device_get(train_and_keep(learner, key))  # jax takes 0.1 ms for each entry it is asked for
    draws = np.asarray(all_draws(key))
    slow = q_learning(learner, first.q_table, draws)
    acted = np.concatenate([[first.agents.action], carries.agents.action])
    rows_seen = np.concatenate([[first.agents.row], carries.agents.row])
    for t, ((row, action), q_table, epsilon, episode) in enumerate(slow):
        assert (rows_seen[t], acted[t]) == (row, action)
        # Every quantity is a short sum of short binary fractions: the same in any order of summation, or nearly.
        np.testing.assert_allclose(carries.q_table[t], q_table, rtol=0, atol=2e-6)
        assert carries.agents.episode[t] == episode
        np.testing.assert_allclose(carries.agents.epsilon[t], epsilon, rtol=1e-6, atol=1e-30)  # subnormals flush


start = jax.jit(jax.vmap(begin, in_axes=(None, 0)))
chunk = jax.jit(jax.vmap(advance, in_axes=(None, 0, None)))
curves = jax.jit(jax.vmap(curve, in_axes=(None, 0)))


def train_to_end(learner, count=16):
    """`count` seeds trained to the end."""
    keys = jax.vmap(jax.random.fold_in, in_axes=(None, 0))(rng.key(0), jnp.arange(count))
    training = start(learner, keys)
    for _ in range(10_000):
        training, progress = chunk(learner, training, 1024)
        if (np.asarray(progress[0]) >= 1).all():
            return training
    raise AssertionError("training does not end")


@pytest.mark.parametrize("joint", [1, 5])
@pytest.mark.parametrize(
    "values", [{"learning_rate": 0.1}, {"learning_rate": 1.0}, {"discount": 0.5}, {"discount": 0.95}]
)
def test_standard_rules_converge_to_the_optimal_q(joint, values):
    task = make_task("joint_reach", joint=joint, states={1: 24, 5: 13}[joint])
    learner = make_learner("tabular_q", task, episodes=1500, epsilon=1.0, **values)
    carry = train_to_end(learner).carry
    optimal = value_iteration(task, learner.discount)
    # The process is deterministic, so a constant learning rate converges. What is left is float32 (values of up to
    # 230 have a spacing of 1.5e-5, and errors add over 1 / (1 - discount) steps), and rows the end of an episode
    # keeps from being visited: the goal's own.
    error = np.abs(carry.q_table - optimal)[:, :-1].max()
    assert error < 2e-3 * np.abs(optimal).max()


@pytest.mark.parametrize(("action", "cell"), [(0, 1), (1, 5), (2, 7), (3, 3)])
def test_moves_go_up_right_down_and_left_unless_an_obstacle_is_there(action, cell):
    open_map = make_task("navigate", map=("...", ".S.", "..G"))
    walled = make_task("navigate", map=(".#.", "#S.", "..G"))
    key = jax.random.key(0)
    assert open_map.step(open_map.reset(key), action, key)[0] == cell
    assert walled.step(walled.reset(key), action, key)[0] == (4 if action in (0, 3) else cell)


@pytest.mark.parametrize("agents", [1, 64])
def test_navigate_finds_paths_as_short_as_breadth_first_search(agents):
    task = make_task("navigate", max_episode_steps=300)
    learner = make_learner("tabular_q", task, episodes=600, epsilon=0.5, discount=0.9, agents=agents)
    carry = train_to_end(learner, 4).carry
    play = jax.jit(jax.vmap(lambda q, key: rollout(learner.env, greedy(learner, q), key)[0]))
    played = play(carry.q_table, jax.random.split(rng.key(1), 4))
    assert played.success.all()
    assert (played.steps == shortest_path(task.map)).all()


@pytest.mark.parametrize(("joint", "value"), [(1, 117.91), (4, 121.692), (5, 106.564)])
def test_printed_rules_give_the_printed_tables(joint, value):
    task = make_task("joint_reach", joint=joint, action=5.0, states=5, rules="printed")
    learner = make_learner("tabular_q", task, episodes=5000, epsilon=0.8, learning_rate=0.99, discount=0.9)
    carry = train_to_end(learner).carry
    assert np.allclose(carry.q_table[:, 4, 1], value, rtol=1e-6)
    assert np.array_equal(carry.q_table[:, :4, 0], carry.q_table[:, :4, 1])


def test_collective_update_is_the_mean_over_agents():
    task = random_task(1, 6, 3, 6)
    learner = make_learner("tabular_q", task, episodes=100, agents=50, learning_rate=0.5, discount=0.5)
    before = jax.jit(lambda key: advance(learner, begin(learner, key), 10)[0].carry)(rng.key(0))
    after, _ = jax.jit(learner.train_step)(before)
    q, agents = jax.device_get((before.q_table, before.agents))
    expected = q.copy()
    for row in range(6):
        for action in range(3):
            errors = [
                float(agents.reward[i])
                + 0.5 * (0 if agents.terminated[i] else q[int(agents.next_row[i])].max())
                - q[row, action]
                for i in range(50)
                if agents.row[i] == row and agents.action[i] == action
            ]
            expected[row, action] += 0.5 * np.mean(errors) if errors else 0.0
    np.testing.assert_allclose(after.q_table, expected, rtol=0, atol=1e-6)


def test_curve_counts_every_episode_once():
    task = make_task("joint_reach", joint=5, states=13)
    learner = make_learner("tabular_q", task, episodes=60, record=7, epsilon=1.0)
    training = train_to_end(learner, 3)
    episodes = training.record[:, :, measures(learner, jax.tree.map(lambda x: x[0], training.carry)).index("episodes")]
    assert (episodes.sum(axis=1) == 60).all()
    assert set(np.unique(episodes)) <= {8.0, 9.0}
    found = curves(learner, training)
    assert (found["success"] == 1).all() and (found["steps"] >= 12).all()


def test_the_curve_of_truncated_episodes_has_their_return_and_length():
    """Every step earns 1: the return of an episode is its length."""
    task = random_task(0, 2, 1, 2, max_episode_steps=3)
    task = task.replace(next_state=jnp.array([[0], [1]], jnp.int32), reward=jnp.ones((2, 1)), rows=jnp.arange(2))
    learner = make_learner("tabular_q", task, episodes=200, learning_rate=1.0, discount=0.5)
    found = curves(learner, train_to_end(learner, 1))
    assert (found["return"] == 3).all() and (found["steps"] == 3).all() and (found["success"] == 0).all()


@pytest.mark.parametrize("agents", [(), (9,)], ids=["one place", "several places"])
@pytest.mark.parametrize("shared", ["array", "index", "values", None])
@pytest.mark.parametrize("backend", ["cpu", "gpu"])
def test_additions_of_all_runs_are_those_of_each(agents, shared, backend, monkeypatch):
    """Of one place or several in each run's array, the same ones again among them; numbers whose sums are exact."""
    monkeypatch.setattr(jax, "default_backend", lambda: backend)
    draw = np.random.default_rng(0)
    args = {
        "array": draw.integers(0, 9, (5, 7, 3)).astype(np.float32),
        "index": draw.integers(0, 7, (5, *agents)).astype(np.int32),
        "values": draw.integers(0, 9, (5, *agents, 3)).astype(np.float32),
    }
    each = {name: [x[0]] * 5 if name == shared else list(x) for name, x in args.items()}
    expected = np.stack(each["array"])
    for run in range(5):
        np.add.at(expected[run], each["index"][run], each["values"][run])
    given = [x[0] if name == shared else x for name, x in args.items()]
    found = jax.vmap(add_at, in_axes=[None if name == shared else 0 for name in args])(*given)
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("keys", [{"epsilon": 0.5}, {"exploration": "boltzmann", "temperature": 2.0}])
def test_a_gpu_draws_what_a_cpu_draws(keys, monkeypatch):
    """It draws only the number that it needs, a CPU both: the same to the bit."""
    task = make_task("joint_reach", joint=5, states=13)
    learner = make_learner("tabular_q", task, episodes=20, **keys)
    found = train_to_end(learner, 2)
    monkeypatch.setattr(tabular, "ways", lambda: ways()._replace(draws_ahead=not ways().draws_ahead))
    jax.clear_caches()
    other = train_to_end(learner, 2)
    jax.tree.map(
        np.testing.assert_array_equal, (found.carry.q_table, found.record), (other.carry.q_table, other.record)
    )
