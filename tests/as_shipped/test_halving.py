"""Successive halving: the survivors of a slow and obvious one, the same bits after a kill and on other devices."""

import signal
import subprocess
import sys

import numpy as np
import pytest
from small_sweep import CONFIG, assert_same_tables, run_cli, write_config

from humanoid_mjx import evaluate, sweep
from humanoid_mjx.runs.listing import look_at

AXES = {"learner.epsilon": [0.1, 0.3, 0.6, 1.0], "learner.learning_rate": [0.03, 0.2, 0.7]}
HALVING = CONFIG | {"sweep": {"mode": "halving", "eta": 2, "rungs": 3, "axes": AXES}, "episodes": 81, "chunk": 20}
RUNGS = [(20, 12), (40, 6), (81, 3)]
"""Episodes and points of each rung."""


@pytest.fixture(scope="module")
def halved(tmp_path_factory):
    return sweep(HALVING, tmp_path_factory.mktemp("halved") / "run")


@pytest.fixture(scope="module")
def grids(tmp_path_factory):
    """Sweeps of all points to the budget of each rung."""
    folder = tmp_path_factory.mktemp("grids")
    whole = HALVING | {"sweep": {"axes": AXES}, "record": 10}
    return [sweep(whole | {"episodes": episodes}, folder / str(episodes)) for episodes, _ in RUNGS]


def test_survivors_are_those_of_whole_sweeps_to_the_budget_of_each_rung(halved, grids):
    alive, ended = list(range(12)), {}
    for rung, grid in enumerate(grids):
        ended |= dict.fromkeys(alive, rung + 1)
        rows = grid.summary

        def judged(point, rows=rows):
            mine = rows["point"] == point
            success = round(float(rows["greedy_success"][mine].mean()), 3)
            costs = [float(np.median(rows[name][mine])) for name in ("greedy_steps", "whole_steps", "steps")]
            return [-success, *costs, point]

        alive = sorted(alive, key=judged)[: RUNGS[min(rung + 1, 2)][1]]
    summary, results = halved.summary, halved.results
    assert dict(zip(summary["point"].tolist(), summary["rung"].tolist(), strict=True)) == ended
    assert sorted(ended.values()) == [1] * 6 + [2] * 3 + [3] * 3
    for rung, ((episodes, _), grid) in enumerate(zip(RUNGS, grids, strict=True), 1):
        for mine, theirs in ((summary, grid.summary), (results, grid.results)):
            of_points = np.isin(theirs["point"], [point for point, end in ended.items() if end == rung])
            for name in theirs:
                assert mine[name][mine["rung"] == rung].tolist() == theirs[name][of_points].tolist(), name
        assert results["episode"][results["rung"] == rung].max() == episodes
    assert [best["point"] for best in halved.points()] == alive == [point for point in alive if ended[point] == 3]


DIES = """
import os, signal
from humanoid_mjx.cli import main
from humanoid_mjx.training import chunks
from humanoid_mjx.training.session import Session
chunks.CHECKPOINT_EVERY_S = 0.0
def taken(self, event, take=Session.take):
    take(self, event)
    if self.rung == 1 and isinstance(event, chunks.State) and event.arrays["progress"].any():
        os.kill(os.getpid(), signal.SIGKILL)
Session.take = taken
main()
"""
"""A process that kills itself as soon as it has stored a state of its second rung."""


def test_a_killed_sweep_resumes_on_other_devices_to_the_same_bits(halved, tmp_path, monkeypatch):
    config, run = write_config(tmp_path, **HALVING), tmp_path / "run"
    monkeypatch.setenv("JAX_NUM_CPU_DEVICES", "1")
    command = [sys.executable, "-c", DIES, "sweep", config, "--out", "run"]
    killed = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    assert len(list(run.glob("checkpoint/pool-*.npz"))) == 1
    found = look_at(run)
    assert found.state == "interrupted" and 12 / 21 <= found.share < 18 / 21
    resumed = run_cli("sweep", config, "--out", "run", "--resume", cwd=tmp_path, devices="2")
    assert resumed.returncode == 0, resumed.stderr
    assert "rung 3 of 3: the best 3 of 12 points train anew, with 81 episodes" in resumed.stdout
    assert_same_tables(run, halved.path)
    assert not list(run.glob("checkpoint/pool-*.npz")) and look_at(run).state == "finished"


def test_stopped_points_are_in_the_tables_and_in_no_comparison(halved, said):
    code, out, _ = said("plot", halved.path, "--x", "learner.epsilon", "--y", "greedy_steps")
    assert code == 0 and "only the points of the last rung are drawn; --by rung shows all." in out
    code, out, _ = said("plot", halved.path, "--x", "rung", "--y", "greedy_steps")
    assert code == 0 and "last rung" not in out
    code, out, err = said("report", halved.path)
    page = (halved.path / "report.html").read_text()
    ended = "halving: 12 points ended, 6 at rung 1, 3 at rung 2, 3 at rung 3"
    assert code == 0 and f"{ended}; only those at rung 3 are ranked and compared." in page, err
    assert "All 3 points, best first" in page and "What matters" not in page and "Two parameters" not in page
    stopped = int(halved.summary["point"][halved.summary["rung"] == 1][0])
    assert 0 <= evaluate(halved, point=stopped, episodes=4)["greedy"].success.value <= 1


def test_info_says_what_the_search_costs(said, tmp_path):
    code, out, _ = said("info", write_config(tmp_path, **HALVING))
    rungs = "12 with 20 episodes, 6 with 40 episodes, 3 with 81 episodes"
    assert code == 0 and f"halving trains {rungs}: as much as 8.9 of all 12 points to the end, 74%" in out
    assert "21 points x 3 seeds = 63 runs in 1 compiled program" in out


def test_points_of_several_programs_and_steps_are_halved(tmp_path):
    """Two groups of points, and a learner whose budget counts steps."""
    learner = {"name": "linear_q", "envs": 4, "rollout": 2, "evaluations": 2, "evaluation_envs": 2, "resolution": 4}
    axes = {"learner.tilings": [1, 2], "learner.learning_rate": {"loguniform": [0.01, 1.0]}}
    search = {"mode": "halving", "points": 5, "eta": 2, "rungs": 2, "axes": axes}
    changes = {"learner": learner, "sweep": search, "episodes": None, "total_steps": 64, "record": 4, "seeds": 2}
    run = sweep(CONFIG | changes, tmp_path / "run", trackers=["tensorboard"])
    rungs, results = run.summary["rung"], run.results
    assert sorted(rungs.tolist()) == [1] * 6 + [2] * 4
    assert results["step"][results["rung"] == 1][:4].tolist() == [8, 16, 24, 32]
    assert results["step"][results["rung"] == 2][:4].tolist() == [16, 32, 48, 64]
    assert not run.summary["diverged"].any()
    assert len(list((run.path / "tensorboard").iterdir())) == 2, "those of the last rung"


def test_a_length_that_is_left_out_judges_as_one_that_is_written(tmp_path):
    """A task that pays for every step: the points of the fewest steps are not those of the highest return."""
    axes = {"learner.epsilon": [0.1, 0.6], "task.step_reward": [-3.0, 3.0]}
    search = {
        "task": {"name": "joint_reach", "joint": 1, "max_episode_steps": 60},
        "learner": {"name": "tabular_q", "discount": 0.95},
        "sweep": {"mode": "halving", "eta": 2, "rungs": 2, "axes": axes},
    }
    default = {key: x for key, x in (CONFIG | search).items() if key != "episodes"}
    one, other = (sweep(x, tmp_path / str(len(x))).summary["rung"] for x in (default, default | {"episodes": 1000}))
    np.testing.assert_array_equal(one, other)
