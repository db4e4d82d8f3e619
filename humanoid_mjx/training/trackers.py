"""Trackers, which follow points of a sweep while it trains: TensorBoard, Weights & Biases, MLflow or your own."""

import os
import re
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from humanoid_mjx.runs.folder import RunFolder
from humanoid_mjx.spec import InputError, find, package
from humanoid_mjx.training.curves import Curves, chosen_points
from humanoid_mjx.training.plan import Plan, at_point
from humanoid_mjx.user_code import in_words

KINDS = {"mlflow": "MLflow", "tensorboard": "TensorBoard", "wandb": "WandB"}
TRACKERS = {name: f"humanoid_mjx.training.trackers:{kind}" for name, kind in KINDS.items()}

MAX_POINTS = 30
"""The most sweep points that trackers follow."""

PROJECT = "humanoid_mjx"
"""Default project of Weights & Biases and experiment of MLflow."""

METRICS, EVERY_S = 1000, 5.0
"""The most values that MLflow takes at once, and the time from one call to the next, s: each costs a transaction."""


class Tracker:
    """Base of trackers: override any of the three methods."""

    def on_start(self, folder: Path, config: dict[str, Any], points: Mapping[str, Mapping[str, Any]]) -> None:
        """Begin to follow the sweep of this config into a run folder; an error ends the sweep.

        `points`: the swept values of each point that is followed, by the point's name, such as `07_epsilon=0.3`.
        """

    def on_record(self, point: str, step: int, means: Mapping[str, float]) -> None:
        """Take the means over all seeds of a point, by measure, after so many episodes or control steps, as soon as
        the last seed is there. Each value comes once; greedy scores of earlier steps come when the runs are over."""

    def on_end(self, files: Sequence[Path], finished: bool) -> str | None:
        """End, and return a line that tells the user where to look, if any. `files`: figures and the best policy, from
        the command `sweep`; `finished`: False if the sweep was stopped."""


class Tracking:
    """The trackers of a sweep, within `with`. One that fails is left out from there on: training is worth more."""

    def __init__(self, trackers: Sequence[str | Tracker], note: Callable[[str], None]):
        """Make those that are given by name or import path. `note` takes remarks for the user.

        Raises:
          InputError: there is no such tracker, or the package that it needs is not installed.
        """
        self.trackers = [find("tracker", TRACKERS, Tracker, t)() if isinstance(t, str) else t for t in trackers]
        self.watch = [partial(_Means, self)] if self.trackers else []
        """Makers of what a sweep tells its learning curves (`training.sweep.sweep`)."""
        self.files: list[Path] = []
        self.lines: list[str] = []
        """Lines for the user, after the block."""
        self._note, self._started = note, list[Tracker]()

    def __enter__(self) -> "Tracking":
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        self.lines = [line for line in self.tell("on_end", self.files, kind is None) if line]

    def start(self, *given: Any) -> None:
        for tracker in self.trackers:
            try:
                tracker.on_start(*given)
            except Exception as error:
                raise InputError(f"{type(tracker).__name__} cannot track this sweep: {in_words(error)}.") from error
            self._started.append(tracker)

    def tell(self, method: str, *given: Any) -> list[Any]:
        answers = []
        for tracker in tuple(self._started):
            try:
                answers.append(getattr(tracker, method)(*given))
            except Exception as error:
                self._started.remove(tracker)
                self._note(f"{type(tracker).__name__} no longer tracks this sweep: {in_words(error)}.")
        return answers


class _Means(Curves):
    """Learning curves that tell trackers the means over all seeds of each point, once each."""

    def __init__(self, tracking: Tracking, folder: RunFolder, plan: Plan):
        digits = len(str(len(plan.points) - 1))
        points = {_name(digits, n, plan.points[n]): plan.points[n] for n in chosen_points(plan, MAX_POINTS).tolist()}
        tracking.start(folder.path, plan.resolved(), points)
        self.tracking, self.names = tracking, list(points)
        super().__init__(folder, plan, MAX_POINTS)

    def _take(self, points: np.ndarray, seeds: np.ndarray, known: np.ndarray, curves: dict[str, np.ndarray]) -> None:
        told = {name: each.known.min(axis=1) for name, each in self.measures.items()}
        super()._take(points, seeds, known, curves)
        for point in np.unique(points).tolist():
            since = {name: int(told[name][point]) if name in told else 0 for name in curves}
            upto = {name: int(self.measures[name].known[point].min()) for name in curves}
            for place in range(min(since.values()), max(upto.values())):
                new = [name for name in curves if since[name] <= place < upto[name]]
                means = {name: float(self.measures[name].curves[point, :, place].mean()) for name in new}
                if means := {name: mean for name, mean in means.items() if np.isfinite(mean)}:
                    self.tracking.tell("on_record", self.names[point], int(self.places[place]), means)


def _name(digits: int, number: int, values: dict[str, Any]) -> str:
    """The name of a point: `07_epsilon=0.3_learning_rate=0.1`, of characters that every file system takes."""
    words = [f"{key.partition('.')[2]}={f'{v:.3g}' if isinstance(v, float) else v}" for key, v in values.items()]
    name = "_".join([f"{number:0{digits}d}", *words])
    return re.sub(r"[^\w.=+-]", "-", name, flags=re.ASCII)[:100]


class TensorBoard(Tracker):
    """Event files in the run folder, a sub-folder for each point. A resumed sweep writes them anew."""

    def __init__(self) -> None:
        self.writer = package("tensorboardX", "tensorboard", "--tracker tensorboard").SummaryWriter

    def on_start(self, folder: Path, config: dict[str, Any], points: Mapping[str, Mapping[str, Any]]) -> None:
        self.folder = folder / "tensorboard"
        shutil.rmtree(self.folder, ignore_errors=True)
        self.writers: dict[str, Any] = {}

    def on_record(self, point: str, step: int, means: Mapping[str, float]) -> None:
        writer = self.writers.get(point) or self.writers.setdefault(point, self.writer(str(self.folder / point)))
        for name, mean in means.items():
            writer.add_scalar(name, mean, step)
        writer.flush()

    def on_end(self, files: Sequence[Path], finished: bool) -> str:
        for writer in self.writers.values():
            writer.close()
        return f"tensorboard --logdir {self.folder}"


class WandB(Tracker):
    """Weights & Biases: a group of runs, one for each point and one of the sweep with figures and the best policy.

    WANDB_PROJECT, WANDB_MODE and the other variables of the environment count. A resumed sweep begins new runs. Files
    are in `wandb/` of the working directory: they hold links, which run folders may not.
    """

    def __init__(self) -> None:
        self.wandb = package("wandb", "wandb", "--tracker wandb")

    def on_start(self, folder: Path, config: dict[str, Any], points: Mapping[str, Mapping[str, Any]]) -> None:
        place = {"project": os.environ.get("WANDB_PROJECT", PROJECT), "group": folder.name}
        settings = self.wandb.Settings(silent=True, console="off")
        self._start = partial(self.wandb.init, **place, reinit="create_new", settings=settings)
        self.folder, self.sweep = folder, self._start(name=folder.name, job_type="sweep", config=config)
        self.configs = {name: at_point(config, values) for name, values in points.items()}
        self.runs: dict[str, Any] = {}

    def on_record(self, point: str, step: int, means: Mapping[str, float]) -> None:
        if point not in self.runs:
            self.runs[point] = self._start(name=point, job_type="point", config=self.configs[point])
            self.runs[point].define_metric("*", step_metric="trained")  # the own count of W&B may not fall
        self.runs[point].log({"trained": step, **means})

    def on_end(self, files: Sequence[Path], finished: bool) -> str:
        for path in files:
            if path.suffix == ".png":
                self.sweep.log({path.stem: self.wandb.Image(str(path))})
            else:
                self.sweep.log_artifact(str(path), name=f"{self.folder.name}-{path.stem}", type="model")
        here = f"wandb sync {Path(self.sweep.dir).parents[1]}/offline-run-*" if self.sweep.offline else self.sweep.url
        for run in (*self.runs.values(), self.sweep):
            run.finish(exit_code=int(not finished))
        return here


class MLflow(Tracker):
    """MLflow: a run of the sweep with config, figures and the best policy, and below it a run for each point.

    The variables MLFLOW_TRACKING_URI and MLFLOW_EXPERIMENT_NAME count. A resumed sweep begins new runs.
    """

    def __init__(self) -> None:
        self.mlflow = package("mlflow", "mlflow", "--tracker mlflow")

    def on_start(self, folder: Path, config: dict[str, Any], points: Mapping[str, Mapping[str, Any]]) -> None:
        self.client = self.mlflow.MlflowClient()
        place = self.mlflow.set_experiment(os.environ.get("MLFLOW_EXPERIMENT_NAME", PROJECT)).experiment_id
        self.sweep = self.client.create_run(place, run_name=folder.name).info.run_id
        self.client.log_dict(self.sweep, config, "config.yaml")
        self._child = partial(self.client.create_run, place, tags={"mlflow.parentRunId": self.sweep})
        self.points, self.runs, self.waiting = points, dict[str, str](), dict[str, list[Any]]()
        self.due = time.monotonic() + EVERY_S

    def on_record(self, point: str, step: int, means: Mapping[str, float]) -> None:
        if point not in self.runs:
            self.runs[point], self.waiting[point] = self._child(run_name=point).info.run_id, []
            params = [self.mlflow.entities.Param(key, str(value)) for key, value in self.points[point].items()]
            self.client.log_batch(self.runs[point], params=params)
        now = int(time.time() * 1000)
        self.waiting[point] += [self.mlflow.entities.Metric(name, mean, now, step) for name, mean in means.items()]
        if time.monotonic() > self.due:
            self._log()

    def _log(self) -> None:
        for point, metrics in self.waiting.items():
            for first in range(0, len(metrics), METRICS):
                self.client.log_batch(self.runs[point], metrics=metrics[first : first + METRICS])
            metrics.clear()
        self.due = time.monotonic() + EVERY_S

    def on_end(self, files: Sequence[Path], finished: bool) -> str:
        self._log()
        for path in files:
            self.client.log_artifact(self.sweep, str(path))
        for run in (*self.runs.values(), self.sweep):
            self.client.set_terminated(run, "FINISHED" if finished else "KILLED")
        return f"mlflow ui --backend-store-uri {self.mlflow.get_tracking_uri()}"
