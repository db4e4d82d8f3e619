"""Learning curves while a sweep trains, and as event files of TensorBoard."""

import importlib
import re
import shutil
import threading
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from humanoid_mjx.runs.folder import RunFolder
from humanoid_mjx.runs.tables import finished_runs, named, run_numbers
from humanoid_mjx.spec import InputError
from humanoid_mjx.training.plan import Plan

FOLDER = "tensorboard"
"""Folder of the event files in a run folder."""

MAX_POINTS = 30
"""The most sweep points that are written."""

LABEL_LETTERS = 100


def event_writer() -> Any:
    """The class that writes event files.

    Raises:
      InputError: the package that has it is not installed.
    """
    try:
        return importlib.import_module("tensorboardX").SummaryWriter
    except ImportError as error:
        raise InputError(
            "--tensorboard needs the package tensorboardX; pip install 'humanoid-mjx[tensorboard]' brings it."
        ) from error


class _Measure(NamedTuple):
    """The curves of a measure, as far as they are known."""

    curves: Float[np.ndarray, "points seeds record"]
    known: Int[np.ndarray, "points seeds"]
    """Number of record points of each run that are known."""
    written: Int[np.ndarray, " points"]
    """Number of record points of each point that are written."""


class Curves:
    """The learning curves of the points of a sweep, as far as they are known while it trains.

    Of more than `most` points so many are drawn by chance: even steps through a grid would confound its axes.
    """

    def __init__(self, folder: RunFolder, plan: Plan, most: int):
        """Begin with the runs that are finished already."""
        self.plan, self.seeds, self.places = plan, plan.config.seeds, plan.labels().places[-1]
        most = most if len(plan.rungs) == 1 else len(plan.points)  # few of them reach the last rung
        self.points = np.sort(np.random.default_rng(0).permutation(len(plan.points))[:most])
        self.measures: dict[str, _Measure] = {}
        self.lock = threading.Lock()
        """Held while the measures change."""
        done = finished_runs(folder.path, ("point", "seed", "curve.", "final."), folder.digest)
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

    def close(self) -> None:
        """The sweep is over."""

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
                blank = np.full((*shape, len(self.places)), np.nan), np.zeros(shape, int), np.zeros(shape[0], int)
                measure = self.measures.setdefault(name, _Measure(*blank))
                measure.curves[points, seeds] = curve
                measure.known[points, seeds] = np.maximum(measure.known[points, seeds], known)


class EventFiles(Curves):
    """The event files of a run folder: a sub-folder for each point, a scalar for each measure of a learning curve.

    A value is the mean over all seeds of a point, as results.parquet has them, and is written as soon as the last of
    them has it. A resumed sweep writes the files anew, from what is stored.
    """

    def __init__(self, folder: RunFolder, plan: Plan):
        """Begin with the runs that are finished already.

        Raises:
          InputError: the package that writes event files is not installed.
        """
        shutil.rmtree(folder.path / FOLDER, ignore_errors=True)
        place, writer = partial(_name, len(str(len(plan.points) - 1))), event_writer()
        self.writers: dict[int, Any] = {}
        self._new = lambda number: writer(str(folder.path / FOLDER / place(number, plan.points[number])))
        super().__init__(folder, plan, MAX_POINTS)

    def close(self) -> None:
        """Write out what is still held back."""
        for writer in self.writers.values():
            writer.close()

    def _take(self, points: np.ndarray, seeds: np.ndarray, known: np.ndarray, curves: dict[str, np.ndarray]) -> None:
        """Keep curves, and write what all seeds of a point have."""
        super()._take(points, seeds, known, curves)
        for point in np.unique(points).tolist():
            number = int(self.points[point])
            writer = self.writers.get(number) or self.writers.setdefault(number, self._new(number))
            for name in curves:
                measure = self.measures[name]
                upto = int(measure.known[point].min())
                for place in range(measure.written[point], upto):
                    if np.isfinite(mean := measure.curves[point, :, place].mean()):
                        writer.add_scalar(name, float(mean), int(self.places[place]))
                measure.written[point] = max(upto, measure.written[point])
            writer.flush()


def _name(digits: int, number: int, values: dict[str, Any]) -> str:
    """The sub-folder of a point: `07_epsilon=0.3_learning_rate=0.1`, of characters that every file system takes."""
    words = [f"{key.partition('.')[2]}={f'{v:.3g}' if isinstance(v, float) else v}" for key, v in values.items()]
    name = "_".join([f"{number:0{digits}d}", *words])
    return re.sub(r"[^\w.=+-]", "-", name, flags=re.ASCII)[:LABEL_LETTERS]
