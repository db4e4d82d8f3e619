"""The figures of a sweep: learning curves by swept value, heat maps over any two swept parameters."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import combinations, cycle, pairwise, product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from humanoid_mjx.report.style import COLORS, count_axis, figure, label_lines, shades, wrapped
from humanoid_mjx.runs.ranking import short
from humanoid_mjx.runs.statistics import iqm, iqm_interval
from humanoid_mjx.spec import InputError, find, modules_in
from humanoid_mjx.tasks import TASKS
from humanoid_mjx.tasks.base import Task

MAX_LEVELS = 12
"""More values than this on one axis are put into bins."""

BINS = 5

HEAT_MAPS = {
    "greedy_success": "share of greedy episodes that reach the goal",
    "greedy_steps": "steps of a greedy episode",
}

CURVES = {
    "steps": "steps per episode",
    "success": "share of episodes that succeed",
    "greedy_success": "share of greedy episodes that succeed",
    "return": "return per episode (undiscounted)",
    "td_error": "TD error, root mean square",
}

TERMS = "terms of the reward, sums of an episode"


COUNTED = {"episode": "episodes", "step": "control steps"}
"""The columns that a learning curve is drawn over, and what they are called."""


class Figure(NamedTuple):
    """A figure of a learning curve, drawn panel by panel."""

    title: str
    needed: tuple[str, ...]
    """Columns without which it is not drawn."""
    draw: Callable[[Any, Mapping[str, np.ndarray], str | None], dict[str, float]]
    """(panel, rows, swept parameter) -> the last value of each line by its label."""
    by_axis: bool = True
    """True if it tells the values of a swept parameter apart."""


class Levels(NamedTuple):
    """The values of one swept parameter, in order, and which of them each point has."""

    labels: list[str]
    index: np.ndarray


def sweep_figures(
    folder: Path,
    title: str,
    axes: list[str],
    results: Mapping[str, np.ndarray],
    summary: Mapping[str, np.ndarray],
    own: Sequence[Figure] = (),
) -> list[Path]:
    """Draw all figures of a run folder, and the task's own, from its tables; the paths of what was drawn."""
    paths = [folder / "learning_curves.png"]
    learning_curves(paths[0], title, axes, results, own)
    for name in mapped(axes, summary):
        paths.append(folder / f"{name}.png")
        heat_maps(paths[-1], f"{title}: {HEAT_MAPS[name]}", axes, summary, name)
    return paths


def mapped(axes: list[str], summary: Mapping[str, np.ndarray]) -> list[str]:
    """The measures worth a heat map: there are two swept parameters, and the measure is not the same everywhere."""
    return [name for name in HEAT_MAPS if len(axes) >= 2 and name in summary and _tells(summary[name])]


def curved(results: Mapping[str, np.ndarray], own: Sequence[Figure] = ()) -> list[Figure]:
    """The figures worth drawing: of what was recorded those that change, or if none does all."""
    measures = [Figure(title, (name,), partial(draw_curves, name=name)) for name, title in CURVES.items()]
    floats = [name for name, values in results.items() if values.dtype.kind == "f"]
    # A term of the reward is nothing else that is recorded.
    terms = tuple(name for name in floats if "." not in name and name not in CURVES and not name.startswith("greedy_"))
    every = *measures, *([Figure(TERMS, terms, partial(draw_terms, names=terms), by_axis=False)] if terms else []), *own
    recorded = [each for each in every if set(each.needed) <= results.keys()]
    return [each for each in recorded if any(_tells(results[name]) for name in each.needed)] or recorded


def figures_of(task: str, modules: str | None) -> list[Figure]:
    """The figures that a task adds, by its name; none where its module is no longer there."""
    try:
        with modules_in(modules):
            return [Figure(*each) for each in find("task", TASKS, Task, task).figures]
    except InputError:
        return []


def averaged(axes: Sequence[str], results: Mapping[str, np.ndarray], interval: str = "band") -> str:
    """Meaning of the lines and bands of learning curves, in words; `interval` names the drawing of the interval."""
    runs = results.get("run", np.zeros(len(results["seed"]), int))
    counts = sorted({len(np.unique(results["seed"][runs == run])) for run in np.unique(runs)})
    others = ", over all values of the other parameters" if len(axes) > 1 else ""
    if counts[-1] == 1:
        return f"1 seed{others}"
    seeds = str(counts[0]) if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    return f"interquartile mean over {seeds} seeds{others}; {interval}: 95 % bootstrap over seeds"


def learning_curves(
    path: Path, title: str, axes: list[str], results: Mapping[str, np.ndarray], own: Sequence[Figure] = ()
) -> None:
    """A row of panels for each figure, a panel for each swept parameter, a line for each of its values.

    A line is the interquartile mean over seeds of the mean over all points with that value; its band is the 95 %
    bootstrap interval over seeds.
    """
    rows = curved(results, own)
    columns: list[str | None] = list(axes) or [None]
    with figure(path, len(rows), len(columns), sharex=True, sharey="row") as (fig, panels):
        fig.suptitle(wrapped(f"{title}: {averaged(axes, results)}", fig), x=0.01, ha="left")
        for column, axis_name in enumerate(columns):
            lowest = max((row for row, each in enumerate(rows) if each.by_axis), default=0) if column else len(rows) - 1
            for row, each in enumerate(rows):
                panel = panels[row, column]
                panel.tick_params(labelbottom=row == lowest)
                if column > 0 and not each.by_axis:
                    panel.set_axis_off()
                    continue
                each.draw(panel, results, axis_name)
                if row == 0:
                    panel.set_title(axis_name or "")
                if row < lowest:
                    panel.set_xlabel("")
                if column > 0:
                    panel.set_ylabel("")


def draw_curves(panel: Any, results: Mapping[str, np.ndarray], axis_name: str | None, name: str) -> dict[str, float]:
    """One panel of learning curves.

    Returns:
      the last value of each line by its label; NaN where there is none.
    """
    everything = Levels(["all"], np.zeros(len(results["seed"]), int))
    levels = find_levels(results[axis_name]) if axis_name else everything
    colors = shades(len(levels.labels))
    counter = _counter(results)
    count, seed, values = results[counter], results["seed"], results[name]
    rows = [levels.index == level for level in range(len(colors))]
    ends = [
        draw_line(panel, count[chosen], seed[chosen], values[chosen], color, label=label).end
        for chosen, color, label in zip(rows, colors, levels.labels, strict=True)
    ]
    if axis_name:
        label_lines(panel)
    count_axis(panel)
    panel.set_xlabel(COUNTED[counter])
    panel.set_ylabel(CURVES[name])
    return dict(zip(levels.labels, ends, strict=True))


def draw_terms(
    panel: Any, results: Mapping[str, np.ndarray], axis_name: str | None, names: Sequence[str]
) -> dict[str, float]:
    """One panel of columns, a line for each, over all values of whatever was swept; returns as `draw_curves`."""
    counter, looks = _counter(results), product(("-", "--", ":"), COLORS)  # colours come again with another dash
    ends = [
        draw_line(panel, results[counter], results["seed"], results[name], color, label=name, linestyle=dash).end
        for name, (dash, color) in zip(names, cycle(looks), strict=False)
    ]
    label_lines(panel)
    count_axis(panel)
    panel.set_xlabel(COUNTED[counter])
    panel.set_ylabel(TERMS)
    return dict(zip(names, ends, strict=True))


def _counter(results: Mapping[str, np.ndarray]) -> str:
    return "step" if "step" in results else "episode"


class Line(NamedTuple):
    """A line as it was drawn."""

    end: float
    """Its last value; NaN where nothing is drawn."""
    left_out: int
    """Number of places left out because only some of the seeds have a number there."""


def draw_line(
    panel: Any,
    x: np.ndarray,
    seed: np.ndarray,
    y: np.ndarray,
    color: Any,
    *,
    place: np.ndarray | None = None,
    joined: bool = True,
    **look: Any,
) -> Line:
    """Draw one line with its band from rows of a table, or its places apart, each with a bar for its interval.

    At each place the value of a seed is the mean of its rows. Drawn are the interquartile mean over seeds and its 95 %
    bootstrap interval, where every seed has a number.

    Args:
      panel: the axes of matplotlib.
      x: (rows,) of numbers.
      seed: (rows,) of integers.
      y: (rows,) of numbers, NaN where there is none.
      color: of the line and its band.
      place: (rows,) Which rows belong together; by default those of equal `x`. A place is drawn at its mean `x`.
      joined: whether to draw a line through the places.
      look: how the line looks, such as `linestyle`.
    """
    places, p = np.unique(x if place is None else place, return_inverse=True)
    seeds, s = np.unique(seed, return_inverse=True)
    curves = cell_mean(s, p, y, (len(seeds), len(places)))
    known = np.isfinite(curves)
    shown = known.all(axis=0)
    left_out = int((known.any(axis=0) & ~shown).sum())
    if not shown.any():
        return Line(float("nan"), left_out)
    across = places if place is None else cell_mean(np.zeros_like(p), p, x, (1, len(places)))[0]
    at, middle = across[shown], iqm(curves[:, shown])
    low, high = iqm_interval(curves[:, shown]) if len(seeds) > 1 else (middle, middle)
    if joined:
        panel.plot(at, middle, color=color, **{"linewidth": 1.4} | look)
        if len(seeds) > 1:
            panel.fill_between(at, low, high, color=color, alpha=0.2, linewidth=0)
    else:
        # A percentile interval need not hold the estimate itself.
        ends = np.maximum([middle - low, high - middle], 0.0)
        panel.errorbar(at, middle, yerr=ends, color=color, **{"fmt": "o", "markersize": 3, "elinewidth": 0.8} | look)
    return Line(float(middle[-1]), left_out)


def cell_mean(
    row: np.ndarray, column: np.ndarray, values: np.ndarray, shape: tuple[int, int]
) -> Float[np.ndarray, "rows columns"]:
    """The mean of the values that belong to each cell of a table; NaN where none is known."""
    values = np.asarray(values, float)
    known = np.isfinite(values)
    cells = (row * shape[1] + column)[known]
    size = shape[0] * shape[1]
    count, total = np.bincount(cells, minlength=size), np.bincount(cells, values[known], minlength=size)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan).reshape(shape)


def heat_maps(path: Path, title: str, axes: list[str], summary: Mapping[str, np.ndarray], name: str) -> None:
    """A panel for every two swept parameters: the mean of `name` over seeds and over all other parameters."""
    pairs = list(combinations(axes, 2))
    others = " and all values of the other parameters" if len(axes) > 2 else ""
    with figure(path, 1, len(pairs), size=(4.4, 3.8)) as (fig, panels):
        fig.suptitle(wrapped(f"{title}: mean over seeds{others}", fig), x=0.01, ha="left")
        span = limits(axes, summary, name)
        images = [draw_map(panel, summary, pair, name, span) for panel, pair in zip(panels[0], pairs, strict=True)]
        if span[0] < span[1]:
            fig.colorbar(images[0], ax=list(panels[0]), fraction=0.03, pad=0.01, label="yellow is best")


def draw_map(
    panel: Any, summary: Mapping[str, np.ndarray], pair: tuple[str, str], name: str, span: tuple[float, float]
) -> Any:
    """One heat map, its colours from the first to the second value of `span`; the image."""
    x, y = (find_levels(summary[axis]) for axis in pair)
    mean = cell_means(summary, pair, name)
    upwards = best_is_most(summary, name)
    colors = "cividis" if upwards else "cividis_r"
    image = panel.imshow(mean, origin="lower", aspect="auto", cmap=colors, vmin=span[0], vmax=span[1])
    panel.grid(False)
    crowded = len(x.labels) > 5
    panel.set_xticks(range(len(x.labels)), x.labels, rotation=45 if crowded else 0, ha="right" if crowded else "center")
    panel.set_yticks(range(len(y.labels)), y.labels)
    panel.set_xlabel(pair[0])
    panel.set_ylabel(pair[1])
    if mean.size <= 150:
        _write_cells(panel, mean, *(span if upwards else span[::-1]))
    return image


def best_is_most(summary: Mapping[str, np.ndarray], name: str) -> bool:
    """Return whether more of a measure is better, as of success and of measures that grow with it."""
    success, values = (np.asarray(summary[each], float) for each in ("greedy_success", name))
    known = np.isfinite(success) & np.isfinite(values)
    return name == "greedy_success" or float(np.sum((success - success[known].mean()) * values, where=known)) > 0


def limits(axes: Sequence[str], summary: Mapping[str, np.ndarray], name: str) -> tuple[float, float]:
    """The least and the greatest value in all heat maps of a measure, so that they can share their colours."""
    every = [cell_means(summary, pair, name) for pair in combinations(axes, 2)]
    return float(min(map(np.nanmin, every))), float(max(map(np.nanmax, every)))


def cell_means(summary: Mapping[str, np.ndarray], pair: tuple[str, str], name: str) -> Float[np.ndarray, "y x"]:
    """The mean of a measure for each two values of two swept parameters; NaN where it is not known."""
    x, y = (find_levels(summary[axis]) for axis in pair)
    return cell_mean(y.index, x.index, summary[name], (len(y.labels), len(x.labels)))


def find_levels(values: np.ndarray) -> Levels:
    """The distinct values of a swept parameter; where there are too many, bins of equally many points."""
    distinct, index = np.unique(values, return_inverse=True)
    if len(distinct) <= MAX_LEVELS or distinct.dtype.kind not in "if":
        return Levels([short(v) for v in distinct], index)
    edges = np.quantile(distinct, np.linspace(0, 1, BINS + 1))
    labels = [f"{short(a)} to {short(b)}" for a, b in pairwise(edges)]
    return Levels(labels, np.clip(np.searchsorted(edges, values, side="right") - 1, 0, BINS - 1))


def _tells(values: np.ndarray) -> bool:
    """True if a measure changes at all: where no episode ends early, their length does not."""
    known = values[np.isfinite(values)]
    return len(known) > 0 and bool(known.min() < known.max())


def _write_cells(panel: Any, mean: np.ndarray, worst: float, best: float) -> None:
    for (row, column), value in np.ndenumerate(mean):
        if np.isfinite(value):
            dark = worst != best and (value - worst) / (best - worst) < 0.55
            panel.text(
                column, row, f"{value:.2g}" if abs(value) < 10 else f"{value:.0f}",
                ha="center", va="center", fontsize=6 if mean.size > 30 else 8, color="white" if dark else "black",
            )  # fmt: skip
