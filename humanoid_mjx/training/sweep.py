"""Run a sweep: train every point into a run folder that can be resumed."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass
from functools import partial
from html import escape
from pathlib import Path
from types import NoneType
from typing import Any

import jax
import numpy as np

from humanoid_mjx.config import Config, load, parse
from humanoid_mjx.runs.folder import THEN, RunFolder, read_config, run_path
from humanoid_mjx.runs.ranking import BEST_POINTS, ranked
from humanoid_mjx.runs.tables import read_table
from humanoid_mjx.spec import InputError, check_count
from humanoid_mjx.training.chunks import EngineOf, Here
from humanoid_mjx.training.cost import check_disk
from humanoid_mjx.training.curves import Curves
from humanoid_mjx.training.plan import Plan, make_plan
from humanoid_mjx.training.progress import Reporter, reporting
from humanoid_mjx.training.session import Session
from humanoid_mjx.training.trackers import Tracker, Tracking


@dataclass(frozen=True)
class Run:
    """A run folder, as its reader sees it."""

    path: Path

    @property
    def config(self) -> Config:
        """The config that the run was made with, fully resolved."""
        return parse(read_config(self.path), str(self.path / "config.yaml"))

    @property
    def later(self) -> "Run | None":
        """The run that went on from this one in the world of `then`."""
        return Run(self.path / THEN) if (self.path / THEN).is_dir() else None

    @property
    def results(self) -> dict[str, np.ndarray]:
        """One entry per sweep point, seed and record step, by column."""
        return read_table(self.path / "results.parquet")

    @property
    def timing(self) -> dict[str, np.ndarray]:
        """One entry per sweep point, seed and record step: `wall_s`, seconds since training began."""
        return read_table(self.path / "timing.parquet")

    @property
    def summary(self) -> dict[str, np.ndarray]:
        """One entry per sweep point and seed, by column."""
        return read_table(self.path / "summary.parquet")

    @property
    def best(self) -> dict[str, Any]:
        """The best point: the values of the swept keys, `point`, and how it acts greedily."""
        return self.points()[0]

    def points(self) -> list[dict[str, Any]]:
        """All points whose runs are finished, as `best` has them, the best first (`runs.ranking`); in mode halving
        those that got furthest."""
        config, summary = self.config, self.summary
        axes = list(config.sweep.axes) if config.sweep else []
        return [
            dict(zip(axes, each.values, strict=True))
            | {"point": each.point, "greedy_success": each.success}
            | {"greedy_return": each.greedy_return, "greedy_steps": each.greedy_steps}
            for each in ranked(axes, summary, quickest=config.episodes is not None)
        ]

    def __str__(self) -> str:
        config, shown = self.config, [f"{self.path}: {_words(self.config)}"]
        if (self.path / "summary.parquet").is_file():
            shown.append(f"best: {', '.join(f'{key} {_number(value)}' for key, value in self.best.items())}")
        else:
            shown.append(f"no run of {config.name} is finished yet")
        return "; ".join(shown)

    def _repr_html_(self) -> str:
        head = f"<p><b>{escape(str(self.path))}</b>: {escape(_words(self.config))}</p>"
        if not (self.path / "summary.parquet").is_file():
            return head + "<p>No run is finished yet.</p>"
        best = self.points()[:BEST_POINTS]
        rows = ["".join(f"<th>{escape(key)}</th>" for key in best[0])]
        rows += ["".join(f"<td>{escape(_number(value))}</td>" for value in each.values()) for each in best]
        return f"{head}<table>{''.join(f'<tr>{row}</tr>' for row in rows)}</table>"


def _words(config: Config) -> str:
    axes = f", swept over {', '.join(config.sweep.axes)}" if config.sweep else ""
    return f"{config.learner['name']} on {config.task['name']}{axes}, {config.seeds:,} seeds"


def _number(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def sweep(
    config: Config | Mapping[str, Any] | str | Path,
    out: Path | str | None = None,
    *,
    resume: bool = False,
    overrides: Sequence[str] = (),
    pool_size: int | None = None,
    reporter: Reporter | None = None,
    quiet: bool = False,
    trackers: Sequence[str | Tracker] = (),
    watch: Sequence[Callable[[RunFolder, Plan], Curves]] = (),
    engine: EngineOf | None = None,
) -> Run:
    """Train every point of a sweep with every seed. With `then` in the config, train on in the folder `then` of the
    run folder.

    Args:
      config: a config, its plain values, a path, or the name of a shipped one.
      out: the run folder; by default the next of runs/NAME, runs/NAME-2, ..., or the last of them with `resume`.
      resume: complete a run folder instead of making one.
      overrides: such as "learner.epsilon=0.1"; only where `config` is a path or a name.
      pool_size: how many runs each device trains at once; by default what memory and cache hold. Tables learn the same
        bit by bit whatever it is; sums in networks round differently. Runs whose environments the cores of a CPU can
        share train one at a time.
      reporter: called with the progress; by default it is shown in a terminal or a notebook.
      quiet: show nothing.
      trackers: what follows it, such as "tensorboard", "wandb", "mlflow", "my.module:Class" or a `Tracker`.
      watch: makers of objects that are given the learning curves while they grow.
      engine: makes what trains, such as `training.on_ray.OnRay`; by default this process does, on all its devices.

    Raises:
      InputError: the config or the place cannot be used, in one sentence. Nothing stored is lost.
    """
    if isinstance(config, (str, Path)):
        config = load(config, overrides)
    elif overrides:
        raise InputError("sweep: overrides are for a config given by path or name; change these values themselves.")
    elif isinstance(config, Mapping):
        config = parse(dict(config))
    elif not isinstance(config, Config):
        raise InputError(f"sweep: config must be a config, its name or path, or a mapping of its keys, got {config!r}.")
    if pool_size is not None:
        check_count("sweep: pool_size", pool_size, 1)
    if not isinstance(reporter, Reporter | None):
        raise InputError(f"sweep: reporter must be a Reporter, got {reporter!r}.")
    if isinstance(trackers, str) or not isinstance(trackers, Sequence):
        raise InputError(f'sweep: trackers must be a list such as ["tensorboard"], got {trackers!r}.')
    check_later(config)  # before anything trains

    def first(config: Config, out: Path | str | None, resume: bool) -> Run:
        shown = nullcontext(reporter or Reporter()) if reporter or quiet else reporting()
        return sweep_first(config, out, resume, engine or partial(Here, pool_size=pool_size), shown, trackers, watch)

    run = last = first(config, out, resume)
    while later := last.config.later(last.path):
        out = last.path / THEN
        last = first(later, out, resume and out.exists())
    return run


def sweep_first(
    config: Config,
    out: Path | str | None,
    resume: bool,
    engine: EngineOf,
    shown: AbstractContextManager[Reporter],
    trackers: Sequence[str | Tracker] = (),
    watch: Sequence[Callable[[RunFolder, Plan], Curves]] = (),
) -> Run:
    """Train as `sweep` does, but not on in the world of `then`; `shown` opens what is told of the progress."""
    plan = make_plan(config)
    with (
        closing(engine(plan)) as trainer,
        shown as speaker,
        Tracking(trackers, speaker.note) as tracking,
        closing(open_folder(out, plan, resume, trainer.at_once)) as folder,
    ):
        session = Session(folder, plan, speaker, [make(folder, plan) for make in (*watch, *tracking.watch)])
        try:
            session.train(trainer)
            session.end()
        finally:
            session.write_results()
    return Run(folder.path)


def check_later(config: Config) -> None:
    """Raise an InputError if the training of `then` cannot be, or cannot go on from the first."""
    if later := config.later("the run folder"):
        first, second = (
            [jax.tree.map(lambda leaf: leaf.shape, group.policy) for group in make_plan(each).groups]
            for each in (config, later)
        )
        if first != second:
            raise InputError(f"{later.source}: what it learns has another size than before; leave sizes as they are.")


def train_chunks(run: Path, numbers: Sequence[int]) -> None:
    """Train some chunks of a run folder, of which other processes train others at the same time.

    Raises:
      InputError: the run folder or the machine cannot serve.
    """
    plan = make_plan(Run(run).config)
    engine = Here(plan)
    with closing(RunFolder.resume(run, plan.resolved(), shared=True)) as folder:
        Session(folder, plan, Reporter()).train(engine, numbers)


def open_folder(out: Path | str | None, plan: Plan, resume: bool, at_once: Sequence[int]) -> RunFolder:
    """The run folder of a sweep, of which so many runs of each group train `at_once`. Where no place is given and
    another sweep takes it meanwhile: the next free one.

    Raises:
      InputError: the place cannot be used, or its disk cannot hold the run.
    """
    if not isinstance(out, (str, Path, NoneType)) or "\0" in str(out):
        raise InputError(f"sweep: out must be the path of a run folder, got {out!r}.")
    place = Path(out or run_path(plan.config.name, resume))
    check_disk(place, plan, at_once)
    while True:
        try:
            return (RunFolder.resume if resume else RunFolder.create)(place, plan.resolved())
        except InputError:
            after = place if out or resume else run_path(plan.config.name)
            if after == place:
                raise
            place = after
