"""Function approximation: targets against plain Python, features, and learners on tasks whose values are known."""

import re
from functools import partial
from itertools import chain
from operator import itemgetter
from types import SimpleNamespace
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import linen as nn
from hypothesis import given, settings
from hypothesis import strategies as st
from jax.sharding import Mesh, PartitionSpec
from probes import DISCOUNT, END, PROBES, make, probe
from small_sweep import assert_same_tables

import humanoid_mjx.training.chunks as chunk_module
from humanoid_mjx import InputError, make_learner, make_task, sweep
from humanoid_mjx.compute import rng
from humanoid_mjx.config import load
from humanoid_mjx.evaluation.replay import replay, why_stopped
from humanoid_mjx.learners import acting, exploration
from humanoid_mjx.learners.acting import start_all, step_all
from humanoid_mjx.learners.approximate import Batch, lambda_targets
from humanoid_mjx.learners.base import ENVS
from humanoid_mjx.learners.deep import DeepQ, QNetwork
from humanoid_mjx.learners.linear import LinearQ, Scale, combined, tile_coding
from humanoid_mjx.learners.normalisation import moments, normalise, observe
from humanoid_mjx.tasks.continuous import ContinuousTask, auto_reset
from humanoid_mjx.training import pool
from humanoid_mjx.training.plan import make_plan
from humanoid_mjx.training.pool import Pool
from humanoid_mjx.training.program import advance, begin, finish
from humanoid_mjx.training.programs import in_turn, placement

LEARNERS = {
    "tiles": ("linear_q", {"resolution": 3, "tilings": 2, "order": 1, "learning_rate": 0.3}),
    "shared tiles": ("linear_q", {"resolution": 3, "tilings": 2, "order": 1, "learning_rate": 0.3, "shared": True}),
    "deep": ("deep_q", {"width": 32, "layers": 1, "learning_rate": 0.01, "learning_rate_end": 0.1}),
}


def build(kind, task, **values):
    name, own = LEARNERS[kind]
    common = {"envs": 32, "rollout": 4, "discount": DISCOUNT, "epsilon": 1.0, "epsilon_decay": 1.0, "trace_decay": 0.5}
    return make_learner(name, task, total_steps=32 * 4 * 400, record=4, **(common | own | values))


@jax.jit
def trained(learner, updates, key):
    """Compiled once for all tasks and values of one structure."""
    return advance(learner, begin(learner, key), updates)


@jax.jit
def learned(learner, rate, value, batch):
    """The value after one batch, and the mean squared error before it."""
    value, _, error = learner.learn(rate, value, (), batch, rng.key(0))
    return value, error


def train(learner, updates=400, seed=0):
    return trained(jax.tree.map(jnp.asarray, learner), np.int32(updates), rng.key(seed))


@pytest.mark.parametrize("joints", [1, 2])
@pytest.mark.parametrize("kind", LEARNERS)
def test_learners_find_the_values_of_the_probes(kind, joints):
    for name in PROBES:
        task, obs, expected = probe(name, joints)
        learner = build(kind, task)
        training, progress = train(learner)
        assert float(progress[0]) == 1.0
        policy = learner.policy(training.carry)
        q = np.asarray(learner.q_values(policy.value, learner.preprocess(policy, jnp.asarray(obs))))
        # Q of equal choices of all joints is their mean. The probes are deterministic: the only error is that of
        # learning, most for the network's moving features.
        np.testing.assert_allclose(q.mean(axis=1), expected, atol=0.07 if kind == "deep" else 0.02, err_msg=name)


def numpy_targets(reward, terminated, truncated, value, discount, decay):
    steps, envs = reward.shape
    target = np.zeros((steps, envs))
    for e in range(envs):
        for t in reversed(range(steps)):
            if terminated[t, e]:
                target[t, e] = reward[t, e]
            elif truncated[t, e] or t == steps - 1:
                target[t, e] = reward[t, e] + discount * value[t, e]
            else:
                mixed = decay * target[t + 1, e] + (1 - decay) * value[t, e]
                target[t, e] = reward[t, e] + discount * mixed
    return target


targets = jax.jit(lambda_targets)


@given(st.integers(0, 10_000), st.floats(0, 0.99), st.sampled_from([0.0, 0.3, 0.95, 1.0]))
@settings(max_examples=50)
def test_targets_agree_with_plain_python(seed, discount, decay):
    draw = np.random.default_rng(seed)
    reward, value = draw.normal(size=(2, 7, 5)).astype(np.float32)
    ends = draw.integers(0, 6, (7, 5))
    terminated, truncated = ends == 0, ends == 1
    found = targets(reward, terminated, truncated, value, np.float32(discount), np.float32(decay))
    expected = numpy_targets(reward, terminated, truncated, value, discount, decay)
    # Seven steps of float32 arithmetic on numbers of order 1 to 10.
    np.testing.assert_allclose(found, expected, rtol=2e-5, atol=2e-5)


def test_linear_with_a_feature_for_each_state_is_a_table():
    """The same moves, fed one by one to the linear learner and to the rule of the table."""
    task = make_task("joint_reach", joint=5, states=13)
    values = {"tilings": 1, "resolution": 13, "envs": 1, "rollout": 1, "trace_decay": 0.0, "learning_rate": 0.3}
    learner = make_learner("linear_q", task, total_steps=100, record=1, **values)
    value, _ = learner.init_value(rng.key(0))
    table = np.zeros((13, 2))
    draw = np.random.default_rng(0)
    for _ in range(200):
        row, action, target = draw.integers(13), draw.integers(2), draw.normal()
        obs = np.float32([[row / 12]])
        value, _ = learned(
            learner, learner.learning_rate, value, Batch(obs, np.int32([[action]]), np.float32([target]))
        )
        table[row, action] += 0.3 * (target - table[row, action])
    np.testing.assert_allclose(value[0], table, atol=1e-5)


def test_the_action_that_is_credited_is_the_one_carried_out():
    """As a table does: where most moves are replaced by any, what is learned of a move is where that move leads."""
    task = make_task("joint_reach", joint=5, states=13, success_rate=0.3)
    learner = make_learner("linear_q", task, total_steps=100, record=1, envs=64, rollout=8, epsilon=0.0)
    _, seen, _ = jax.jit(lambda key: learner._collect(learner.init(key), rng.key(1)))(rng.key(0))
    moved, credited = np.diff(np.round(12 * np.asarray(seen.obs)[..., 0]), axis=0), np.asarray(seen.action)[:-1, :, 0]
    assert 0.2 < credited.mean() < 0.8, "both are carried out"
    # Each place has a row: the first action stays, the second goes one on.
    goes_on = moved >= 0  # elsewhere a new episode begins
    np.testing.assert_array_equal(moved[goes_on], credited[goes_on])


@pytest.mark.parametrize("ended", [0, 1, 16, 33, 40])
def test_only_episodes_that_ended_begin_anew(ended):
    """In blocks as all at once, also side by side with a run in which none has ended."""
    task, keys = make_task("leg_reach"), jax.random.split(rng.key(1), 40)
    state = jax.jit(lambda key: start_all(task, 40, key).state)(rng.key(0))
    done = np.random.default_rng(0).permutation(40) < ended
    state = jax.tree.map(lambda x: jnp.stack([x, x]), state._replace(truncated=jnp.asarray(done)))
    state = state._replace(truncated=state.truncated.at[1].set(False))
    plain = jax.vmap(auto_reset, (None, 0, 0))
    resets = [jax.jit(jax.vmap(lambda s, f=f: f(task, s, keys)))(state) for f in (acting._reset_done, plain)]
    for found, expected in zip(*map(jax.tree.leaves, resets), strict=True):
        np.testing.assert_allclose(np.asarray(found, float), np.asarray(expected, float), rtol=1e-6, atol=1e-7)


def test_two_devices_share_the_environments_of_a_run():
    """Each acts in a half of them, and both then learn the same from all."""
    learner = build("deep", make_task("leg_reach"), minibatches=2)
    carry, mesh = jax.jit(learner.init)(rng.key(0)), Mesh(np.array(jax.local_devices()[:2]), (ENVS,))
    shared, key = learner.replace(devices=2), rng.key(1)

    def everywhere(function, out_specs):
        """Arrays without entries are made on each device, as by `training.programs`: jaxlib 0.11.2 crashes on them."""

        def call(carry):
            leaves, structure = jax.tree.flatten(carry)

            def on_device(*some):
                rest = iter(some)
                whole = [next(rest) if leaf.size else jnp.zeros(leaf.shape, leaf.dtype) for leaf in leaves]
                return function(structure.unflatten(whole))

            mapped = jax.shard_map(on_device, mesh=mesh, in_specs=PartitionSpec(), out_specs=out_specs, check_vma=False)
            return mapped(*(leaf for leaf in leaves if leaf.size))

        return jax.jit(call)

    envs, seen, totals = everywhere(lambda c: shared._act(c, key), PartitionSpec())(carry)
    for half, rows in enumerate((slice(16), slice(16, 32))):
        part = carry._replace(envs=jax.tree.map(itemgetter(rows), carry.envs))
        expected = jax.jit(learner._act)(part, jax.random.fold_in(key, half))
        found = jax.tree.map(itemgetter(rows), envs), jax.tree.map(itemgetter((slice(None), rows)), seen)
        jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-4, atol=1e-5), found, expected[:2])
        totals = jax.tree.map(jnp.subtract, totals, expected[2])
    assert max(abs(float(x)) for x in totals.values()) < 1e-3, "the sums are those of both"

    def step(carry):
        return jax.tree.map(lambda x: x[None], shared.train_step(carry)[0].weights)

    after = everywhere(step, PartitionSpec(ENVS))(carry)
    jax.tree.map(lambda x: np.testing.assert_array_equal(*x), after)
    assert after.moments.count[0] == 32 * learner.rollout


def test_cores_share_a_run_where_they_are_more_than_the_runs():
    walk, leg = (make_plan(load(name)).groups[0].learners for name in ("walk_cpu", "leg_reach"))
    one, two = np.array([jax.local_devices()[:2]]), np.array(jax.local_devices()[:2])[:, None]
    for learners, runs, room, found in (
        (walk, 1, 100, [([0], 1, one)]),
        (walk, 3, 1, [([0, 1, 2], 1, one)]),
        (walk, 4, 100, [([0, 1, 2, 3], 1, two)]),
        (walk, 5, 100, [([0, 1, 2, 3], 1, two), ([4], 1, one)]),
        (leg, 1, 100, [([0], 1, two[:1])]),
        (leg, 5, 100, [([0, 1, 2, 3, 4], 3, two)]),
    ):
        parts = in_turn(learners, list(range(runs)), room)
        placed = [(part, *placement(learners, len(part), room)) for part in parts]
        assert str(placed) == str(found)
    fits = {(128, 2): True, (129, 2): False, (126, 2): False, (128, 4): False, (129, 1): True}
    assert {case: walk.replace(envs=case[0]).can_share(case[1]) for case in fits} == fits


def test_one_sample_moves_its_value_by_the_rate():
    scale = Scale(np.full(3, -2.0), np.full(3, 2.0), 1.5)
    groups = np.repeat(combined([[range(3)]], 2), 2, axis=0)
    # Three groups of two observations; shifted tilings stand over, by a tile along each.
    assert [tile_coding(scale, groups, 4, tilings).size for tilings in (1, 2, 3)] == [3 * 16, 6 * 25, 9 * 25]
    basis = tile_coding(scale, groups, 4, 3)
    obs = jnp.array(np.random.default_rng(0).uniform(-2, 2, (50, 3)), jnp.float32)
    place = jax.jit(basis.encode)(obs)
    assert place.shape == (50, 2, basis.active) and int(place.min()) >= 0 and int(place.max()) < basis.size
    assert all(len(set(row.tolist())) == basis.active for row in place.reshape(100, -1))
    np.testing.assert_array_equal(place[:, 0], place[:, 1])
    learner = build("tiles", probe("constant reward")[0])
    weights, _ = learner.init_value(rng.key(0))
    batch = Batch(jnp.float32([[0.3]]), jnp.int32([[1]]), jnp.float32([3.0]))
    after, error = learned(learner, 0.25, weights, batch)
    assert error == 9.0
    moved = learner.q_values(after, batch.obs)[0, 0]
    np.testing.assert_allclose(moved, [0.0, 0.75], atol=1e-5)


def test_features_combine_observations_of_a_family():
    assert combined([[(0, 1, 2)]], 2).tolist() == [[[0, 1], [0, 2], [1, 2]]]
    assert combined([[(0, 3), (3, 4, 0)]], 2).tolist() == [[[0, 3], [0, 4], [3, 4]]]
    assert combined([[(2,), (0, 1)], [(0,), (1, 3)]], 2).tolist() == [[[0], [1], [2]], [[0], [1], [3]]]
    assert combined([[(2,), (0, 1)], [(0,), (1, 2)]], 2).tolist() == [[[0], [1], [2]]]  # alike
    with pytest.raises(InputError, match="as many groups"):
        combined([[(0, 1, 2)], [(0, 1)]], 2)


@pytest.mark.parametrize("resolution", [2, 20])
@pytest.mark.parametrize("kind", ["tiles", "shared tiles"])
def test_a_weight_moves_by_the_mean_error_of_its_samples(kind, resolution):
    """Joints that share weights learn from each other's samples. Few tiles and many add up by ways of their own."""
    learner = build(kind, probe("constant reward", 2)[0], resolution=resolution)
    draw = np.random.default_rng(0)
    old = draw.normal(size=learner.init_value(rng.key(0))[0].shape).astype(np.float32)
    obs, target = draw.uniform(-1, 1, (9, 1)).astype(np.float32), draw.normal(size=9).astype(np.float32)
    action = draw.integers(2, size=(9, 2))
    moved, _ = learned(learner, 0.5, jnp.asarray(old), Batch(*map(jnp.asarray, (obs, action, target))))
    tiles = learner.features()
    errors: dict[tuple[int, int, int], list[float]] = {}
    for places, choices, value in zip(np.asarray(tiles.encode(jnp.asarray(obs)))[:, 0], action, target, strict=True):
        weights = [[(joint % len(old), place, choice) for place in places] for joint, choice in enumerate(choices)]
        error = value - np.mean([sum(old[at] for at in own) for own in weights])
        for at in chain(*weights):
            errors.setdefault(at, []).append(error)
    expected = old.copy()
    for at, own in errors.items():
        expected[at] += 0.5 * np.mean(own) / tiles.active
    np.testing.assert_allclose(moved, expected, rtol=1e-4, atol=1e-5)


def test_focus_makes_tiles_narrow_in_the_middle_of_a_range():
    scale = Scale(np.full(1, -4.0), np.full(1, 4.0), 2.0)
    np.testing.assert_allclose(scale(jnp.float32([[-9], [-4], [-1], [0], [1], [4]]))[:, 0], [0, 0, 0.25, 0.5, 0.75, 1])
    basis = tile_coding(scale, np.array([[[0]]]), 4, 1)
    tiles = basis.encode(jnp.float32([[-1.1], [-0.9], [-0.1], [0.1], [0.9], [1.1], [3.9]]))[:, 0, 0]
    assert tiles.tolist() == [0, 1, 1, 2, 2, 3, 3]


def test_moments_are_those_of_all_that_was_seen():
    draw = np.random.default_rng(0)
    batches = [draw.normal(3, 2, (n, 4)).astype(np.float32) for n in (7, 100, 31)]
    seen = moments(4)
    for batch in batches:
        seen = observe(seen, jnp.asarray(batch))
    together = np.concatenate(batches)
    np.testing.assert_allclose(seen.mean, together.mean(axis=0), rtol=1e-5)
    np.testing.assert_allclose(seen.variance, together.var(axis=0), rtol=1e-4)
    assert abs(np.asarray(normalise(seen, jnp.asarray(together))).std() - 1) < 1e-3


def test_training_feeds_the_statistics_raw_observations_once():
    task, _, _ = probe("delayed reward")
    learner = build("deep", task)
    carry = train(learner, updates=5)[0].carry
    assert float(carry.weights.moments.count) == 5 * 4 * 32
    np.testing.assert_allclose(carry.weights.moments.mean, 0.0, atol=1e-6)
    np.testing.assert_allclose(carry.weights.moments.variance, 1.0, atol=1e-6)


def test_exploration():
    allowed = np.array([[True, True, True, False], [True, True, False, False]])
    best = jnp.zeros((4000, 2), jnp.int32)
    epsilon = jnp.repeat(jnp.float32([0.6, 0.0]), 2000)
    action = exploration.explore(best, allowed, epsilon, rng.key(0))
    counts = np.bincount(np.asarray(action[:2000, 0]), minlength=4) / 2000
    # Three in ten thousand such samples fall outside 3.6 sigma = 0.04.
    np.testing.assert_allclose(counts, [0.6, 0.2, 0.2, 0.0], atol=0.04)
    assert int(action[:, 1].max()) == 1 and not action[2000:].any()
    both = np.asarray(action[:2000] > 0).mean(axis=0)
    np.testing.assert_allclose(np.asarray((action[:2000] > 0).all(axis=1)).mean(), both.prod(), atol=0.03)


def test_the_greedy_choice_is_the_best_there_is_and_any_of_equal_ones():
    allowed = np.array([[True, True, True, False], [True, True, False, False]])
    q = jnp.tile(jnp.float32([[0.0, 1.0, 1.0, 5.0], [2.0, 1.0, 9.0, 9.0]]), (2000, 1, 1))
    best = exploration.greedy(q, allowed, rng.key(0))
    # Three in ten thousand such samples fall outside 3.6 sigma = 0.04.
    np.testing.assert_allclose(np.bincount(best[:, 0], minlength=4) / 2000, [0, 0.5, 0.5, 0], atol=0.04)
    assert (best[:, 1] == 0).all()


class Hasty(LinearQ):
    """An exploration of one's own: each joint takes its worst choice while epsilon is large, then its first."""

    def choose(self, q, amount, tie_key, key):
        return jnp.where(amount[:, None] < 0.5, 0, jnp.where(self.allowed, q, jnp.inf).argmin(axis=-1))


def test_an_exploration_of_ones_own_chooses_the_actions_of_training_and_no_others():
    learner = Hasty(task=make_task("leg_reach", duration=0.3), envs=4, rollout=5, epsilon_decay=0.0)
    carry = jax.jit(learner.init)(rng.key(0))
    value = carry.weights.value.at[..., 2].set(-1.0)  # the third choice is everywhere the worst
    weights = carry.weights._replace(value=value)
    _, experience, _ = jax.jit(learner._collect)(carry._replace(weights=weights), rng.key(1))
    first = np.arange(5) < 3  # an episode has three decisions
    np.testing.assert_array_equal(experience.action, np.broadcast_to(np.where(first, 2, 0)[:, None, None], (5, 4, 5)))
    greedy = jax.jit(learner.act)(weights, carry.envs.state.obs, rng.key(0))
    assert greedy.shape == (4, 5) and not (greedy == 2).any()


def test_epsilon_decays_by_the_episode_and_climbs_the_ladder():
    learner = build("tiles", probe("choice")[0], epsilon=0.5, epsilon_decay=0.9, epsilon_min=0.2, epsilon_spread=1.0)
    found = exploration.amounts(learner, jnp.array([0, 1, 100]))
    np.testing.assert_allclose(found, [0.5, (0.45) ** 1.5, 0.2**2], rtol=1e-5)


@pytest.mark.parametrize("rule", ["epsilon_greedy", "boltzmann"])
def test_chances_are_those_of_the_actions(rule):
    """By enumeration of all actions of two joints; `drawn_choices` and `explore` take each so often."""
    allowed = np.array([[True, True, True], [True, True, False]])
    learner = SimpleNamespace(allowed=allowed, exploration=rule)
    q, amount = np.float32([[0.5, 1.0, -1.0], [2.0, 1.0, 9.0]]), 0.3
    found = exploration.chances(learner, jnp.asarray(q)[None], jnp.float32([amount]))[0]
    actions = [(a, b) for a in range(3) for b in range(2)]
    if rule == "boltzmann":
        odds = {(a, b): np.exp((q[0, a] + q[1, b]) / 2 / amount) for a, b in actions}
        odds = {action: each / sum(odds.values()) for action, each in odds.items()}
        drawn = exploration.drawn_choices(jnp.broadcast_to(found, (4000, 2, 3)), rng.key(0))
    else:
        single = np.array([[0.1, 0.8, 0.1], [0.85, 0.15, 0.0]])
        odds = {(a, b): single[0, a] * single[1, b] for a, b in actions}
        best = jnp.tile(jnp.int32([[1, 0]]), (4000, 1))
        drawn = exploration.explore(best, allowed, jnp.full(4000, amount), rng.key(0))
    np.testing.assert_allclose(found.sum(axis=-1), 1.0, rtol=1e-6)
    for (a, b), chance in odds.items():
        assert found[0, a] * found[1, b] == pytest.approx(chance, rel=1e-5)
        # Three in ten thousand such samples fall outside 3.6 sigma = 0.03.
        assert np.mean((drawn[:, 0] == a) & (drawn[:, 1] == b)) == pytest.approx(chance, abs=0.03)


@pytest.mark.parametrize("rule", ["epsilon_greedy", "boltzmann"])
def test_expected_sarsa_finds_the_values_of_its_own_exploration(rule):
    """Two states in a row, the second with a choice of -1 and 1: the first is worth the mean, discounted."""
    task = make(1, (-1.0, 1.0), 0.0, (1, END), ((0, 0), (-1, 1)))
    own = {"epsilon": 0.5} if rule == "epsilon_greedy" else {"temperature": 1.0}
    values = {"envs": 32, "rollout": 4, "discount": DISCOUNT, "epsilon_decay": 1.0, "trace_decay": 0.0}
    values |= {"method": "expected_sarsa", "exploration": rule, "resolution": 3, "tilings": 2, "order": 1} | own
    learner = make_learner("linear_q", task, total_steps=32 * 4 * 400, record=4, **values)
    policy = learner.policy(train(learner)[0].carry)
    q = np.asarray(learner.q_values(policy.value, jnp.float32([[-1.0], [1.0]])))[:, 0]
    better = 0.75 if rule == "epsilon_greedy" else 1 / (1 + np.exp(-2.0))
    np.testing.assert_allclose(q, [[DISCOUNT * (2 * better - 1)] * 2, [-1.0, 1.0]], atol=0.02)


def test_sums_are_over_the_episodes_that_ended():
    """Against plain Python: episodes of one or two steps, that end by themselves or are cut off."""
    task = make(1, (-1.0, 1.0), 0.5, (1, END), ((0.25, 0.5), (-1.0, 2.0)), cap=2)
    envs, draw = start_all(task, 16, rng.key(0)), np.random.default_rng(0)
    step = jax.jit(lambda *given: step_all(task, *given))
    length, total, right, episodes = np.zeros((4, 16))
    for t in range(6):
        action = jnp.asarray(draw.integers(0, 2, (16, 1)), jnp.int32)
        envs, state, sums = step(envs, action, rng.key(t), rng.key(100 + t))
        length, total, done = length + 1, total + np.asarray(state.reward), np.asarray(state.done)
        right += np.asarray(action[:, 0])
        success = done & np.asarray(state.success)
        assert done.sum() > 0 and success.sum() == sums["success"] and done.sum() == sums["episodes"]
        assert (done * length).sum() == sums["steps"] and (done * total).sum() == sums["return"]
        assert (done * right).sum() == sums["right"]
        length, total, right, episodes = length * ~done, total * ~done, right * ~done, episodes + done
        np.testing.assert_array_equal(envs.episode, episodes)
        assert (np.asarray(envs.state.obs) != np.asarray(state.final_obs))[done].any()


class TellsItsRate(LinearQ):
    def learn(self, rate, value, optimizer, batch, key):
        return value, optimizer, rate


def test_the_learning_rate_falls_linearly_to_its_end():
    values = {"envs": 4, "rollout": 2, "learning_rate": 0.5, "learning_rate_end": 0.2}
    learner = TellsItsRate(task=probe("choice")[0], total_steps=80, **values)
    carry, step = jax.jit(learner.init)(rng.key(0)), jax.jit(learner.train_step)
    outcomes = [step(carry._replace(update=jnp.int32(update)))[1] for update in (0, 5, 10, 15)]
    np.testing.assert_allclose([x.squares["td_error"] for x in outcomes], [0.5, 0.3, 0.1, 0.1], rtol=1e-6)
    assert [float(x.done) for x in outcomes] == [0.0, 40.0, 80.0, 120.0]


class Uneven(ContinuousTask):
    """Joints with different numbers of choices."""

    observation_size: ClassVar = 1
    action_bins: ClassVar = (9, 3)

    @property
    def observation_bounds(self):
        return np.zeros(1), np.ones(1)


def test_joints_of_fewer_choices_have_no_more_and_share_no_weights():
    with pytest.raises(InputError, match="shared needs joints that have the same number of choices"):
        build("shared tiles", Uneven())
    assert build("tiles", probe("choice")[0]).replace(task=Uneven()).allowed.sum(axis=1).tolist() == [9, 3]


def test_stored_configs_may_hold_retired_keys_at_their_only_value():
    task = probe("choice")[0]
    assert build("tiles", task, action_repeat=1, coarse_to_fine=False, basis="tiles") == build("tiles", task)
    with pytest.raises(InputError, match=r"learner\.action_repeat: unknown key"):
        build("tiles", task, action_repeat=2)


@pytest.mark.parametrize(
    ("name", "values", "words"),
    [
        ("deep_q", {"minibatches": 3}, r"minibatches must divide envs \* rollout"),
        ("deep_q", {"trace_decay": 1.5}, "learner.trace_decay must be at most 1"),
        ("linear_q", {"focus": 0.5}, "learner.focus must be at least 1"),
        ("linear_q", {"basis": "fourier"}, "learner.basis: unknown key"),
        ("linear_q", {"resolution": 2000, "order": 2}, "make it coarser"),
        (
            "deep_q",
            {"method": "double_q"},
            "learner.method must be one of 'q_learning' or 'expected_sarsa'",
        ),
        (
            "deep_q",
            {"temperature": 0.5},
            "temperature is not read with exploration epsilon_greedy; leave it out, or set",
        ),
        ("linear_q", {"exploration": "boltzmann", "epsilon": 0.5}, "learner.exploration=epsilon_greedy"),
        ("tabular_q", {}, "learner.name: tabular_q learns finite tasks"),
    ],
)
def test_bad_values_get_a_sentence(name, values, words):
    task = probe("both")[0]
    if "order" in values:
        task = make_task("joint_reach", joint=1)
        values = values | {"resolution": 10_000, "tilings": 200}
    with pytest.raises(InputError, match=words):
        make_learner(name, task, **values)


SWEEP = {
    "name": "deep",
    "task": {"name": "joint_reach", "joint": 5, "states": 13, "max_episode_steps": 40},
    "learner": {"name": "deep_q", "width": 16, "layers": 1, "envs": 8, "rollout": 8}
    | {"evaluation_envs": 4, "evaluations": 5},
    "sweep": {"axes": {"learner.epsilon": [0.2, 1.0], "learner.trace_decay": [0.0, 0.9]}},
    "seeds": 2,
    "total_steps": 8 * 8 * 40,
    "record": 10,
}


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    return sweep(SWEEP, tmp_path_factory.mktemp("deep") / "run")


def test_the_policy_is_the_mean_of_the_weights_of_late():
    """Those after each update, that of update i of t counting as a beta distribution's density at i / t does."""
    learner = build("tiles", probe("both")[0], weight_averaging=0.25)
    step, carry = jax.jit(learner.train_step), jax.jit(learner.init)(rng.key(0))
    seen = []
    for _ in range(20):
        carry = step(carry)[0]
        seen.append(np.asarray(carry.weights.value, float))
    # (i + eta - 1)! / (i - 1)! with eta = 1 / weight_averaging - 1 = 3
    share = np.array([i * (i + 1) * (i + 2) for i in range(1, 21)], float)
    policy = learner.policy(carry)
    np.testing.assert_allclose(policy.value, np.tensordot(share / share.sum(), seen, 1), rtol=1e-5, atol=1e-7)
    assert not np.allclose(policy.value, seen[-1], rtol=1e-3)
    jax.tree.map(np.testing.assert_array_equal, policy.moments, carry.weights.moments)


def test_parts_in_which_no_update_ends_have_no_evaluation():
    """Of two updates the first ends in the middle and the second at the end of the training."""
    learner = build("tiles", probe("choice")[0], evaluations=4, evaluation_envs=4).replace(total_steps=2 * 32 * 4)
    training, _ = train(learner, updates=2)
    found = jax.jit(finish)(learner, training, rng.key(0))
    assert np.isfinite(found["curve"]["greedy_return"]).tolist() == [False, True, False, True]
    assert found["final"]["greedy_return"] == found["curve"]["greedy_return"][3]
    last = jax.tree.map(lambda x: x[3], training.snapshots[0])
    jax.tree.map(np.testing.assert_array_equal, last, training.carry.weights)


def test_snapshots_are_of_the_end_of_each_part():
    """Training to the middle gives the weights that stand in the middle of a longer training."""
    learner = build("tiles", probe("both")[0], evaluations=4)
    whole, _ = train(learner)
    half, _ = train(learner, updates=200)
    middle = jax.tree.map(lambda x: x[1], whole.snapshots[0])
    jax.tree.map(np.testing.assert_array_equal, middle, half.carry.weights)
    jax.tree.map(np.testing.assert_array_equal, jax.tree.map(lambda x: x[3], whole.snapshots[0]), whole.carry.weights)
    results = jax.jit(finish)(learner, half, rng.key(1))
    curve, final = results["curve"], results["final"]
    np.testing.assert_array_equal(np.isfinite(curve["greedy_success"]), [True, True, False, False])
    assert final["greedy_return"] == curve["greedy_return"][1]


def test_a_stopped_training_of_networks_goes_on_to_the_same_bits(swept, tmp_path, monkeypatch):
    monkeypatch.setattr(chunk_module, "CHECKPOINT_EVERY_S", 0.0)
    monkeypatch.setattr(pool, "MAX_STEPS", 3)
    chunks = []
    train = Pool.train

    def stop_soon(self):
        train(self)
        chunks.append(self)
        if len(chunks) > 8:
            raise KeyboardInterrupt

    monkeypatch.setattr(Pool, "train", stop_soon)
    with pytest.raises(KeyboardInterrupt):
        sweep(SWEEP, tmp_path / "run")
    assert list((tmp_path / "run/checkpoint").glob("pool-*.npz"))
    monkeypatch.setattr(Pool, "train", train)
    again = sweep(SWEEP, tmp_path / "run", resume=True)
    assert_same_tables(again.path, swept.path)


def test_a_run_that_breaks_is_marked_and_can_be_replayed_while_the_others_finish(tmp_path):
    learner = {"name": "linear_q", "tilings": 1, "resolution": 13, "envs": 4, "rollout": 4, "evaluation_envs": 2}
    axes = {"task.bonus": [100.0, 3e38]}
    config = SWEEP | {"learner": learner, "sweep": {"axes": axes}, "seeds": 1, "total_steps": 4 * 4 * 60}
    run = sweep(config, tmp_path / "run")
    assert run.summary["diverged"].tolist() == [False, True]
    assert np.isfinite(run.summary["greedy_return"][0])
    again = replay(run.path, 1, 0)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(again.carry.weights))
    broken, _ = jax.jit(lambda carry: again.learner.train_step(carry))(again.carry)
    assert not all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(broken.weights))
    words = why_stopped(run.path, run.summary)
    assert "1 run stopped" in words and "; not finite: the reward" in words
    assert re.search(r"Point 1 with seed 0 stopped after step \d+;", words) and f"replay('{run.path}', 1, 0)" in words
    with pytest.raises(InputError, match="point 0 with seed 0 did not diverge"):
        replay(run.path, 0, 0)


def test_a_point_of_a_curve_in_which_no_episode_ended_is_not_known(tmp_path):
    """Elsewhere the terms of the reward add up to the return: float32 sums of 100 decisions."""
    task = {"name": "leg_reach", "physics": "chain"}
    learner = {"name": "linear_q", "envs": 4, "rollout": 4, "evaluation_envs": 1}
    config = {"name": "leg", "task": task, "learner": learner, "total_steps": 320, "record": 20}
    results = sweep(config, tmp_path / "run").results
    unknown = np.isnan(results["success"])
    assert unknown.any() and not unknown.all()
    for name in ("return", "steps", "near", "settled"):
        np.testing.assert_array_equal(np.isfinite(results[name]), ~unknown)
    np.testing.assert_allclose(results["near"] + results["settled"], results["return"], rtol=1e-5)


def test_precision_is_of_a_gpu(monkeypatch):
    """On a CPU no precision changes a bit; elsewhere bfloat16, of 8 binary digits, rounds three layers' numbers."""

    def q(precision):
        network = QNetwork(64, 3, 2, 5, precision)
        value = jax.jit(network.init)(rng.key(0), jnp.zeros(10))
        return np.asarray(network.apply(value, jax.random.normal(rng.key(1), (50, 10))))

    exact = q("float32")
    np.testing.assert_array_equal(q("tensorfloat32"), exact)
    np.testing.assert_array_equal(q("bfloat16"), exact)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    rounded = q("bfloat16")
    assert rounded.dtype == np.float32
    error = np.sqrt(np.mean((rounded - exact) ** 2)) / exact.std()
    assert 2.0**-11 < error < 2.0**-5


def test_networks_learn_on_a_gpu_as_on_a_cpu(monkeypatch):
    """The sums and products there are in another order, but for rounding the same."""
    learner = build("deep", probe("choice", 2)[0], minibatches=2, epochs=2)
    value, optimizer = learner.init_value(rng.key(0))
    obs, target = jax.random.normal(rng.key(1), (256, learner.env.observation_size)), jnp.arange(256.0) / 256
    batch = Batch(obs, jnp.zeros((256, 2), int), target)
    one, *_ = learner.learn(learner.learning_rate, value, optimizer, batch, rng.key(2))
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    two, *_ = learner.learn(learner.learning_rate, value, optimizer, batch, rng.key(2))
    for old, new, same in zip(*map(jax.tree.leaves, (value, one, two)), strict=True):
        assert np.abs(new - old).max() > 1e-4
        np.testing.assert_allclose(same, new, rtol=1e-4, atol=1e-6)


class Plain(nn.Module):
    @nn.compact
    def __call__(self, obs):
        return nn.Dense(2)(obs)


class Normed(nn.Module):
    fixed: bool

    @nn.compact
    def __call__(self, obs):
        return nn.BatchNorm(use_running_average=self.fixed)(nn.Dense(2)(obs))[..., None, :]


class Dropping(nn.Module):
    @nn.compact
    def __call__(self, obs):
        return nn.Dropout(0.5, deterministic=False)(nn.Dense(2)(obs))[..., None, :]


@pytest.mark.parametrize(
    ("module", "got"),
    [
        (None, "got AttributeError: 'NoneType' object has no attribute 'init'"),
        (Plain(), "got ('params', (2,))."),
        (Normed(False), "got ModifyScopeVariableError: "),
        (Normed(True), "'batch_stats'"),
        (Dropping(), "got InvalidRngError: "),
    ],
    ids=str,
)
def test_a_network_of_ones_own_that_does_not_fit_gets_one_sentence(module, got):
    class OwnQ(DeepQ):
        network = lambda self: module  # noqa: E731

    with pytest.raises(InputError) as caught:
        jax.eval_shape(OwnQ(task=make_task("joint_reach")).init, rng.key(0))
    said = str(caught.value)
    assert said.startswith(
        "OwnQ.network() must return a Flax module from (..., 1) to (..., joints, bins), here (..., 1, 2)"
    )
    assert got in said and "\n" not in said
