"""The pace of training: in the provenance, the time left against sweeps that are played out, and the estimate of how
long a sweep takes."""

import json
import time
from collections import deque

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from humanoid_mjx import sweep
from humanoid_mjx.cli import app
from humanoid_mjx.config import parse
from humanoid_mjx.training import pace
from humanoid_mjx.training.pace import EVERY_S, Pace, Remaining, estimate, time_in_words
from humanoid_mjx.training.plan import make_plan
from humanoid_mjx.training.pool import IDLE, Pool


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


def played_out(lengths_s, size):
    """Yields (time, slots, progress, runs that wait) every half second of a sweep of runs of such lengths, in so many
    slots; the last time is its end."""
    slots, began, waiting, now = np.full(size, -1), np.zeros(size), list(range(len(lengths_s))), 0.0
    while True:
        over = (slots < 0) | (now - began >= lengths_s[slots])
        for slot in np.flatnonzero(over):
            slots[slot], began[slot] = (waiting.pop(0) if waiting else -1), now
        done = np.where(slots >= 0, (now - began) / lengths_s[slots], 0.0)
        yield now, slots, done, len(waiting)
        if (slots < 0).all():
            return
        now += EVERY_S


@pytest.mark.parametrize("slow", [0.0, 0.1, 0.3])
def test_the_time_left_is_right_within_a_fifth_from_the_middle_on(slow):
    """Runs of 8 to 12 s, and a share of them that take ten times as long, as where the reward pays for waiting."""
    draw = np.random.default_rng(3)
    lengths_s = draw.uniform(8.0, 12.0, 600) * np.where(draw.random(600) < slow, 10.0, 1.0)
    remaining, said = Remaining(600), {}
    for now, slots, done, waiting in played_out(lengths_s, 50):
        remaining.look(now, slots, done)
        said[now] = remaining.seconds(waiting)
    end = max(said)
    # Of what is left, or three seconds where little is: looks are half a second apart, and a run that waits is like the
    # mean one.
    for now, seconds in said.items():
        if now > end / 2:
            assert seconds == pytest.approx(end - now, rel=0.2, abs=3.0), now


def test_nothing_is_said_before_a_pace_is_known():
    remaining = Remaining(4)
    assert remaining.look(0.0, np.array([0, 1]), np.zeros(2)) and remaining.seconds(2) is None
    assert not remaining.look(EVERY_S / 2, np.array([0, 1]), np.array([0.1, 0.1]))
    # Run 0 needs 9 s more and its successor 10; run 1, which has not moved, is taken to be like it.
    assert remaining.look(1.0, np.array([0, 1]), np.array([0.1, 0.0])) and remaining.seconds(0) == pytest.approx(10.0)
    assert remaining.seconds(1) == pytest.approx(19.0)


TABLES = {
    "name": "tables",
    "task": {"name": "joint_reach", "joint": 1, "states": 24, "max_episode_steps": 60},
    "learner": {"name": "tabular_q"},
    "sweep": {"axes": {"task.states": [11, 13, 17, 19]}},
    "seeds": 3,
    "episodes": 20,
    "record": 10,
}


class Slots(Pool):
    """Ten slots in which a run takes 20 s; in the first two seconds all are three times as slow."""

    def __init__(self, runs: int):
        self.now, self.waiting = 0.0, deque(range(runs))
        self.slots, self.progress = np.full(10, IDLE), np.zeros(10)
        self.fill()

    def fill(self):
        for slot in np.flatnonzero(~self.busy)[: len(self.waiting)]:
            self.slots[slot], self.progress[slot] = self.waiting.popleft(), 0.0

    def train(self):
        self.progress += 0.05 / (3.0 if self.now < 2.0 else 1.0)
        self.now += 1.0

    def harvest(self):
        over = self.busy & (self.progress >= 1.0 - 1e-9)
        self.now += 7.0 * over.any()  # evaluations are counted apart
        runs = self.slots[over]
        self.slots[over] = IDLE
        return (runs, {}) if len(runs) else None


@pytest.mark.parametrize("measured_s", [6.0, 45.0])
def test_the_time_left_is_by_the_rate_of_the_second_half(measured_s, monkeypatch):
    pool = Slots(runs=105)
    monkeypatch.setattr(pace.time, "monotonic", lambda: pool.now)
    # Ten runs at once take 20 s; the two slow seconds make up for a third each.
    wanted = 105 / 10 * 20.0 + 2.0 * (1 - 1 / 3)
    assert pace._seconds_of_training(pool, 105, measured_s) == pytest.approx(wanted, abs=1.0)  # a chunk


def test_a_training_that_ends_meanwhile_takes_what_it_took(monkeypatch):
    pool = Slots(runs=15)
    monkeypatch.setattr(pace.time, "monotonic", lambda: pool.now)
    # The first ten take 22 chunks of a second, two of them slow; the last five 20 more.
    assert pace._seconds_of_training(pool, 15, 1000.0) == pytest.approx(42.0)


def test_a_sweep_of_several_programs(tmp_path, monkeypatch):
    found = estimate(make_plan(parse(TABLES)), [2] * 4, measured_s=0.0)
    assert found.measured == 3 and found.total_s == found.compile_s + found.train_s + found.evaluate_s
    assert min(found) > 0 and np.isfinite(found.total_s)

    monkeypatch.setattr(pace, "MOST_PROGRAMS", 1)
    monkeypatch.setattr(pace, "_measure", lambda plan, group, *_: (2.0, 10.0, 1.0))
    assert estimate(make_plan(parse(TABLES)), [2] * 4) == (8.0, 40.0, 4.0, 1)
    path = tmp_path / "tables.yaml"
    path.write_text(json.dumps(TABLES))
    shown = CliRunner().invoke(app, ["info", str(path), "--time"])
    assert "about 52 s on this machine, without figures" in shown.output
    assert "--time measures" in CliRunner().invoke(app, ["info", str(path)]).output


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.2, "1 s"), (47.0, "47 s"), (200.0, "3 min"), (7000.0, "1.9 h"), (90_000.0, "25.0 h"), (1e6, "12 days")],
)
def test_times_in_words(seconds, words):
    assert time_in_words(seconds) == words
