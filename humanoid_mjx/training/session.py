"""The work of one process on a run folder: groups of runs trained in turn, stored, resumed, reported."""

import contextlib
import gc
import threading
import time
from collections import deque
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import jax
import numpy as np

from humanoid_mjx import compute
from humanoid_mjx.compute.processes import Processes
from humanoid_mjx.runs.archive import check_finite
from humanoid_mjx.runs.folder import REMOVE, RunFolder, damaged, diverged_name, pools, read_arrays, read_provenance
from humanoid_mjx.runs.tables import finished_runs, scores, write_tables
from humanoid_mjx.spec import InputError
from humanoid_mjx.training.cost import training_bytes
from humanoid_mjx.training.events import Curves
from humanoid_mjx.training.pace import COMPILING, Look, Pace
from humanoid_mjx.training.plan import Plan
from humanoid_mjx.training.pool import IDLE, Pool
from humanoid_mjx.training.program import SHOWN
from humanoid_mjx.training.programs import Devices, in_turn, placement
from humanoid_mjx.training.progress import Reporter, State

CHECKPOINT_EVERY_S = 30.0
"""Seconds of training that a kill may cost."""

TABLES_AFTER_S = 60.0
"""Seconds after which tables are written while it trains; those of a shorter sweep are written once."""

TABLES_SHARE = 0.05
"""The share of the wall time that rewriting the tables may take while runs finish."""

LEAVE_AFTER_S = 5.0
"""Seconds that training has after an interrupt to store what it did since the last checkpoint. A compiler cannot be
interrupted, so a thread that compiles is left behind."""


class Session:
    """The work of one process on a run folder."""

    def __init__(
        self, folder: RunFolder, plan: Plan, processes: Processes, reporter: Reporter, watchers: Sequence[Curves]
    ):
        self.folder, self.plan, self.processes, self.reporter = folder, plan, processes, reporter
        self.watchers = watchers
        for part in folder.parts():
            # Check policies now: a damaged one can still be trained again by this sweep.
            arrays = read_arrays(part, digest=folder.digest)
            if not np.any(arrays.get("final.diverged")):
                policies = {name: array for name, array in arrays.items() if name.startswith("policy")}
                check_finite(policies, f"{part}: it", REMOVE)
        self.mine = set(processes.share(np.concatenate([group.runs for group in plan.groups])).tolist())
        done = finished_runs(folder.path, ("point", "seed"), folder.digest)
        finished = set((done["point"] * plan.config.seeds + done["seed"]).tolist()) if done else set()
        if finished and not 0 <= min(finished) <= max(finished) < plan.num_runs:
            raise InputError(f"{folder.path / 'checkpoint'}: what it holds does not fit this training.")
        self.finished = finished & self.mine
        self.interrupted = self._under_way()
        processes.meet()  # before anyone writes
        self.earlier = {}
        with contextlib.suppress(InputError):  # a damaged one is written anew
            self.earlier = read_provenance(folder.path)
        self.began = time.monotonic()
        self.tables_due = self.began + TABLES_AFTER_S
        self.started = datetime.now(UTC).isoformat(timespec="seconds")
        self.made_by = compute.made_by()
        self.compile_s = 0.0
        self.scores = np.zeros((len(plan.points), 3))
        """Of each point the number of runs that this session has finished, and the sums of their success and return."""
        self.best: tuple[float, float] | None = None
        self.pace = Pace(plan.num_runs, len(plan.groups))
        self.tables_are_old = True
        self.lock, self.stop = threading.Lock(), threading.Event()

    def train(self, index: int, room: int, policies: Any) -> None:
        """Train the runs of a group that are not finished yet, at most `room` at once, and fewer where
        the memory turns out not to suffice.

        Raises:
          InputError: it does not suffice for one run.
        """
        group = self.plan.groups[index]
        mine = [run for run in group.runs.tolist() if run in self.mine]
        # By all runs, not by those that wait: networks round differently with another number of runs side by side.
        for runs in in_turn(group.learners, mine, room):
            self._train_runs(index, runs, *placement(group.learners, len(runs), room), policies)

    def _train_runs(self, index: int, runs: list[int], size: int, devices: Devices, policies: Any) -> None:
        """Train those of the runs that are not finished yet, `size` at once on each of the devices or rows of them."""
        group = self.plan.groups[index]
        while waiting := deque(run for run in runs if run not in self.finished):
            slots = size * len(devices)
            where = f" in process 0 of {self.processes.count}" if self.processes.count > 1 else ""
            self.reporter.note(
                f"{min(slots, len(runs)):,} of {len(runs):,} runs train side by side{where}, in an estimated "
                f"{slots * training_bytes(group) / 2**20:,.0f} MiB"
            )
            try:
                self._train_side_by_side(index, waiting, size, devices, policies)
            except Exception as error:
                if not compute.out_of_memory(error):
                    raise
                if size <= 1:
                    raise InputError(
                        f"{self.folder.path}: the memory does not suffice for one run, which is estimated to need "
                        f"{training_bytes(group) / 2**20:,.0f} MiB; make the task or the learner smaller."
                    ) from error
                self.reporter.note(f"the memory does not suffice for {slots:,} runs side by side; half as many go on")
                self.interrupted = self._under_way()
            gc.collect()  # the arrays of a pool that failed; its error's frames held them
            size //= 2

    def _train_side_by_side(self, index: int, waiting: deque[int], size: int, devices: Devices, policies: Any) -> None:
        """Train the waiting runs of a group, `size` at once on each of the devices or rows of them."""
        group = self.plan.groups[index]
        self.stop.clear()
        with compute.counting_compiles() as compiles:
            pool = Pool(group, waiting, size, devices, self.plan.config.seed, policies)
            pool.stop = self.stop
            pool.looked = lambda: [watcher.look(pool) for watcher in self.watchers]
            self._restore(index, pool)
            self._work_in_a_thread(index, pool)
        self.compile_s += compiles.seconds
        self.tables_are_old = True
        (self.folder.path / self.folder.pool).unlink(missing_ok=True)

    def _under_way(self) -> list[tuple[Path, dict[str, np.ndarray]]]:
        """Return the runs of ours that an interrupted session, perhaps of other devices or processes, had under way."""
        waiting = self.mine - self.finished
        digest = self.folder.digest
        return [(path, _only(waiting, read_arrays(path, digest=digest))) for path in pools(self.folder.path)]

    def _restore(self, index: int, pool: Pool) -> None:
        """Take up the runs of this group that were under way."""
        for path, arrays in self.interrupted:
            try:
                if int(arrays["group"]) == index:
                    pool.restore(arrays, str(path))
            except (LookupError, TypeError, ValueError) as error:
                raise damaged(path, "does not fit this training") from error

    def wait(self) -> None:
        """Wait for the other processes.

        Raises:
          InputError: one is lost, and its runs are not finished.
        """
        if self.processes.count > 1:
            self.reporter.phase("waiting for the other processes")
            self.tables_are_old = True
        words = self.processes.collect("trained", str(self.pace.mean))
        if self.processes.index == 0:
            self.pace.elsewhere = sum(map(float, words[1:]))
            for path in pools(self.folder.path):
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
        self.folder.write_arrays(self.folder.pool, {"group": np.array(index)} | pool.state())

    def _work(self, index: int, pool: Pool) -> None:
        """Train the waiting runs until none is left."""
        saved = time.monotonic()
        pool.prepare()
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
        ended = scores(arrays)
        rows = np.stack(
            [np.ones(len(runs)), *(ended.get(name, ended["diverged"] * np.nan) for name in SHOWN[:2])], axis=1
        )
        known = np.isfinite(rows).all(axis=1)
        np.add.at(self.scores, points[known], rows[known])
        with self.lock:
            self.folder.add_part({"point": points.astype(np.int32), "seed": seeds.astype(np.int32)} | arrays)
            self.finished.update(runs.tolist())
            self.tables_are_old = True
        for watcher in self.watchers:
            watcher.store(runs, arrays)

    def _report(self, pool: Pool) -> None:
        slots, progress = pool.slots.copy(), pool.progress.copy()
        busy, finished = slots != IDLE, len(self.finished)
        recent = pool.recent.copy()
        rows = busy & np.isfinite(recent).all(axis=1)
        success, mean_return = self._best(slots[rows], np.minimum(progress[rows], 1.0), recent[rows])
        steps = float(recent[rows, 2].mean()) if rows.any() else None
        waiting = max(len(self.mine) - finished - int(busy.sum()), 0)
        learner, length = pool.group.learners, 1.0 if self.plan.unit == "episode" else steps or 0.0
        evaluation = learner.evaluations * learner.evaluation_envs * length / self.plan.budget
        self.pace.look(time.monotonic(), Look(pool.phase, slots, progress, waiting, finished, evaluation))
        alternates = finished and pool.phase in ("starting", "training", "evaluating")
        self.reporter.phase("training and evaluating" if alternates else pool.phase)
        if progress[busy].any():
            budget, pace = self.plan.budget, self.pace
            total, unit = len(self.mine) * budget, f"{self.plan.unit}s"
            rate = pace.recent * budget
            self.reporter.update(State(pace.done * budget, total, unit, rate, pace.left_s, success, mean_return, steps))

    def _best(self, runs: np.ndarray, shares: np.ndarray, known: np.ndarray) -> tuple[float, float] | tuple[None, None]:
        """Success and return at the best point so far: means over its runs, each by its share of the training that is
        done. What was reached stays, whatever trains now."""
        sums = self.scores.copy()
        np.add.at(sums, runs // self.plan.config.seeds, shares[:, None] * np.insert(known[:, :2], 0, 1.0, axis=1))
        sums = sums[sums[:, 0] > 0]
        now = max(((success, gain) for success, gain in (sums[:, 1:] / sums[:, :1]).tolist()), default=self.best)
        self.best = now if self.best is None or (now and now > self.best) else self.best
        return self.best or (None, None)

    def write_results(self) -> None:
        """Bring tables and provenance up to date with the finished runs."""
        if not self.tables_are_old or self.processes.index:
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
        } | self.pace.rates(self.plan, self.folder.path)
        sessions = [*self.earlier.get("sessions", []), session]
        provenance = {
            **self.made_by,
            "config": self.folder.digest,
            "processes": self.processes.count,
            "precision": "float64" if jax.config.read("jax_enable_x64") else "float32",
            "seed": self.plan.config.seed,
            "points": len(self.plan.points),
            "runs": self.plan.num_runs,
            "runs_finished": finished,
            "started": sessions[0]["started"],
            "wall_s": round(sum(each["wall_s"] for each in sessions), 3),
            "compile_s": round(sum(each["compile_s"] for each in sessions), 3),
            **self.pace.rates(self.plan, self.folder.path),
            "sessions": sessions,
        }
        self.folder.write_json("provenance.json", provenance)
        now = time.monotonic()
        self.tables_due = now + (now - start) / TABLES_SHARE


def _only(runs: set[int], arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the rows of some runs in a file of runs under way."""
    if "slots" not in arrays:  # no such file: who restores it says so
        return arrays
    rows = np.isin(arrays["slots"], list(runs))
    return {name: array[rows] if array.ndim else array for name, array in arrays.items()}
