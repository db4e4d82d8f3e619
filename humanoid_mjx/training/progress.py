"""Progress that the user sees while a sweep runs: a bar with rate and time left; without a terminal a line now and
then."""

import os
import sys
import time
from collections import deque
from types import TracebackType

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

LINE_EVERY_S = 10.0

RECENT_LOOKS = 100
"""Number of looks, ten a second, over which the rate shown is taken: the recent past."""


class Reporter:
    """Base of reporters, which are called while a sweep runs. This one shows nothing."""

    def begin(self, total: float, unit: str) -> None:
        """A sweep begins that will take `total` of `unit`, such as episodes."""

    def note(self, text: str) -> None:
        """A remark, shown once."""

    def phase(self, text: str) -> None:
        """The present phase."""

    def update(self, done: float, success: float | None = None, mean_return: float | None = None) -> None:
        """How much is done of the total; the success and return of recent episodes, where they are known."""

    def length(self, steps: float) -> None:
        """The mean number of steps of recent episodes."""

    def count(self, done: int, total: int) -> None:
        """A count of things done out of a total, such as frames painted."""


class PatientConsole(Console):
    """A console that goes on in silence where its reader has gone, as after `| head`: training is worth more."""

    def on_broken_pipe(self) -> None:
        self.quiet = True
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class Bar(Reporter):
    """Reports on a console."""

    def __init__(self, console: Console):
        self.console, self.total, self.unit = console, 1.0, ""
        self._text, self._done, self._length = "starting", 0.0, 0.0
        self._began = self._last_line = time.monotonic()
        self._seen: deque[tuple[float, float]] = deque([(self._began, 0.0)], maxlen=RECENT_LOOKS)
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            TaskProgressColumn(),
            TextColumn("{task.fields[rate]}"),
        )
        self._bar = Progress(
            *columns,
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=console,
            transient=True,
        )
        self._task = self._bar.add_task(self._text, total=None, rate="")

    def __enter__(self) -> "Bar":
        if self.console.is_terminal:
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.console.is_terminal:
            self._bar.stop()

    def begin(self, total: float, unit: str) -> None:
        self.total, self.unit = total, unit
        self._bar.update(self._task, total=total)

    def note(self, text: str) -> None:
        self.console.print(text, highlight=False, soft_wrap=True)

    def phase(self, text: str) -> None:
        changed, self._text = text != self._text, text
        self._bar.update(self._task, description=text)
        if changed and not self.console.is_terminal:
            self._line()

    def length(self, steps: float) -> None:
        self._length = steps

    def update(self, done: float, success: float | None = None, mean_return: float | None = None) -> None:
        now = time.monotonic()
        if done > self._done:
            if not self._done:
                self._seen.clear()  # what comes before the first progress is compiling
            self._seen.append((now, done))
        self._done = done
        (first, at_first), (last, at_last) = self._seen[0], self._seen[-1]
        speed = (at_last - at_first) / (last - first) if last - first > 0.5 else 0.0
        rate = f"{speed:,.0f} {self.unit}/s" if speed else ""
        if speed and self._length and self.unit == "steps":
            rate += f"  {speed / self._length:,.0f} episodes/s"
        if success is not None:
            rate += f"  success {success:.0%}  return {mean_return:.3g}"
        self._bar.update(self._task, completed=done, rate=rate)
        if not self.console.is_terminal and now - self._last_line > LINE_EVERY_S:
            self._line(rate)

    def count(self, done: int, total: int) -> None:
        self.total = total
        self._bar.update(self._task, total=total)
        self.update(done)

    def _line(self, rate: str = "") -> None:
        self._last_line = time.monotonic()
        share = f" {self._done / self.total:.0%}" if self._done else ""
        self.console.print(
            f"{self._last_line - self._began:6.1f} s  {self._text}{share}  {rate}".rstrip(), highlight=False
        )
