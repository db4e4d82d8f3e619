"""Statistics against plain definitions; figures drawn from tables of every shape."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest, trim_mean
from scipy.stats.mstats import trimmed_mean_ci
from small_sweep import of_rows

from humanoid_mjx.report.drawing import CURVES, HEAT_MAPS, TERMS
from humanoid_mjx.report.figures import curved, learning_curves, sweep_figures
from humanoid_mjx.runs import ranking
from humanoid_mjx.runs.ranking import best_table, by_point, compared, find_levels, ranked
from humanoid_mjx.runs.statistics import iqm, iqm_interval, mean_interval, rate_interval
from humanoid_mjx.runs.tables import scores


@given(st.integers(1, 40), st.integers(0, 1000))
def test_interquartile_mean_is_that_of_the_values_repeated_four_times(n, seed):
    values = np.random.default_rng(seed).normal(size=n)
    np.testing.assert_allclose(iqm(values), trim_mean(np.repeat(values, 4), 0.25), rtol=1e-10, atol=1e-10)


def test_the_interval_of_an_interquartile_mean_covers_the_truth_as_often_as_it_says():
    ends = (iqm_interval(np.random.default_rng(trial).normal(size=100)) for trial in range(1000))
    # Four sigma of 1,000 trials are 3 %.
    assert 0.92 < np.mean([low <= 0 <= high for low, high in ends]) < 0.98


@given(st.integers(4, 40), st.integers(0, 1000))
def test_the_interval_of_an_interquartile_mean_is_that_of_scipys_trimmed_mean(quarters, seed):
    values = np.random.default_rng(seed).exponential(size=4 * (quarters // 4))
    np.testing.assert_allclose(iqm_interval(values), trimmed_mean_ci(values, (0.25, 0.25)), rtol=1e-9, atol=1e-12)


@given(st.integers(1, 40), st.integers(0, 40))
def test_interval_of_a_probability_is_wilsons(n, successes):
    share = np.arange(n) < successes
    expected = binomtest(int(share.sum()), n).proportion_ci(0.95, method="wilson")
    np.testing.assert_allclose(rate_interval(share), expected, atol=1e-12)


def test_interval_of_a_mean_leaves_out_what_is_not_known():
    values = np.random.default_rng(0).normal(size=(400, 3))
    values[100:, 1] = values[1:, 2] = np.nan
    low, high = mean_interval(values)
    for column, n in ((0, 400), (1, 100)):
        known = values[:n, column]
        error = known.std() / n**0.5
        ends = known.mean() + np.array([-1.96, 1.96]) * error
        np.testing.assert_allclose([low[column], high[column]], ends, atol=0.05 * error)  # Student's is 1.984 of 100
    assert np.isnan([low[2], high[2]]).all()


def test_many_values_of_an_axis_are_put_into_bins():
    values = np.random.default_rng(1).uniform(size=500)
    levels = find_levels(values)
    assert len(levels.labels) == 5
    assert np.bincount(levels.index).tolist() == [100] * 5
    assert find_levels(np.array(["b", "a", "b"])).index.tolist() == [1, 0, 1]


def test_points_are_ranked_by_success_then_speed_then_learning():
    summary = {
        "point": np.array([2, 2, 0, 0, 1, 1, 3, 3]),
        "learner.epsilon": np.array([0.2, 0.2, 0.0, 0.0, 0.1, 0.1, 0.3, 0.3]),
        "greedy_success": np.array([0.9994, 1.0, 1.0, 1.0, 0.5, 1.0, 1.0, 1.0]),
        "greedy_steps": np.array([9.0, 9.0, 9.0, 9.0, 1.0, 1.0, np.nan, np.nan]),
        "greedy_return": np.zeros(8),
        "whole_steps": np.array([20.0, 30.0, 30.0, 40.0, 1.0, 1.0, 1.0, 1.0]),
    }
    points = ranked(["learner.epsilon"], summary, quickest=True)
    assert [point.point for point in points] == [2, 0, 3, 1]
    # Success counts by thousandths.
    assert (points[0].values, points[0].success, points[0].greedy_steps, points[0].whole) == ((0.2,), 0.9997, 9.0, 25.0)
    by_return = summary | {"greedy_return": np.array([1.0, 1.0, 1.0, 1.0, 9.0, 9.0, 3.0, 3.0])}
    points = ranked([], by_return, quickest=False)
    assert [point.point for point in points] == [3, 0, 2, 1]


@pytest.mark.parametrize(
    ("quickest", "columns", "order"),
    [
        (True, {"whole_steps": [3.0, 1.0, 2.0]}, [1, 2, 0]),
        (True, {"steps": [1.0, 2.0, 3.0], "whole_steps": [9.0, 2.0, 2.0]}, [1, 2, 0]),
        # A cart-pole that lasts longer is better: the steps at the end of training say nothing.
        (False, {"steps": [196.0, 200.0, 200.0], "return": [196.0, 199.0, 200.0]}, [2, 1, 0]),
        (False, {"whole_return": [1.0, 3.0, np.nan]}, [1, 0, 2]),
    ],
)
def test_training_tells_points_apart_that_act_equally_well(quickest, columns, order):
    equal = {"greedy_success": np.ones(3), "greedy_steps": np.full(3, 200.0), "greedy_return": np.full(3, 200.0)}
    same = {name: np.full(3, 5.0) for name in ("steps", "return", "success")}
    columns = {name: np.array(values) for name, values in columns.items()}
    points = ranked([], {"point": np.arange(3)} | equal | same | columns, quickest)
    assert [point.point for point in points] == order


def test_the_table_of_the_best_points_says_where_another_is_worse():
    """By what it has learned, or only by how it learned."""
    wholes, greedy = np.array([40.0, 50.0, 30.0]), np.array([9.0, 9.0, 12.0])
    summary = {"point": np.repeat(np.arange(3), 8), "seed": np.tile(np.arange(8), 3)}
    summary |= {"learner.epsilon": np.repeat([0.1, 0.2, 0.3], 8), "diverged": np.arange(24) == 8}
    noise = np.random.default_rng(0).normal(0.0, 0.1, 24)
    summary |= {"greedy_success": np.ones(24), "greedy_steps": np.repeat(greedy, 8), "greedy_return": np.zeros(24)}
    summary |= {"whole_steps": np.repeat(wholes, 8) + noise, "steps": np.zeros(24)}
    axes = ["learner.epsilon"]

    def table(summary):
        told = compared("grid", axes, summary, quickest=True)
        return best_table(axes, summary, ranked(axes, summary, quickest=True), True, told)

    headings, rows = table(summary)
    whole = "steps over all of training (95\u00a0%)"
    assert headings == ["point", *axes, "greedy success", "greedy steps", whole, "diverged", "as good"]
    assert [row[:4] for row in rows] == [
        ["0", "0.1", "100.0%", "9.0"],
        ["1", "0.2", "100.0%", "9.0"],
        ["2", "0.3", "100.0%", "12.0"],
    ]
    assert [row[5] for row in rows] == ["0 of 8", "1 of 8", "0 of 8"] and rows[0][4].startswith("40.0")
    assert rows[0][6] == "yes" and rows[1][6].startswith("slower, +9.") and rows[2][6] == "no, +3 to +3"
    many = {name: np.repeat(values, 4) for name, values in summary.items()}
    assert len(table(many | {"point": np.tile(np.arange(12), 8), "seed": np.repeat(np.arange(8), 12)})[1]) == 12


def test_the_summary_has_the_end_of_a_curve_and_the_whole_of_it():
    unknown = [np.nan] * 20
    curves = {"steps": [[10.0] * 18 + [1.0, 3.0], unknown, [*unknown[1:], 4.0]], "slip": [[1.0, 2.0, 3.0]] * 3}
    found = scores({f"curve.{name}": np.array(curve) for name, curve in curves.items()})
    np.testing.assert_allclose(found["steps"], [2.0, np.nan, 4.0])
    np.testing.assert_allclose(found["whole_steps"], [9.2, np.nan, 4.0], rtol=1e-6)
    assert set(found) == {"steps", "whole_steps", "slip"} and (found["slip"] == 3.0).all()


@pytest.mark.parametrize("axes", [[], ["learner.epsilon"], ["learner.epsilon", "task.rules", "learner.discount"]])
@pytest.mark.parametrize("seeds", [1, 5])
def test_figures_of_every_number_of_axes(tmp_path, axes, seeds):
    rng = np.random.default_rng(2)
    points, record = 8, 6
    columns = {
        "learner.epsilon": np.repeat([0.1, 0.5], 4),
        "task.rules": np.array(["printed", "standard"] * 4, object),
        "learner.discount": np.tile([0.5, 0.5, 0.9, 0.9], 2),
    }
    rows = [(p, s, e) for p in range(points) for s in range(seeds) for e in range(record)]
    p, s, e = np.array(rows).T
    results = {"point": p, "seed": s, "episode": (e + 1) * 10} | {name: columns[name][p] for name in axes}
    results |= {"steps": rng.uniform(10, 20, len(p)), "success": np.where(e == 0, np.nan, 1.0)}
    first = e == 0
    summary = {name: values[first] for name, values in results.items()}
    summary |= {"greedy_success": np.ones(first.sum()), "greedy_steps": rng.uniform(5, 9, first.sum())}
    told = {"order": range(points), "finals": lambda name: by_point(summary, name)[1] if name in summary else None}
    told["compared"] = compared("grid", axes, summary, quickest=True)
    learned = dataclasses.replace(of_rows(results, axes), **told)
    paths = sweep_figures(tmp_path, "title", learned)
    greedy = [HEAT_MAPS["greedy_steps"]] * bool(axes)
    assert [each.title for each in curved(learned)] == [CURVES["steps"], *greedy]
    terms = results | {"alive": results["steps"] / 2, "calm": -results["steps"], "td_error": 1.0 / results["episode"]}
    learned = of_rows(terms, axes)
    assert [each.title for each in curved(learned)] == [CURVES["steps"], CURVES["td_error"], TERMS]
    learning_curves(tmp_path / "terms.png", "title", learned)
    # The greedy success is 1 everywhere: no map is drawn of what is the same everywhere.
    assert [path.name for path in paths[1:]] == (["parameters.png", "greedy_steps.png"] if len(axes) > 1 else [])
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)


def test_runs_that_learned_to_end_early_are_told_which_penalty_to_halve(monkeypatch):
    """Of each run the first and the last point of the curve: the first one falls early, the others go on, one of them
    with shorter episodes that succeed; points without an episode say nothing."""
    columns = {
        "point": [0, 0, 0, 0, 0, 0, 0, 1, 1],
        "seed": [0, 0, 0, 1, 1, 2, 2, 0, 0],
        "steps": [60.0, np.nan, 10.0, 60.0, 900.0, 60.0, 10.0, 60.0, 10.0],
        "return": [-120.0, np.nan, 5.0, -120.0, 40.0, -120.0, 3.0, 6.0, 5.0],
        "success": [0.0, np.nan, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0],
        "slip": [-132.0, np.nan, -2.0, -132.0, -20.0, -132.0, -2.0, -1.0, -2.0],
        "effort": [-6.0, np.nan, -1.0, -6.0, -2.0, -6.0, -1.0, -1.0, -1.0],
    }
    table = {name: np.array(column) for name, column in columns.items()}
    weights = {"task.rewards.slip": -2.4, "task.rewards.effort": -0.006, "task.rewards.speed": 0.6}
    ends = {name: column[[2, 4, 6, 8]] for name, column in table.items()}
    summary = ends | {name: np.full(4, weight) for name, weight in weights.items()}
    monkeypatch.setattr(ranking, "read_table", lambda path, names: {name: table[name] for name in names})
    assert ranking.fallen_in_words(Path(), summary) == (
        "1 of 4 runs learned to end their episodes early: at first a step brought -2, of which slip -2.2. With half "
        "the penalty it may pay to go on: --set task.rewards.slip=-1.2"
    )
    table["steps"][2] = 40.0
    assert "1 of 4 runs" in ranking.fallen_in_words(Path(), summary), "two thirds of the first length"
    table["return"][0] = 1.0
    assert ranking.fallen_in_words(Path(), summary) == ""
    assert ranking.fallen_in_words(Path(), ends) == "", "a task without weights"
    table["steps"][:] = np.nan
    assert ranking.fallen_in_words(Path(), summary) == "", "no episode ended"
