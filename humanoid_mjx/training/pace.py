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
from humanoid_mjx.training.pool import Pool
from humanoid_mjx.training.programs import arranged
from humanoid_mjx.training.warm_start import earlier_policies

WINDOW_S, WINDOW_SHARE = 10.0, 0.3
"""Seconds over which a pace is taken, and the share of the session where that is longer."""

EVERY_S = 0.5
"""Seconds between two looks that are kept; twice as many whenever `LOOKS` are there."""

LOOKS = 40

OVERRUN = 0.1
"""The share of the time beyond an estimate that is said to be left of it."""

COMPILING = ("tracing", "compiling")
"""Phases in which training stands still."""

PLAYED_OUT = 2000
"""Waiting runs whose start and end are played out; those beyond them take the mean."""

MEASURED_S = 6.0
"""Seconds of training that are measured of a program, once it is compiled."""

MOST_PROGRAMS = 3
"""Programs of a sweep that are measured; the others are taken to be like their mean."""

LEAST_LOOKS = 4
"""Chunks of training that are measured even where they take longer."""


class Look(NamedTuple):
    """What trains at one moment."""

    phase: str
    slots: Int[np.ndarray, " slots"]
    """The run that each slot holds, below 0 for none."""
    progress: Float[np.ndarray, " slots"]
    """How much of it is done, from 0 to 1."""
    waiting: int
    """Runs that no slot has held yet."""
    finished: int
    """Runs that are over, those of earlier sessions among them."""
    evaluation: float = 0.0
    """An estimate of the time that the evaluation of a run takes, as a share of its training."""


class Pace:
    """Pace of a sweep and the time that is left, from looks at what trains.

    Runs of one sweep can differ by a factor of twenty in length: where the reward pays for waiting, episodes last to
    their cap. What all of them together make a second says little then: at the end the slow ones train alone. So the
    slots are played out, each at its own pace. Compiling and evaluating have clocks of their own, in which training
    stands still.
    """

    def __init__(self, runs: int, programs: int = 1):
        """For runs numbered from 0 to `runs` - 1, in so many compiled programs."""
        self.programs = programs
        self.done = 0.0
        """Runs that are done, parts of runs counted; it never falls."""
        self.seconds = self.work = 0.0
        """Seconds of training, and the runs done in them, compiling left out."""
        self.elsewhere = 0.0
        """The mean pace of other processes, runs a second."""
        self.trained_s = self.compiled_s = self.evaluated_s = 0.0
        """Seconds of each kind of phase so far."""
        self._now = 0.0
        self._look: Look | None = None
        self._progressed: tuple[float, float] | None = None
        """The time and `done` of the last look that saw progress."""
        self._whole, self._slope, self._began = (np.full(runs, np.nan) for _ in range(3))
        """Seconds that each run seen so far trains from its beginning to its end; those that it would take at its
        present pace; the training time when it began, minus infinity where that is not known or no longer of use."""
        self._looks: deque[tuple[float, float, Look]] = deque()
        """Training time, `done` and what was seen."""
        self._every_s = EVERY_S
        self._first_compiled_s = self._ready = 0.0
        """Seconds of compiling before the first training, and when what evaluates will be compiled."""
        self._evaluated, self._per_run_s = (0.0, 0), None
        """Seconds of evaluating and runs finished at the last end of an evaluation; seconds that a run took by then."""
        self._before: int | None = None

    def look(self, time_s: float, look: Look) -> None:
        """Take note of what trains at `time_s`, s, of any clock."""
        passed, self._now = (time_s - self._now if self._look else 0.0), time_s
        phase = self._look.phase if self._look else look.phase
        if phase in COMPILING:
            self.compiled_s += passed
        elif phase == "evaluating":
            self.evaluated_s += passed
        else:
            self.trained_s += passed
        if look.phase == "evaluating" and self._ready:
            self._ready, self._first_compiled_s = 0.0, self.compiled_s
        self._look, under_way = look, look.progress[look.slots >= 0]
        # Runs that were harvested are for a moment neither under way nor stored.
        done = max(self.done, look.finished + float(np.minimum(under_way, 1.0).sum()))
        if self._before is None:
            self._before, self.done = look.finished, done
        if done > self.done:
            self._progress(time_s, done)
        self._evaluations(look)
        self._runs(look)

    def pause(self) -> None:
        """Work stands still until the next progress: a new program will be compiled."""
        self._progressed = None

    def _progress(self, time_s: float, done: float) -> None:
        if self._progressed:
            self.seconds += time_s - self._progressed[0]
            self.work += done - self._progressed[1]
        if not self._first_compiled_s:
            self._first_compiled_s = self.compiled_s
            self._ready = time_s + self.compiled_s  # what evaluates takes about as long, beside training
        self._progressed, self.done = (time_s, done), done

    def _evaluations(self, look: Look) -> None:
        """Note what an evaluation took that is over."""
        before = self._before or 0
        if look.finished > max(self._evaluated[1], before):
            self._evaluated, self._ready = (self.evaluated_s, look.finished), 0.0
            self._per_run_s = self.evaluated_s / (look.finished - before)

    def _runs(self, look: Look) -> None:
        """Note how long the runs in the slots take."""
        if self._looks and len(self._looks[-1][2].slots) != len(look.slots):
            self._looks.clear()
        new = (look.slots >= 0) & np.isnan(self._began[look.slots])
        earlier_session = (look.progress[new] > 0.0) & (not self._looks)
        self._began[look.slots[new]] = np.where(earlier_session, -np.inf, self.trained_s)
        if self._looks and self.trained_s - self._looks[-1][0] < self._every_s:
            return
        self._looks.append((self.trained_s, self.done, look))
        window = max(WINDOW_S, WINDOW_SHARE * self.trained_s)
        while self._looks[0][0] < self.trained_s - window:
            self._looks.popleft()
        if len(self._looks) > LOOKS:
            self._looks = deque(list(self._looks)[::-2][::-1])
            self._every_s *= 2
        slots, progress = look.slots, look.progress
        seconds, share = np.zeros(len(slots)), np.zeros(len(slots))
        for earlier_s, _, earlier in self._looks:
            fits = (seconds == 0) & (slots == earlier.slots) & (slots >= 0)
            fits &= (earlier.progress < progress) & (progress < 1.0)
            seconds[fits], share[fits] = self.trained_s - earlier_s, (progress - earlier.progress)[fits]
        known = seconds > 0
        self._slope[slots[known]] = seconds[known] / share[known]
        begun = (slots >= 0) & ((progress < 1.0) | np.isfinite(self._began[slots]))
        runs, progress = slots[begun], progress[begun]
        passed = self.trained_s - self._began[runs]
        passed = np.where(np.isfinite(passed), passed, self._slope[runs] * progress)
        to_come = np.where(progress < 1.0, self._slope[runs] * (1.0 - progress), 0.0)
        self._whole[runs] = passed + to_come
        self._began[runs[progress >= 1.0]] = -np.inf

    @property
    def mean(self) -> float:
        """Runs a second of this process; 0 where training was over at the first look."""
        return self.work / self.seconds if self.seconds else 0.0

    @property
    def recent(self) -> float:
        """Runs a second of late, evaluations left out; 0 where that is not known yet."""
        if len(self._looks) < 2:
            return 0.0
        (first_s, first, _), (last_s, last, _) = self._looks[0], self._looks[-1]
        return (last - first) / (last_s - first_s)

    @property
    def left_s(self) -> float | None:
        """Seconds until the runs in the slots and those that wait are trained and evaluated; None where no pace is
        known yet."""
        seen = self._whole[np.isfinite(self._whole)]
        if not len(seen) or self._look is None:
            return None
        look = self._look
        training = max(self._training_s(seen, look), _left(self._ready - self._now) if self._ready else 0.0)
        more = self.programs > 1 and look.waiting > 0
        compiling = _left(self.programs * self._first_compiled_s - self.compiled_s) if more else 0.0
        left = look.waiting + int((look.slots >= 0).sum())
        if self._per_run_s is None:
            expected = float(seen.mean()) * look.evaluation * -(-left // len(look.slots))
        else:
            expected = self._per_run_s * left
        spent = self.evaluated_s - self._evaluated[0]
        return training + compiling + (_left(expected - spent) if left else 0.0)

    def _training_s(self, seen: Float[np.ndarray, " seen"], look: Look) -> float:
        """Seconds of training left, by runs seen so far: the waiting ones are like them, and begin in the order in
        which slots become free."""
        slope = np.where(look.slots >= 0, self._slope[look.slots], 0.0)
        slope = np.where(np.isnan(slope), seen.mean(), slope)
        free = (slope * np.clip(1.0 - look.progress, 0.0, 1.0)).tolist()
        heapq.heapify(free)
        now = min(look.waiting, PLAYED_OUT)
        for seconds in np.random.default_rng(0).choice(seen, now).tolist():
            heapq.heapreplace(free, free[0] + seconds)
        return max(free) + float(seen.mean()) * (look.waiting - now) / len(free)

    def rates(self, plan: Plan, folder: Path) -> dict[str, float]:
        """`steps_per_s` and `episodes_per_s`, by the length of all episodes of training in the tables of `folder`;
        neither where training was over at the first look, and no steps where lengths are not recorded."""
        speed = (self.mean + self.elsewhere) * plan.budget
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


def _left(seconds: float) -> float:
    """Seconds left by an estimate; beyond its end, in which `seconds` are negative, a share of the time since."""
    return seconds if seconds > 0 else -OVERRUN * seconds


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
    size, devices = arranged(len(runs), room)
    pool = Pool(group, deque(runs), size, devices, plan.config.seed, earlier_policies(group))
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


def time_in_words(seconds: float) -> str:
    """A time for a reader: `8 s`, `4 min`, `2.5 h`, `3 days`."""
    for unit, size, most in (("s", 1.0, 100.0), ("min", 60.0, 100.0), ("h", 3600.0, 48.0)):
        if seconds < most * size:
            return f"{seconds / size:.1f} {unit}" if unit == "h" else f"{max(seconds / size, 1.0):.0f} {unit}"
    return f"{seconds / 86_400.0:,.0f} days"
