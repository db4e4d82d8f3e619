"""Progress that the user sees: a bar with the time left; without a terminal a line now and then."""

import os
import sys
import time
from contextlib import AbstractContextManager, nullcontext
from datetime import timedelta
from typing import Any, NamedTuple

from rich.console import Console, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

LINE_EVERY_S = 10.0

ROOM_FOR_A_BAR = 60
"""Columns of a screen that shows more than words."""

ALMOST = 0.99
"""The greatest share that is shown of what is not over."""


def counted(count: int, name: str) -> str:
    """A count of things: `1 point`, `4,800 runs`."""
    return f"{count:,} {name}{'s' * (count != 1)}"


class State(NamedTuple):
    """A sweep under way, as a reporter gets it."""

    done: float
    """Episodes or control steps trained."""
    total: float
    unit: str
    """`episodes` or `steps`."""
    rate: float = 0.0
    """Of the unit, a second; 0 where it is not known."""
    left_s: float | None = None
    """Seconds until all runs are trained and evaluated, where they can be told."""
    success: float | None = None
    """Share of the recent episodes that succeed at the best point so far; with the two below None where none has
    ended."""
    mean_return: float | None = None
    """Mean return of these episodes."""
    steps: float | None = None
    """Mean length of the recent episodes of all runs under way."""


class Reporter:
    """Base of reporters, which are called while a sweep runs. This one shows nothing."""

    def note(self, text: str) -> None:
        """A remark, shown once."""

    def phase(self, text: str) -> None:
        """The present phase, such as `compiling`; called again while it lasts."""

    def update(self, state: State) -> None:
        """The state of the sweep, some times a second."""

    def count(self, done: int, total: int) -> None:
        """A count of things done out of a total, such as frames painted."""


class PatientConsole(Console):
    """A console that goes on in silence where its reader has gone, as after `| head`: training is worth more.

    Where no person reads, lines are not broken and a row of a table is a line without bars, so that `grep` finds it.
    """

    def print(self, *given: Any, **options: Any) -> None:
        """Print; an error says that it is of standard output."""
        if not (self.is_terminal or self.is_jupyter):
            given = tuple(_plain(each) if isinstance(each, Table) else each for each in given)
            options["soft_wrap"] = True
        try:
            super().print(*given, **options)
        except OSError as error:
            error.filename = error.filename or "standard output"
            raise

    def on_broken_pipe(self) -> None:
        self.quiet = True
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _plain(table: Table) -> str:
    """Return a table as lines: title, headings, rows with two spaces between the columns, caption."""
    columns = []
    for column in table.columns:
        cells = [" ".join(str(cell).split()) for cell in (column.header, *column.cells)]
        place, width = str.rjust if column.justify == "right" else str.ljust, max(map(len, cells))
        columns.append([place(cell, width) for cell in cells])
    rows = ("  ".join(row).rstrip() for row in zip(*columns, strict=True))
    return "\n".join(str(line) for line in (table.title, *rows, table.caption) if line is not None)


def reporting() -> AbstractContextManager[Reporter]:
    """The reporter of a program: a bar in a terminal, lines in a notebook, otherwise nothing."""
    console = PatientConsole(highlight=False)
    return Bar(console) if console.is_terminal or console.is_jupyter else nullcontext(Reporter())


class Bar(Reporter):
    """Reports on a console. The bar shows the share of the time: what has passed, of that and of what is left."""

    def __init__(self, console: Console, after_s: float = 0.0):
        """`after_s`: seconds that the phases after a sweep take, such as drawing figures."""
        self.console, self.after_s = console, after_s
        self._phase, self._rate, self._share = "starting", "", 0.0
        self._left: float | None = None
        """Seconds left when they were last told ..."""
        self._told = self._began = self._last_line = time.monotonic()
        """... and that moment."""
        self._live = Live(get_renderable=self._render, console=console, transient=True, refresh_per_second=5)

    def __enter__(self) -> "Bar":
        if self.console.is_terminal:
            self._live.start()
        return self

    def __exit__(self, *error: object) -> None:
        if self.console.is_terminal:
            self._live.stop()

    def note(self, text: str) -> None:
        self.console.print(text, highlight=False, soft_wrap=True)

    def phase(self, text: str) -> None:
        if text == self._phase:
            return
        self._phase = text
        if not self.console.is_terminal:
            self._line()

    def update(self, state: State) -> None:
        self._left = None if state.left_s is None else state.left_s + self.after_s
        self._told = time.monotonic()
        self._rate = f"{state.rate:,.0f} {state.unit}/s" if state.rate else ""
        if state.rate and state.steps and state.unit == "steps":
            self._rate += f"  {state.rate / state.steps:,.0f} episodes/s"
        if state.success is not None:
            self._rate += f"  best success {state.success:.0%}  return {state.mean_return:.3g}"
        self._line_now_and_then()

    def count(self, done: int, total: int) -> None:
        self._told = time.monotonic()
        self._left = (self._told - self._began) * (total - done) / done if done else None
        self._line_now_and_then()

    def _line_now_and_then(self) -> None:
        if not self.console.is_terminal and time.monotonic() - self._last_line > LINE_EVERY_S:
            self._line()

    def _words(self) -> tuple[str, str]:
        """The share of the time that has passed, which never falls, and the time left; blank where not known."""
        now = time.monotonic()
        if self._left is None:
            return "", ""
        left = max(self._left - (now - self._told), 1.0)
        passed = now - self._began
        self._share = max(self._share, min(passed / (passed + left), ALMOST))
        return f"{self._share:.0%}", f"left {timedelta(seconds=round(left))}"

    def _render(self) -> RenderableType:
        share, left = self._words()
        passed = str(timedelta(seconds=int(time.monotonic() - self._began)))
        # The most important first: a narrow screen cuts the end.
        words = Text("  ".join(filter(None, (share, left, self._phase, passed, self._rate))), no_wrap=True)
        words.truncate(self.console.width)
        if self.console.width < ROOM_FOR_A_BAR:
            return words
        table = Table.grid(padding=(0, 2, 0, 0))
        table.add_column(width=20)
        table.add_column(no_wrap=True, overflow="crop")
        table.add_row(ProgressBar(1.0, self._share, width=20, pulse=not share), words)
        return table

    def _line(self) -> None:
        self._last_line = time.monotonic()
        share, left = self._words()
        words = "  ".join(filter(None, (f"{self._phase} {share}".rstrip(), left, self._rate)))
        self.console.print(f"{self._last_line - self._began:6.1f} s  {words}", highlight=False, soft_wrap=True)
