"""The benchmarks run, and their subjects do the same work."""

import json
import subprocess
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import benches
import ground_physics as ground
import leg_physics as physics
import numpy as np
import other_tables
import pytest
import results as compare
import startup
import tabular
import trainings as training
from timing import Subject, spread, time_in_turn, time_rates
from typer.testing import CliRunner

from humanoid_mjx import InputError, compute
from humanoid_mjx.cli import app
from humanoid_mjx.commands.bench import BENCHES, measuring
from humanoid_mjx.compute import provenance
from humanoid_mjx.training.sweep import Run

TINY = """
import sys
sys.path.append("benchmarks")
import other_tables, tabular
other_tables.PYTHON_STEPS = 50
tabular.BATCHES, tabular.STEPS = {"cpu": (8,), "gpu": (8,)}, (50, 50)
from humanoid_mjx.cli import main
main()
"""
"""In a process of its own, where no type checker stands around what numba compiles."""


def test_tabular_writes_its_records(tmp_path):
    file = tmp_path / "bench.json"
    command = [sys.executable, "-c", TINY, "bench", "tabular", "--json", str(file)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    result = json.loads(file.read_text())
    assert set(result) == {"machine", "versions", "commit", "records"}
    assert {record["subject"] for record in result["records"]} >= {"scan", "naive_scan", "python"}
    keys = {"bench", "subject", "device", "batch", "value", "unit", "compile_s", "repeats", "spread", "commit"}
    for record in result["records"]:
        assert set(record) == keys
    assert max(map(len, done.stdout.splitlines())) <= 100


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


def test_control_times_every_controller():
    lines = []
    records = benches.control(lines.append, physics.Setting((1,), 2, 2))  # one leg is on one device, and compiled once
    assert [(r.bench, r.subject) for r in records] == [
        ("control", name) for name in (*physics.CONTROLLERS, "none mjx-jax", "computed torque mjx-jax")
    ]
    assert all(r.value > 0 for r in records)
    assert "ns a step for control" in lines[-1] and "ns a step" not in lines[0]


def test_the_leg_is_timed_in_every_physics():
    lines = []
    records = benches.legs(lines.append, physics.Setting((1,), 2, 2, 2))  # one leg is on one device
    control = {f"{name} control+physics steps/s" for name in ("chain", "mjx-jax", "mjx-jax plain")}
    physical = {f"{name} physics steps/s" for name in ("chain", "mjx-jax", "mujoco")}
    assert {f"{r.subject} {r.unit}" for r in records} == control | physical
    assert all(r.value > 0 for r in records) and "mjx-jax plain" in lines[-1]


def test_the_ground_writes_a_record_for_every_physics_and_batch(monkeypatch):
    lines = []
    steps = {"mjx-jax": 25, ground.COMPUTED_TORQUE: 25, "mjx-warp": 25, "mujoco": 2}
    monkeypatch.setattr(ground, "visited", ground.states_of)
    records = benches.bodies(lines.append, ground.Setting((1,), steps))
    subjects = ["mjx-jax ground", "mjx-jax computed torque ground", "mujoco ground"]
    subjects += ["mjx-jax ground moving", "mujoco ground moving"]
    assert [(r.subject, r.batch) for r in records] == [(name, 1) for name in subjects] and len(lines) == 5
    assert all(r.bench == "physics" and r.value > 0 for r in records)


def stored(*success):
    """A run folder of two seeds side by side, four record points each, the first two passed at the first look."""
    held = {
        "config": SimpleNamespace(budget=4000, seeds=2),
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
    assert lines[2] == "nowhere: does not ship" and "of an update" in lines[1]
    assert {r.subject for r in records} == {"deep_q leg_reach"} and {r.batch for r in records} == {16}
    units = {"steps/s", "episodes/s", "success at the end", "share of physics", "share of the task"}
    assert {r.unit for r in records} == units | {"share of learning"}
    parts = [record.value for record in records if record.unit.startswith("share of ")]
    assert len(parts) == 3 and sum(parts) == pytest.approx(1.0) and min(parts) >= 0.0 and parts[0] > 0.0
    assert all(r.compile_s > 0 and r.repeats == 2 for r in records)
    assert len(records[-4].as_json()["by_seed"]) == 2
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


@pytest.mark.parametrize("name", ["cpu_2_cores", "h200"])
def test_a_result_compared_with_itself_has_not_changed(name):
    """Also one with keys that are no longer measured, and with several figures of one key."""
    before = compare.read_result(Path(__file__).parents[2] / "docs" / "bench" / f"{name}.json")
    found = compare.changes(before, before)
    assert {change.factor for change in found} <= {1.0, np.inf} and not any(change.regressed for change in found)
    assert len(found) > 90 and not compare.warnings(before, before)


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


def test_every_benchmark_is_found():
    assert {name: measuring(name) for name in BENCHES} == {
        "tabular": benches.tables,
        "physics": benches.physics,
        "control": benches.control,
        "training": training.run,
        "startup": startup.run,
    }
