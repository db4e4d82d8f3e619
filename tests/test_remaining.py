"""The time left of a sweep, against sweeps that are played out."""

import io
import re

import numpy as np
import pytest
from rich.console import Console
from rich.progress import Progress

from humanoid_mjx.training import progress
from humanoid_mjx.training.remaining import EVERY_S, Remaining


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


@pytest.mark.parametrize("training_s", [20, 3])
def test_what_the_bar_says_counts_compiling_and_evaluating(monkeypatch, training_s):
    """One program: 6 s of compiling before it trains, and 6 s beside training, which a short training waits for."""
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    bar = progress.Bar(Console(file=io.StringIO(), width=80))
    bar.begin(10 * training_s, "steps")
    trained = 6 + training_s
    end, shown = max(trained, 12), {}
    for second in range(end + 3):
        now[0] = float(second)
        bar.phase("training" if 6 <= second < trained else "evaluating" if second >= end else "compiling")
        if second >= 6:
            bar.update(10.0 * min(second - 6, training_s))
        shown[second] = bar._time_left()
    assert shown[5] == progress.UNKNOWN
    # Training and evaluation up to the end, after which nobody knows how long the rest takes.
    for second in range(8, end):
        hours, minutes, seconds = map(int, re.fullmatch(r"(\d+):(\d\d):(\d\d)", shown[second]).groups())
        assert (hours, minutes) == (0, 0) and seconds == pytest.approx(end - second, abs=1.0), second
    assert shown[end + 1] == progress.UNKNOWN


def test_the_time_that_has_passed_goes_on_after_training():
    now = [100.0]
    bars = Progress(progress.Elapsed(), console=Console(file=io.StringIO()), get_time=lambda: now[0])
    bars.add_task("", total=10)
    (task,) = bars.tasks
    now[0] = 130.0
    bars.update(task.id, completed=10)
    now[0] = 175.0
    assert progress.Elapsed().render(task).plain == "0:01:15"
