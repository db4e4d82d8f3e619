"""Timing: compilation apart, everything waited for, subjects in turn, the median quoted; and calls of programs on all
devices."""

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import jax
import numpy as np

REPEATS = 7

CONTROLLED, PLAIN = "control+physics steps/s", "physics steps/s"
"""Units of simulations with a controller in the loop and without."""

SOUND = 0.99
"""Share of a simulation's numbers that must be finite: a body that is thrown about may be beyond a physics."""

REST = 0.02
"""Seconds in which threads of the subject before come to rest: those of OpenMP, as numba has, go on to ask for work and
keep the cores from the next. This thread does not sleep meanwhile, for a core that nobody uses can take 10 ms to come
back."""


@dataclass(frozen=True)
class Record:
    """One figure."""

    bench: str
    subject: str
    device: str
    batch: int
    value: float
    unit: str
    compile_s: float
    repeats: int
    spread: float | None = None
    """Interquartile range of the repeats over their median. None: there is one."""
    by_seed: Sequence[float | None] | None = None
    """The value of each training seed, None where it has none; only of figures that differ from seed to seed."""
    interval: tuple[float, float] | None = None
    """The 95 % interval of the mean over training seeds."""
    beside: int | None = None
    """The batch of those that it was timed in turn with, where its own is another."""

    def as_json(self) -> dict[str, Any]:
        """The figure as plain values, without what it does not have."""
        return {name: value for name, value in asdict(self).items() if value is not None or name == "spread"}


@dataclass(frozen=True)
class Subject:
    """Something to time: a function without arguments, and how many units of work a call does."""

    call: Callable[[], Any]
    work: float
    batch: int
    repeats: int = REPEATS
    device: str = ""
    unit: str = CONTROLLED
    beside: int | None = None
    """As in `Record`."""


class Timing(NamedTuple):
    """Times of one subject."""

    seconds: float
    """The median over the calls, s."""
    compile_s: float
    result: Any
    """Result of a call."""
    spread: float | None
    """As in `Record`."""


def time_in_turn(subjects: Mapping[str, Subject]) -> dict[str, Timing]:
    """Time subjects in turn, round after round, so that a machine whose speed drifts favours none.

    Before each there is a pause of `REST`. The seconds to compile are those of the first call less those of a later.
    """
    first: dict[str, float] = {}
    results: dict[str, Any] = {}
    for name, subject in subjects.items():
        first[name], results[name] = _timed(subject.call)
    times: dict[str, list[float]] = {name: [] for name in subjects}
    for turn in range(max(subject.repeats for subject in subjects.values())):
        for name, subject in subjects.items():
            if turn < subject.repeats:
                times[name].append(_timed(subject.call)[0])
    middle = {name: statistics.median(ts) for name, ts in times.items()}
    return {
        name: Timing(t, max(0.0, first[name] - t), results[name], spread(times[name])) for name, t in middle.items()
    }


def time_rates(bench: str, subjects: Mapping[str, Subject], say: Callable[[str], None], of: str) -> list[Record]:
    """Time subjects in turn, and say the rate of each; `of` names what a batch is made of.

    Raises:
      FloatingPointError: a simulation ran away, whose numbers may be fast.
    """
    records = []
    for key, timing in time_in_turn(subjects).items():
        subject = subjects[key]
        if any(leaf.size and np.isfinite(leaf).mean() < SOUND for leaf in jax.tree.leaves(timing.result)):
            raise FloatingPointError(f"{key}: the simulation diverged.")
        records.append(record(bench, key, subject, timing, subject.unit))
        say(f"{key:30} {subject.batch:9,} {of}  {records[-1].value:10.3e} {subject.unit:23}"
            f"  compiled in {timing.compile_s:4.1f} s")  # fmt: skip
    return records


def spread(seconds: Sequence[float]) -> float | None:
    """Interquartile range of repeats over their median. None: there is only one."""
    if len(seconds) < 2:
        return None
    low, middle, high = statistics.quantiles(seconds, n=4, method="inclusive")
    return round((high - low) / middle, 4)


def record(bench: str, name: str, subject: Subject, timing: Timing, unit: str, work: float | None = None) -> Record:
    """A rate as a record; `work` is what a call does in `unit`s, where that is not the subject's own."""
    work = subject.work if work is None else work
    return Record(
        bench=bench,
        subject=name,
        device=subject.device or jax.devices()[0].device_kind,
        batch=subject.batch,
        value=work / timing.seconds,
        unit=unit,
        compile_s=round(timing.compile_s, 3),
        repeats=subject.repeats,
        spread=timing.spread,
        beside=subject.beside,
    )


def _timed(call: Callable[[], Any]) -> tuple[float, Any]:
    rested = time.perf_counter() + REST
    while (start := time.perf_counter()) < rested:
        pass
    result = jax.block_until_ready(call())
    return time.perf_counter() - start, result


BLOCK = {"cpu": 512, "gpu": 262_144}
"""Legs at once on a device: as many as its cache holds, of a core with all that a step works on."""


def on_devices(
    program: Callable[..., Any], by_device: Sequence[Sequence[Sequence[Any]]], again: int = 1
) -> Callable[[], Any]:
    """A call of one jitted program on shares of the work: a thread for each device, one share after another.

    Args:
      by_device: for each device the arguments of each share.
      again: how often a GPU runs all of it, without a wait between two programs.

    Returns:
      a call that gives, for each device, a list of what the program returns for each share.
    """
    threads = ThreadPoolExecutor(len(by_device))
    wait = jax.block_until_ready if jax.default_backend() == "cpu" else lambda result: result

    def work(shares: Sequence[Sequence[Any]]) -> list[Any]:
        for _ in range(again):
            results = [wait(program(*share)) for share in shares]
        return jax.block_until_ready(results)

    return lambda: list(threads.map(work, by_device))


def on_all_devices(
    simulate: Callable[..., Any], state: Sequence[np.ndarray], block: int | None = None, again: int = 1
) -> Callable[[], Any]:
    """A call that shares out the rows of `state` over all devices (`on_devices`), in blocks of about `block` rows."""
    batch = len(state[0])
    devices = jax.local_devices()[:batch]
    blocks = max(1, batch // ((block or BLOCK.get(devices[0].platform, batch)) * len(devices)))
    shares = zip(*(np.array_split(array, len(devices) * blocks) for array in state), strict=True)
    placed = [jax.device_put(share, devices[i % len(devices)]) for i, share in enumerate(shares)]
    return on_devices(simulate, [placed[i :: len(devices)] for i in range(len(devices))], again)


def joined(shares: Sequence[Sequence[Sequence[Any]]]) -> tuple[np.ndarray, ...]:
    """The arrays that a call of `on_all_devices` gives, of all rows in their order."""
    in_order = [share for shares_in_turn in zip(*shares, strict=True) for share in shares_in_turn]
    return tuple(np.concatenate(parts) for parts in zip(*in_order, strict=True))
