"""Statistics against plain definitions; figures drawn from tables of every shape."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import trim_mean

from humanoid_mjx.report.figures import find_levels, sweep_figures
from humanoid_mjx.runs.statistics import iqm, iqm_interval, rate_interval


@given(st.integers(1, 12), st.integers(0, 1000))
def test_interquartile_mean_of_a_multiple_of_four_is_the_trimmed_mean(quarter, seed):
    values = np.random.default_rng(seed).normal(size=(4 * quarter, 3))
    np.testing.assert_allclose(iqm(values), trim_mean(values, 0.25), rtol=1e-12, atol=1e-12)


@given(st.integers(1, 40), st.integers(0, 1000))
def test_interquartile_mean_is_that_of_the_values_repeated_four_times(n, seed):
    values = np.random.default_rng(seed).normal(size=n)
    np.testing.assert_allclose(iqm(values), trim_mean(np.repeat(values, 4), 0.25), rtol=1e-10, atol=1e-10)


def test_bootstrap_interval_covers_the_truth_as_often_as_it_says():
    rng = np.random.default_rng(0)
    covered = []
    for trial in range(300):
        low, high = iqm_interval(rng.normal(size=30), seed=trial)
        covered.append(low <= 0 <= high)
    # 300 trials of a 95 % interval: the percentile bootstrap is a little narrow at 30 values, four sigma are 5 %.
    assert 0.88 < np.mean(covered) < 0.99


def test_interval_of_a_probability_covers_the_truth_as_often_as_it_says():
    rng = np.random.default_rng(0)
    intervals = [rate_interval(rng.uniform(size=40) < 0.1) for _ in range(500)]
    # The binomial is coarse at 40 trials: its coverage by Wilson's interval is 0.94 there, four sigma are 4 %.
    assert 0.90 < np.mean([low <= 0.1 <= high for low, high in intervals]) < 0.98
    for certain in (np.ones(20, bool), np.zeros(20, bool)):
        low, high = rate_interval(certain)
        assert 0.0 <= low < high <= 1.0


def test_resampling_in_parts_changes_little(monkeypatch):
    values = np.random.default_rng(0).normal(size=(50, 2))
    whole = iqm_interval(values)
    monkeypatch.setattr("humanoid_mjx.runs.statistics.RESAMPLED_NUMBERS", 1000)
    # 500 resamples, other ones: an end of the interval has an error of about a tenth of its width.
    np.testing.assert_allclose(iqm_interval(values), whole, atol=0.2 * np.ptp(whole, axis=0).max())


def test_many_values_of_an_axis_are_put_into_bins():
    values = np.random.default_rng(1).uniform(size=500)
    levels = find_levels(values)
    assert len(levels.labels) == 5
    assert np.bincount(levels.index).tolist() == [100] * 5
    assert find_levels(np.array(["b", "a", "b"])).index.tolist() == [1, 0, 1]


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
    paths = sweep_figures(tmp_path, "title", axes, results, summary)
    expected = ["learning_curves"] + ["greedy_steps"] * (len(axes) > 1)
    assert [path.stem for path in paths] == expected, "greedy_success is 1 everywhere, which is no heat map"
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)
