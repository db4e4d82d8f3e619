"""The pace of training: that of a session, the time that the rest of a sweep takes by the pace of each run, and the
time that a sweep would take by a short piece of it."""

import heapq
import time
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow.parquet as pq
from jaxtyping import Float, Int

from humanoid_mjx.training.chunks import Here
from humanoid_mjx.training.plan import Plan
from humanoid_mjx.training.pool import Pool
from humanoid_mjx.training.programs import placement

LATELY_S, LATELY_SHARE = 5.0, 0.15
"""Time constant of the recent pace: the longer of these seconds and this share of the training so far."""

KNOWN_S = 0.5
"""Seconds of training after which the pace of a run is known, unless it is over before."""

OVERRUN = 0.1
"""Time left that is shown after an estimate was exceeded, as a share of the excess."""

PLAYED_OUT = 2000
"""Waiting runs whose slots are simulated; further ones are estimated by the mean."""

MEASURED_S = 6.0
"""Seconds of training that are measured of a program, once it is compiled."""

MOST_PROGRAMS = 3
"""Programs of a sweep that are measured; the others are taken to be like their mean."""

LEAST_LOOKS = 4
"""Chunks of training that are measured even where they take longer."""


class Look(NamedTuple):
    """The slots of a pool at one moment."""

    phase: str
    slots: Int[np.ndarray, " slots"]
    """The run that each slot holds, below 0 for none."""
    progress: Float[np.ndarray, " slots"]
    """The share of it that is done, from 0 to 1."""
    waiting: int
    """Runs that no slot has held yet."""
    finished: int
    """Runs that are over, those of earlier sessions among them."""
    evaluation: float = 0.0
    """An estimate of the time that the evaluation of a run takes, as a share of its training, by the episodes or
    control steps of both."""


class Pace:
    """Pace of a sweep and the time that is left, from looks at what trains.

    Runs of one sweep can differ by a factor of twenty in length: where the reward pays for waiting, episodes last to
    their cap. The total rate of finished runs then says little, since at the end the slow ones train alone. So the
    estimate simulates the slots, each at its own pace. Compiling and evaluating are timed separately from training.
    """

    def __init__(self, programs: int = 1, later: float = 0.0):
        """Begin without any look. `programs`: number of the sweep's compiled programs; `later`: the training of the
        rungs that follow this one, as a share of its own."""
        self.programs, self.later = programs, later
        self.done = 0.0
        """Runs that are done, parts of runs counted; it never falls."""
        self.trained_s = self.compiled_s = self.evaluated_s = 0.0
        """Seconds of each kind of phase so far."""
        self._now = 0.0
        self._look: Look | None = None
        self._began = 0.0, 0
        """`done` and the finished runs at the first look."""
        self._whole, self._over = np.zeros(0), deque[float](maxlen=PLAYED_OUT)
        """Seconds that each slot's run trains from its beginning to its end, NaN until they are known; and those of the
        last runs that left their slots."""
        self._late = np.zeros((2, 0))
        """Progress of each slot's run and the seconds that it took, the latest counting most."""
        self._late_in_all = np.zeros(2)
        """The same of all runs together."""
        self._first_compiled_s = self._ready = 0.0
        """Seconds of compiling before the first training, and when what evaluates will be compiled."""
        self._evaluated = 0.0, 0
        """Seconds of evaluating, and runs finished since the first look, at the last end of an evaluation."""

    def look(self, time_s: float, look: Look) -> None:
        """Take note of what trains at `time_s`, s, of any clock."""
        before, passed = self._look, time_s - self._now
        self._look, self._now = look, time_s
        # Runs that were harvested are for a moment neither under way nor stored.
        done = max(self.done, look.finished + float(np.minimum(look.progress[look.slots >= 0], 1.0).sum()))
        if before is None or len(before.slots) != len(look.slots):
            self._over.extend(_known(self._whole).tolist())
            self._late, self._whole = np.zeros((2, len(look.slots))), np.full(len(look.slots), np.nan)
        else:
            others = look.slots != before.slots
            self._over.extend(_known(self._whole[others]).tolist())
            self._whole[others] = np.nan
        if before is None:
            self._began, self.done = (done, look.finished), done
        elif before.phase == "training":
            self._train(before, look, passed, done)
        elif before.phase == "evaluating":
            self.evaluated_s += passed
        else:
            self.compiled_s += passed
        self.done = done
        if look.phase == "training" and not self._first_compiled_s:
            self._first_compiled_s = self.compiled_s
            self._ready = time_s + self.compiled_s  # what evaluates takes about as long, beside training
        elif look.phase == "evaluating" and self._ready:
            self._ready, self._first_compiled_s = 0.0, self.compiled_s
        if (ended := look.finished - self._began[1]) > self._evaluated[1]:
            self._evaluated, self._ready = (self.evaluated_s, ended), 0.0

    def _train(self, before: Look, look: Look, passed: float, done: float) -> None:
        """Note the progress of some seconds of training."""
        self.trained_s += passed
        kept = np.exp(-passed / max(LATELY_S, LATELY_SHARE * self.trained_s))
        self._late_in_all = kept * self._late_in_all + (done - self.done, passed)
        if len(before.slots) != len(look.slots):
            return
        same = look.slots == before.slots
        first = np.where(same, before.progress, 0.0)
        seconds = np.where(same | (look.progress > 0), passed, 0.0)
        late = np.where(same, kept * self._late, 0.0) + np.stack([look.progress - first, seconds])
        self._late = np.where(first < 1.0, late, self._late)  # those that are over only wait for their harvest
        moved, seconds = self._late
        known = (look.slots >= 0) & (moved > 0) & ((seconds >= KNOWN_S) | (look.progress >= 1.0))
        self._whole[known] = seconds[known] / moved[known]

    @property
    def recent(self) -> float:
        """Runs a second of late, evaluations left out; 0 where that is not known yet."""
        done, seconds = self._late_in_all
        return float(done / seconds) if seconds else 0.0

    @property
    def left_s(self) -> float | None:
        """Seconds until the runs in the slots, those that wait and those of later rungs are trained and evaluated; None
        where no pace is known yet."""
        seen = np.append(_known(self._whole), self._over)
        if not len(seen) or self._look is None:
            return None
        look = self._look
        training = max(self._training_s(seen, look), _left(self._ready - self._now) if self._ready else 0.0)
        more = self.programs > 1 and look.waiting > 0
        compiling = _left(self.programs * self._first_compiled_s - self.compiled_s) if more else 0.0
        left, (seconds, ended) = look.waiting + int((look.slots >= 0).sum()), self._evaluated
        expected = float(seen.mean()) * look.evaluation * -(-left // len(look.slots))
        expected = seconds / ended * left if ended else expected
        here = training + compiling + (_left(expected - (self.evaluated_s - seconds)) if left else 0.0)
        return here + self.later * (self.trained_s + self.compiled_s + self.evaluated_s + here)

    def _training_s(self, seen: Float[np.ndarray, " seen"], look: Look) -> float:
        """Seconds of training left, by runs seen so far: the waiting ones are like them, and begin in the order in
        which slots become free."""
        whole = np.where(look.slots >= 0, np.where(np.isnan(self._whole), seen.mean(), self._whole), 0.0)
        free = (whole * np.clip(1.0 - look.progress, 0.0, 1.0)).tolist()
        heapq.heapify(free)
        now = min(look.waiting, PLAYED_OUT)
        for seconds in np.random.default_rng(0).choice(seen, now).tolist():
            heapq.heapreplace(free, free[0] + seconds)
        return max(free) + float(seen.mean()) * (look.waiting - now) / len(free)

    def rates(self, plan: Plan, folder: Path) -> dict[str, float]:
        """`steps_per_s` and `episodes_per_s`, by the length of all episodes of training in the tables of `folder`;
        neither where training was over at the first look, and no steps where lengths are not recorded."""
        if not (self.trained_s and self.done > self._began[0]):
            return {}
        speed = (self.done - self._began[0]) / self.trained_s * plan.budget
        # Where several episodes feed one table its episodes are counted once for all of them.
        speed *= float(np.mean([getattr(learner, "agents", 1) for learner in plan.learners]))
        lengths = np.zeros(0)  # steps of an episode at each record point of each run in which one ended
        if not plan.learners[0].cumulative:
            with suppress(KeyError, FileNotFoundError):  # no lengths, or no run that has ended
                steps = pq.read_table(folder / "results.parquet", columns=["steps"])["steps"].to_numpy().astype(float)
                lengths = steps[np.isfinite(steps) & (steps > 0)]
        found = {f"{plan.unit}s_per_s": speed}
        if len(lengths) and plan.unit == "episode":
            found["steps_per_s"] = speed * lengths.mean()
        elif len(lengths):
            found["episodes_per_s"] = speed * float(np.mean(1.0 / lengths))
        return {name: float(f"{rate:.4g}") for name, rate in found.items()}


def _known(values: Float[np.ndarray, " values"]) -> Float[np.ndarray, " known"]:
    return values[np.isfinite(values)]


def _left(seconds: float) -> float:
    """Return the estimated seconds left; after the estimate was exceeded (`seconds` below 0), a share of the excess."""
    return seconds if seconds > 0 else -OVERRUN * seconds


def estimate(plan: Plan, measured_s: float = MEASURED_S) -> tuple[dict[str, float], int]:
    """Train a piece of a sweep and say how long all of it would take.

    A sample of the runs trains side by side, as many as the sweep would train at once. Episodes of an early policy can
    be much longer or shorter than those of a later one, which an estimate from the beginning cannot know. A run that
    several cores of a CPU will share counts as if it had one. `measured_s`: training of each program that is measured,
    s.

    Returns:
      the seconds of each part, figures left out, compiling as long as it took here; and how many of the sweep's
      programs were measured.
    """
    chosen = np.unique(np.linspace(0, len(plan.groups) - 1, MOST_PROGRAMS).round().astype(int))
    here = Here(plan)
    found = np.array([_measure(here, int(index), measured_s) for index in chosen])
    runs = np.array([len(group.runs) for group in plan.groups])
    compiling, training, evaluating = found.sum(axis=0)
    more = runs.sum() / runs[chosen].sum()
    parts = {"compiling (less once it is cached)": compiling * len(runs) / len(chosen), "training": training * more}
    return parts | ({"evaluating": evaluating * more} if evaluating else {}), len(chosen)


def _measure(here: Here, index: int, measured_s: float) -> tuple[float, float, float]:
    """The seconds of compiling, training and evaluating of a group; in mode halving by as many runs of the last rung as
    take the time of all."""
    plan, group = here.plan, here.plan.groups[index]
    runs = np.random.default_rng(0).permutation(group.runs[-len(group.first_runs) :])
    waiting = deque(runs[: int(np.ceil(len(runs) * plan.work / len(plan.points)))].tolist())
    size, devices = placement(group.learners, len(waiting), here.rooms[index])
    pool = Pool(group, waiting, size, devices, plan.config.seed, here.policies[index])
    began = time.monotonic()
    pool.fill()
    pool.train()
    pool.finish()
    compiled = time.monotonic()
    pool.finish()
    evaluate_s = time.monotonic() - compiled
    rounds = -(-len(runs) * plan.num_runs // (len(plan.points) * group.seeds * len(pool.slots)))
    train_s = _seconds_of_training(pool, measured_s)
    return max(compiled - began - evaluate_s, 0.0), train_s, rounds * evaluate_s


def _seconds_of_training(pool: Pool, measured_s: float) -> float:
    """Seconds that the runs of a pool train, by their pace in `measured_s`, s."""
    pace, trained_s, looks, over = Pace(), 0.0, 0, 0
    while pool.busy.any():
        pace.look(trained_s, Look("training", pool.slots.copy(), pool.progress, len(pool.waiting), over))
        if trained_s >= measured_s and looks >= LEAST_LOOKS and pace.left_s is not None:
            return trained_s + pace.left_s
        began = time.monotonic()
        pool.train()
        trained_s, looks = trained_s + time.monotonic() - began, looks + 1
        if harvest := pool.harvest():
            over += len(harvest[0])
            pool.fill()
    return trained_s


def time_in_words(seconds: float) -> str:
    """A time for a reader: `8 s`, `4 min`, `2.5 h`, `3 days`."""
    for unit, size, most in (("s", 1.0, 100.0), ("min", 60.0, 100.0), ("h", 3600.0, 48.0)):
        if seconds < most * size:
            return f"{seconds / size:.1f} {unit}" if unit == "h" else f"{max(seconds / size, 1.0):.0f} {unit}"
    return f"{seconds / 86_400.0:,.0f} days"
