"""The pace of training: in the provenance, the time left against sweeps that are played out, and the estimate of how
long a sweep takes."""

import json
import time

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from command_line import told
from small_sweep import CONFIG

from humanoid_mjx import sweep
from humanoid_mjx.config import parse
from humanoid_mjx.training import pace
from humanoid_mjx.training.pace import Look, Pace, estimate
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


def looked(plan, *looks):
    """A pace that has seen so much of the budget of one run done at each time, and what went on."""
    pace = Pace()
    for time_s, done, *phase in looks:
        pace.look(time_s, Look(*phase or ["training"], np.array([0]), np.array([done / plan.budget]), 0, 0))
    return pace


def test_the_rate_is_that_of_training_without_compiling_and_evaluating(folder):
    of = plan("episode")
    looks = (0.0, 50.0, "compiling"), (60.0, 50.0), (61.0, 100.0), (63.0, 300.0, "evaluating"), (90.0, 300.0)
    assert looked(of, *looks).rates(of, folder) == {"steps_per_s": 2083.0, "episodes_per_s": 83.33}
    # A training that is over at the first look has none.
    assert looked(of, (1.0, 100.0), (2.0, 100.0)).rates(of, folder) == Pace().rates(plan("step"), folder) == {}


def test_steps_are_episodes_by_the_length_of_each_and_those_that_feed_one_table_count_all(folder):
    found = looked(plan("step"), (0.0, 50.0), (1.0, 450.0)).rates(plan("step"), folder)
    # As many steps make ten episodes of ten steps as 2.5 of forty.
    assert found == {"steps_per_s": 400.0, "episodes_per_s": pytest.approx(200 / 10 + 200 / 40)}
    pace = looked(plan("episode"), (0.0, 100.0), (1.0, 110.0))
    assert pace.rates(plan("episode", agents=16), folder)["episodes_per_s"] == 160.0
    assert pace.rates(plan("episode", rules="printed"), folder) == {"episodes_per_s": 10.0}


@pytest.mark.parametrize("learner", ["tabular_q", "linear_q"])
def test_provenance_has_both_rates(learner, tmp_path, monkeypatch):
    # It is looked at every 0.1 s: on any machine several times in its first second.
    train, pauses = Pool.train, iter([0.2] * 5)
    monkeypatch.setattr(Pool, "train", lambda pool: (train(pool), time.sleep(next(pauses, 0.0))))
    monkeypatch.setattr("humanoid_mjx.training.pool.CHUNK_S", 0.01)
    length = {"episodes": 3000} if learner == "tabular_q" else {"total_steps": 40_000}
    config = {"name": "x", "task": {"name": "joint_reach", "max_episode_steps": 60}, "learner": {"name": learner}}
    run = sweep(config | length, tmp_path / "run")
    made = json.loads((run.path / "provenance.json").read_text())
    assert made["sessions"][0]["episodes_per_s"] == made["episodes_per_s"]
    # An episode takes from one step to the cap of 60.
    assert 1.0 <= made["steps_per_s"] / made["episodes_per_s"] <= 60.0


EVERY_S = 0.25
"""Seconds from one look to the next."""


def played_out(lengths_s, size, compile_s=0.0, evaluate_s=0.0, share=lambda passed: passed):
    """Yields (time, look) of a sweep of runs of such lengths, in so many slots; the last time is its end.

    Nothing trains for `compile_s` in the beginning and while an evaluation lasts, whenever a quarter of the runs in the
    slots is over. `share`: progress by the passed share of a run's time.
    """
    slots, trained_s = np.full(size, -1), np.zeros(size)
    waiting, now, finished = list(range(len(lengths_s))), 0.0, 0
    estimate = evaluate_s / lengths_s.mean()

    def seen(phase):
        done = np.where(slots >= 0, share(np.minimum(trained_s / lengths_s[slots], 1.0)), 0.0)
        return now, Look(phase, slots.copy(), done, len(waiting), finished, estimate)

    while True:
        for slot in np.flatnonzero(slots < 0)[: len(waiting)]:
            slots[slot], trained_s[slot] = waiting.pop(0), 0.0
        if (slots < 0).all():
            yield seen("evaluating")
            return
        while now < compile_s:
            yield seen("compiling")
            now += EVERY_S
        over = (slots >= 0) & (trained_s >= lengths_s[slots])
        if 4 * over.sum() >= size or (over.any() and (over == (slots >= 0)).all()):
            ends = now + evaluate_s
            while now < ends:
                yield seen("evaluating")
                now += EVERY_S
            slots[over], finished = -1, finished + int(over.sum())
            continue
        yield seen("training")
        now, trained_s = now + EVERY_S, trained_s + EVERY_S


def estimates(looks, **options):
    """The time left that is told at each moment of a sweep, and its end."""
    pace, found, now = Pace(**options), {}, 0.0
    for now, look in looks:
        pace.look(now, look)
        found[now] = pace.left_s
    return found, now


@pytest.mark.parametrize("slow", [0.0, 0.1, 0.3])
def test_the_time_left_is_right_within_a_fifth_from_the_middle_on(slow):
    """Runs of 8 to 12 s, and a share of them that take ten times as long, as where the reward pays for waiting."""
    draw = np.random.default_rng(3)
    lengths_s = draw.uniform(8.0, 12.0, 600) * np.where(draw.random(600) < slow, 10.0, 1.0)
    found, end = estimates(played_out(lengths_s, 50))
    for now, seconds in found.items():
        if end / 2 < now < end:
            assert seconds == pytest.approx(end - now, rel=0.2, abs=3.0), now


@pytest.mark.parametrize("evaluate_s", [0.0, 5.0, 60.0])
@pytest.mark.parametrize("size", [4, 12])
def test_compiling_and_evaluating_have_their_share(evaluate_s, size):
    """Three times four runs, or twelve at once, of 30 s; compiling takes 20 s, a tenth to two thirds of all."""
    found, end = estimates(played_out(np.full(12, 30.0), size, 20.0, evaluate_s))
    assert all(found[now] is None for now in found if now <= 20.0)
    assert all(found[now] == pytest.approx(end - now, rel=0.1, abs=2.0) for now in found if 22.0 < now < end)


def test_later_rungs_take_as_long_as_their_share_of_the_work():
    """Three rungs of the same work: at the end of the first two thirds are left."""
    found, end = estimates(played_out(np.full(40, 8.0), 10, 10.0, 2.0), later=2.0)
    assert all(found[now] == pytest.approx(3 * end - now, rel=0.15) for now in found if 14.0 < now <= end)


def test_nothing_is_said_before_a_pace_is_known():
    pace = Pace()

    def left(time_s, progress, waiting):
        pace.look(time_s, Look("training", np.array([0, 1]), np.array(progress), waiting, 0))
        return pace.left_s

    assert left(0.0, [0.0, 0.0], 2) is None
    assert left(0.2, [0.1, 0.1], 2) is None
    # Run 0 needs 9 s more; run 1, which has not moved, is taken to be like it.
    pace = Pace()
    assert left(0.0, [0.0, 0.0], 0) is None
    assert left(1.0, [0.1, 0.0], 0) == pytest.approx(10.0)


TABLES = CONFIG | {"name": "tables", "sweep": {"axes": {"task.states": [11, 13, 17, 19]}}, "episodes": 20}


def test_a_sweep_of_several_programs(tmp_path, monkeypatch):
    found = estimate(make_plan(parse(TABLES)), measured_s=0.0)
    assert found[1] == 3 and all(0 < seconds < np.inf for seconds in found[0].values())

    monkeypatch.setattr(pace, "MOST_PROGRAMS", 1)
    monkeypatch.setattr(pace, "_measure", lambda *_: (2.0, 10.0, 1.0))
    assert estimate(make_plan(parse(TABLES))) == (
        {"compiling (less once it is cached)": 8.0, "training": 40.0, "evaluating": 4.0},
        1,
    )
    path = tmp_path / "tables.yaml"
    path.write_text(json.dumps(TABLES))
    assert "about 52 s on this machine, without figures" in told("info", path, "--time")
    assert "--time measures" in told("info", path)
