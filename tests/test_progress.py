"""The progress that the user sees: its rates, and its time left, which counts compiling and evaluating."""

import io
import re

import numpy as np
import pytest
from rich.console import Console
from rich.progress import Progress

from humanoid_mjx.training import progress


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


def test_the_time_left_is_that_of_the_slowest_run_and_not_of_the_rate(monkeypatch):
    """Two runs of ten seconds and one of a hundred, in three slots; compiling that comes between counts for nothing."""
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    bar = progress.Bar(Console(file=io.StringIO(), width=80))
    bar.begin(300.0, "steps", 1, 3)
    share = np.zeros(3)
    for second in (0, 1, 2, 3, 63, 64):
        now[0] = float(second)
        bar.phase("compiling" if second == 3 else "training")
        share += 0.0 if second in (0, 63) else [0.1, 0.1, 0.01]
        bar.slots(np.arange(3), share, 0)
        bar.update(100.0 * float(share.sum()))
    assert bar._left == pytest.approx(96.0, abs=0.1)
