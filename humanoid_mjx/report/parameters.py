"""Figures of what the parameters of a sweep do: each alone, which of them matters, two at a time."""

from itertools import combinations
from typing import Any

import numpy as np
from jaxtyping import Float, Num
from scipy.special import stdtrit

from humanoid_mjx.report.drawing import cell_mean
from humanoid_mjx.report.style import COLORS, is_geometric, log_axis, plt
from humanoid_mjx.runs.curves import Learning
from humanoid_mjx.runs.ranking import MEASURES, Judged, find_levels, short

MAX_LABELS, MAX_CELLS = 8, 60
"""The most values written along a side of a heat map, and the most of its cells that say their number."""


def draw_points(learning: Learning, axis: str, panel: Any, _: str | None) -> None:
    """The result of each point over a parameter, with a local mean of the points and its 95 % interval."""
    policy, column = learning.compared.policy, learning.axes[axis]
    result = of_points(learning, policy.measure)
    words = column.dtype.kind not in "iuf"
    levels = find_levels(column)
    x = levels.index.astype(float) if words else column.astype(float)
    known = np.isfinite(result)
    good = np.isin(learning.points, list(policy.as_good))
    for chosen, color in ((known & ~good, "0.55"), (known & good, COLORS[1])):
        panel.plot(x[chosen], result[chosen], "o", color=color, markersize=3.5, alpha=0.7)
    logarithmic = not words and is_geometric(np.sort(x))
    if logarithmic:
        log_axis(panel)
    if words:
        panel.set_xticks(range(len(levels.labels)), levels.labels)
    elif len(np.unique(x[known])) > 3:
        at = (np.geomspace if logarithmic else np.linspace)(x.min(), x.max(), 60)
        where, places = (np.log(x), np.log(at)) if logarithmic else (x, at)
        low, middle, high = local_mean(where[known], result[known], places)
        panel.plot(at, middle, color=COLORS[0])
        low, high = (np.clip(end, np.nanmin(result), np.nanmax(result)) for end in (low, high))
        panel.fill_between(at, low, high, color=COLORS[0], alpha=0.2, linewidth=0)
    panel.set_xlabel(axis)
    panel.set_ylabel(MEASURES[policy.measure])


def local_mean(
    x: Num[np.ndarray, " n"], y: Num[np.ndarray, " n"], at: Num[np.ndarray, " m"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Local means of points (E. Nadaraya, 1964; normal weights of a sixth of the range), between the ends of their 95 %
    intervals: Student's, as many freedoms as weights."""
    weights = np.exp(-0.5 * ((at[:, None] - x) / (np.ptp(x) / 6)) ** 2)
    weights /= weights.sum(axis=1, keepdims=True)
    middle, count = weights @ y, 1 / (weights**2).sum(axis=1)
    error = np.sqrt((weights**2 * (y - middle[:, None]) ** 2).sum(axis=1) * count / np.maximum(count - 1, 0.5))
    half = stdtrit(np.maximum(count - 1, 1), 0.975) * error
    return middle - half, middle, middle + half


def draw_importance(judged: Judged, panel: Any, _: str | None) -> dict[str, float]:
    """A bar for each parameter, and for each two of them together: the share of the differences that it explains."""
    shares = list(judged.matters.items())[:MAX_LABELS][::-1]
    for place, (_, share) in enumerate(shares):
        ends = np.maximum([[share.value - share.low], [share.high - share.value]], 0.0)
        panel.barh(place, max(share.value, 0.0), color=COLORS[0], alpha=0.75, height=0.6)
        panel.errorbar(share.value, place, xerr=ends, fmt="none", color="0.2", elinewidth=0.9, capsize=2)
    panel.set_yticks(range(len(shares)), [name.replace(" and ", "\nand ") for name, _ in shares], fontsize=8)
    panel.set_xlim(0.0, 1.0)
    panel.set_xlabel("share explained")
    return {name: share.value for name, share in shares}


def draw_parallel(learning: Learning, panel: Any, _: str | None) -> None:
    """Parallel coordinates: a line for each point through its values of all parameters, yellow where it is best."""
    policy, places = learning.compared.policy, []
    result = of_points(learning, policy.measure)
    for column in learning.axes.values():
        x = find_levels(column).index.astype(float) if column.dtype.kind not in "iuf" else column.astype(float)
        x = np.log(x) if column.dtype.kind in "iuf" and is_geometric(np.sort(x)) else x
        places.append((x - x.min()) / (np.ptp(x) or 1.0))
    heights, least, span = np.stack(places), np.nanmin(result), np.nanmax(result) - np.nanmin(result) or 1.0
    colors = plt.get_cmap("cividis_r" if policy.measure.endswith("steps") else "cividis")
    for point in list(learning.order)[::-1]:
        bold = learning.points[point] in policy.as_good
        panel.plot(
            heights[:, point], color=colors((result[point] - least) / span), linewidth=1.8 if bold else 0.7, alpha=0.9
        )
    for place, column in enumerate(learning.axes.values()):
        for end, value in ((0.0, column.min()), (1.0, column.max())):
            panel.text(place, end, short(value), fontsize=7, ha="center", va="top" if not end else "bottom")
    panel.set_xticks(range(len(places)), [axis.rpartition(".")[2] for axis in learning.axes])
    panel.set_yticks([])
    panel.set_ylim(-0.08, 1.08)


def draw_map(
    learning: Learning,
    pair: tuple[str, str],
    name: str,
    span: tuple[float, float],
    best: bool,
    panel: Any,
    _: str | None,
) -> None:
    """One heat map, its colours from the first to the second value of `span`.

    `best`: of each cell the best setting of the other parameters, in place of the mean over them.
    """
    levels = [find_levels(learning.axes[axis]) for axis in pair]
    cells, upwards = map_cells(learning, pair, name, best), best_is_most(learning, name)
    colors = "cividis" if upwards else "cividis_r"
    image = panel.imshow(cells, origin="lower", aspect="auto", cmap=colors, vmin=span[0], vmax=span[1])
    panel.figure.colorbar(image, ax=panel)
    panel.grid(False)
    for set_ticks, axis, of in zip((panel.set_xticks, panel.set_yticks), pair, levels, strict=True):
        every = -(-len(of.labels) // MAX_LABELS)
        crowded = len("".join(of.labels)) > 24 and axis == pair[0]
        turned = {"rotation": 45, "ha": "right", "rotation_mode": "anchor"} if crowded else {}
        set_ticks(range(0, len(of.labels), every), of.labels[::every], fontsize=8, **turned)
    panel.set_xlabel(pair[0])
    panel.set_ylabel(pair[1])
    if cells.size <= MAX_CELLS:
        worst, most = span if upwards else span[::-1]
        for (row, column), value in np.ndenumerate(cells):
            if np.isfinite(value):
                dark = worst != most and (value - worst) / (most - worst) < 0.55
                places = 0 if abs(value) >= 10 or value in (0, 1) else 2
                written = f"{value:.{places}f}".removeprefix("0" if 0 < abs(value) < 1 else "")
                look = {"fontsize": 6 if cells.size > 30 else 8, "color": "white" if dark else "black"}
                panel.text(column, row, written, ha="center", va="center", **look)


def of_points(learning: Learning, name: str) -> Float[np.ndarray, " points"]:
    """A final measure of each point over its seeds as in the table of points: the mean success, else the median."""
    values = learning.finals(name)
    assert values is not None
    known, found = np.isfinite(values).any(axis=1), np.full(len(values), np.nan)
    found[known] = (np.nanmean if name == "greedy_success" else np.nanmedian)(values[known], axis=1)
    return found


def best_is_most(learning: Learning, name: str) -> bool:
    """Return whether more of a measure is better, as of success and of measures that grow with it."""
    success, values = of_points(learning, "greedy_success"), of_points(learning, name)
    known = np.isfinite(success) & np.isfinite(values)
    return name == "greedy_success" or float(np.sum((success - success[known].mean()) * values, where=known)) > 0


def limits(learning: Learning, name: str) -> tuple[float, float]:
    """The least and the greatest value in all heat maps of a measure, so that they can share their colours."""
    ways = (False, True) if len(learning.axes) > 2 else (False,)
    every = [map_cells(learning, pair, name, best) for pair in combinations(learning.axes, 2) for best in ways]
    return float(min(map(np.nanmin, every))), float(max(map(np.nanmax, every)))


def map_cells(learning: Learning, pair: tuple[str, str], name: str, best: bool) -> Float[np.ndarray, "y x"]:
    """A measure for each two values of two swept parameters; NaN where it is not known."""
    x, y = (find_levels(learning.axes[axis]) for axis in pair)
    values, shape = of_points(learning, name), (len(y.labels), len(x.labels))
    if not best:
        return cell_mean(y.index, x.index, values, shape)
    first, of = (-np.inf, np.fmax) if best_is_most(learning, name) else (np.inf, np.fmin)
    found = np.full(shape, first)
    of.at(found, (y.index, x.index), values)
    return np.where(np.isfinite(found), found, np.nan)
