"""The pace of work without compiling, and that of a session in episodes and steps a second."""

from collections import deque
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from humanoid_mjx.training.plan import Plan

RECENT = 100
"""Looks that saw progress, ten a second at most, over which the recent pace is taken."""


class Pace:
    """The work and the seconds from looks at how much is done.

    What comes before the first progress is compiling; `pause` says that a new program will be compiled.
    """

    def __init__(self) -> None:
        self.seconds = self.work = 0.0
        self.elsewhere = 0.0
        """The mean pace of other processes."""
        self._looks: deque[tuple[float, float]] = deque(maxlen=RECENT)
        self._idle: float | None = None
        """The work done while nothing progresses yet."""

    def look(self, time_s: float, done: float) -> bool:
        """Take note of the work done, which never falls; return whether this look sees the first progress.

        Args:
          time_s: of any clock, s.
          done: in the unit of the work, such as episodes or control steps.
        """
        if self._idle is None:
            self._idle = done
        last_s, last = self._looks[-1] if self._looks else (time_s, self._idle)
        if done <= last:
            return False
        if self._looks:
            self.seconds += time_s - last_s
            self.work += done - last
        self._looks.append((time_s, done))
        return len(self._looks) == 1

    def pause(self) -> None:
        """Work stands still until the next progress."""
        self._looks.clear()
        self._idle = None

    @property
    def mean(self) -> float:
        """Work a second of this process; 0 where it was over at the first look."""
        return self.work / self.seconds if self.seconds else 0.0

    @property
    def recent(self) -> float:
        """Work a second over the last looks; 0 where these are of half a second or less."""
        if not self._looks:
            return 0.0
        (first_s, first), (last_s, last) = self._looks[0], self._looks[-1]
        return (last - first) / (last_s - first_s) if last_s - first_s > 0.5 else 0.0

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
