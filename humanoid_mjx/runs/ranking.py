"""The order of the points of a sweep, which of them are as good as the best, and which parameter matters."""

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations, pairwise, repeat
from typing import Any, NamedTuple

import numpy as np

from humanoid_mjx.runs.statistics import ERROR, Estimate, difference, estimate, importance, interval, not_worse


class Ranked(NamedTuple):
    """A point of a sweep, over its seeds."""

    point: int
    values: tuple[Any, ...]
    """Values of the swept parameters."""
    success: float
    """Share of greedy episodes that succeed: the mean over seeds."""
    greedy_return: float
    """Undiscounted return of greedy episodes; like the fields below a median over seeds."""
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


def ranked(axes: Sequence[str], summary: Mapping[str, np.ndarray], quickest: bool) -> list[Ranked]:
    """All points from best to worst.

    First come those that succeed most often, among them the quickest or those of the highest return. Training breaks
    ties: the steps of an episode at its end, or its success and return there, and then the area under the curve.

    `quickest`: as the thesis judges its tables. A body that falls is quick too, so what is trained by control steps is
    judged by its return.
    """
    order = np.argsort(summary["point"], kind="stable")
    points, starts, counts = np.unique(summary["point"][order], return_index=True, return_counts=True)

    def over_seeds(name: str, mean: Callable[..., np.ndarray] = np.median) -> np.ndarray:
        """The mean of a column over the seeds of each point; NaN where there is no such column."""
        found = np.full(len(points), np.nan)
        for count in np.unique(counts) if name in summary else ():
            rows = order[starts[counts == count][:, None] + np.arange(count)]
            found[counts == count] = mean(summary[name][rows].T, axis=0)
        return found

    success = over_seeds("greedy_success", np.mean)
    greedy_return, greedy_steps = over_seeds("greedy_return"), over_seeds("greedy_steps")
    steps, returns = over_seeds("steps"), over_seeds("return")
    whole = over_seeds("whole_steps" if quickest else "whole_return")
    costs = (greedy_steps, steps, whole) if quickest else (-greedy_return, -over_seeds("success"), -returns, -whole)
    ranks = np.nan_to_num(np.stack([-np.round(success, 3), *costs], axis=1), nan=np.inf, posinf=np.inf, neginf=np.inf)
    values = zip(*(summary[axis][order[starts]] for axis in axes), strict=True) if axes else repeat(())
    means = (column.tolist() for column in (success, greedy_return, greedy_steps, steps, returns, whole))
    found = map(Ranked, points.tolist(), values, *means, map(tuple, ranks.tolist()))
    return sorted(found, key=lambda point: point.rank)


MEASURES = {
    "greedy_success": "success of greedy episodes",
    "greedy_steps": "steps of greedy episodes",
    "greedy_return": "return of greedy episodes",
    "success": "success at the end of training",
    "steps": "steps at the end of training",
    "return": "return at the end of training",
    "whole_steps": "steps over all of training",
    "whole_return": "return over all of training",
}
"""Measures by which points are judged, in words."""


class Compared(NamedTuple):
    """The points of a sweep, compared by their common seeds."""

    measure: str
    """The measure that tells them apart: the first in their ranks that is not the same for all that are left."""
    as_good: frozenset[int]
    """Points that are not worse than the best (`statistics.not_worse`)."""
    complete: int
    """Number of points all of whose seeds are finished."""
    seeds: int
    matters: dict[str, Estimate]
    """By parameter, and by two of them with ` and ` between for what they do together: the share of the variance of
    the measure between points; the greatest first."""


NOT_COMPARED = Compared("", frozenset(), 0, 0, {})


def compared(mode: str, axes: Sequence[str], summary: Mapping[str, np.ndarray], quickest: bool) -> Compared:
    """Compare all finished points: by the greedy measures of `ranked`, and by training while all are alike."""
    points, finished = by_point(summary, "seed")
    whole = np.asarray(np.isfinite(finished).all(axis=1))
    if not whole.any():
        return NOT_COMPARED
    left, measure, values, told = whole.copy(), "", finished, False
    for name in ("greedy_success", *(QUICKEST if quickest else RICHEST)):
        if name not in summary or (told and name not in GREEDY):
            continue
        found = by_point(summary, name)[1] * (-1 if name.endswith("steps") else 1)
        if not measure or _differ(found[left]):
            measure, values = name, found
        left[left] = not_worse(found[left], ERROR / 2)
        told = told or _differ(found[left])
    left |= points == ranked(axes, summary, quickest)[0].point
    known = whole & np.isfinite(values).all(axis=1)
    return Compared(
        measure,
        frozenset(points[left].tolist()),
        int(whole.sum()),
        finished.shape[1],
        _matters(
            mode == "grid",
            {axis: by_point(summary, axis)[1][known, 0] for axis in axes if mode != "zip"},
            values[known],
        ),
    )


def _differ(values: np.ndarray) -> bool:
    """True if the means of points are not the same."""
    return bool(np.ptp(np.nan_to_num(values.mean(axis=1))) > SAME)


def _matters(grid: bool, axes: Mapping[str, np.ndarray], values: np.ndarray) -> dict[str, Estimate]:
    """The importance of each parameter, and in a grid of what each two do together."""
    levels = {axis: find_levels(column) for axis, column in axes.items()}
    shares: dict[tuple[str, ...], np.ndarray] = {}
    shares |= {(axis,): importance(each.index, values, not grid) for axis, each in levels.items()}
    for one, other in combinations(axes, 2) if grid else ():
        pair = levels[one].index * len(levels[other].labels) + levels[other].index
        shares[one, other] = importance(pair, values) - shares[one,] - shares[other,]
    named = {" and ".join(axis.rpartition(".")[2] for axis in key): estimate(x, -1.0, 1.0) for key, x in shares.items()}
    return dict(sorted(named.items(), key=lambda each: -each[1].value))


QUICKEST = "greedy_steps", "steps", "whole_steps"
RICHEST = "greedy_return", "success", "return", "whole_return"
"""Measures after success, by which points are ranked."""

GREEDY = "greedy_success", "greedy_steps", "greedy_return"
"""Measures of greedy episodes; where they tell no points apart, training does."""

SAME = 0.0005
"""Means of points that are closer than this are the same."""


def by_point(summary: Mapping[str, np.ndarray], name: str) -> tuple[np.ndarray, np.ndarray]:
    """The numbers of the points, and a column of theirs, (points, seeds); NaN or None where a run is missing."""
    points, row = np.unique(summary["point"], return_inverse=True)
    seeds, column = np.unique(summary["seed"], return_inverse=True)
    numbers = summary[name].dtype.kind in "biuf"
    found = np.full((len(points), len(seeds)), np.nan if numbers else None, float if numbers else object)
    found[row, column] = summary[name]
    return points, found


def in_words(axes: Sequence[str], points: Sequence[Ranked], found: Compared) -> str:
    """What a sweep has found, as one sentence: the best point, how many are as good, and which parameter matters."""
    if len(points) < 2 or not found.complete:
        return ""
    named = zip((axis.rpartition(".")[2] for axis in axes), points[0].values, strict=True)
    best = ", ".join(f"{name} {short(value)}" for name, value in named)
    count, unsure = len(found.as_good), f"cannot tell with {found.seeds} seed{'s' * (found.seeds != 1)} which"
    if count == found.complete:
        told = f"{unsure} of the {count:,} points is best; the first of the table has {best}"
    else:
        equal = f"as good: {count:,} of {found.complete:,} points" if count > 1 else "better than all other points"
        told = f"best: {best}; {equal} by {MEASURES[found.measure]}"
    if len(found.matters) < 2:
        return f"{told}."
    sure = {name: f"{x.value:.0%}" for name, x in found.matters.items() if x.low > 0 and x.value > LITTLE}
    if not sure:
        return f"{told}; {unsure} parameter matters."
    first, *then = (f"{name} ({share})" for name, share in sure.items())
    most = "together matter most" if " and " in first else "matters most"
    return f"{told}; {first} {most}{f', then {then[0]}' if then else ''}."


LITTLE = 0.05
"""A parameter that explains no more than this share of the differences is not worth a word."""


def training_interval(summary: Mapping[str, np.ndarray], point: int, name: str = "steps") -> tuple[float, float]:
    """The 95 % interval of a point's median of a column, such as the `steps` at the end of training."""
    low, high = interval(summary[name][summary["point"] == point])
    return float(low), float(high)


def best_table(
    axes: Sequence[str], summary: Mapping[str, np.ndarray], points: Sequence[Ranked], quickest: bool, found: Compared
) -> tuple[list[str], list[list[str]]]:
    """Headings and rows of a table of the first `BEST_POINTS`, by what `quickest` judges them by (`ranked`)."""
    measure, tied, seeds = (
        "steps" if quickest else "return",
        found.measure not in GREEDY,
        len(np.unique(summary["seed"])),
    )
    greedy = ["greedy steps"] if quickest else ["greedy return", "greedy steps"]
    headings = ["point", *axes, "greedy success", *greedy, f"{measure} at the end of training (95\u00a0%)"]
    some_diverged, compares = bool(np.any(summary["diverged"])), found.complete > 1
    headings += [f"{measure} over all of training"] * tied + ["diverged"] * some_diverged + ["as good"] * compares
    numbers, judged = by_point(summary, found.measure or "seed")
    rows = []
    for point in points[:BEST_POINTS]:
        low, high = training_interval(summary, point.point, measure)
        end = _number(point.steps if quickest else point.training_return)
        end += f" ({low:.2f} to {high:.2f})" if low < high else ""
        means = ([] if quickest else [f"{point.greedy_return:.4g}"]) + [f"{point.greedy_steps:.1f}", end]
        diverged = f"{int(np.sum(summary['diverged'][summary['point'] == point.point]))} of {seeds}"
        cells = [str(point.point), *map(short, point.values), f"{point.success:.1%}", *means]
        gap = difference(*(judged[numbers == each.point][0] for each in (point, points[0])))
        worse = f"no, {gap.low:+.3g} to {gap.high:+.3g}" if np.isfinite(gap.value) else ""
        equal = "yes" if point.point in found.as_good else worse
        rows.append([*cells, *[_number(point.whole)] * tied, *[diverged] * some_diverged, *[equal] * compares])
    return headings, rows


MAX_LEVELS = 12
"""More values than this on one axis are put into bins."""

BINS = 5


class Levels(NamedTuple):
    """The values of one swept parameter, in order, and which of them each point has."""

    labels: list[str]
    index: np.ndarray


def find_levels(values: np.ndarray) -> Levels:
    """The distinct values of a swept parameter; where there are too many, bins of equally many points."""
    distinct, index = np.unique(values, return_inverse=True)
    if len(distinct) <= MAX_LEVELS or distinct.dtype.kind not in "if":
        return Levels([short(v) for v in distinct], index)
    edges = np.quantile(distinct, np.linspace(0, 1, BINS + 1))
    labels = [f"{short(a)} to {short(b)}" for a, b in pairwise(edges)]
    return Levels(labels, np.clip(np.searchsorted(edges, values, side="right") - 1, 0, BINS - 1))


def _number(value: float) -> str:
    """A mean for a reader; nothing where none is known."""
    return f"{value:.2f}" if np.isfinite(value) else ""


def short(value: Any) -> str:
    """A value as a label."""
    return f"{value:.3g}" if isinstance(value, (float, np.floating)) else str(value)
