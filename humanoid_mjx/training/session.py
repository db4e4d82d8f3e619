"""The driver of a sweep: it alone writes the run folder, from what engines train, and reports."""

import contextlib
import time
from collections.abc import Sequence
from datetime import UTC, datetime

import jax
import numpy as np

from humanoid_mjx import compute
from humanoid_mjx.runs import folder as run_folder
from humanoid_mjx.runs.archive import check_finite
from humanoid_mjx.runs.ranking import ranked
from humanoid_mjx.runs.tables import all_runs, run_numbers, scores, write_tables
from humanoid_mjx.spec import InputError
from humanoid_mjx.training import chunks
from humanoid_mjx.training.curves import Curves
from humanoid_mjx.training.pace import Look, Pace
from humanoid_mjx.training.plan import Plan
from humanoid_mjx.training.pool import COMPILING, IDLE
from humanoid_mjx.training.program import SHOWN
from humanoid_mjx.training.progress import Reporter
from humanoid_mjx.training.progress import State as Shown

TABLES_AFTER_S = 60.0
"""Seconds after which tables are written while it trains; those of a shorter sweep are written once."""

TABLES_SHARE = 0.05
"""The share of the wall time that rewriting the tables may take while runs finish."""

REPORT_EVERY_S = 0.1


class Session:
    """The work on a run folder: what engines give, stored and shown (`chunks.Desk`)."""

    def __init__(self, folder: run_folder.RunFolder, plan: Plan, reporter: Reporter, watchers: Sequence[Curves] = ()):
        """Look at what is stored; raise an InputError if it is damaged."""
        self.folder, self.plan, self.reporter, self.watchers = folder, plan, reporter, watchers
        self.watched = max((watcher.points for watcher in watchers), key=len, default=None)
        if self.watched is not None:  # at the last rung
            self.watched = self.watched + (len(plan.rungs) - 1) * len(plan.points)
        for part in run_folder.parts(folder.path):
            # Check policies now: a damaged one can still be trained again by this sweep.
            arrays = run_folder.read_arrays(part, digest=folder.digest)
            if not np.any(arrays.get("final.diverged")):
                policies = {name: array for name, array in arrays.items() if name.startswith("policy")}
                check_finite(policies, f"{part}: it", run_folder.REMOVE)
        most = len(plan.rungs) * len(plan.points) * plan.config.seeds
        done = all_runs(folder.path, ("point", "seed"))
        self.finished = set(run_numbers(done, len(plan.points), plan.config.seeds).tolist())
        if self.finished and not 0 <= min(self.finished) <= max(self.finished) < most:
            raise InputError(f"{folder.path / 'checkpoint'}: what it holds does not fit this training.")
        self.scores = np.zeros((most // plan.config.seeds, 3))
        """Of each point the number of runs that this session has finished, and the sums of their success and return."""
        self._begin(0)
        self.under_way: dict[str, chunks.UnderWay] = {}
        self.machines: set[str] = set()
        self.reported = 0.0
        self.earlier = {}
        with contextlib.suppress(InputError):  # a damaged one is written anew
            self.earlier = run_folder.read_provenance(folder.path)
        self.began = time.monotonic()
        self.tables_due = self.began + TABLES_AFTER_S
        self.started = datetime.now(UTC).isoformat(timespec="seconds")
        self.made_by = compute.made_by()
        self.compile_s = 0.0
        self.best: tuple[float, float] | None = None
        self.tables_are_old = True

    def train(self, engine: chunks.Engine, numbers: Sequence[int] | None = None) -> None:
        """Let an engine train what is not finished. `numbers`: those of some chunks of a rung; by default all of all.

        Raises:
          InputError: it cannot train some of it, or the rung before is not finished.
        """
        last = len(self.plan.rungs) - 1 if numbers is None else min(numbers, default=0) // self.plan.num_runs
        for rung in range(last + 1):
            every = chunks.chunks(self.plan, self._go_on() if rung else None)
            if chosen := [chunk for chunk in every if numbers is None or chunk.number in numbers]:
                engine.train(chosen, self)

    def _begin(self, rung: int) -> None:
        work, *later = (each.points * each.budget for each in self.plan.rungs[rung:])
        self.rung, self.pace = rung, Pace(len(self.plan.groups), sum(later) / work)
        """The present rung, and the pace of its runs."""

    def _go_on(self) -> np.ndarray:
        """Begin the next rung. Return its points, as in `Group.points`: the best of the stored rung before."""
        plan, every = self.plan, len(self.plan.points)
        arrays = all_runs(self.folder.path, ("point", "seed", "curve.", "final."))
        arrays = {name: array[arrays["rung"] == self.rung] for name, array in arrays.items()}
        due = plan.rungs[self.rung].points * plan.config.seeds
        if missing := due - len(arrays.get("seed", ())):
            raise InputError(
                f"{self.folder.path}: {missing:,} of {due:,} runs of rung {self.rung + 1} are not finished, and their "
                "results decide which points train next; the same command with resume=True trains them."
            )
        self._begin(self.rung + 1)
        rung = plan.rungs[self.rung]
        best = ranked((), {"point": arrays["point"]} | scores(arrays), plan.unit == "episode")[: rung.points]
        self.reporter.note(
            f"rung {self.rung + 1} of {len(plan.rungs)}: the best {rung.points:,} of {every:,} points train anew, "
            f"with {rung.budget:,} {plan.unit}s"
        )
        return np.sort([point.point for point in best]) + self.rung * every

    def end(self) -> None:
        """Remove the states of runs under way; raise an InputError if runs are missing."""
        if missing := self.plan.num_runs - len(self.finished):
            raise InputError(
                f"{self.folder.path}: {missing:,} of {self.plan.num_runs:,} runs are not finished; the same command "
                "with resume=True trains them."
            )
        for path in run_folder.pools(self.folder.path):
            path.unlink()

    def given(self, chosen: Sequence[chunks.Chunk]) -> chunks.Given:
        runs, states = {run for chunk in chosen for run in chunk.runs}, list[tuple[str, chunks.Arrays]]()
        # Of this session or an earlier one, perhaps of another engine.
        for path in run_folder.pools(self.folder.path, chosen[0].number, chosen[-1].number):
            try:
                arrays = _only(runs - self.finished, run_folder.read_arrays(path, digest=self.folder.digest))
                states += [(str(path), arrays)] if len(arrays.get("slots", " ")) else []
            except InputError:
                if path.exists():  # else of another job of an array, which is done
                    raise
        return chunks.Given(self.finished & runs, self.watched, states)

    def take(self, event: chunks.Event) -> None:
        match event:
            case chunks.UnderWay():
                self.under_way[event.key] = event
                if (now := time.monotonic()) - self.reported >= REPORT_EVERY_S:
                    self.reported = now
                    self._report()
                if now >= self.tables_due:
                    self.write_results()
            case chunks.Growth():
                for watcher in self.watchers:
                    watcher.grow(event.runs, event.progress, event.curves)
            case chunks.State():
                self.folder.write_arrays(f"checkpoint/pool-{event.key}.npz", event.arrays)
            case chunks.Finished():
                self._store(event)
            case chunks.Note():
                self.reporter.note(event.text)
            case chunks.Ended():
                self.under_way.pop(event.key, None)
                self.compile_s += event.compile_s
                self.tables_are_old = True
                (self.folder.path / f"checkpoint/pool-{event.key}.npz").unlink(missing_ok=True)

    def _store(self, event: chunks.Finished) -> None:
        new = np.array([run not in self.finished for run in event.runs.tolist()])
        runs, arrays = event.runs[new], {name: array[new] for name, array in event.arrays.items()}
        if not len(runs):  # of a worker that was thought lost
            return
        every, count = len(self.plan.points), self.plan.config.seeds
        points, seeds = np.divmod(runs, count)
        rung, point = np.divmod(points.astype(np.int32), every)
        for run, state in event.diverged.items():
            self.folder.write_arrays(run_folder.diverged_name(run // count % every, run % count), state)
        ended = scores(arrays)
        rows = np.stack(
            [np.ones(len(runs)), *(ended.get(name, ended["diverged"] * np.nan) for name in SHOWN[:2])], axis=1
        )
        known = np.isfinite(rows).all(axis=1)
        np.add.at(self.scores, points[known], rows[known])
        numbers = {"point": point, "seed": seeds.astype(np.int32)}
        numbers |= {"rung": rung} if len(self.plan.rungs) > 1 else {}
        self.folder.write_arrays(f"checkpoint/part-{runs.min():05d}.npz", numbers | arrays)
        self.finished.update(runs.tolist())
        self.tables_are_old = True
        for key, look in self.under_way.items():  # until the next look
            self.under_way[key] = look._replace(slots=np.where(np.isin(look.slots, runs), IDLE, look.slots))
        for watcher in self.watchers:
            watcher.store(runs, arrays)

    def _report(self) -> None:
        looks = list(self.under_way.values())
        slots, progress, recent = (np.concatenate([look[place] for look in looks]) for place in (3, 4, 5))
        busy, rung, seeds = slots != IDLE, self.plan.rungs[self.rung], self.plan.config.seeds
        due = rung.points * seeds
        finished = len(self.finished) - sum(before.points for before in self.plan.rungs[: self.rung]) * seeds
        rows = busy & np.isfinite(recent).all(axis=1)
        success, mean_return = self._best(slots[rows], np.minimum(progress[rows], 1.0), recent[rows])
        steps = float(recent[rows, 2].mean()) if rows.any() else None
        waiting = max(due - finished - int(busy.sum()), 0)
        learner = self.plan.groups[looks[-1].group].learners
        length = 1.0 if self.plan.unit == "episode" else steps or 0.0
        evaluation = learner.evaluations * learner.evaluation_envs * length / rung.budget
        phases = {look.phase for look in looks}
        phase = "training" if "training" in phases else min(phases - {*COMPILING}, default=looks[-1].phase)
        self.pace.look(time.monotonic(), Look(phase, slots, progress, waiting, finished, evaluation))
        alternates = finished and phase in ("starting", "training", "evaluating")
        phase = "training and evaluating" if alternates else phase
        self.reporter.phase(f"rung {self.rung + 1}: {phase}" if len(self.plan.rungs) > 1 else phase)
        if progress[busy].any():
            budget, pace = rung.budget, self.pace
            total, unit = due * budget, f"{self.plan.unit}s"
            rate = pace.recent * budget
            self.reporter.update(Shown(pace.done * budget, total, unit, rate, pace.left_s, success, mean_return, steps))

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
        if not self.tables_are_old:
            return
        start = time.monotonic()
        self.tables_are_old = False
        write_tables(self.folder, self.plan.table(), self.plan.unit, self.plan.places)
        if (finished := len(self.finished)) == self.earlier.get("runs_finished"):
            return
        rates = self.pace.rates(self.plan, self.folder.path)
        times = {"wall_s": round(start - self.began, 3), "compile_s": round(self.compile_s, 3)}
        sessions = [*self.earlier.get("sessions", []), {"started": self.started} | times | rates]
        provenance = {
            **self.made_by,
            "config": self.folder.digest,
            **({"machines": sorted(self.machines)} if self.machines else {}),
            "precision": "float64" if jax.config.read("jax_enable_x64") else "float32",
            "seed": self.plan.config.seed,
            "points": len(self.plan.points),
            "runs": self.plan.num_runs,
            "runs_finished": finished,
            "started": sessions[0]["started"],
            **{name: round(sum(each[name] for each in sessions), 3) for name in times},
            **rates,
            "sessions": sessions,
        }
        self.folder.write_json("provenance.json", provenance)
        now = time.monotonic()
        self.tables_due = now + (now - start) / TABLES_SHARE


def _only(runs: set[int], arrays: chunks.Arrays) -> chunks.Arrays:
    """Return the rows of some runs in a file of runs under way."""
    if "slots" not in arrays:  # no such file: who restores it says so
        return arrays
    rows = np.isin(arrays["slots"], list(runs))
    return arrays if rows.all() else {name: array[rows] if array.ndim else array for name, array in arrays.items()}
