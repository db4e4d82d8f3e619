"""What the user sees while a sweep runs: a bar with rate and time left; without a terminal a line now and then."""

import time
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


class Reporter:
    """Told what happens while a sweep runs. This one keeps it to itself."""

    def begin(self, total: float, unit: str) -> None:
        """A sweep begins that will take `total` of `unit`, such as episodes."""

    def note(self, text: str) -> None:
        """Something to know once."""

    def phase(self, text: str) -> None:
        """What is done now."""

    def update(self, done: float) -> None:
        """How much is done of the total."""


class Bar(Reporter):
    """Reports on a console."""

    def __init__(self, console: Console):
        self.console, self.total, self.unit = console, 1.0, ""
        self._text, self._done = "starting", 0.0
        self._began = self._last_line = time.monotonic()
        self._first: tuple[float, float] | None = None
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

    def update(self, done: float) -> None:
        now = time.monotonic()
        self._first = self._first or (now, self._done)
        self._done = done
        elapsed = now - self._first[0]
        rate = f"{(done - self._first[1]) / elapsed:,.0f} {self.unit}/s" if elapsed > 0.5 else ""
        self._bar.update(self._task, completed=done, rate=rate)
        if not self.console.is_terminal and now - self._last_line > LINE_EVERY_S:
            self._line(rate)

    def _line(self, rate: str = "") -> None:
        self._last_line = time.monotonic()
        share = f" {self._done / self.total:.0%}" if self._done else ""
        self.console.print(
            f"{self._last_line - self._began:6.1f} s  {self._text}{share}  {rate}".rstrip(), highlight=False
        )
