"""Learning curves as event files of TensorBoard, written while a sweep trains."""

import importlib
import re
import shutil
import time
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from humanoid_mjx.runs.folder import RunFolder
from humanoid_mjx.runs.tables import finished_runs, named
from humanoid_mjx.spec import InputError
from humanoid_mjx.training.plan import Plan
from humanoid_mjx.training.pool import Pool

FOLDER = "tensorboard"
"""Where the event files are in a run folder."""

MAX_POINTS = 30
"""The most sweep points that are written. Of more they are drawn by chance: even steps through a grid would confound
its axes."""

LOOK_EVERY_S = 2.0
"""Seconds between two looks at the curves of the runs under way."""

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
    """How many record points of each run are known."""
    written: Int[np.ndarray, " points"]
    """How many record points of each point are written."""

    @classmethod
    def blank(cls, points: int, seeds: int, record: int) -> "_Measure":
        return cls(np.full((points, seeds, record), np.nan), np.zeros((points, seeds), int), np.zeros(points, int))


class EventFiles:
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
        self.seeds, self.places = plan.config.seeds, plan.labels().places
        draw = np.random.default_rng(0).permutation(len(plan.points))
        self.points = np.sort(draw[:MAX_POINTS])
        place = partial(_name, len(str(len(plan.points) - 1)))
        writer = event_writer()
        self.writers = [
            writer(str(folder.path / FOLDER / place(number, plan.points[number]))) for number in self.points.tolist()
        ]
        self.measures: dict[str, _Measure] = {}
        self.looked = time.monotonic()
        done = finished_runs(folder.path, ("point", "seed", "curve.", "final."), folder.digest)
        if done:
            self.store(done["point"] * self.seeds + done["seed"], done)

    def look(self, pool: Pool) -> None:
        """Write what the runs under way have newly learned, now and then."""
        if time.monotonic() - self.looked < LOOK_EVERY_S:
            return
        self.looked = time.monotonic()
        rows, (points, seeds) = self._chosen(pool.slots)
        if not len(rows):
            return
        known = np.floor(np.minimum(pool.progress[rows], 1.0) * len(self.places) - 1e-6).astype(int)
        self._take(points, seeds, known, pool.curves(rows, len(self.points) * self.seeds))

    def store(self, runs: np.ndarray, arrays: dict[str, np.ndarray]) -> None:
        """Write the whole curves of runs that are over, and the scores of their greedy policies at the end."""
        rows, (points, seeds) = self._chosen(runs)
        curves = {name: curve[rows] for name, curve in named(arrays, "curve").items()}
        for name, score in named(arrays, "final").items():
            if name not in curves and name != "diverged":
                curves[name] = np.full((len(rows), len(self.places)), np.nan)
                curves[name][:, -1] = score[rows]
        self._take(points, seeds, np.full(len(rows), len(self.places)), curves)

    def close(self) -> None:
        """Write out what is still held back."""
        for writer in self.writers:
            writer.close()

    def _chosen(self, runs: np.ndarray) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
        """Which of some runs are written: their rows, and the index in `points` and the seed of each."""
        points, seeds = np.divmod(runs, self.seeds)
        rows = np.flatnonzero(np.isin(points, self.points) & (runs >= 0))
        return rows, (np.searchsorted(self.points, points[rows]), seeds[rows])

    def _take(self, points: np.ndarray, seeds: np.ndarray, known: np.ndarray, curves: dict[str, np.ndarray]) -> None:
        """Keep curves of some runs, of which so many record points are known, and write what all seeds have."""
        for name, curve in curves.items():
            if name not in self.measures:
                self.measures[name] = _Measure.blank(len(self.points), self.seeds, len(self.places))
            measure = self.measures[name]
            measure.curves[points, seeds] = curve
            measure.known[points, seeds] = np.maximum(measure.known[points, seeds], known)
            for point in np.unique(points).tolist():
                upto = int(measure.known[point].min())
                for place in range(measure.written[point], upto):
                    if np.isfinite(mean := measure.curves[point, :, place].mean()):
                        self.writers[point].add_scalar(name, float(mean), int(self.places[place]))
                measure.written[point] = max(upto, measure.written[point])
        for point in np.unique(points).tolist():
            self.writers[point].flush()


def _name(digits: int, number: int, values: dict[str, Any]) -> str:
    """The sub-folder of a point: `07_epsilon=0.3_learning_rate=0.1`, of characters that every file system takes."""
    words = [f"{key.partition('.')[2]}={f'{v:.3g}' if isinstance(v, float) else v}" for key, v in values.items()]
    name = "_".join([f"{number:0{digits}d}", *words])
    return re.sub(r"[^\w.=+-]", "-", name, flags=re.ASCII)[:LABEL_LETTERS]
