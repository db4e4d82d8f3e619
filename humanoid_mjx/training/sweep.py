"""Run a sweep: train every point into a run folder that can be resumed."""

import gc
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

from humanoid_mjx import runtime
from humanoid_mjx.config import Config, load, parse
from humanoid_mjx.learners.base import WholeRunLearner
from humanoid_mjx.runs.folder import (
    POOL,
    RunFolder,
    damaged,
    diverged_name,
    fresh_path,
    latest_path,
    read_arrays,
    read_config,
    read_provenance,
)
from humanoid_mjx.runs.tables import finished_runs, read_table, write_tables
from humanoid_mjx.spec import InputError
from humanoid_mjx.training.disk import check_disk
from humanoid_mjx.training.events import EventFiles, event_writer
from humanoid_mjx.training.memory import runs_that_fit, slots, training_bytes
from humanoid_mjx.training.plan import Group, Plan, make_plan, resolved
from humanoid_mjx.training.pool import COMPILING, Pool
from humanoid_mjx.training.progress import Reporter
from humanoid_mjx.training.speed import Speed
from humanoid_mjx.training.warm_start import earlier_policies
from humanoid_mjx.training.whole_runs import WholeRuns
from humanoid_mjx.types import Device

CHECKPOINT_EVERY_S = 30.0
"""Seconds of training that a kill may cost."""

TABLES_SHARE = 0.05
"""The share of the wall time that rewriting the tables may take while runs finish."""

LEAVE_AFTER_S = 5.0
"""Seconds that training has after an interrupt to store what it did since the last checkpoint. A compiler cannot be
interrupted, so a thread that compiles is left behind."""


@dataclass(frozen=True)
class Run:
    """A run folder, as its reader sees it."""

    path: Path

    @property
    def config(self) -> Config:
        """The config that the run was made with, fully resolved."""
        return parse(read_config(self.path), str(self.path / "config.yaml"))

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


def sweep(
    config: Config | Mapping[str, Any] | str | Path,
    out: Path | str | None = None,
    *,
    resume: bool = False,
    overrides: Sequence[str] = (),
    pool_size: int | None = None,
    reporter: Reporter | None = None,
    tensorboard: bool = False,
) -> Run:
    """Train every point of a sweep with every seed.

    Args:
      config: a config, its plain values, a path, or the name of a shipped one.
      out: the run folder; by default the first free of runs/NAME, runs/NAME-2, ..., or the latest to be resumed.
      resume: complete a run folder instead of making one.
      overrides: such as "learner.epsilon=0.1"; only where `config` is a path or a name.
      pool_size: how many runs train at once; by default what memory and cache hold. Tables learn the same
        bit by bit whatever it is; sums in networks round differently.
      reporter: called with the progress; by default nothing is shown.
      tensorboard: write learning curves as event files of TensorBoard into the run folder while it trains.

    Raises:
      InputError: the config or the place cannot be used, in one sentence. Nothing stored is lost.
    """
    if isinstance(config, (str, Path)):
        config = load(config, overrides)
    elif isinstance(config, Mapping):
        config = parse(dict(config))
    plan = make_plan(config)
    sizes = [pool_size or runs_that_fit(group, jax.local_devices()[0]) for group in plan.groups]
    policies = [earlier_policies(group) for group in plan.groups]
    if tensorboard:
        event_writer()
    place = Path(out or (latest_path if resume else fresh_path)(config.name))
    check_disk(place, plan, [slots(group, size) for group, size in zip(plan.groups, sizes, strict=True)])
    folder = _open(place, config, resume, given=out is not None)
    try:
        session = _Session(folder, plan, reporter or Reporter(), EventFiles(folder, plan) if tensorboard else None)
        session.reporter.begin(plan.num_runs * plan.budget, f"{plan.unit}s")
        try:
            for index in range(len(plan.groups)):
                session.train(index, sizes[index], policies[index])
        finally:
            session.write_results()
            if session.events:
                session.events.close()
    finally:
        folder.close()
    return Run(folder.path)


def _open(place: Path, config: Config, resume: bool, given: bool) -> RunFolder:
    """The run folder of a sweep. Where no place was given and another sweep takes it meanwhile: the next free one."""
    while True:
        try:
            return (RunFolder.resume if resume else RunFolder.create)(place, resolved(config))
        except InputError:
            after = place if given or resume else fresh_path(config.name)
            if after == place:
                raise
            place = after


class _Session:
    """The work of one process on a run folder."""

    def __init__(self, folder: RunFolder, plan: Plan, reporter: Reporter, events: EventFiles | None):
        self.folder, self.plan, self.reporter, self.events = folder, plan, reporter, events
        for part in folder.parts():
            read_arrays(part)  # a damaged policy would else be found after the sweep that could have trained it again
        done = finished_runs(folder.path, ("point", "seed"))
        self.finished = set((done["point"] * plan.config.seeds + done["seed"]).tolist()) if done else set()
        if self.finished and not 0 <= min(self.finished) <= max(self.finished) < plan.num_runs:
            raise InputError(f"{folder.path / 'checkpoint'}: what it holds does not fit this training.")
        self.earlier = read_provenance(folder.path)
        self.began = self.tables_due = time.monotonic()
        self.started = datetime.now(UTC).isoformat(timespec="seconds")
        self.compile_s = self.shown = 0.0
        self.speed = Speed()
        self.tables_are_old = True
        self.lock, self.stop = threading.Lock(), threading.Event()

    def train(self, index: int, size: int, policies: Any) -> None:
        """Train the runs of a group that are not finished yet, at most `size` at once on each device, and fewer where
        the memory turns out not to suffice.

        Raises:
          InputError: it does not suffice for one run.
        """
        group = self.plan.groups[index]
        whole = isinstance(group.learners, WholeRunLearner)
        # Not the number still waiting: networks' sums depend on how many runs are side by side, also after a resume.
        devices = jax.local_devices()[: 1 if whole else len(group.runs)]
        size = 1 if whole else min(size, -(-len(group.runs) // len(devices)))
        while waiting := deque(run for run in group.runs.tolist() if run not in self.finished):
            try:
                self._train_side_by_side(index, waiting, size, devices, policies)
            except Exception as error:
                if not runtime.out_of_memory(error):
                    raise
                self._too_large(group, size * len(devices))
            gc.collect()  # the arrays of a pool that failed; its error's frames held them
            size //= 2
            self.speed.pause()

    def _too_large(self, group: Group, slots: int) -> None:
        """Say that the memory does not suffice for so many runs side by side.

        Raises:
          InputError: they are as few as can be.
        """
        if slots <= len(jax.local_devices()):
            raise InputError(
                f"{self.folder.path}: the memory does not suffice for one run, which is estimated to need "
                f"{training_bytes(group) / 2**20:,.0f} MiB; make the task or the learner smaller."
            )
        self.reporter.note(f"the memory does not suffice for {slots:,} runs side by side; half as many go on")

    def _train_side_by_side(
        self, index: int, waiting: deque[int], size: int, devices: Sequence[Device], policies: Any
    ) -> None:
        """Train the waiting runs of a group, `size` at once on each of the devices."""
        group = self.plan.groups[index]
        self.stop.clear()
        self.reporter.note(self._side_by_side(group, size * len(devices)))
        with runtime.counting_compiles() as compiles:
            common = self.plan.config.seed, policies
            if isinstance(group.learners, WholeRunLearner):
                pool = WholeRuns(group, waiting, devices[0], *common, self.stop)
            else:
                pool = Pool(group, waiting, size, devices, *common)
            if self.events:
                pool.looked = partial(self.events.look, pool)
            self._restore(index, pool)
            self._work_in_a_thread(index, pool)
        self.compile_s += compiles.seconds
        self.tables_are_old = True
        for path in self.folder.pools():
            path.unlink()

    def _work_in_a_thread(self, index: int, pool: Pool) -> None:
        """Train what waits, and report how it goes.

        Raises:
          what training raised; or KeyboardInterrupt, once what is under way is stored.
        """
        errors: list[BaseException] = []

        def work() -> None:
            try:
                self._work(index, pool)
            except BaseException as error:
                errors.append(error)

        thread = threading.Thread(target=work, daemon=True)
        thread.start()
        try:
            while thread.is_alive():
                thread.join(0.1)
                self._report(pool)
                if time.monotonic() >= self.tables_due:
                    self.write_results()
        finally:
            self.stop.set()
            self._leave(index, pool, thread)
        if errors:
            raise errors[0]

    def _leave(self, index: int, pool: Pool, thread: threading.Thread) -> None:
        """Wait until training has stored what is under way; do it where it compiles and cannot answer."""
        deadline = time.monotonic() + LEAVE_AFTER_S
        while thread.is_alive() and pool.phase not in COMPILING and time.monotonic() < deadline:
            thread.join(0.05)
        if thread.is_alive() and pool.phase in COMPILING and pool.busy.any():
            self._store_under_way(index, pool)

    def _store_under_way(self, index: int, pool: Pool) -> None:
        self.folder.write_arrays(POOL, {"group": np.array(index)} | pool.state())

    def _side_by_side(self, group: Group, slots: int) -> str:
        """How many runs train at once, and what memory that is estimated to take."""
        runs, memory = len(group.runs), slots * training_bytes(group) / 2**20
        return f"{min(slots, runs):,} of {runs:,} runs train side by side, in an estimated {memory:,.0f} MiB"

    def _work(self, index: int, pool: Pool) -> None:
        """Train the waiting runs until none is left."""
        saved = time.monotonic()
        pool.fill()
        while pool.busy.any():
            if self.stop.is_set() or time.monotonic() - saved > CHECKPOINT_EVERY_S:
                self._store_under_way(index, pool)
                saved = time.monotonic()
            if self.stop.is_set():
                return
            pool.train()
            if not self.stop.is_set() and (harvest := pool.harvest()):
                for run, arrays in pool.diverged.items():
                    self.folder.write_arrays(diverged_name(*divmod(run, self.plan.config.seeds)), arrays)
                pool.diverged.clear()
                self._store(*harvest)
                pool.fill()

    def _store(self, runs: np.ndarray, arrays: dict[str, np.ndarray]) -> None:
        points, seeds = np.divmod(runs, self.plan.config.seeds)
        with self.lock:
            self.folder.add_part({"point": points.astype(np.int32), "seed": seeds.astype(np.int32)} | arrays)
            self.finished.update(runs.tolist())
            self.tables_are_old = True
        if self.events:
            self.events.store(runs, arrays)

    def _report(self, pool: Pool) -> None:
        busy = pool.busy
        self.reporter.phase(pool.phase)
        if under_way := float(np.minimum(pool.progress[busy], 1.0).sum()):
            known = pool.recent[busy][np.isfinite(pool.recent[busy]).all(axis=1)]
            success, mean_return, length = map(float, known.mean(axis=0)) if len(known) else (None, None, None)
            # Runs that were harvested are for a moment neither under way nor stored.
            self.shown = max(self.shown, (len(self.finished) + under_way) * self.plan.budget)
            self.speed.look(time.monotonic(), self.shown)
            if length is not None:
                self.reporter.length(length)
            self.reporter.update(self.shown, success, mean_return)

    def _restore(self, index: int, pool: Pool) -> None:
        """Take up the runs of this group that an interrupted session, perhaps on other devices, had under way."""
        for path in self.folder.pools():
            arrays = read_arrays(path)
            try:
                if int(arrays["group"]) == index:
                    pool.restore(arrays, str(path))
            except (LookupError, TypeError, ValueError) as error:
                raise damaged(path, "does not fit this training") from error

    def write_results(self) -> None:
        """Bring tables and provenance up to date with the finished runs."""
        if not self.tables_are_old:
            return
        start = time.monotonic()
        self.tables_are_old = False
        with self.lock:
            finished = write_tables(self.folder, self.plan.labels())
        if finished == self.earlier.get("runs_finished"):
            return
        session = {
            "started": self.started,
            "wall_s": round(start - self.began, 3),
            "compile_s": round(self.compile_s, 3),
        } | self.speed.rates(self.plan, self.folder.path)
        sessions = [*self.earlier.get("sessions", []), session]
        provenance = {
            "versions": runtime.versions(),
            "machine": runtime.machine(),
            "precision": "float64" if jax.config.read("jax_enable_x64") else "float32",
            "seed": self.plan.config.seed,
            "points": len(self.plan.points),
            "runs": self.plan.num_runs,
            "runs_finished": finished,
            "started": sessions[0]["started"],
            "wall_s": round(sum(each["wall_s"] for each in sessions), 3),
            "compile_s": round(sum(each["compile_s"] for each in sessions), 3),
            **self.speed.rates(self.plan, self.folder.path),
            "sessions": sessions,
        }
        self.folder.write_json("provenance.json", provenance)
        now = time.monotonic()
        self.tables_due = now + (now - start) / TABLES_SHARE
