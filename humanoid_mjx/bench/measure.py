"""How things are timed: compile apart, everything waited for, subjects in turn, the median quoted."""

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import jax

REPEATS = 7


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
    """How far the repeats lie apart: the range of their middle half over their median. None: there is one."""
    by_seed: Sequence[float | None] | None = None
    """The value of each training seed, None where it has none; only of figures that differ from seed to seed."""
    interval: tuple[float, float] | None = None
    """The 95 % interval of the mean over training seeds."""

    def as_json(self) -> dict[str, Any]:
        """The figure as plain values, without what only trainings have."""
        seeds = ("by_seed", "interval")
        return {name: value for name, value in asdict(self).items() if name not in seeds or value is not None}


@dataclass(frozen=True)
class Subject:
    """Something to time: a function without arguments, and how many units of work a call does."""

    call: Callable[[], Any]
    work: float
    batch: int
    repeats: int = REPEATS
    device: str = ""


class Timing(NamedTuple):
    """What `time_in_turn` found of one subject."""

    seconds: float
    """The median over the calls, s."""
    compile_s: float
    result: Any
    """What a call returns."""
    spread: float | None
    """As in `Record`."""


def time_in_turn(subjects: Mapping[str, Subject]) -> dict[str, Timing]:
    """Time subjects in turn, round after round, so that a machine whose speed drifts favours none.

    The seconds to compile are those of the first call less those of a later one.
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


def spread(seconds: Sequence[float]) -> float | None:
    """How far repeats lie apart: the range of their middle half over their median. None: there is only one."""
    if len(seconds) < 2:
        return None
    low, middle, high = statistics.quantiles(seconds, n=4, method="inclusive")
    return round((high - low) / middle, 4)


def record(bench: str, name: str, subject: Subject, timing: Timing, unit: str, work: float | None = None) -> Record:
    """A rate as a record; `work` is what a call does in `unit`s, where that is not the subject's own."""
    return Record(
        bench=bench,
        subject=name,
        device=subject.device or jax.devices()[0].device_kind,
        batch=subject.batch,
        value=(subject.work if work is None else work) / timing.seconds,
        unit=unit,
        compile_s=round(timing.compile_s, 3),
        repeats=subject.repeats,
        spread=timing.spread,
    )


def _timed(call: Callable[[], Any]) -> tuple[float, Any]:
    start = time.perf_counter()
    result = jax.block_until_ready(call())
    return time.perf_counter() - start, result
