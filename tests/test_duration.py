"""The estimate of how long a sweep takes."""

import json
from collections import deque

import numpy as np
import pytest
from typer.testing import CliRunner

from humanoid_mjx.cli import app
from humanoid_mjx.config import parse
from humanoid_mjx.training import duration
from humanoid_mjx.training.duration import estimate, time_in_words
from humanoid_mjx.training.plan import make_plan
from humanoid_mjx.training.pool import IDLE, Pool

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
    monkeypatch.setattr(duration.time, "monotonic", lambda: pool.now)
    # Ten runs at once take 20 s; the two slow seconds make up for a third each.
    wanted = 105 / 10 * 20.0 + 2.0 * (1 - 1 / 3)
    assert duration._seconds_of_training(pool, 105, measured_s) == pytest.approx(wanted, abs=1.0)  # a chunk


def test_a_training_that_ends_meanwhile_takes_what_it_took(monkeypatch):
    pool = Slots(runs=15)
    monkeypatch.setattr(duration.time, "monotonic", lambda: pool.now)
    # The first ten take 22 chunks of a second, two of them slow; the last five 20 more.
    assert duration._seconds_of_training(pool, 15, 1000.0) == pytest.approx(42.0)


def test_a_sweep_of_several_programs(tmp_path, monkeypatch):
    found = estimate(make_plan(parse(TABLES)), [2] * 4, measured_s=0.0)
    assert found.measured == 3 and found.total_s == found.compile_s + found.train_s + found.evaluate_s
    assert min(found) > 0 and np.isfinite(found.total_s)

    monkeypatch.setattr(duration, "MOST_PROGRAMS", 1)
    monkeypatch.setattr(duration, "_measure", lambda plan, group, *_: (2.0, 10.0, 1.0))
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
