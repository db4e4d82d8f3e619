"""The benchmarks run, and their subjects do the same work."""

import json
import os
import subprocess
import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import ground_physics as ground
import leg_physics
import numpy as np
import opponents
import other_tables
import publish
import pytest
import results as compare
import startup
import tabular
import trainings as training
from publish import Row, Worker
from timing import Subject, joined, spread, time_in_turn, time_rates
from typer.testing import CliRunner

from humanoid_mjx import InputError, compute
from humanoid_mjx.cli import app
from humanoid_mjx.commands.bench import BENCHES
from humanoid_mjx.compute import provenance
from humanoid_mjx.training.sweep import Run


def test_a_row_that_fails_is_written_as_such_and_the_rest_goes_on(tmp_path, monkeypatch):
    there = [
        Row("physics", "raises", 1, json.loads, ("}",)),
        Row("physics", "dies", 1, os._exit, (3,)),
        Row("physics", "nowhere", 1, print, (), "no_such_package"),
        Row("tabular", "python", 1, publish.tables_row, ("python", 1)),
        Row("training", "not chosen", 1, print),
    ]
    monkeypatch.setattr(publish, "rows", lambda backend: there)
    found = publish.publish(["physics", "tabular"], tmp_path, "the command")
    written = json.loads((tmp_path / "speed_cpu.json").read_text())
    assert written["records"] == found["records"] and written["command"] == "the command"
    assert [(row["subject"], row["unit"]) for row in found["records"]] == [
        ("python", "steps/s"),
        ("python", "episodes/s"),
    ]
    why = {row["subject"]: row["why"] for row in written["failed"]}
    assert list(why) == ["raises", "dies", "nowhere"] and "JSONDecodeError" in why["raises"]
    assert why["dies"] == "its process died with code 3" and why["nowhere"] == "no_such_package is not installed"
    assert compare.read_result(tmp_path / "speed_cpu.json")["commit"] == compute.commit()


def test_no_row_starts_after_the_limit_and_one_that_is_late_is_ended(monkeypatch):
    monkeypatch.setattr(publish, "rows", lambda backend: [Row("physics", "late", 1, print)])
    assert [row["why"] for row in publish.publish(limit=-1.0)["failed"]] == ["not begun within -1 s"]
    worker = Worker("own")
    with pytest.raises(RuntimeError, match="took longer than 0 s"):
        worker.ask(0.01, time.sleep, 1e6)
    assert not worker.alive


@pytest.mark.parametrize("backend", ["cpu", "gpu"])
def test_rows_have_names_of_their_own_and_all_benchmarks(backend):
    rows = publish.rows(backend)
    assert len(set(map(str, rows))) == len(rows) and {row.bench for row in rows} == set(BENCHES)
    assert all(row.process == "own" for row in rows) == (backend == "gpu")


def test_robots_are_thrown_about_as_native_mujoco_moves_them():
    states = ground.states_of(4, True, "dog")
    assert [part.shape for part in states] == [(4, 19), (4, 18), (4, 12)] and np.ptp(states[0], axis=0).min() > 0.0
    scene = ground.contacts("dog")
    assert 0.0 < scene["contacts"] < scene["most contacts"] and scene["solver iterations"] > 0.0
    ours = joined(ground.compiled("tree", states, 5, "dog")())[0]
    np.testing.assert_allclose(ours, opponents.native(states, 5, "dog")(), atol=1e-4)


def test_the_leg_is_timed_in_the_air():
    found = [publish.legs_row(name, 1)[0] for name in ("chain", "mujoco")]
    assert [(row.subject, row.unit) for row in found] == [
        ("legs chain", "control+physics steps/s"), ("legs mujoco", "physics steps/s")
    ]  # fmt: skip
    bare = leg_physics.chain(1, 100, controlled=False)
    after = opponents.mujoco(1, 100)()
    np.testing.assert_allclose(joined(bare())[0], after[:, :5], atol=1e-3)


def test_subjects_finish_as_many_episodes(monkeypatch):
    steps = 40_000
    monkeypatch.setattr(other_tables, "PYTHON_STEPS", steps)
    finished = {}
    for name in ("scan", "naive_scan", "python"):
        make = tabular.scan if name == "scan" else getattr(other_tables, name)
        made = make(np.full(2, 0.5, np.float32), steps)
        finished[name] = made.episodes(made.call()) / (1 if name == "python" else 2)
    # Episodes take 23 steps once epsilon has decayed, after some thousand: 1,500 of 40,000 steps.
    assert all(abs(n / finished["python"] - 1) < 0.03 for n in finished.values()), finished


def stored(*success):
    """A run folder of two seeds side by side, four record points each, the first two passed at the first look."""
    held = {
        "config": SimpleNamespace(episodes=None, total_steps=4000, seeds=2),
        "timing": {"wall_s": np.array([5.0, 5.0, 7.0, 9.0] * 2, np.float32)},
        "results": {"steps": np.array([20.0, np.nan, 30.0, 40.0, 20.0, 30.0, np.nan, 40.0])},
        "summary": {"greedy_success": np.array([0.9, 0.97])},
    }
    held["results"] |= {"greedy_success": np.array(success)} if success else {}
    return type("Stored", (Run,), held)(Path())


def test_rates_leave_compiling_out_and_time_to_success_does_not():
    found = training.measure(stored(np.nan, 0.5, 0.96, 0.9, np.nan, 0.5, 0.9, 0.97))
    assert found[:2] == pytest.approx((2 * 2000 / 4.0, 1000 / 30.0)) and found.seconds == 9.0
    assert found.steps.tolist() == [3000.0, 4000.0] and found.final.tolist() == [0.9, 0.97]


def test_a_single_evaluation_is_that_of_the_end():
    """As with `learner.evaluations=1`: nobody looked before."""
    np.testing.assert_array_equal(training.measure(stored()).steps, [np.nan, 4000.0])


def test_a_seed_that_never_succeeds_is_not_left_out():
    found = training.measure(stored(np.nan, 0.5, 0.96, 0.9, np.nan, 0.5, 0.9, 0.94))
    by_unit = {figure["unit"]: figure for figure in training.figures(found)}
    assert by_unit["steps to 95 %"]["by_seed"] == [3000.0, None]
    assert by_unit["steps to 95 %"]["value"] == np.inf and np.isnan(by_unit["s to 95 %"]["value"])
    assert "at worst never, not every seed" in training.in_words(found)


def test_training_writes_records_and_skips_what_is_not_there():
    lines = []
    tiny = ["total_steps=4096", "record=4", "learner.evaluation_envs=2", "learner.envs=16", "learner.evaluations=2"]
    records = training.run(lines.append, ["leg_reach", "nowhere"], tiny, seeds=2)
    assert lines[1] == "nowhere: does not ship"
    assert {r.subject for r in records} == {"leg_reach"} and {r.batch for r in records} == {16}
    assert {r.unit for r in records} == {"steps/s", "episodes/s", "success at the end"}
    assert all(r.compile_s > 0 and r.repeats == 2 for r in records)
    assert len(records[-1].as_json()["by_seed"]) == 2
    assert "by_seed" not in records[0].as_json()


def test_the_commit_is_that_of_the_checkout_and_none_outside_one(tmp_path, monkeypatch):
    def git(*arguments: str) -> str:
        who = ("-c", "user.name=a", "-c", "user.email=a@b.c")
        return subprocess.run(("git", "-C", tmp_path, *who, *arguments), capture_output=True, text=True).stdout.strip()

    module = tmp_path / "package" / "compute" / "provenance.py"
    module.parent.mkdir(parents=True)
    module.write_text("")
    monkeypatch.setattr(provenance, "__file__", str(module))
    assert compute.commit() is None
    git("init")
    git("add", ".")
    git("commit", "-m", "first")
    assert compute.commit() == git("rev-parse", "HEAD") != ""
    module.write_text("changed")
    assert compute.commit() == git("rev-parse", "HEAD") + "-dirty"


def test_the_spread_is_the_range_of_the_middle_half():
    assert spread([1.0]) is None
    assert spread([2.0, 2.0, 2.0]) == 0.0
    assert spread([1.0, 2.0, 3.0, 4.0, 5.0]) == pytest.approx(2.0 / 3.0, abs=1e-4)
    timings = time_in_turn({"once": Subject(lambda: 0, 1, 1, repeats=1), "often": Subject(lambda: 0, 1, 1, repeats=5)})
    assert timings["once"].spread is None and timings["often"].spread >= 0.0


def test_a_simulation_that_ran_away_is_refused():
    subject = Subject(lambda: np.array([0.0, np.nan]), 1, 2, repeats=1)
    with pytest.raises(FloatingPointError, match="tree: the simulation diverged"):
        time_rates("b", {"tree": subject}, lambda line: None, "bodies")


def result(**values):
    """A result of made-up records: subject = (value, spread) or (value, spread, unit)."""
    records = [
        {"bench": "b", "subject": name, "device": "cpu", "batch": 8, "value": x[0], "unit": (*x, "steps/s")[2]}
        | ({} if x[1] is None else {"spread": x[1]})
        for name, x in values.items()
    ]
    return {"machine": {"cpu": "one"}, "versions": {"jax": "1"}, "records": records}


@pytest.mark.parametrize(
    ("before", "after", "regressed"),
    [
        ((100.0, 0.0), (96.0, 0.0), False),  # the least noise is 5 %
        ((100.0, 0.0), (94.0, 0.0), True),
        ((100.0, 0.3), (61.0, 0.4), False),  # both spreads: half
        ((100.0, 0.3), (49.0, 0.4), True),
        ((100.0, None), (81.0, 0.0), False),
        ((100.0, None), (79.0, 0.0), True),
        ((10.0, 0.0, "s to 95 %"), (11.0, 0.0, "s to 95 %"), True),  # seconds are better the fewer they are
        ((1e6, 0.0, "steps to 95 %"), (2e6, 0.0, "steps to 95 %"), True),  # and so are steps
        ((0.5, 0.0, "success at the end"), (0.0, None, "success at the end"), True),
    ],
)
def test_a_figure_regressed_where_it_is_worse_by_more_than_the_noise(before, after, regressed):
    (change,) = compare.changes(result(one=before), result(one=after))
    assert change.regressed == regressed


def test_results_that_differ_are_compared_where_they_agree(tmp_path, monkeypatch):
    before, after = result(one=(100.0, 0.0), two=(5.0, 0.0)), result(three=(1.0, 0.0), one=(50.0, 0.0))
    after["machine"]["cpu"] = "another"
    for name, content in (("a", before), ("b", after), ("c", result(four=(1.0, 0.0)))):
        (tmp_path / f"{name}.json").write_text(json.dumps(content))
    (tmp_path / "odd.json").write_text('{"records": [{"bench": "b"}]}')
    monkeypatch.chdir(tmp_path)
    bench = partial(CliRunner().invoke, app)
    done = bench(["bench", "compare", "a.json", "b.json"])
    assert done.exit_code == 1 and "SLOWER" in done.output and "1 of 1 figures became worse" in done.output
    assert "cpu was one, is another" in done.output and "1 of the first result's figures" in done.output
    done = bench(["bench", "compare", "b.json", "a.json"])
    assert done.exit_code == 0 and "SLOWER" not in done.output and "None of 1 figures" in done.output
    for files, why in (
        (["a.json"], "give two files"),
        (["a.json", "c.json"], "no figure in common"),
        (["a.json", "nowhere.json"], "nowhere.json: not a result"),
        (["odd.json", "a.json"], "odd.json: not a result"),
    ):
        assert why in str(bench(["bench", "compare", *files]).exception)


def test_startup_is_measured_with_nothing_compiled_and_again():
    lines = []
    records = startup.run(lines.append, ("joint1",), ("seeds=1",), repeats=1)
    values = {(r.subject, r.unit): r.value for r in records}
    assert len(values) == len(records) and len(lines) == 2
    for kind in ("joint1 cold", "joint1 warm"):
        found = {unit: value for (subject, unit), value in values.items() if subject == kind}
        assert found["s to training"] > 0.0 and found["processor s to training"] > 0.0
        shares = [value for unit, value in found.items() if unit.startswith("share of ")]
        assert sum(shares) == pytest.approx(1.0, abs=1e-3) and min(shares) >= 0.0
        assert ("share of tracing" in found) == (kind == "joint1 cold")
    with pytest.raises(InputError, match=r"did not come to training: error: .*learner\.nothing"):
        startup.run(lines.append, ("joint1",), ("learner.nothing=1",), repeats=1)
