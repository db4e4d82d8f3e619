"""Figures of one's own: what is drawn is what the tables hold; what cannot be drawn gets a sentence."""

from contextlib import contextmanager
from itertools import pairwise

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import small_sweep
from command_line import told

from humanoid_mjx import InputError, sweep
from humanoid_mjx.report import plotting, style
from humanoid_mjx.report.plotting import plot
from humanoid_mjx.runs.statistics import interval

AXES = {"learner.epsilon": [0.1, 0.5, 0.9], "learner.learning_rate": {"logspace": [0.01, 1.0, 3]}}
CONFIG = small_sweep.CONFIG | {"sweep": {"axes": AXES}, "seeds": 5, "episodes": 40, "record": 8}


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    return sweep(CONFIG, tmp_path_factory.mktemp("plot") / "small")


@pytest.fixture(scope="module")
def other(small):
    changed = CONFIG | {"seeds": 3, "episodes": 30, "record": 6, "sweep": {"axes": {"task.rules": ["standard"]}}}
    return sweep(changed, small.path.parent / "other")


@pytest.fixture
def panels(monkeypatch):
    """The panel of each figure, as it is when it is saved."""
    found = []

    @contextmanager
    def kept(*args, **kwargs):
        with style.figure(*args, **kwargs) as (fig, axes):
            yield fig, axes
            fig.canvas.draw()
            found.append(axes[0, 0])

    monkeypatch.setattr(plotting, "figure", kept)
    return found


def labels(panel):
    return [text.get_text() for text in panel.get_legend().get_texts()]


def test_a_line_is_the_mean_over_seeds_of_what_the_table_holds(small, panels, tmp_path):
    plot([small.path], "episode", "steps", "learner.epsilon", tmp_path / "x.png")
    (panel,), results = panels, small.results
    assert len(panel.lines) == len(panel.collections) == 3
    ends = {}
    for epsilon, line, band in zip([0.1, 0.5, 0.9], panel.lines, panel.collections, strict=True):
        mine = np.isclose(results["learner.epsilon"], epsilon)
        value = lambda s, e: results["steps"][mine & (results["seed"] == s) & (results["episode"] == e)].mean()  # noqa: E731, B023
        by_seed = [[value(s, e) for e in range(5, 41, 5)] for s in range(5)]
        low, high = interval(np.array(by_seed))
        np.testing.assert_array_equal(line.get_xdata(), np.arange(5, 41, 5))
        np.testing.assert_allclose(line.get_ydata(), np.median(by_seed, axis=0), rtol=1e-6)
        inside = band.get_paths()[0].get_extents()
        np.testing.assert_allclose([inside.y0, inside.y1], [low.min(), high.max()], rtol=1e-6)
        ends[f"{epsilon:g}"] = line.get_ydata()[-1]
    assert labels(panel) == list(ends)
    assert panel.get_title(loc="left") == "learner.epsilon"
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("episodes", "steps per episode")


def test_final_values_over_a_parameter_that_is_spread_by_ratios(small, panels, tmp_path):
    plot([small.path], "learner.learning_rate", "greedy_success", "learner.epsilon", tmp_path / "x.png")
    (panel,), summary = panels, small.summary
    assert panel.get_xscale() == "log"
    ticks = [tick for tick in panel.get_xticklabels() if tick.get_text()]
    assert [tick.get_text() for tick in ticks] == ["0.01", "0.1", "1"]
    boxes = [tick.get_window_extent() for tick in ticks]
    assert all(a.x1 < b.x0 for a, b in pairwise(boxes))
    mine = np.isclose(summary["learner.epsilon"], 0.9) & np.isclose(summary["learner.learning_rate"], 1.0)
    assert panel.lines[2].get_ydata()[-1] == pytest.approx(np.median(summary["greedy_success"][mine].astype(float)))


def test_several_runs_are_told_apart(small, other, panels, tmp_path):
    plot([small.path, other.path], None, "return", None, tmp_path / "a.png")
    plot([small.path, other.path], None, "return", "learner.epsilon", tmp_path / "b.png")
    alone, both = panels
    assert sorted(labels(alone)) == ["other", "small"]
    by_run = {line.get_label(): line for line in alone.lines}
    assert by_run["other"].get_xdata()[-1] == 30 and by_run["small"].get_xdata()[-1] == 40
    results = other.results
    last = results["return"][results["episode"] == 30].astype(float)
    assert by_run["other"].get_ydata()[-1] == pytest.approx(np.median(last))
    assert "over 3 to 5 seeds" in alone.figure.get_suptitle()
    assert sorted(labels(both)) == ["0.1, small", "0.5, small", "0.6, other", "0.9, small"]
    assert both.lines[2].get_linestyle() != both.lines[0].get_linestyle()


def test_places_where_some_seeds_have_no_number_are_left_out_and_said(small, panels, tmp_path):
    table = pq.read_table(small.path / "summary.parquet")
    values = table["steps"].to_numpy().copy()
    values[np.isclose(table["learner.epsilon"].to_numpy(), 0.5) & (table["seed"].to_numpy() == 1)] = np.nan
    (tmp_path / "run").mkdir()
    for name in ("config.yaml", "results.parquet"):
        (tmp_path / "run" / name).write_bytes((small.path / name).read_bytes())
    changed = table.set_column(table.column_names.index("steps"), "steps", pa.array(values))
    pq.write_table(changed, tmp_path / "run/summary.parquet")
    _, notes = plot([tmp_path / "run"], "learner.epsilon", "steps", None, tmp_path / "x.png")
    apart = "One line for all values of learner.learning_rate; --by learner.learning_rate tells them apart."
    assert notes == ["Left out for want of a number of every seed: 1 place.", apart]
    np.testing.assert_allclose(panels[0].lines[0].get_xdata(), [0.1, 0.9], rtol=1e-6)


def test_what_cannot_be_drawn(small, tmp_path):
    run = small.path
    for words, given in {
        "did you mean 'learner.epsilon'": [run, "--x", "learner.epsilom"],
        "did you mean 'epsilon'. .*learner.epsilon, learner.learning_rate,": [run, "--by", "epsln"],
        "did you mean 'return'": [run, "--y", "retrun"],
        "at the end of training only": [run, "--y", "greedy_success"],
        "holds words": [run, "--y", "task.rules", "--x", "learner.epsilon"],
        "named twice": [run, run],
        "no run folder": [tmp_path],
        "end in .png": [run, "--out", "x.jpg"],
        "there is no folder": [run, "--out", tmp_path / "no" / "x.png"],
    }.items():
        with pytest.raises(InputError, match=words):
            told("plot", *given)


def test_the_command_draws_into_the_run_folder(small):
    output = told("plot", small.path, "--by", "learner.learning_rate")
    file = small.path / "figures/success_over_episode_by_learner_learning_rate.png"
    assert str(file) in output.replace("\n", "") and file.read_bytes().startswith(b"\x89PNG")
