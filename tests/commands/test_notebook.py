"""Runs in programs and notebooks: what they read, evaluate, plot and play, and what a notebook shows of it."""

import io
import re

import pytest
from rich.console import Console
from small_sweep import CONFIG

import humanoid_mjx
from humanoid_mjx import InputError
from humanoid_mjx.evaluation.policy import find_policy
from humanoid_mjx.training import progress


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return humanoid_mjx.sweep(CONFIG, tmp_path_factory.mktemp("notebook") / "small")


def test_a_run_is_read_and_shows_its_best_points(run):
    loaded = humanoid_mjx.load_run(str(run.path))
    points = loaded.points()
    assert len(points) == 6 and points[0] == loaded.best
    rows = loaded.summary["point"] == loaded.best["point"]
    for key in ("learner.epsilon", "learner.learning_rate"):
        assert set(loaded.summary[key][rows]) == {loaded.best[key]}
    assert loaded.best["greedy_success"] == pytest.approx(loaded.summary["greedy_success"][rows].mean())
    assert "tabular_q on joint_reach, swept over learner.epsilon, learner.learning_rate, 3 seeds" in str(loaded)
    shown = loaded._repr_html_()
    assert shown.count("<tr>") == 1 + 6 and "<th>learner.epsilon</th>" in shown
    with pytest.raises(InputError, match="this is no run folder"):
        humanoid_mjx.load_run(run.path.parent)


def test_runs_and_policies_are_evaluated(run):
    by_run, by_path, by_policy = (
        humanoid_mjx.evaluate(what, episodes=8) for what in (run, str(run.path), find_policy(str(run.path)))
    )
    assert set(by_run) == {"greedy", "zero", "random"} and by_run == by_path == by_policy
    assert by_run["greedy"].success.value == 1.0
    with pytest.raises(InputError, match="neither a run folder nor a policy"):
        humanoid_mjx.evaluate("nowhere")


@pytest.mark.parametrize(("place", "shown"), [("terminal", True), ("notebook", True), ("pipe", False)])
def test_a_sweep_shows_its_progress_where_somebody_looks(place, shown, tmp_path, monkeypatch):
    out = io.StringIO()
    kind = {"terminal": {"force_terminal": True}, "notebook": {"force_jupyter": True}, "pipe": {}}[place]
    monkeypatch.setattr(progress, "PatientConsole", lambda **given: Console(file=out, **kind, **given))
    # In a notebook rich displays what it prints.
    displayed = []
    monkeypatch.setattr("rich.jupyter.display", lambda segments, text: displayed.append(text))
    for quiet in (True, False):
        humanoid_mjx.sweep(CONFIG | {"seeds": 1, "sweep": None}, tmp_path / f"run{quiet}", quiet=quiet)
        said = out.getvalue() + "".join(displayed)
        assert bool(re.search("train side by side", said)) == (shown and not quiet)
