"""Learning curves as far as they are known while a sweep trains."""

import threading
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from humanoid_mjx.runs.folder import RunFolder
from humanoid_mjx.runs.tables import finished_runs, named, run_numbers
from humanoid_mjx.training.plan import Plan


class _Measure(NamedTuple):
    """The curves of a measure, as far as they are known."""

    curves: Float[np.ndarray, "points seeds record"]
    known: Int[np.ndarray, "points seeds"]
    """Number of record points of each run that are known."""


def chosen_points(plan: Plan, most: int) -> Int[np.ndarray, " points"]:
    """Return the numbers of all points of a sweep, of more than `most` so many by chance: even steps through a grid
    would confound its axes. Of a search by halving all: few of them reach the last rung."""
    most = most if len(plan.rungs) == 1 else len(plan.points)
    return np.sort(np.random.default_rng(0).permutation(len(plan.points))[:most])


class Curves:
    """The learning curves of at most `most` points of a sweep, as far as they are known while it trains."""

    def __init__(self, folder: RunFolder, plan: Plan, most: int):
        """Begin with the runs that are finished already."""
        self.plan, self.seeds, self.places = plan, plan.config.seeds, plan.places[-1]
        self.points = chosen_points(plan, most)
        self.measures: dict[str, _Measure] = {}
        self.lock = threading.Lock()
        """Held while the measures change."""
        done = finished_runs(folder.path, ("point", "seed", "curve.", "final."))
        if done:
            self.store(run_numbers(done, len(plan.points), self.seeds), done)

    def grow(self, runs: np.ndarray, progress: np.ndarray, curves: dict[str, np.ndarray]) -> None:
        """Take note of the curves so far of runs under way."""
        rows, (points, seeds) = self._chosen(runs)
        if len(rows):
            known = np.floor(np.minimum(progress[rows], 1.0) * len(self.places) - 1e-6).astype(int)
            self._take(points, seeds, known, {name: curve[rows] for name, curve in curves.items()})

    def store(self, runs: np.ndarray, arrays: dict[str, np.ndarray]) -> None:
        """Take note of the whole curves of runs that are over, and the scores of their greedy policies at the end."""
        rows, (points, seeds) = self._chosen(runs)
        curves = {name: curve[rows] for name, curve in named(arrays, "curve").items()}
        for name, score in named(arrays, "final").items():
            if name not in curves and name != "diverged":
                curves[name] = np.full((len(rows), len(self.places)), np.nan)
                curves[name][:, -1] = score[rows]
        self._take(points, seeds, np.full(len(rows), len(self.places)), curves)

    def _chosen(self, runs: np.ndarray) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
        """Rows of the runs that belong to the points at the last rung, with the index in `points` and the seed of
        each."""
        points, seeds = np.divmod(runs, self.seeds)
        points = points - (len(self.plan.rungs) - 1) * len(self.plan.points)
        rows = np.flatnonzero(np.isin(points, self.points) & (runs >= 0))
        return rows, (np.searchsorted(self.points, points[rows]), seeds[rows])

    def _take(self, points: np.ndarray, seeds: np.ndarray, known: np.ndarray, curves: dict[str, np.ndarray]) -> None:
        """Keep curves of some runs, of which so many record points are known."""
        with self.lock:
            for name, curve in curves.items():
                shape = len(self.points), self.seeds
                blank = _Measure(np.full((*shape, len(self.places)), np.nan), np.zeros(shape, int))
                measure = self.measures.setdefault(name, blank)
                measure.curves[points, seeds] = curve
                measure.known[points, seeds] = np.maximum(measure.known[points, seeds], known)
