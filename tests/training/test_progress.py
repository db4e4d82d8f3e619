"""The progress that the user sees: its words, its share of the time, and what a narrow screen shows of it."""

import io
import re

import pytest
from rich.console import Console
from rich.table import Table

from humanoid_mjx.training import progress
from humanoid_mjx.training.progress import Bar, PatientConsole, State


@pytest.fixture
def now(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock[0])
    return clock


def test_without_a_terminal_there_is_a_line_for_each_phase_and_now_and_then(now):
    out = io.StringIO()
    with Bar(Console(file=out, width=40)) as bar:
        for second in range(40):
            now[0] = float(second)
            bar.phase("compiling" if second < 5 else "training")
            if second >= 5:
                bar.update(State(100.0 * second, 4000.0, "steps", 100.0, 40.0 - second, 0.5, 1.0, 25.0))
    lines = out.getvalue().splitlines()
    assert [line.split()[2] for line in lines] == ["compiling", *["training"] * 4], lines
    assert lines[-1] == "  38.0 s  training 95%  left 0:00:02  100 steps/s  4 episodes/s  best success 50%  return 1"
    assert "%" not in lines[0] and "left" not in lines[0]


def test_the_share_is_of_the_time_and_never_falls_nor_is_whole_before_the_end(now):
    """The time left grows where runs become slow; what comes after the sweep has its share."""
    bar, shares = Bar(Console(file=io.StringIO()), after_s=10.0), []
    for second, left in ((10.0, 80.0), (50.0, 140.0), (60.0, 30.0), (89.0, 0.1), (95.0, 0.1)):
        now[0] = second
        bar.update(State(1.0, 2.0, "episodes", left_s=left))
        shares.append(bar._words()[0])
    assert shares == ["10%", "25%", "60%", "90%", "90%"]
    bar.phase("drawing figures")
    now[0] = 98.0
    assert bar._words() == ("93%", "left 0:00:07")
    now[0] = 500.0
    assert bar._words() == ("99%", "left 0:00:01")


def test_a_count_has_the_time_that_it_takes(now):
    bar = Bar(Console(file=io.StringIO()))
    assert bar._words() == ("", "")
    now[0] = 20.0
    bar.count(50, 250)
    assert bar._words() == ("20%", "left 0:01:20")


@pytest.mark.parametrize("width", [30, 59, 60, 200])
def test_every_screen_shows_the_share_and_the_time_left(now, width):
    out = io.StringIO()
    bar = Bar(Console(file=out, width=width, force_terminal=True, legacy_windows=False))
    bar.phase("drawing figures")
    now[0] = 60.0
    bar.update(State(1.0, 2.0, "episodes", 123_456.0, 60.0, 0.5, 1.0, 25.0))
    bar.console.print(bar._render(), end="")
    shown = re.sub(r"\x1b\[[\d;?]*\w", "", out.getvalue()).rstrip("\n")
    assert "50%" in shown and "left 0:01:00" in shown and len(shown) <= width and "\n" not in shown
    assert ("\u2501" in shown) == (width >= 60) and ("123,456 episodes/s" in shown) == (width == 200)


@pytest.mark.parametrize("width", [30, 120])
def test_a_row_is_a_line_without_a_terminal(width):
    """However narrow the screen is, no cell is cut; within a terminal the table has its frame."""
    table = Table(title="2 points", caption="trained")
    table.add_column("a\nvalue", justify="right")
    table.add_column("agent")
    table.add_row("3", "one that has more words than a narrow screen has room for")
    table.add_row("100", "zero")
    for terminal in (False, True):
        out = io.StringIO()
        PatientConsole(file=out, width=width, force_terminal=terminal).print(table)
        lines = out.getvalue().splitlines()
        assert (lines[2] == "      3  one that has more words than a narrow screen has room for") == (not terminal)
        assert terminal or [lines[0], lines[1], lines[3:]] == [
            "2 points",
            "a value  agent",
            ["    100  zero", "trained"],
        ]
