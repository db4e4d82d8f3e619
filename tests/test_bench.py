"""The benchmarks run, and their subjects do the same work."""

import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from humanoid_mjx.bench import control, ground, postures, tabular, training
from humanoid_mjx.cli import app
from humanoid_mjx.training.sweep import Run

TINY = """
from humanoid_mjx.bench import tabular
tabular.BATCHES, tabular.STEPS, tabular.PYTHON_STEPS = {"cpu": (8,), "gpu": (8,)}, 50, 50
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
    assert set(result) == {"machine", "versions", "records"}
    assert {record["subject"] for record in result["records"]} >= {"scan", "naive_scan", "python"}
    keys = {"bench", "subject", "device", "batch", "value", "unit", "compile_s", "repeats"}
    assert all(set(record) == keys for record in result["records"])


def test_subjects_finish_as_many_episodes(monkeypatch):
    steps = 200_000
    monkeypatch.setattr(tabular, "STEPS", steps)
    monkeypatch.setattr(tabular, "PYTHON_STEPS", steps)
    finished = {}
    for name in ("scan", "naive_scan", "python"):
        call, count = tabular.SUBJECTS[name](np.full(2, 0.5, np.float32))
        finished[name] = count(call()) / (1 if name == "python" else 2)
    # Episodes take 23 steps once epsilon has decayed, after some thousand: 8,500 or so of 200,000 steps.
    assert all(abs(n / finished["python"] - 1) < 0.02 for n in finished.values()), finished


def test_control_times_every_controller():
    lines = []
    records = control.run(lines.append, control.Setting((8,), 2, 2))
    assert [(r.bench, r.subject) for r in records] == [
        ("control", name) for name in (*control.CONTROLLERS, *control.ON_MJX)
    ]
    assert all(r.value > 0 for r in records)
    assert "ns a step for control" in lines[-1] and "ns a step" not in lines[0]


def test_unknown_benchmarks_are_refused():
    done = CliRunner().invoke(app, ["bench", "tabula"])
    assert "did you mean 'tabular'" in str(done.exception)


def test_the_ground_is_the_same_body_in_every_physics():
    batch, steps = 2, 25
    by_mjx = np.concatenate([np.asarray(x) for device in ground.compiled("mjx-jax", batch, steps)() for x in device])
    by_mujoco = ground.mujoco(batch, steps)()
    # 0.1 s: float32 and four iterations of the solver against float64 and convergence.
    np.testing.assert_allclose(by_mjx, by_mujoco, atol=1e-4)
    assert np.abs(by_mjx - ground.start(batch)[0]).max() > 1e-3


def test_the_ground_writes_a_record_for_every_physics_and_batch():
    lines = []
    records = ground.run(lines.append, ground.Setting((2,), {"mjx-jax": 25, "mjx-warp": 25, "mujoco": 2}))
    assert [(r.subject, r.batch) for r in records] == [("mjx-jax ground", 2), ("mujoco ground", 2)] and len(lines) == 2
    assert all(r.bench == "physics" and r.value > 0 for r in records)


def test_postures_count_the_episodes_that_they_train():
    records = postures.run(lambda line: None, {"chain": postures.Size(1, 2)})
    assert [(r.subject, r.batch, r.unit) for r in records] == [
        ("chain posture_switch", 16, "episodes/s"),
        ("chain posture_switch", 16, "steps/s"),
    ]
    # An episode takes at least the two decisions from start to goal, and at most the cap of 40.
    assert 2 <= records[1].value / records[0].value <= 40


class Stored(Run):
    """A run folder of four record points, whose first two were passed when training was first looked at."""

    config = SimpleNamespace(budget=4000)
    timing = {"wall_s": np.array([5.0, 5.0, 7.0, 9.0], np.float32)}  # noqa: RUF012
    results = {  # noqa: RUF012
        "steps": np.array([20.0, np.nan, 30.0, 40.0]),
        "greedy_success": np.array([np.nan, 0.5, 0.96, 0.9]),
    }


def test_rates_leave_compiling_out_and_time_to_success_does_not():
    found = training.measure(Stored(Path()))
    assert found == pytest.approx((2000 / 4.0, 500 / 30.0, 7.0, 0.96))
    Stored.results["greedy_success"][2] = 0.94
    assert np.isnan(training.measure(Stored(Path())).success_s)


def test_training_writes_records_and_skips_what_is_not_there():
    lines = []
    tiny = ["total_steps=4096", "record=4", "learner.evaluation_envs=2", "learner.envs=16", "learner.evaluations=2"]
    records = training.run(lines.append, ["leg_reach", "nowhere"], tiny)
    assert lines[1] == "nowhere: does not ship"
    assert {r.subject for r in records} == {"deep_q leg_reach"} and {r.batch for r in records} == {16}
    assert {r.unit for r in records} == {"steps/s", "episodes/s"} and all(r.compile_s > 0 for r in records)
