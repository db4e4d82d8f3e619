"""How long a sweep will take on this machine, from a short piece of its training."""

import time
from collections import deque
from collections.abc import Sequence
from threading import Event
from typing import NamedTuple

import numpy as np

from humanoid_mjx.learners.base import WholeRunLearner
from humanoid_mjx.training.plan import Group, Plan
from humanoid_mjx.training.pool import IDLE, Pool
from humanoid_mjx.training.programs import arranged
from humanoid_mjx.training.warm_start import earlier_policies
from humanoid_mjx.training.whole_runs import WholeRuns

MEASURED_S = 6.0
"""Seconds of training that are measured of a program, once it is compiled."""

MOST_PROGRAMS = 3
"""Programs of a sweep that are measured; the others are taken to be like their mean."""

LEAST_LOOKS = 4
"""Chunks of training that are measured even where they take longer."""


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
    common = plan.config.seed, earlier_policies(group)
    if isinstance(group.learners, WholeRunLearner):
        return _measure_whole_runs(WholeRuns(group, deque(runs), devices[0], *common, Event()), measured_s)
    pool = Pool(group, deque(runs), size, devices, *common, share)
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


def _measure_whole_runs(pool: WholeRuns, measured_s: float) -> tuple[float, float, float]:
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
