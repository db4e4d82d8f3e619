"""How fast training is, as the user sees it: in the progress, in the provenance."""

import io
import json
import time

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from rich.console import Console

from humanoid_mjx import sweep
from humanoid_mjx.config import parse
from humanoid_mjx.training import progress
from humanoid_mjx.training.pace import Pace
from humanoid_mjx.training.plan import make_plan
from humanoid_mjx.training.pool import Pool


def plan(unit, agents=1, rules="standard"):
    learner = {"name": "tabular_q", "agents": agents} if unit == "episode" else {"name": "linear_q"}
    length = {"episodes": 500} if unit == "episode" else {"total_steps": 500}
    task = {"name": "joint_reach", "joint": 1, "rules": rules}
    return make_plan(parse({"name": "x", "task": task, "learner": learner} | length))


@pytest.fixture
def folder(tmp_path):
    pq.write_table(pa.table({"steps": [10.0, 40.0, float("nan")]}), tmp_path / "results.parquet")
    return tmp_path


def looked(*looks):
    pace = Pace()
    for look in looks:
        pace.look(*look)
    pace.pause()
    return pace


def test_the_rate_is_that_between_the_first_and_the_last_progress(folder):
    pace = looked((0.0, 50.0), (60.0, 50.0), (61.0, 100.0), (62.0, 150.0), (63.0, 300.0), (90.0, 300.0))
    assert pace.rates(plan("episode"), folder) == {"steps_per_s": 100.0 * 25, "episodes_per_s": 100.0}
    # The next program took 50 s to compile.
    for time_s, done in ((100.0, 300.0), (150.0, 400.0), (152.0, 1000.0)):
        pace.look(time_s, done)
    pace.pause()
    assert pace.rates(plan("episode"), folder)["episodes_per_s"] == (200.0 + 600.0) / (2.0 + 2.0)


def test_steps_are_episodes_by_the_length_of_each(folder):
    pace = looked((0.0, 0.0), (1.0, 100.0), (2.0, 1100.0))
    found = pace.rates(plan("step"), folder)
    # As many steps make ten episodes of ten steps as 2.5 of forty.
    assert found == {"steps_per_s": 1000.0, "episodes_per_s": pytest.approx(500 / 10 + 500 / 40)}


def test_episodes_that_feed_one_table_count_all(folder):
    pace = looked((0.0, 0.0), (1.0, 100.0), (2.0, 110.0))
    assert pace.rates(plan("episode", agents=16), folder)["episodes_per_s"] == 160.0
    assert pace.rates(plan("episode", rules="printed"), folder) == {"episodes_per_s": 10.0}


def test_a_training_that_is_over_at_the_first_look_has_no_rate(folder):
    assert looked((0.0, 0.0), (1.0, 100.0)).rates(plan("episode"), folder) == {}
    assert Pace().rates(plan("step"), folder) == {}


def test_what_is_done_before_a_resumed_sweep_compiles_is_no_progress(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    bar = progress.Bar(Console(file=io.StringIO(), width=120))
    bar.begin(100_000, "steps", programs=2)
    for second in range(64):
        now[0] = float(second)
        bar.phase("compiling" if second < 60 else "training")
        bar.update(1_000.0 + 100.0 * max(second - 60, 0))
    # 98,700 steps are left, and a minute of compiling for the second program.
    assert bar._time_left() == "0:17:27"


@pytest.mark.parametrize("learner", ["tabular_q", "linear_q"])
def test_provenance_has_both_rates(learner, tmp_path, monkeypatch):
    # It is looked at every 0.1 s: on any machine several times before it is over.
    train = Pool.train
    monkeypatch.setattr(Pool, "train", lambda pool: (train(pool), time.sleep(0.2)))
    monkeypatch.setattr("humanoid_mjx.training.pool.CHUNK_S", 0.01)
    length = {"episodes": 3000} if learner == "tabular_q" else {"total_steps": 40_000}
    config = {"name": "x", "task": {"name": "joint_reach", "max_episode_steps": 60}, "learner": {"name": learner}}
    run = sweep(config | length, tmp_path / "run")
    made = json.loads((run.path / "provenance.json").read_text())
    assert made["sessions"][0]["episodes_per_s"] == made["episodes_per_s"]
    # An episode takes from one step to the cap of 60.
    assert 1.0 <= made["steps_per_s"] / made["episodes_per_s"] <= 60.0


@pytest.mark.parametrize(
    ("unit", "shown"), [("steps", "1,000 steps/s  40 episodes/s"), ("episodes", "1,000 episodes/s")]
)
def test_the_progress_says_episodes_a_second_whatever_is_counted(unit, shown, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    out = io.StringIO()
    with progress.Bar(Console(file=out, width=120)) as bar:
        bar.begin(50_000, unit)
        bar.length(25.0)
        for at, done in ((100.0, 0.0), (101.0, 5_000.0), (106.0, 10_000.0), (121.0, 25_000.0)):
            now[0] = at
            bar.update(done, 0.5, 1.0)
    last = out.getvalue().splitlines()[-1]
    assert f"{shown}  success 50%" in last, last
