"""Progress that the user sees while a sweep runs: a bar with rate and time left; without a terminal a line now and
then."""

import os
import sys
import time
from datetime import timedelta
from types import TracebackType

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TaskProgressColumn, TextColumn
from rich.text import Text

from humanoid_mjx.training.pace import Pace, Remaining

LINE_EVERY_S = 10.0

UNKNOWN = "-:--:--"
"""In the place of a time that is not known."""

COMPILING = ("tracing", "compiling")
"""Phases in which training stands still."""


class Reporter:
    """Base of reporters, which are called while a sweep runs. This one shows nothing."""

    def begin(self, total: float, unit: str, programs: int = 1, runs: int = 0) -> None:
        """A sweep begins that will take `total` of `unit`, such as episodes, in so many compiled programs and runs."""

    def note(self, text: str) -> None:
        """A remark, shown once."""

    def phase(self, text: str) -> None:
        """The present phase."""

    def update(self, done: float, success: float | None = None, mean_return: float | None = None) -> None:
        """How much is done of the total; the success and return of recent episodes, where they are known."""

    def slots(self, slots: np.ndarray, progress: np.ndarray, waiting: int) -> None:
        """The run that each slot holds, below 0 for none, how much of it is done, and how many more runs wait; where
        the time left is known better by these than by the rate of all."""

    def length(self, steps: float) -> None:
        """The mean number of steps of recent episodes."""

    def count(self, done: int, total: int) -> None:
        """A count of things done out of a total, such as frames painted."""


class PatientConsole(Console):
    """A console that goes on in silence where its reader has gone, as after `| head`: training is worth more."""

    def on_broken_pipe(self) -> None:
        self.quiet = True
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class Elapsed(ProgressColumn):
    """The time since the beginning, which goes on while evaluating and drawing, when all is trained."""

    def render(self, task: Task) -> Text:
        return Text(str(timedelta(seconds=int(task.elapsed or 0.0))))


class Bar(Reporter):
    """Reports on a console."""

    def __init__(self, console: Console):
        self.console, self.total, self.unit = console, 1.0, ""
        self._text, self._done, self._length = "starting", 0.0, 0.0
        self._began = self._last_line = time.monotonic()
        self._pace, self._remaining = Pace(), Remaining(0)
        self._left: float | None = None
        """Seconds that training will still take without compiling, where the runs in the slots tell."""
        self._programs = 0
        self._stood, self._looked = 0.0, self._began
        """The seconds of compiling so far, and when they were last counted."""
        self._standing, self._ready = 0.0, 0.0
        """The seconds that all compiling is expected to take while nothing trains, and when what evaluates will be
        compiled, which is while the first runs train."""
        columns = (
            TextColumn("{task.description}"),
            BarColumn(bar_width=20),
            TaskProgressColumn(),
            Elapsed(),
            TextColumn("left {task.fields[left]}"),
            TextColumn("{task.fields[rate]}"),  # the last, so that a narrow screen cuts it and nothing else
        )
        self._bar = Progress(*columns, console=console, transient=True)
        self._task = self._bar.add_task(self._text, total=None, rate="", left=UNKNOWN)

    def __enter__(self) -> "Bar":
        if self.console.is_terminal:
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.console.is_terminal:
            self._bar.stop()

    def begin(self, total: float, unit: str, programs: int = 1, runs: int = 0) -> None:
        self.total, self.unit, self._programs, self._remaining = total, unit, programs, Remaining(runs)
        self._bar.update(self._task, total=total)

    def note(self, text: str) -> None:
        self.console.print(text, highlight=False, soft_wrap=True)

    def phase(self, text: str) -> None:
        now = time.monotonic()
        self._stood += now - self._looked if self._text in COMPILING else 0.0
        self._looked = now
        if text == "evaluating" and self._ready:
            self._ready, self._standing = 0.0, self._stood * self._programs
        changed, self._text = text != self._text, text
        self._bar.update(self._task, description=text, left=self._time_left())
        if changed and not self.console.is_terminal:
            self._line()

    def slots(self, slots: np.ndarray, progress: np.ndarray, waiting: int) -> None:
        if self._remaining.look(time.monotonic() - self._stood, slots, progress):
            self._left = self._remaining.seconds(waiting)

    def length(self, steps: float) -> None:
        self._length = steps

    def update(self, done: float, success: float | None = None, mean_return: float | None = None) -> None:
        now = time.monotonic()
        if not self._done and self._text == "training":
            self._pace.look(now, 0.0)  # what is done while nothing trains yet is an earlier session's
        if self._pace.look(now, done):
            self._standing = self._stood * self._programs
            self._ready = now + self._stood  # it takes about as long
        self._done, speed = done, self._pace.recent
        rate = f"{speed:,.0f} {self.unit}/s" if speed else ""
        if speed and self._length and self.unit == "steps":
            rate += f"  {speed / self._length:,.0f} episodes/s"
        if success is not None:
            rate += f"  success {success:.0%}  return {mean_return:.3g}"
        self._bar.update(self._task, completed=done, rate=rate, left=self._time_left())
        if not self.console.is_terminal and now - self._last_line > LINE_EVERY_S:
            self._line(rate)

    def _time_left(self) -> str:
        """The time until training is over, or dashes where it is not known."""
        training = self._left
        if training is None and (speed := self._pace.recent):
            training = (self.total - self._done) / speed
        if not self._done or training is None:
            return UNKNOWN
        seconds = max(training, self._ready - time.monotonic()) + max(self._standing - self._stood, 0.0)
        return str(timedelta(seconds=round(seconds))) if seconds > 0.5 else UNKNOWN

    def count(self, done: int, total: int) -> None:
        self.total = total
        self._bar.update(self._task, total=total)
        self.update(done)

    def _line(self, rate: str = "") -> None:
        self._last_line = time.monotonic()
        share = f" {self._done / self.total:.0%}" if self._done else ""
        left = self._time_left() if share else UNKNOWN
        left = "" if left == UNKNOWN else f"  left {left}"
        self.console.print(
            f"{self._last_line - self._began:6.1f} s  {self._text}{share}{left}  {rate}".rstrip(), highlight=False
        )
