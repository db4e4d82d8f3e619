"""The pace of training: that of a session, the time that the rest of a sweep takes by the pace of each run, and the
time that a sweep would take by a short piece of it."""

import heapq
import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow.parquet as pq
from jaxtyping import Float, Int

from humanoid_mjx.training.plan import Group, Plan
from humanoid_mjx.training.pool import IDLE, Pool
from humanoid_mjx.training.programs import arranged
from humanoid_mjx.training.warm_start import earlier_policies
from humanoid_mjx.training.whole_runs import pool_of

RECENT = 100
"""Looks that saw progress, ten a second at most, over which the recent pace is taken."""

WINDOW_S = 10.0
"""Seconds over which the pace of a run is taken."""

EVERY_S = 0.5
"""Seconds between two looks that are kept."""

PLAYED_OUT = 2000
"""Waiting runs whose start and end are played out; those beyond them take the mean."""

MEASURED_S = 6.0
"""Seconds of training that are measured of a program, once it is compiled."""

MOST_PROGRAMS = 3
"""Programs of a sweep that are measured; the others are taken to be like their mean."""

LEAST_LOOKS = 4
"""Chunks of training that are measured even where they take longer."""


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


class Remaining:
    """The time until a sweep is trained, by looks at the slots in which runs train.

    Runs of one sweep can differ by a factor of twenty in length: where the reward pays for waiting, episodes last to
    their cap. What all of them together make a second says little then: at the end the slow ones train alone.
    """

    def __init__(self, runs: int):
        """For runs numbered from 0 to `runs` - 1."""
        self._whole = np.full(runs, np.nan, np.float32)
        """Seconds that each run seen so far takes from its beginning to its end."""
        self._looks: deque[tuple[float, np.ndarray, np.ndarray]] = deque(maxlen=int(WINDOW_S / EVERY_S) + 1)

    def look(self, time_s: float, slots: Int[np.ndarray, " slots"], progress: Float[np.ndarray, " slots"]) -> bool:
        """Take note of which run each slot holds, below 0 for none, and how much of it is done.

        `time_s`: of a clock that stands still while nothing can train, s. Whether the last look was long enough ago.
        """
        if self._looks and len(self._looks[-1][1]) != len(slots):
            self._looks.clear()
        if self._looks and time_s - self._looks[-1][0] < EVERY_S:
            return False
        self._looks.append((time_s, slots.copy(), progress.copy()))
        seconds, done = np.zeros(len(slots)), np.zeros(len(slots))
        for earlier_s, earlier_slots, earlier in self._looks:
            fits = (seconds == 0) & (slots == earlier_slots) & (slots >= 0) & (earlier < progress) & (progress < 1.0)
            seconds[fits], done[fits] = time_s - earlier_s, (progress - earlier)[fits]
        known = seconds > 0
        self._whole[slots[known]] = seconds[known] / done[known]
        return True

    def seconds(self, waiting: int) -> float | None:
        """Seconds until the runs in the slots and so many waiting ones are over; None where no pace is known yet.

        Waiting runs are taken to be like those seen so far, and to begin in the order in which slots become free.
        """
        seen = self._whole[np.isfinite(self._whole)]
        if not len(seen):
            return None
        _, slots, progress = self._looks[-1]
        whole = np.where(slots >= 0, self._whole[slots], 0.0)
        whole = np.where(np.isnan(whole), seen.mean(), whole)
        free = (whole * np.clip(1.0 - progress, 0.0, 1.0)).tolist()
        heapq.heapify(free)
        now = min(waiting, PLAYED_OUT)
        for seconds in np.random.default_rng(0).choice(seen, now).tolist():
            heapq.heapreplace(free, free[0] + seconds)
        return max(free) + float(seen.mean()) * (waiting - now) / len(free)


class Duration(NamedTuple):
    """Seconds that a sweep takes by estimate, figures left out."""

    compile_s: float
    """Tracing and compiling, as long as it took here: less where the cache on disk has the programs by now."""
    train_s: float
    evaluate_s: float
    measured: int
    """How many of the sweep's programs were measured."""

    @property
    def total_s(self) -> float:
        """All together."""
        return self.compile_s + self.train_s + self.evaluate_s


def estimate(plan: Plan, rooms: Sequence[int], measured_s: float = MEASURED_S) -> Duration:
    """Train a piece of a sweep and say how long all of it would take.

    A sample of the runs trains side by side, as many as the sweep would train at once. The rate is that of the second
    half of `measured_s`, s: episodes of an early policy can be much longer or shorter than those of a later one, which
    an estimate from the beginning cannot know.

    Args:
      plan: what is to be trained.
      rooms: how many runs of each group the devices can train at once.
      measured_s: how long each program that is measured trains, s.
    """
    chosen = np.unique(np.linspace(0, len(plan.groups) - 1, MOST_PROGRAMS).round().astype(int))
    found = np.array([_measure(plan, plan.groups[index], rooms[index], measured_s) for index in chosen])
    runs = np.array([len(group.runs) for group in plan.groups])
    compiling, training, evaluating = found.sum(axis=0)
    more = runs.sum() / runs[chosen].sum()
    return Duration(compiling * len(runs) / len(chosen), training * more, evaluating * more, len(chosen))


def _measure(plan: Plan, group: Group, room: int, measured_s: float) -> tuple[float, float, float]:
    """The seconds of compiling, training and evaluating of a group."""
    runs = np.random.default_rng(0).permutation(group.runs).tolist()
    size, devices, share = arranged(group.learners, len(runs), room)
    pool = pool_of(group, deque(runs), size, devices, plan.config.seed, earlier_policies(group), share)
    if not group.learners.side_by_side:
        return _measure_whole_runs(pool, measured_s)
    began = time.monotonic()
    pool.fill()
    pool.train()
    pool.finish()
    compiled = time.monotonic()
    pool.finish()
    evaluate_s = time.monotonic() - compiled
    train_s = _seconds_of_training(pool, len(runs), measured_s)
    rounds = -(-len(runs) // len(pool.slots))
    return max(compiled - began - evaluate_s, 0.0), train_s, rounds * evaluate_s


def _seconds_of_training(pool: Pool, runs: int, measured_s: float) -> float:
    """How long so many runs train, by what the first of them do in `measured_s`, s; evaluations left out."""
    looks, trained_s, over = [(0.0, float(pool.progress.sum()))], 0.0, 0
    while pool.busy.any() and (trained_s < measured_s or len(looks) <= LEAST_LOOKS):
        began = time.monotonic()
        pool.train()
        trained_s += time.monotonic() - began
        looks.append((trained_s, over + float(np.minimum(pool.progress[pool.busy], 1.0).sum())))
        if harvest := pool.harvest():
            over += len(harvest[0])
            pool.fill()
    if not pool.busy.any():
        return trained_s
    times, done = np.array(looks).T
    half = int(np.searchsorted(times, trained_s / 2))
    # Runs of one program learn at one pace, so the last of them wait for nobody.
    return trained_s + (runs - done[-1]) * (times[-1] - times[half]) / max(done[-1] - done[half], 1e-9)


def _measure_whole_runs(pool: Pool, measured_s: float) -> tuple[float, float, float]:
    """The same where runs train one after another and each compiles: two runs begin, and the first goes on for a while.
    What a second one compiles is what all others will, too."""
    runs, compile_s, rates = pool.busy.sum() + len(pool.waiting), [], []
    for least_s in (measured_s, 0.0)[: int(runs)]:
        looks: list[tuple[float, float]] = []

        def look(looks: list[tuple[float, float]] = looks, least_s: float = least_s) -> None:
            looks.append((time.monotonic(), float(pool.progress[0])))
            if len(looks) > 1 and looks[-1][0] - looks[0][0] > least_s:
                pool.stop.set()

        pool.looked = look
        pool.stop.clear()
        began = time.monotonic()
        pool.fill()
        pool.train()
        times, shares = np.array(looks).T
        # Where a run has one part only, its training cannot be told from compiling.
        rates.append((shares[-1] - shares[0]) / (times[-1] - times[0]) if len(looks) > 1 else np.inf)
        compile_s.append(max(times[0] - began - shares[0] / rates[-1], 0.0))
        pool.slots[:], pool.progress[:] = IDLE, 0.0
    return compile_s[0] + (runs - 1) * compile_s[-1], float(runs) / rates[0], 0.0


def time_in_words(seconds: float) -> str:
    """A time for a reader: `8 s`, `4 min`, `2.5 h`, `3 days`."""
    for unit, size, most in (("s", 1.0, 100.0), ("min", 60.0, 100.0), ("h", 3600.0, 48.0)):
        if seconds < most * size:
            return f"{seconds / size:.1f} {unit}" if unit == "h" else f"{max(seconds / size, 1.0):.0f} {unit}"
    return f"{seconds / 86_400.0:,.0f} days"
