"""Which points of a sweep are best."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from humanoid_mjx.runs.statistics import iqm, iqm_interval


class Ranked(NamedTuple):
    """A point of a sweep, over its seeds."""

    point: int
    values: tuple[Any, ...]
    """Values of the swept parameters."""
    success: float
    """Share of greedy episodes that succeed: the mean over seeds."""
    greedy_return: float
    """Undiscounted return of greedy episodes; like the fields below an interquartile mean over seeds."""
    greedy_steps: float
    steps: float
    """Steps of an episode at the end of training."""
    cost: float
    """What ranks points that succeed equally often: `greedy_steps` or minus `greedy_return`; infinite if unknown."""


def ranked(axes: Sequence[str], summary: Mapping[str, np.ndarray], quickest: bool) -> list[Ranked]:
    """All points from best to worst: those that succeed most often, among them the quickest or those of the highest
    return, among them those whose episodes of training were the shortest at its end.

    `quickest`: as the thesis judges its tables. A body that falls is quick too, so what is trained by control steps is
    judged by its return.
    """
    order = np.argsort(summary["point"], kind="stable")
    points, starts = np.unique(summary["point"][order], return_index=True)
    found = []
    for point, rows in zip(points, np.split(order, starts[1:]), strict=True):
        values = tuple(summary[axis][rows][0] for axis in axes)
        success = float(summary["greedy_success"][rows].mean())
        total, greedy_steps, steps = (
            float(iqm(summary[name][rows])) for name in ("greedy_return", "greedy_steps", "steps")
        )
        cost = _last_if_unknown(greedy_steps if quickest else -total)
        found.append(Ranked(int(point), values, success, total, greedy_steps, steps, cost))
    return sorted(found, key=lambda each: (_greedy(each), _last_if_unknown(each.steps)))


def ties(points: Sequence[Ranked]) -> int:
    """How many points do as well as the first when they act greedily."""
    return sum(_greedy(point) == _greedy(points[0]) for point in points)


def training_interval(summary: Mapping[str, np.ndarray], point: int) -> tuple[float, float]:
    """The 95 % interval of a point's `steps`."""
    low, high = iqm_interval(summary["steps"][summary["point"] == point].astype(float))
    return float(low), float(high)


def _greedy(point: Ranked) -> tuple[float, float]:
    return -round(point.success, 3), point.cost


def _last_if_unknown(value: float) -> float:
    return value if np.isfinite(value) else np.inf
