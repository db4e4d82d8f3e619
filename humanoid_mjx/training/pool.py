"""Slots in which runs train side by side; a slot whose run is over takes the next one that waits.

Runs differ widely in length: where the reward pays for waiting, an episode lasts to its cap. In fixed blocks the quick
ones would wait for the slowest.
"""

import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx import compute
from humanoid_mjx.compute import kept
from humanoid_mjx.kernels.fallback import with_fallback
from humanoid_mjx.learners import Learner
from humanoid_mjx.spec import InputError
from humanoid_mjx.training.plan import Group
from humanoid_mjx.training.program import Training, curve
from humanoid_mjx.training.programs import Devices, programs, programs_of
from humanoid_mjx.training.state import blank, from_arrays, to_arrays

CHUNK_S = 0.2
"""Seconds of training between two checks for finished runs. The length of the chunks changes no result."""

MAX_STEPS = 1 << 20
"""Largest number of steps in a chunk."""

HARVEST_SHARE = 0.25
"""The share of slots that must be over before they are emptied and filled again ..."""

HARVEST_AFTER_S = 10.0
"""... unless so many seconds have passed."""

IDLE = -1

COMPILING = ("tracing", "compiling")
"""Phases in which training stands still."""

CORES_OF_A_COMPILER = 4
"""Cores that XLA uses to compile a program. With no more cores than that, the program that ends a run is compiled only
after the training steps, for which training waits."""


class Pool:
    """Trains runs of a group, taking them from `waiting`, in as many slots on each device."""

    def __init__(self, group: Group, waiting: deque[int], size: int, devices: Devices, seed: int, policies: Any = None):
        """Make `size` slots on each of the devices, or on each row of those that share the environments of runs.

        `policies`: policies from which the runs start, every leaf with a leading axis of the group's runs.
        """
        self.group, self.waiting, self.seed, self.policies = group, waiting, seed, policies
        self.programs, self.rows = programs_of(group.learners, devices), devices
        size *= len(devices)
        self.compiled: dict[str, Callable[..., Any]] = {}
        self.phase = "starting"
        """The present phase, in a word for the user."""
        self.slots = np.full(size, IDLE, np.int64)
        self.fresh = np.zeros(size, bool)
        """Slots whose run has no training state yet."""
        self.progress = np.zeros(size)
        self.recent = np.full((size, 3), np.nan)
        """Success, return and steps of an episode of each slot's run, over its last ones."""
        self.began = self.harvested = time.monotonic()
        self.wall_s = np.full((size, group.learners.record), np.nan, np.float32)
        """Seconds from the beginning of training to each record point of each slot's run, pauses left out."""
        self.steps = 1
        self._load()
        self.training = jax.device_put(blank(group.one_run, size), self.programs.by_run)

    @property
    def busy(self) -> np.ndarray:
        """Mask of the slots that hold a run."""
        return self.slots != IDLE

    def fill(self) -> None:
        """Give the idle slots the runs that wait."""
        if not self.compiled:  # what takes longest is compiled beside what is compiled here
            with_fallback(lambda: self._program("advance", *self._given("advance")), self._renew)()
        # Other threads read these: clear a finished run's values before its slot holds another run.
        self.progress = np.where(self.busy, self.progress, 0.0)
        self.recent = np.where(self.busy[:, None], self.recent, np.nan)
        fresh = self.fresh
        for slot in np.flatnonzero(~self.busy)[: len(self.waiting)]:
            fresh[slot], self.slots[slot] = True, self.waiting.popleft()
        if fresh.any():
            self._load()
            rows = np.searchsorted(self.group.runs, np.maximum(self.slots, self.group.runs[0]))
            policies = self._put(self.policies, rows)
            mask = jax.device_put(fresh, self.programs.by_run)
            self.training = self._call("begin", mask, self.learners, self.seeds, self.training, policies)
            self.wall_s[fresh] = np.nan
            self.fresh = np.zeros(len(self.slots), bool)

    def train(self) -> None:
        """Let every run train for about `CHUNK_S`."""
        given = self._given("advance")
        if "advance" not in self.compiled:  # what ends the runs is compiled while they train
            self._program("finish", *self._given("finish"), after=self._program("advance", *given))
        began = time.monotonic()
        self.training, progress = self._call("advance", *given)
        self.progress, self.recent = map(np.asarray, progress)
        passed = np.arange(self.wall_s.shape[1]) < np.floor(self.progress[:, None] * self.wall_s.shape[1] + 1e-6)
        self.wall_s[passed & np.isnan(self.wall_s)] = time.monotonic() - self.began
        factor = CHUNK_S / max(time.monotonic() - began, 1e-6)
        self.steps = int(np.clip(self.steps * np.clip(factor, 0.25, 4.0), 1, MAX_STEPS))

    def harvest(self) -> tuple[np.ndarray, dict[str, np.ndarray], dict[int, dict[str, np.ndarray]]] | None:
        """Take out the runs that are over, if it is worthwhile.

        Returns:
          the runs; their curves, final scores and policies by name, every array with a leading axis of runs; and by
          run the last training states of those whose numbers were no longer finite.
        """
        over = self.busy & (self.progress >= 1.0)
        waited = time.monotonic() - self.harvested > HARVEST_AFTER_S
        if not over.any() or not (over.sum() >= HARVEST_SHARE * len(over) or waited or (over == self.busy).all()):
            return None
        results = jax.tree.map(np.asarray, self.finish())
        arrays = {f"{part}.{name}": each for part in ("curve", "final") for name, each in results[part].items()}
        arrays |= to_arrays(results["policy"], "policy") | {"time.wall_s": self.wall_s}
        runs, stopped = self.slots[over], np.flatnonzero(over & arrays["final.diverged"]).tolist()
        states = to_arrays(self.training, "training") if stopped else {}
        diverged = {int(self.slots[slot]): {name: array[slot] for name, array in states.items()} for slot in stopped}
        self.slots[over] = IDLE
        self.harvested = time.monotonic()
        return runs, {name: array[over] for name, array in arrays.items()}, diverged

    def finish(self) -> dict[str, Any]:
        """Curves, final scores and policies of what the slots hold."""
        return self._call("finish", *self._given("finish"))

    def curves(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
        """The runs under way of some points, the progress of each, and their learning curves so far by name, each
        (runs, record).

        What is recorded at a point of a curve is complete once a run's progress is beyond it.
        """
        slots = np.flatnonzero(self.busy & np.isin(self.slots // self.group.seeds, points))
        size = min(len(points) * self.group.seeds, len(self.slots))  # the same each time, so that it compiles once
        curves = _curves(self.learners, self.training, jnp.asarray(np.resize(slots, size)))
        curves = {name: np.asarray(curve)[: len(slots)] for name, curve in curves.items()}
        return self.slots[slots], self.progress[slots], curves

    def state(self) -> dict[str, np.ndarray]:
        """All that `restore` needs."""
        slots = np.where(self.fresh, IDLE, self.slots)
        state = {"slots": slots, "progress": self.progress, "wall_s": self.wall_s}
        return state | {"elapsed": np.array(time.monotonic() - self.began)} | to_arrays(self.training, "training")

    def restore(self, arrays: dict[str, np.ndarray], where: str) -> None:
        """Load runs that still wait from an earlier pool's `state` into idle slots. Raise an InputError if it is the
        state of another training."""
        runs, rows = np.unique(arrays["slots"], return_index=True)
        rows = rows[np.isin(runs, np.array(self.waiting))][: (~self.busy).sum()]
        idle = np.flatnonzero(~self.busy)[: len(rows)]
        if not len(rows):
            return
        merged = to_arrays(self.training, "training")
        for name, array in merged.items():
            stored = arrays.get(name)
            if stored is None or stored.shape[1:] != array.shape[1:] or stored.dtype != array.dtype:
                raise InputError(f"{where}: what it holds does not fit this training.")
            merged[name] = array.copy()
            merged[name][idle] = stored[rows]
        self.slots[idle], self.progress[idle] = arrays["slots"][rows], arrays["progress"][rows]
        self.wall_s[idle] = arrays["wall_s"][rows]
        self.began = min(self.began, time.monotonic() - float(arrays["elapsed"]))
        for run in self.slots[idle].tolist():
            self.waiting.remove(run)
        self._load()
        self.training = jax.device_put(from_arrays(self.training, merged, "training", where), self.programs.by_run)

    def _given(self, name: str) -> tuple[Any, ...]:
        """Return the arguments of `advance` or `finish`."""
        steps = jax.device_put(np.int32(self.steps), self.programs.everywhere)
        return self.learners, self.training, steps if name == "advance" else self.seeds

    def _call(self, name: str, *args: Any) -> Any:
        """Call a program of `programs`, compiled by the time that it is first needed; wait for its result."""

        def ready() -> Callable[..., Any]:
            program = self._program(name, *args)
            if not program.done():
                self.phase = "compiling"
            return program.result()

        if name not in self.compiled:
            program = with_fallback(ready, self._renew)()
            self.compiled[name] = program  # of the programs after `_renew`
        self.phase = {"begin": "starting", "advance": "training", "finish": "evaluating"}[name]
        return jax.block_until_ready(self.compiled[name](*args))

    def _renew(self) -> None:
        """Make programs without kernels, since one of a kernel failed to compile."""
        programs.cache_clear()
        self.programs, self.compiled = programs_of(self.group.learners, self.rows), {}

    def _program(self, name: str, *args: Any, after: "Future[Any] | None" = None) -> "Future[Callable[..., Any]]":
        """A program of `programs` for such arguments, which a thread of its own compiles, or loads where an earlier
        process did.

        `after`: a program that is needed before. This one is then traced in that thread, too, and where cores are few
        once the other one is there.
        """
        leaves, structure = jax.tree.flatten(args)
        kind = name, structure, tuple((leaf.aval, leaf.sharding) for leaf in leaves)
        known = self.programs.compiled.get(kind)
        if known is not None and not (known.done() and known.exception()):
            return known
        # Shapes in the place of arrays, which the training steps give up meanwhile.
        args = jax.tree.map(_shape, args)
        lower = partial(getattr(self.programs, name).lower, *args)
        about = kept.about(self.learners, args, self.programs.options)
        stored = kept.find(name, about)
        lowered = None
        if stored is None and after is None:
            self.phase = "tracing"
            lowered = lower()

        def make() -> tuple[Callable[..., Any], Callable[[], None]]:
            if after is not None and compute.cores() <= CORES_OF_A_COMPILER:
                after.exception()  # waits
            if stored is not None:
                with suppress(Exception):  # it is not worth more than the time that it saves
                    return kept.load_program(stored, args, np.ravel(np.array(self.rows)).tolist()), lambda: None
            return kept.compile_program(name, about, lowered or lower())

        program = self.programs.compiled[kind] = _in_background(make)
        return program

    def _load(self) -> None:
        """Bring the learners and seeds of the slots' runs to the devices. An idle slot repeats the first run."""
        points, numbers = np.divmod(np.maximum(self.slots, self.group.runs[0]), self.group.seeds)
        rows = np.searchsorted(self.group.points, points)
        self.learners: Learner = self._put(self.group.learners, rows)
        seeds = np.full(len(rows), self.seed, np.uint32), numbers.astype(np.uint32)
        self.seeds = jax.device_put(seeds, self.programs.by_run)

    def _put(self, tree: Any, rows: np.ndarray) -> Any:
        return jax.tree.map(lambda leaf: jax.device_put(leaf[rows], self.programs.by_run), tree)


def _shape(leaf: jax.Array) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=leaf.sharding, weak_type=leaf.aval.weak_type)


def _in_background(work: Callable[[], tuple[Callable[..., Any], Callable[[], None]]]) -> "Future[Callable[..., Any]]":
    """Run `work` in a daemon thread and return a Future of the program; then call the function that `work` also gives.

    A compiler cannot be interrupted; a daemon thread lets the process end meanwhile.
    """
    future: Future[Callable[..., Any]] = Future()

    def run() -> None:
        try:
            program, then = work()
        except BaseException as error:
            future.set_exception(error)
            return
        future.set_result(program)
        then()

    threading.Thread(target=run, daemon=True).start()
    return future


@jax.jit
def _curves(learners: Learner, training: Training, rows: jax.Array) -> dict[str, jax.Array]:
    """The learning curves so far of some rows of training states."""
    return {name: x[rows] for name, x in jax.vmap(curve)(learners, training).items()}
