"""Chunks of runs: the unit that a sweep hands to a worker, and the training of the runs of one group.

A chunk follows from the config alone, never from the machine, so that any engine trains the same chunks to the same
bits. `Here` trains them in this process; `training.on_ray` and `commands.slurm` hand them to others. What is trained
comes back as events, and only the driver, a `training.session.Session`, writes the run folder.
"""

import gc
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import NamedTuple, Protocol, TypeAlias, runtime_checkable

import numpy as np

from humanoid_mjx.compute.compiles import timing_compiles
from humanoid_mjx.compute.limits import out_of_memory, reserve_memory
from humanoid_mjx.runs.folder import damaged
from humanoid_mjx.spec import InputError
from humanoid_mjx.training.cost import runs_at_once, training_bytes
from humanoid_mjx.training.plan import Plan
from humanoid_mjx.training.pool import COMPILING, Pool
from humanoid_mjx.training.programs import in_turn, placement
from humanoid_mjx.training.state import earlier_policies

CHECKPOINT_EVERY_S = 30.0
"""Seconds of training that a kill may cost."""

CURVES_EVERY_S = 2.0
"""Seconds between two looks at the curves of the runs under way."""

LEAVE_AFTER_S = 5.0
"""Seconds that training has after an interrupt to store what it did since the last checkpoint. A compiler cannot be
interrupted, so a thread that compiles is left behind."""

Arrays: TypeAlias = dict[str, np.ndarray]


class Chunk(NamedTuple):
    """Consecutive runs of a group that train together."""

    number: int
    group: int
    """Index of the group in the plan."""
    runs: tuple[int, ...]


def chunks(plan: Plan, points: np.ndarray | None = None) -> list[Chunk]:
    """Return runs of a plan in chunks of `config.chunk` runs.

    `points`: numbers of the points that train at a rung, as in `Group.points`; by default all at the first rung.
    """
    chosen = np.arange(len(plan.points)) if points is None else points
    number, parts = int(chosen[0]) // len(plan.points) * plan.num_runs, []
    for index, group in enumerate(plan.groups):
        runs = group.runs[np.isin(group.runs // group.seeds, chosen)]
        parts += [(index, tuple(runs[i : i + plan.chunk].tolist())) for i in range(0, len(runs), plan.chunk)]
    return [Chunk(number, *part) for number, part in enumerate(parts, number)]


def key_of(chosen: Sequence[Chunk]) -> str:
    """Return the name under which the state of chunks that train together is stored: their first and last number."""
    return f"{chosen[0].number}-{chosen[-1].number}"


class UnderWay(NamedTuple):
    """The slots of a pool at one moment."""

    key: str
    group: int
    phase: str
    slots: np.ndarray
    """(slots,) The run that each slot holds, below 0 for none."""
    progress: np.ndarray
    """(slots,) The share of it that is done."""
    recent: np.ndarray
    """(slots, 3) Success, return and steps of its latest episodes."""


class Growth(NamedTuple):
    """The learning curves so far of some runs."""

    runs: np.ndarray
    progress: np.ndarray
    curves: Arrays


class State(NamedTuple):
    """All that the runs under way need to go on."""

    key: str
    arrays: Arrays


class Finished(NamedTuple):
    """Runs that are over: curves, scores and policies, every array with a leading axis of runs."""

    runs: np.ndarray
    arrays: Arrays
    diverged: dict[int, Arrays]
    """The last training states of runs whose numbers were no longer finite."""


class Note(NamedTuple):
    """A remark for the user."""

    text: str


class Ended(NamedTuple):
    """The end of a training."""

    key: str
    compile_s: float


Event: TypeAlias = UnderWay | Growth | State | Finished | Note | Ended


class Given(NamedTuple):
    """Input of a training of some chunks, from the driver."""

    finished: set[int]
    """Their runs that are stored."""
    watched: np.ndarray | None
    """The points whose curves are followed while they grow."""
    states: list[tuple[str, Arrays]]
    """Stored states of their runs under way, each with its file, the newest first."""


@runtime_checkable
class Desk(Protocol):
    """Interface of the driver for engines."""

    machines: set[str]
    """The machines that train, where others than this one do."""

    def given(self, chosen: Sequence[Chunk]) -> Given:
        """Return what the training of some chunks needs."""
        ...

    def take(self, event: Event) -> None:
        """Store or show an event."""
        ...


class Engine:
    """Base of the ways to train chunks. This one leaves all to others, such as jobs that have ended."""

    def __init__(self, plan: Plan):
        self.at_once = [0] * len(plan.groups)
        """The most runs of each group that train at once."""

    def train(self, chosen: Sequence[Chunk], desk: Desk) -> None:
        """Train all runs of the chunks that are not finished.

        Raises:
          InputError: some cannot be trained; all others are.
        """

    def close(self) -> None:
        """Give back what it holds, by default nothing."""


class Work:
    """Runs of a group that train side by side, in a thread of their own."""

    pool: Pool | None = None

    def __init__(self, here: "Here", key: str, index: int, runs: Sequence[int], given: Given, every_s: float | None):
        """Prepare the training of `runs` of the group `index`, which belong together.

        `key`: name of the stored state. `every_s`: seconds between two states; `CHECKPOINT_EVERY_S` by default.
        """
        self.key, self.plan, self.index, self.group = key, here.plan, index, here.plan.groups[index]
        width = (fixed := self.plan.width(self.group)) and (here.pool_size or fixed)
        self.size, self.devices = placement(self.group.learners, len(runs), here.rooms[index], width)
        self.policies = here.policies[index]
        self.every_s = CHECKPOINT_EVERY_S if every_s is None else every_s
        self.together, self.left = len(runs), [run for run in runs if run not in given.finished]
        self.states, self.watched = given.states, given.watched
        self.stopped, self.given_up = threading.Event(), False
        self._events: SimpleQueue[Event | BaseException] = SimpleQueue()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def events(self, every_s: float = 0.1) -> Iterator[Event]:
        """Train; yield what happens, and each `every_s` seconds the slots. Raise what training raises."""
        self._thread.start()
        due = time.monotonic() + every_s
        while True:
            try:
                event = self._events.get(timeout=max(due - time.monotonic(), 0.0))
            except Empty:
                if self.given_up or (not self._thread.is_alive() and self._events.empty()):  # stopped
                    return
                due = time.monotonic() + every_s
                if pool := self.pool:
                    slots = pool.slots.copy(), pool.progress.copy(), pool.recent.copy()
                    yield UnderWay(self.key, self.index, pool.phase, *slots)
                continue
            if isinstance(event, BaseException):
                raise event
            yield event
            if isinstance(event, Ended):
                return

    def stop(self) -> list[Event]:
        """Let training end as soon as what is under way is stored; return the events that nobody has taken."""
        self.stopped.set()
        deadline, pool = time.monotonic() + LEAVE_AFTER_S, self.pool
        while self._thread.is_alive() and not _compiles(pool) and time.monotonic() < deadline:
            self._thread.join(0.05)
        if pool and self._thread.is_alive() and _compiles(pool) and pool.busy.any():
            self._keep(pool)
        events: list[Event] = []
        with suppress(Empty):  # on a worker `events` may take some at the same time
            while True:
                if not isinstance(event := self._events.get_nowait(), BaseException):
                    events.append(event)
        self.given_up = True
        return events

    def _run(self) -> None:
        try:
            with timing_compiles() as compiles:
                self._train()
            if not self.left:
                self._events.put(Ended(self.key, compiles()))
        except BaseException as error:
            self._events.put(error)

    def _train(self) -> None:
        """Train what is left; tables with fewer side by side where the memory turns out not to suffice."""
        size = self.size
        while self.left and not self.stopped.is_set():
            slots, mib = size * len(self.devices), training_bytes(self.group) / 2**20
            many = f"{min(slots, self.together):,} of {self.together:,} runs"
            self._events.put(Note(f"{many} train side by side, in an estimated {math.ceil(slots * mib):,} MiB"))
            try:
                self._side_by_side(size)
            except Exception as error:
                if not out_of_memory(error):
                    raise
                if size <= 1:
                    raise InputError(
                        f"the memory does not suffice for one run, which is estimated to need {mib:,.0f} MiB; make the "
                        "task or the learner smaller."
                    ) from error
                if self.plan.width(self.group):
                    raise InputError(
                        f"the memory does not suffice for {size} networks side by side, and with fewer they learn "
                        f"other bits; begin anew with --set chunk={size // 2}."
                    ) from error
                less = f"the memory does not suffice for {slots:,} runs side by side; half as many go on"
                self._events.put(Note(less))
            self.pool = None
            gc.collect()  # the arrays of a pool that failed; its error's frames held them
            size //= 2

    def _side_by_side(self, size: int) -> None:
        waiting = deque(self.left)
        self.pool = pool = Pool(self.group, waiting, size, self.devices, self.plan.config.seed, self.policies)
        for where, arrays in self.states:
            try:
                pool.restore(arrays, where)
            except (LookupError, TypeError, ValueError) as error:
                raise damaged(Path(where), "does not fit this training") from error
        saved = looked = time.monotonic()
        pool.fill()
        while pool.busy.any():
            if self.stopped.is_set() or time.monotonic() - saved > self.every_s:
                self._keep(pool)
                saved = time.monotonic()
            if self.stopped.is_set():
                return
            pool.train()
            if self.watched is not None and time.monotonic() - looked >= CURVES_EVERY_S:
                looked = time.monotonic()
                self._events.put(Growth(*pool.curves(self.watched)))
            if not self.stopped.is_set() and (harvest := pool.harvest()):
                self._events.put(Finished(*harvest))
                over = set(harvest[0].tolist())
                self.left = [run for run in self.left if run not in over]
                pool.fill()

    def _keep(self, pool: Pool) -> None:
        self.states = [(self.key, pool.state())]
        self._events.put(State(*self.states[0]))


def _compiles(pool: Pool | None) -> bool:
    return pool is not None and pool.phase in COMPILING


class Here(Engine):
    """The engine that is this process, with all its devices."""

    def __init__(self, plan: Plan, pool_size: int | None = None, groups: Sequence[int] | None = None):
        """Prepare to train the runs of all groups or of some.

        `pool_size`: runs that each device trains at once.

        Raises:
          InputError: the memory does not suffice, or there are no policies to start from.
        """
        self.plan, self.pool_size = plan, pool_size
        reserve_memory()
        chosen = {index: plan.groups[index] for index in (range(len(plan.groups)) if groups is None else groups)}
        self.rooms = {index: runs_at_once(group, pool_size, plan.width(group)) for index, group in chosen.items()}
        self.policies = {index: earlier_policies(group) for index, group in chosen.items()}
        self.at_once = [min(self.rooms[index], len(group.first_runs)) for index, group in chosen.items()]

    def works(self, chosen: Sequence[Chunk], given: Given, every_s: float | None = None) -> Iterator[Work]:
        """Yield the trainings of some chunks, one after another; those of a group train side by side."""
        for index, room in self.rooms.items():
            mine = [run for chunk in chosen if chunk.group == index for run in chunk.runs]
            for runs in in_turn(self.plan.groups[index].learners, mine, room):
                work = Work(self, key_of(chosen), index, runs, given, every_s)
                if work.left:
                    yield work

    def train(self, chosen: Sequence[Chunk], desk: Desk) -> None:
        for work in self.works(chosen, desk.given(chosen)):
            try:
                for event in work.events():
                    desk.take(event)
            finally:
                for event in work.stop():
                    desk.take(event)


EngineOf: TypeAlias = Callable[[Plan], Engine]
"""Makes the engine of a plan."""
