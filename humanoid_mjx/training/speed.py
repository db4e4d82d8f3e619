"""How fast a session trains: episodes and steps a second, without compiling."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow.parquet as pq

from humanoid_mjx.training.plan import Plan


class Look(NamedTuple):
    """What is trained of a sweep at a time."""

    time_s: float
    done: float
    """In the plan's unit: episodes, or control steps."""


class Speed:
    """The work and the seconds of a session, from looks at how much is trained.

    What comes before the first progress is compiling; `pause` says that a new program will be compiled.
    """

    def __init__(self) -> None:
        self.seconds = self.work = 0.0
        self.elsewhere = 0.0
        """What other processes make a second."""
        self._first: Look | None = None
        self._last: Look | None = None
        self._idle: float | None = None
        """How much is done while nothing progresses yet."""

    def look(self, time_s: float, done: float) -> None:
        """Take note of how much is done, which never falls."""
        if self._idle is None:
            self._idle = done
        if self._first is None:
            if done > self._idle:
                self._first = self._last = Look(time_s, done)
        elif self._last is not None and done > self._last.done:
            self._last = Look(time_s, done)

    def pause(self) -> None:
        """Training stands still until the next progress."""
        if self._first is not None and self._last is not None:
            self.seconds += self._last.time_s - self._first.time_s
            self.work += self._last.done - self._first.done
        self._first = self._last = self._idle = None

    @property
    def mean(self) -> float:
        """What this process makes a second, in the plan's unit; 0 where training was over at the first look."""
        return self.work / self.seconds if self.seconds else 0.0

    def rates(self, plan: Plan, folder: Path) -> dict[str, float]:
        """`steps_per_s` and `episodes_per_s`, by the length of all episodes of training in the tables of `folder`;
        neither where training was over at the first look, and no steps where lengths are not recorded."""
        speed = self.mean + self.elsewhere
        if not speed:
            return {}
        # Where several episodes feed one table its episodes are counted once for all of them.
        together = np.mean([getattr(learner, "agents", 1) for learner in plan.learners])
        speed *= float(together)
        lengths = np.zeros(0) if plan.learners[0].cumulative else _lengths(folder / "results.parquet")
        if plan.unit == "episode":
            found = {"steps_per_s": speed * lengths.mean()} if len(lengths) else {}
            found["episodes_per_s"] = speed
        else:
            found = {"steps_per_s": speed}
            if len(lengths):
                found["episodes_per_s"] = speed * float(np.mean(1.0 / lengths))
        return {name: float(f"{rate:.4g}") for name, rate in found.items()}


def _lengths(results: Path) -> np.ndarray:
    """Steps of an episode at each record point of each run in which one ended."""
    try:
        lengths = pq.read_table(results, columns=["steps"])["steps"].to_numpy().astype(float)
    except KeyError:
        return np.zeros(0)
    return lengths[np.isfinite(lengths) & (lengths > 0)]
