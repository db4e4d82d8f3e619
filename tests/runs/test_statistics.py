"""Statistics over seeds, against simulated outcomes whose truth is known, and against scipy."""

from itertools import product

import numpy as np
import pytest
from chapter_8_verdicts import above, holm
from scipy import stats

from humanoid_mjx.runs.ranking import _matters, best_table, compared, find_levels, in_words, ranked
from humanoid_mjx.runs.statistics import (
    difference,
    estimate,
    importance,
    importance_of_drawn,
    improvement,
    interval,
    is_chance,
    not_worse,
    of_levels,
    profile,
)

TRIALS = 20_000


def two_kinds(share):
    """Outcomes of seeds of which a share succeeds: two narrow heaps."""
    return lambda rng, shape: (rng.random(shape) < share) + rng.normal(0.0, 0.05, shape)


OUTCOMES = {
    "normal": lambda rng, shape: rng.normal(size=shape),
    "skewed": lambda rng, shape: rng.lognormal(size=shape),
    "half fail": two_kinds(0.5),
    "a third fails": two_kinds(0.67),
    "a fifth fails": two_kinds(0.8),
}


def coverage(outcome, seeds):
    rng = np.random.default_rng(seeds)
    truth = np.median(OUTCOMES[outcome](rng, 2_000_000))
    low, high = interval(OUTCOMES[outcome](rng, (seeds, TRIALS)))
    return np.mean((low <= truth) & (truth <= high))


@pytest.mark.parametrize("outcome", OUTCOMES)
@pytest.mark.parametrize("seeds", [5, 8, 16, 64])
def test_intervals_cover_the_median_as_often_as_they_say(outcome, seeds):
    # 93.75 % is what the range of five values covers of any distribution; three sigma of the trials are 0.5 %.
    assert 0.93 <= coverage(outcome, seeds) <= 0.97


@pytest.mark.parametrize(("outcome", "least"), [("normal", 0.94), ("skewed", 0.92), ("half fail", 0.75)])
def test_three_seeds_cover_what_they_can(outcome, least):
    """Of two kinds of outcomes a quarter of all threes is of one kind: no interval of these can hold the other."""
    assert least <= coverage(outcome, 3) <= 0.97


@pytest.mark.parametrize("seeds", [8, 9, 16, 41])
def test_order_statistics_bracket_the_interpolated_interval(seeds):
    """Each end lies between the two order statistics whose binomial coverages bracket 95 %."""
    low, high = interval(np.arange(seeds, dtype=float))
    k = int(stats.binom.ppf(0.025, seeds, 0.5))  # the smallest k whose tail reaches 2.5 %
    assert k - 1 <= low <= k and low + high == pytest.approx(seeds - 1)


def test_possible_values_bound_an_interval():
    assert estimate(np.array([0.5, 0.8, 1.0]), 0.0, 1.0) == (0.8, pytest.approx(0.5 - 0.813 * 0.5), 1.0)
    assert estimate(np.array([3.0])) == (3.0, 3.0, 3.0)


@pytest.mark.parametrize("outcome", ["normal", "skewed", "half fail"])
@pytest.mark.parametrize("seeds", [5, 16])
def test_of_300_points_alike_none_is_called_worse(outcome, seeds):
    rng, trials = np.random.default_rng(seeds), 60

    def false_alarm():
        values = OUTCOMES[outcome](rng, (300, seeds)) + 3.0 * rng.normal(size=seeds)  # seeds are common to points
        return not not_worse(values).all()

    # At most 5 %, and three sigma of the trials.
    assert np.mean([false_alarm() for _ in range(trials)]) <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / trials)


@pytest.mark.parametrize(("seeds", "kept"), [(3, 20), (5, 16), (16, 16)])
def test_worse_points_are_told_from_the_best(seeds, kept):
    rng = np.random.default_rng(9)
    truth = np.concatenate([np.full(14, 0.97), np.linspace(0.2, 0.8, 286)])
    found = not_worse(truth[:, None] + rng.normal(0.0, 0.05, (300, seeds)) + rng.normal(size=seeds))
    assert found[:14].all() and found.sum() <= kept
    assert not_worse(np.outer([1.0, 0.0, 0.0, 0.0, 0.0], np.ones(5))).tolist() == [True, *[False] * 4]
    assert not_worse(rng.normal(size=(20, 1))).all(), "one seed tells nothing"


@pytest.mark.parametrize(("points", "seeds"), [(3, 5), (4, 4), (9, 3)])
def test_one_point_that_fails_is_told_from_few(points, seeds):
    """Chance picks the same point for all seeds once in points ** (seeds - 1) cases, here less often than 2.5 %."""
    values = np.random.default_rng(3).normal(0.9, 0.01, (points, seeds))
    values[1] -= 0.9
    assert not_worse(values, 0.025).tolist() == [point != 1 for point in range(points)]


def test_common_seeds_make_a_small_difference_visible():
    rng = np.random.default_rng(1)
    luck = rng.normal(size=8)
    one, other = luck + 0.3 + rng.normal(0.0, 0.05, 8), luck + rng.normal(0.0, 0.05, 8)
    assert difference(one, other).low > 0.2
    assert estimate(one).low < estimate(other).high, "the intervals of the two overlap"


def test_comparisons_of_independent_runs_are_those_of_scipy():
    rng = np.random.default_rng(2)
    one, other = rng.normal(0.5, 1, 6), rng.normal(size=7)
    assert above(one, other) == pytest.approx(
        stats.mannwhitneyu(one, other, alternative="greater", method="exact").pvalue
    )
    assert above(np.arange(5) + 9.0, np.arange(5.0)) == pytest.approx(1 / 252)
    assert improvement(one, other) == pytest.approx(stats.mannwhitneyu(one, other).statistic / 42)
    assert improvement(np.ones(3), np.ones(4)) == 0.5
    np.testing.assert_allclose(holm(np.array([0.01, 0.04, 0.03])), [0.03, 0.06, 0.06])
    np.testing.assert_allclose(profile(np.array([1.0, 2.0, 3.0]), np.array([0.0, 2.0, 3.0])), [1.0, 1 / 3, 0.0])


def grid(effect):
    """A grid of 5 x 4 x 3 points and 6 seeds, and what a function of the three indices and noise make of it."""
    index = np.array(np.unravel_index(np.arange(60), (5, 4, 3)))
    return index, effect(*index)[:, None] + np.random.default_rng(3).normal(0.0, 0.5, (60, 6))


def test_effects_of_a_grid_are_those_of_the_analysis_of_variance():
    a, b = np.arange(5) - 2.0, np.arange(4) - 1.5
    index, values = grid(lambda i, j, k: 2 * a[i] + b[j] + a[i] * b[j])
    variances = {"a": 4 * a.var(), "b": b.var(), "ab": a.var() * b.var(), "c": 0.0}
    total = sum(variances.values())
    of = {name: np.median(importance(level, values)) for name, level in zip("abc", index, strict=True)}
    of["ab"] = np.median(importance(index[0] * 4 + index[1], values)) - of["a"] - of["b"]
    for name, variance in variances.items():
        assert of[name] == pytest.approx(variance / total, abs=0.02), name
    np.testing.assert_allclose(of_levels(index[0], values)[1], values[index[0] == 1].mean(axis=0))


@pytest.mark.parametrize("shape", [(2, 2), (3, 4), (3, 3, 2)])
@pytest.mark.parametrize("seeds", [1, 2, 3, 6])
def test_where_chance_alone_differs_few_parameters_matter(shape, seeds):
    """Of 300 sweeps of a grid in less than 5 %, whatever the distribution."""
    rng, index = np.random.default_rng(6), np.indices(shape).reshape(len(shape), -1)
    axes = dict(zip("abc", index, strict=False))
    found = []
    for draw in [rng.normal, lambda size: rng.normal(rng.random(size) < 0.5, 0.01)] * 150:
        found.append([share.low > 0 for share in _matters(True, axes, draw(size=(index.shape[1], seeds))).values()])
    assert np.mean(found) < 0.05


def test_chance_is_judged_as_by_every_deal():
    """Of two levels in 12 repeats, and of what 2 x 2 values do together in 10, where a deal changes signs."""
    rng, judged = np.random.default_rng(7), []
    for size in np.linspace(0.0, 1.5, 40):
        table = rng.normal(size=(2, 1, 12)) + np.array([0, size])[:, None, None]
        both = rng.normal(size=(2, 2, 10)) + np.diag([size, 0])[..., None]
        for each, gaps in (
            (table, table[1, 0] - table[0, 0]),
            (both, both[0, 0] - both[0, 1] - both[1, 0] + both[1, 1]),
        ):
            signs = np.array(list(product([-1, 1], repeat=len(gaps))))
            share = np.mean(np.abs(signs @ gaps) >= abs(gaps.sum()) - 1e-9)
            judged += [(is_chance(each), share > 0.05)] if abs(share - 0.05) > 0.03 else []
    assert all(one == other for one, other in judged) and 10 < sum(one for one, _ in judged) < len(judged) - 10


def test_a_grid_with_a_missing_point_says_what_matters():
    index, values = grid(lambda i, j, k: 2.0 * i)
    found = _matters(True, dict(zip("abc", index[:, 1:], strict=True)), values[1:])
    assert [name for name, share in found.items() if share.low > 0 and share.value > 0.05] == ["a"]
    assert _matters(True, {}, values[:1]) == {}


def test_of_points_drawn_at_random_the_other_parameters_are_no_effect():
    rng = np.random.default_rng(4)
    level, other = rng.integers(5, size=(2, 80))
    values = np.repeat(10.0 * other[:, None], 4, axis=1)
    shares = [np.median(importance(each, values, drawn=True)) for each in (level, other)]
    assert abs(shares[0]) < 0.15 and shares[1] == pytest.approx(1.0)


@pytest.mark.parametrize("points", [5, 9, 12, 14, 20])
def test_of_few_points_drawn_at_random_a_parameter_without_effect_does_not_matter(points):
    """Of 100 sweeps in less than 5; what the other parameter does is the whole difference."""
    rng, found = np.random.default_rng(9), []
    for _ in range(100):
        axes = dict(zip("ab", rng.random((2, points)), strict=True))
        values = 3.0 * axes["b"][:, None] + rng.normal(0.0, 0.3, (points, 3))
        found.append(_matters(False, axes, values)["a"].low > 0)
    assert np.mean(found) < 0.05


def test_of_points_drawn_at_random_the_interval_covers_other_draws():
    """Of 200 sweeps of 40 points and 5 seeds; the share that is true is that of 100,000 points."""
    rng = np.random.default_rng(8)

    def drawn(points):
        x = rng.random((points, 2))
        return find_levels(x[:, 0]).index, (np.sin(3 * x[:, 0]) + x[:, 1])[:, None] + 0.2 * rng.normal(size=(points, 5))

    true = importance(*drawn(100_000), drawn=True).mean()
    found = [importance_of_drawn(*drawn(40)) for _ in range(200)]
    assert np.mean([each.low <= true <= each.high for each in found]) == pytest.approx(0.95, abs=0.035)
    assert np.mean([each.high - each.low for each in found]) < 0.8
    assert importance_of_drawn(*drawn(2)) == (0.0, -1.0, 1.0)


def summary_of(success, seeds):
    """A sweep over two parameters, from its success by epsilon, rate and seed."""
    shape = *success.shape[:2], seeds
    epsilon, rate, seed = (x.ravel() for x in np.indices(shape))
    values = np.broadcast_to(success, shape).ravel()
    found = {
        "point": epsilon * shape[1] + rate,
        "seed": seed,
        "learner.epsilon": epsilon / 10,
        "learner.rate": rate * 1.0,
    }
    zeros = dict.fromkeys(
        ("greedy_steps", "greedy_return", "steps", "return", "success", "whole_steps"), np.zeros(len(seed))
    )
    return found | zeros | {"greedy_success": values, "diverged": np.zeros(len(seed), bool)}


def told(success, seeds):
    summary, axes = summary_of(success, seeds), ["learner.epsilon", "learner.rate"]
    return in_words(axes, ranked(axes, summary, quickest=True), compared("grid", axes, summary, quickest=True))


def test_a_sweep_says_what_it_found_or_that_it_cannot_tell():
    rng = np.random.default_rng(5)
    rates = np.array([0.1, 0.5, 0.9])[None, :, None] + rng.normal(0.0, 0.01, (4, 3, 5))
    words = told(rates, 5)
    assert (
        words.startswith("best: epsilon 0.")
        and "; 4 of 12 points, itself among them, are not told apart from it by success of greedy" in words
        and "rate 2 (at the end of the values tried: " in words
        and "rate); 4" in words
    )
    assert words.endswith(": for success of greedy episodes rate (100%).")
    chance = told(rng.normal(0.5, 0.1, (4, 3, 5)), 5)
    assert chance.startswith("cannot tell with 5 seeds which of the 12 points is best;")
    assert chance.endswith("cannot tell with 5 seeds which parameter matters.")
    assert "cannot tell with 1 seed which of the 12 points" in told(rates[..., :1], 1)


def test_a_sweep_in_which_no_episode_ended_is_judged_by_greedy_episodes():
    summary, axes = summary_of(np.ones((2, 2, 3)), 3), ["learner.epsilon", "learner.rate"]
    found = compared("grid", axes, summary | {"whole_steps": np.full(12, np.nan)}, quickest=True)
    assert found.learning.measure == "" and found.policy.as_good == {0, 1, 2, 3}
    assert in_words(axes, ranked(axes, summary, quickest=True), found).startswith(
        "cannot tell with 3 seeds which of the 4"
    )


@pytest.mark.parametrize(
    ("slower", "words"),
    [(1.0, "and it is the best of these by steps over"), (0.0, "and 4 of these are as good by steps over")],
)
def test_of_policies_alike_the_one_that_learned_sooner_is_best(slower, words):
    rng, axes = np.random.default_rng(5), ["learner.epsilon", "learner.rate"]
    summary = summary_of(np.tile(np.array([0.1, 0.5, 0.9])[None, :, None], (4, 1, 5)), 5)
    summary["whole_steps"] = 50.0 + slower * summary["point"] + rng.normal(0.0, 0.01, 60)
    found = compared("grid", axes, summary, quickest=True)
    assert f"from it by success of greedy episodes, {words} all of training." in in_words(
        axes, ranked(axes, summary, quickest=True), found
    )


def test_no_point_that_learned_sooner_than_the_first_is_called_slower():
    """The first succeeds most often, which its seeds cannot tell, and learned neither first nor last."""
    axes, (steps, noise) = ["learner.epsilon"], (np.array([83.0, 54.0, 75.0, 95.0]), np.array([-1.0, 0.0, 1.0, 0.5]))
    summary = summary_of(np.array([[1.0] * 4, [1, 0, 1, 1], [1, 1, 0, 1], [1, 1, 1, 0]]).reshape(4, 1, 4), 4)
    summary["whole_steps"] = (steps[:, None] + noise).ravel()
    found, points = compared("grid", axes, summary, quickest=True), ranked(axes, summary, quickest=True)
    assert points[0].point == 0 and found.policy.as_good == {0, 1, 2, 3}
    said = {int(row[0]): row[-1] for row in best_table(axes, summary, points, True, found)[1]}
    assert said == {0: "yes", 1: "yes", 2: "yes", 3: "slower, +12 to +12"}
    assert "3 of these are as good by steps over all of training" in in_words(axes, points, found)


def test_a_sweep_that_is_not_over_compares_what_is():
    """Of four points one lacks a seed; of another sweep no point has all of them."""
    rng = np.random.default_rng(6)
    rates = np.array([[0.1], [0.5], [0.9], [0.95]])[:, :, None] + rng.normal(0.0, 0.01, (4, 1, 5))
    whole, axes = summary_of(rates, 5), ["learner.epsilon", "learner.rate"]
    for kept, rows in ((whole["point"] != 1) | (whole["seed"] < 4), 4), (whole["seed"] == whole["point"], 4):
        part = {name: values[kept] for name, values in whole.items()}
        found, points = compared("grid", axes, part, quickest=True), ranked(axes, part, quickest=True)
        table = best_table(axes, part, points, True, found)[1]
        assert len(table) == rows and "nan" not in str(table) and "nan" not in in_words(axes, points, found)
        assert 1 not in found.policy.as_good and found.complete in (0, 3)


def test_a_seed_that_is_missing_leaves_no_interval():
    """In its place the least and the greatest of the others would seem known."""
    one, other = np.array([1.0, np.nan, 3.0, 4.0, 5.0, 6.0]), np.zeros(6)
    assert np.isnan(difference(one, other)).all()
    low, high = interval(np.stack([one, other], axis=1))
    assert np.isnan(low).tolist() == np.isnan(high).tolist() == [True, False]
