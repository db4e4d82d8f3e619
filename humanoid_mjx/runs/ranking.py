"""The order of the points of a sweep, which of them are as good as the best, and which parameter matters."""

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations, pairwise, repeat
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from humanoid_mjx.runs import statistics
from humanoid_mjx.runs.tables import read_table


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
    whole: float
    """Mean over all of training, the area under the learning curve: of the steps where `quickest`, else of the
    return."""


WEIGHTS = "task.rewards."
"""Beginning of the names of columns with the weights of rewards; columns of the names alone have the terms."""

SHORTER = 0.75
"""Share of the first episodes' length below which runs have learned to end early. Those of HyQReal2 and Pegasus that
did came to .16 to .63 of it, and those that walk to more than ten times as much."""

BEST_POINTS = 10
"""Rows of a table of points in a terminal or a notebook."""


def at_end(columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """Mask of the rows of the points that got furthest: all but in mode halving, where the others were stopped."""
    return columns["rung"] == columns["rung"].max() if "rung" in columns else np.ones(len(columns["point"]), bool)


def furthest(columns: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
    """The rows of `at_end`."""
    return {name: column[at_end(columns)] for name, column in columns.items()} if "rung" in columns else columns


def rungs_in_words(summary: Mapping[str, np.ndarray]) -> str:
    """Say how far the points of a sweep in mode halving got; "" of another sweep."""
    if "rung" not in summary:
        return ""
    rungs, counts = np.unique(by_point(summary, "rung")[1].max(axis=1), return_counts=True)
    ended = ", ".join(f"{count:,} at rung {rung:g}" for rung, count in zip(rungs, counts, strict=True))
    return f"halving: {counts.sum():,} points ended, {ended}; only those at rung {rungs[-1]:g} are ranked and compared."


def fallen_in_words(path: Path, summary: Mapping[str, np.ndarray]) -> str:
    """A sentence on runs that learned to end their episodes early, since each step cost more than it brought when
    they began; "" where there are none."""
    own = {name: column.min() for name, column in summary.items() if name.startswith(WEIGHTS)}
    weights = {name.removeprefix(WEIGHTS): weight for name, weight in own.items()}
    if not (terms := [name for name in summary if weights.get(name, 0) < 0]):
        return ""
    table = read_table(path / "results.parquet", ["point", "seed", "return", "steps", "success", *terms])
    table = {name: column[table["steps"] > 0] for name, column in table.items()}
    new = np.diff(table["point"] * (summary["seed"].max() + 1) + table["seed"], prepend=-1) != 0
    first, last = ({name: column[rows] for name, column in table.items()} for rows in (new, np.roll(new, -1)))
    gone = (first["return"] < 0) & (last["steps"] < SHORTER * first["steps"]) & (last["success"] < 0.5)
    if not gone.any():
        return ""
    brought = {name: np.mean(first[name][gone] / first["steps"][gone]) for name in ("return", *terms)}
    worst = min(terms, key=brought.__getitem__)
    return (
        f"{gone.sum():,} of {len(gone):,} runs learned to end their episodes early: at first a step brought "
        f"{brought['return']:.2g}, of which {worst} {brought[worst]:.2g}. With half the penalty it may pay to go on: "
        f"--set {WEIGHTS}{worst}={weights[worst] / 2:.3g}"
    )


def ranked(axes: Sequence[str], summary: Mapping[str, np.ndarray], quickest: bool) -> list[Ranked]:
    """All points from best to worst; of a sweep in mode halving those that got furthest.

    First come those whose greedy episodes succeed most often, among them the quickest or those of the highest return.
    Those that are equal are told apart by how they learned: by the area under the curve, then by the end of training.

    `quickest`: as the thesis judges its tables. A body that falls is quick too, so what is trained by control steps is
    judged by its return.
    """
    summary = furthest(summary)
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
    measure = "steps" if quickest else "return"
    whole, end = over_seeds(f"whole_{measure}"), over_seeds(measure)
    costs = (greedy_steps, whole, end) if quickest else (-greedy_return, -whole, -end)
    ranks = np.nan_to_num(np.stack([-np.round(success, 3), *costs], axis=1), nan=np.inf, posinf=np.inf, neginf=np.inf)
    values = zip(*(summary[axis][order[starts]].tolist() for axis in axes), strict=True) if axes else repeat(())
    means = (column.tolist() for column in (success, greedy_return, greedy_steps, whole))
    found = list(map(Ranked, points.tolist(), values, *means))
    return [found[place] for place in np.lexsort(ranks.T[::-1])]


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


class Judged(NamedTuple):
    """The points of a sweep, judged by one measure."""

    measure: str
    as_good: frozenset[int]
    """Points that are not told apart from the best (`statistics.not_worse`)."""
    matters: dict[str, statistics.Estimate]
    """By parameter, and by two of them with ` and ` between for what they do together: the share of the variance of
    the measure between points; the greatest first."""


class Compared(NamedTuple):
    """The points of a sweep, compared by their common seeds."""

    policy: Judged
    """By greedy episodes after training: by their success, and where that tells no more by their steps or return."""
    learning: Judged
    """By the area under the learning curve; as good are only points that the policy does not tell apart."""
    complete: int
    """Number of points all of whose seeds are finished."""
    seeds: int


UNJUDGED = Judged("", frozenset(), {})
NOT_COMPARED = Compared(UNJUDGED, UNJUDGED, 0, 0)


def compared(mode: str, axes: Sequence[str], summary: Mapping[str, np.ndarray], quickest: bool) -> Compared:
    """Compare all finished points: first by what they have learned, then by how they learned it."""
    summary = furthest(summary)
    points, finished = by_point(summary, "seed")
    whole = np.asarray(np.isfinite(finished).all(axis=1))
    if not whole.any():
        return NOT_COMPARED
    left, best = whole.copy(), points == ranked(axes, summary, quickest)[0].point
    levels = {axis: by_point(summary, axis)[1][:, 0] for axis in axes if mode in ("grid", "random")}

    def judged(names: Sequence[str]) -> Judged:
        measure, values = "", finished
        for name in names:
            if name not in summary:
                continue
            found = by_point(summary, name)[1] * (-1 if name.endswith("steps") else 1)
            if not measure or np.ptp(np.nan_to_num(found[left].mean(axis=1))) > SAME:
                measure, values = name, found
            means = np.nan_to_num(found.mean(axis=1), nan=-np.inf)
            first = left & best if (left & best).any() else left
            lower = left & (means <= means[first].max(initial=-np.inf))  # above the table's first is as good
            left[lower] = statistics.not_worse(found[lower], statistics.ERROR / len(names))
        known = whole & np.isfinite(values).all(axis=1)
        as_good = frozenset(points[left | best].tolist())
        if not known.any():
            return Judged("", as_good, {})
        matters = _matters(mode == "grid", {axis: column[known] for axis, column in levels.items()}, values[known])
        return Judged(measure, as_good, matters)

    policy = judged(QUICKEST if quickest else RICHEST)
    learning = judged(["whole_steps" if quickest else "whole_return"])
    return Compared(policy, learning, int(whole.sum()), finished.shape[1])


def _matters(grid: bool, axes: Mapping[str, np.ndarray], values: np.ndarray) -> dict[str, statistics.Estimate]:
    """The importance of each parameter, and in a grid of what each two do together."""
    levels = {axis: find_levels(column) for axis, column in axes.items()}
    if not (grid and axes):
        shares = {axis: statistics.importance_of_drawn(each.index, values) for axis, each in levels.items()}
    else:
        of = {axis: statistics.importance(each.index, values) for axis, each in levels.items()}
        for one, other in combinations(axes, 2):
            pair = levels[one].index * len(levels[other].labels) + levels[other].index
            of[f"{one} and {other}"] = statistics.importance(pair, values) - of[one] - of[other]
        shares = {name: statistics.estimate(share, -1.0, 1.0) for name, share in of.items()}
        index = [np.unique(column, return_inverse=True)[1] for column in axes.values()]
        whole = np.full((values.shape[1], *(each.max() + 1 for each in index)), np.nan)  # NaN where a point is missing
        whole[:, *index] = values.T
        for name, share in shares.items():
            chosen = [1 + list(axes).index(axis) for axis in name.split(" and ")]
            table = np.moveaxis(whole, chosen, range(len(chosen)))
            table = table.reshape(*table.shape[: len(chosen)], *[1] * (2 - len(chosen)), -1)
            if share.low > 0 and statistics.is_chance(table):
                shares[name] = share._replace(low=0.0)
        if values.shape[1] < 3:  # each of two seeds against the other gives the same share
            shares = {name: share._replace(low=-1.0, high=1.0) for name, share in shares.items()}
    named = {" and ".join(x.rpartition(".")[2] for x in key.split(" and ")): each for key, each in shares.items()}
    return dict(sorted(named.items(), key=lambda each: -each[1].value))


QUICKEST = "greedy_success", "greedy_steps"
RICHEST = "greedy_success", "greedy_return"
"""Measures of what was learned, by which points are ranked."""

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
    """Say in a sentence or two what a sweep has found: the best point, how many are not told apart from it, and which
    parameter matters."""
    if len(points) < 2 or not found.complete:
        return ""
    named = zip((axis.rpartition(".")[2] for axis in axes), points[0].values, strict=True)
    best = ", ".join(f"{name} {short(value)}" for name, value in named)
    policy, learning, of = len(found.policy.as_good), len(found.learning.as_good), f"{found.complete:,} points"
    unsure = f"cannot tell with {found.seeds} seed{'s' * (found.seeds != 1)} which"
    first, second = MEASURES.get(found.policy.measure, ""), MEASURES.get(found.learning.measure, "")
    if (learning if second else policy) == found.complete:
        told = f"{unsure} of the {of} is best; the first of the table has {best}"
    else:
        equal = f"{policy:,} of {of}, itself among them, are not told apart from it"
        equal = equal if policy > 1 else "better than all other points"
        these = f"{learning:,} of these are as good" if learning > 1 else "it is the best of these"
        then = f", and {these} by {second}" if second and policy > 1 else ""
        told = f"best: {best}{_at_ends(axes, points)}; {equal} by {first}{then}"
    if min(len(found.policy.matters), len(axes)) < 2:
        return f"{told}."
    most = {words: _most(each) for words, each in ((first, found.policy), (second, found.learning))}
    parts = [f"for {words} {names}" for words, names in most.items() if names]
    shares = "what matters, by its share of the differences between points"
    return f"{told}.\n{shares}: {'; '.join(parts)}." if parts else f"{told}; {unsure} parameter matters."


def _at_ends(axes: Sequence[str], points: Sequence[Ranked]) -> str:
    """Name the values of the best point that are the least or the greatest of three or more."""
    ends = []
    for axis, values in zip(axes, zip(*(point.values for point in points), strict=True), strict=True):
        numbers = len(set(values)) > 2 and all(isinstance(value, int | float | np.number) for value in values)
        if numbers and values[0] in (min(values), max(values)):
            ends.append(axis.rpartition(".")[2])
    return f" (at the end of the values tried: {', '.join(ends)})" if ends else ""


def _most(judged: Judged) -> str:
    """The parameters that matter most for a measure, in words; nothing if that is not sure."""
    sure = [
        f"{'the interaction of ' * (' and ' in name)}{name} ({share.value:.0%})"
        for name, share in judged.matters.items()
        if share.low > 0 and share.value > LITTLE
    ]
    return ", then ".join(sure[:2])


LITTLE = 0.05
"""A parameter that explains no more than this share of the differences is not worth a word."""


def best_table(
    axes: Sequence[str], summary: Mapping[str, np.ndarray], points: Sequence[Ranked], quickest: bool, found: Compared
) -> tuple[list[str], list[list[str]]]:
    """Headings and rows of a table of points, the best of all first, by what `quickest` judges them by (`ranked`)."""
    summary, measure = furthest(summary), "steps" if quickest else "return"
    seeds = len(np.unique(summary["seed"]))
    greedy = ["greedy steps"] if quickest else ["greedy return", "greedy steps"]
    headings = ["point", *axes, "greedy success", *greedy, f"{measure} over all of training (95\u00a0%)"]
    some_diverged, compares = bool(np.any(summary["diverged"])), found.complete > 1
    headings += ["diverged"] * some_diverged + ["as good"] * compares
    measured = {each.measure: by_point(summary, each.measure) for each in found[:2] if each.measure}
    rows, wholes = [], summary.get(f"whole_{measure}", np.full(len(summary["point"]), np.nan))
    for point in points:
        low, high = statistics.interval(wholes[summary["point"] == point.point], 0.0 if quickest else -np.inf)
        whole = f"{point.whole:.2f}" if np.isfinite(point.whole) else ""
        whole += f" ({low:.2f} to {high:.2f})" if low < high else ""
        means = ([] if quickest else [f"{point.greedy_return:.4g}"]) + [f"{point.greedy_steps:.1f}", whole]
        diverged = f"{int(np.sum(summary['diverged'][summary['point'] == point.point]))} of {seeds}"
        cells = [str(point.point), *map(short, point.values), f"{point.success:.1%}", *means]
        equal = _as_good(point.point, points[0].point, measured, found)
        rows.append([*cells, *[diverged] * some_diverged, *[equal] * compares])
    return headings, rows


def _as_good(point: int, best: int, measured: Mapping[str, tuple[np.ndarray, np.ndarray]], found: Compared) -> str:
    """Say whether a point is as good as the best, or the interval of its difference, seed by seed. `measured`: both
    measures of `found` as `by_point` has them."""
    for judged, words in ((found.policy, "no,"), (found.learning, "slower,")):
        if point not in judged.as_good and judged.measure:
            numbers, values = measured[judged.measure]
            most = 1.0 if judged.measure.endswith("success") else np.inf
            gap = statistics.difference(*(values[numbers == each][0] for each in (point, best)), most=most)
            return f"{words} {gap.low:+.3g} to {gap.high:+.3g}" if np.isfinite(gap.value) else ""
    return "yes"


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


def short(value: Any) -> str:
    """A value as a label."""
    return f"{value:.3g}" if isinstance(value, (float, np.floating)) else str(value)
