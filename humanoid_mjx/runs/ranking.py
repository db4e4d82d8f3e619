"""The order of the points of a sweep, from best to worst."""

from collections.abc import Callable, Mapping, Sequence
from itertools import repeat
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
    training_return: float
    """Return of an episode at the end of training."""
    whole: float
    """Mean over all of training, the area under the learning curve: of the steps where `quickest`, else of the
    return."""
    rank: tuple[float, ...]
    """Sorts points from best to worst."""


BEST_POINTS = 10
"""Rows of a table of points."""

GREEDY = 2
"""Numbers of a rank that say how a point acts greedily."""


def ranked(axes: Sequence[str], summary: Mapping[str, np.ndarray], quickest: bool) -> list[Ranked]:
    """All points from best to worst.

    First come those that succeed most often, among them the quickest or those of the highest return. Training breaks
    ties: the steps of an episode at its end, or its success and return there, and then the area under the curve.

    `quickest`: as the thesis judges its tables. A body that falls is quick too, so what is trained by control steps is
    judged by its return.
    """
    order = np.argsort(summary["point"], kind="stable")
    points, starts, counts = np.unique(summary["point"][order], return_index=True, return_counts=True)

    def over_seeds(name: str, mean: Callable[[np.ndarray], np.ndarray] = iqm) -> np.ndarray:
        """The mean of a column over the seeds of each point; NaN where there is no such column."""
        found = np.full(len(points), np.nan)
        for count in np.unique(counts) if name in summary else ():
            rows = order[starts[counts == count][:, None] + np.arange(count)]
            found[counts == count] = mean(summary[name][rows].T)
        return found

    success = over_seeds("greedy_success", lambda values: values.mean(axis=0))
    greedy_return, greedy_steps = over_seeds("greedy_return"), over_seeds("greedy_steps")
    steps, returns = over_seeds("steps"), over_seeds("return")
    whole = over_seeds("whole_steps" if quickest else "whole_return")
    costs = (greedy_steps, steps, whole) if quickest else (-greedy_return, -over_seeds("success"), -returns, -whole)
    ranks = np.nan_to_num(np.stack([-np.round(success, 3), *costs], axis=1), nan=np.inf, posinf=np.inf, neginf=np.inf)
    values = zip(*(summary[axis][order[starts]] for axis in axes), strict=True) if axes else repeat(())
    means = (column.tolist() for column in (success, greedy_return, greedy_steps, steps, returns, whole))
    found = map(Ranked, points.tolist(), values, *means, map(tuple, ranks.tolist()))
    return sorted(found, key=lambda point: point.rank)


def ties(points: Sequence[Ranked]) -> int:
    """The number of points that do as well as the first when they act greedily."""
    return sum(point.rank[:GREEDY] == points[0].rank[:GREEDY] for point in points)


def training_interval(summary: Mapping[str, np.ndarray], point: int, name: str = "steps") -> tuple[float, float]:
    """The 95 % interval of a point's mean of a column, such as the `steps` at the end of training."""
    low, high = iqm_interval(summary[name][summary["point"] == point].astype(float))
    return float(low), float(high)


def best_table(
    axes: Sequence[str], summary: Mapping[str, np.ndarray], points: Sequence[Ranked], quickest: bool
) -> tuple[list[str], list[list[str]]]:
    """Headings and rows of a table of the first `BEST_POINTS`, by what `quickest` judges them by (`ranked`)."""
    measure, tied, seeds = "steps" if quickest else "return", ties(points) > 1, len(np.unique(summary["seed"]))
    greedy = ["greedy steps"] if quickest else ["greedy return", "greedy steps"]
    headings = ["point", *axes, "greedy success", *greedy, f"{measure} at the end of training (95\u00a0%)"]
    some_diverged = bool(np.any(summary["diverged"]))
    headings += [f"{measure} over all of training"] * tied + ["diverged"] * some_diverged
    rows = []
    for point in points[:BEST_POINTS]:
        low, high = training_interval(summary, point.point, measure)
        end = _number(point.steps if quickest else point.training_return)
        end += f" ({low:.2f} to {high:.2f})" if low < high else ""
        means = ([] if quickest else [f"{point.greedy_return:.4g}"]) + [f"{point.greedy_steps:.1f}", end]
        diverged = f"{int(np.sum(summary['diverged'][summary['point'] == point.point]))} of {seeds}"
        cells = [str(point.point), *map(short, point.values), f"{point.success:.1%}", *means]
        rows.append([*cells, *[_number(point.whole)] * tied, *[diverged] * some_diverged])
    return headings, rows


def _number(value: float) -> str:
    """A mean for a reader; nothing where none is known."""
    return f"{value:.2f}" if np.isfinite(value) else ""


def short(value: Any) -> str:
    """A value as a label."""
    return f"{value:.3g}" if isinstance(value, (float, np.floating)) else str(value)
