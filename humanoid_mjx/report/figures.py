"""The figures of a sweep: learning curves by swept value, heat maps over any two swept parameters."""

from collections.abc import Mapping, Sequence
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from humanoid_mjx.report.style import count_axis, figure, label_lines, shades, short, wrapped
from humanoid_mjx.runs.statistics import iqm, iqm_interval

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
}


COUNTED = {"episode": "episodes", "step": "control steps"}
"""The columns that a learning curve is drawn over, and what they are called."""


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
) -> list[Path]:
    """Draw all figures of a run folder from its tables; the paths of what was drawn."""
    paths = [folder / "learning_curves.png"]
    learning_curves(paths[0], title, axes, results)
    for name in mapped(axes, summary):
        paths.append(folder / f"{name}.png")
        heat_maps(paths[-1], f"{title}: {HEAT_MAPS[name]}", axes, summary, name)
    return paths


def mapped(axes: list[str], summary: Mapping[str, np.ndarray]) -> list[str]:
    """The measures worth a heat map: there are two swept parameters, and the measure is not the same everywhere."""
    return [name for name in HEAT_MAPS if len(axes) >= 2 and name in summary and _tells(summary[name])]


def curved(results: Mapping[str, np.ndarray]) -> list[str]:
    """The measures worth a learning curve: those that change, or if none does all."""
    recorded = [name for name in CURVES if name in results]
    return [name for name in recorded if _tells(results[name])] or recorded


def averaged(axes: Sequence[str], results: Mapping[str, np.ndarray]) -> str:
    """What the lines and bands of learning curves are, in words."""
    seeds = len(np.unique(results["seed"]))
    others = ", over all values of the other parameters" if len(axes) > 1 else ""
    band = "; band: 95 % bootstrap over seeds" if seeds > 1 else ""
    return f"interquartile mean over {seeds} seed{'s' * (seeds > 1)}{others}{band}"


def learning_curves(path: Path, title: str, axes: list[str], results: Mapping[str, np.ndarray]) -> None:
    """A row of panels for each measure, a panel for each swept parameter, a line for each of its values.

    A line is the interquartile mean over seeds of the mean over all points with that value; its band is the 95 %
    bootstrap interval over seeds.
    """
    names = curved(results)
    columns: list[str | None] = list(axes) or [None]
    with figure(path, len(names), len(columns), sharex=True, sharey="row") as (fig, panels):
        fig.suptitle(wrapped(f"{title}: {averaged(axes, results)}", fig), x=0.01, ha="left")
        for column, axis_name in enumerate(columns):
            for row, name in enumerate(names):
                draw_curves(panels[row, column], results, axis_name, name)
                if row == 0:
                    panels[row, column].set_title(axis_name or "")
                if row < len(names) - 1:
                    panels[row, column].set_xlabel("")
                if column > 0:
                    panels[row, column].set_ylabel("")


def draw_curves(panel: Any, results: Mapping[str, np.ndarray], axis_name: str | None, name: str) -> dict[str, float]:
    """One panel of learning curves.

    Returns:
      the last value of each line by its label; NaN where there is none.
    """
    everything = Levels(["all"], np.zeros(len(results["seed"]), int))
    levels = find_levels(results[axis_name]) if axis_name else everything
    colors = shades(len(levels.labels))
    ends = [_line(panel, results, levels.index == level, name, color) for level, color in enumerate(colors)]
    if axis_name:
        label_lines(panel, ends, levels.labels, colors)
    count_axis(panel)
    panel.set_xlabel(COUNTED["step" if "step" in results else "episode"])
    panel.set_ylabel(CURVES[name])
    return dict(zip(levels.labels, ends, strict=True))


def heat_maps(path: Path, title: str, axes: list[str], summary: Mapping[str, np.ndarray], name: str) -> None:
    """A panel for every two swept parameters: the mean of `name` over seeds and over all other parameters."""
    pairs = list(combinations(axes, 2))
    others = " and all values of the other parameters" if len(axes) > 2 else ""
    with figure(path, 1, len(pairs), size=(4.4, 3.8)) as (fig, panels):
        fig.suptitle(wrapped(f"{title}: mean over seeds{others}", fig), x=0.01, ha="left")
        span = limits(axes, summary, name)
        images = [draw_map(panel, summary, pair, name, span) for panel, pair in zip(panels[0], pairs, strict=True)]
        if span[0] < span[1]:
            fig.colorbar(images[0], ax=list(panels[0]), fraction=0.03, pad=0.01)


def draw_map(
    panel: Any, summary: Mapping[str, np.ndarray], pair: tuple[str, str], name: str, span: tuple[float, float]
) -> Any:
    """One heat map, its colours from the first to the second value of `span`; the image."""
    x, y = (find_levels(summary[axis]) for axis in pair)
    mean = cell_means(summary, pair, name)
    image = panel.imshow(mean, origin="lower", aspect="auto", cmap="cividis", vmin=span[0], vmax=span[1])
    panel.grid(False)
    crowded = len(x.labels) > 5
    panel.set_xticks(range(len(x.labels)), x.labels, rotation=45 if crowded else 0, ha="right" if crowded else "center")
    panel.set_yticks(range(len(y.labels)), y.labels)
    panel.set_xlabel(pair[0])
    panel.set_ylabel(pair[1])
    if mean.size <= 150:
        _write_cells(panel, mean, *span)
    return image


def limits(axes: Sequence[str], summary: Mapping[str, np.ndarray], name: str) -> tuple[float, float]:
    """The least and the greatest value in all heat maps of a measure, so that they can share their colours."""
    every = [cell_means(summary, pair, name) for pair in combinations(axes, 2)]
    return float(min(map(np.nanmin, every))), float(max(map(np.nanmax, every)))


def cell_means(summary: Mapping[str, np.ndarray], pair: tuple[str, str], name: str) -> Float[np.ndarray, "y x"]:
    """The mean of a measure for each two values of two swept parameters; NaN where it is not known."""
    x, y = (find_levels(summary[axis]) for axis in pair)
    values = np.asarray(summary[name], float)
    known = np.isfinite(values)
    cells = (y.index * len(x.labels) + x.index)[known]
    size = len(x.labels) * len(y.labels)
    count, total = np.bincount(cells, minlength=size), np.bincount(cells, values[known], minlength=size)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan).reshape(len(y.labels), len(x.labels))


def find_levels(values: np.ndarray) -> Levels:
    """The distinct values of a swept parameter; where there are too many, bins of equally many points."""
    distinct, index = np.unique(values, return_inverse=True)
    if len(distinct) <= MAX_LEVELS or distinct.dtype.kind not in "if":
        return Levels([short(v) for v in distinct], index)
    edges = np.quantile(distinct, np.linspace(0, 1, BINS + 1))
    labels = [f"{short(a)} to {short(b)}" for a, b in pairwise(edges)]
    return Levels(labels, np.clip(np.searchsorted(edges, values, side="right") - 1, 0, BINS - 1))


def _tells(values: np.ndarray) -> bool:
    """Whether a measure changes at all: where no episode ends early, their length does not."""
    known = values[np.isfinite(values)]
    return len(known) > 0 and bool(known.min() < known.max())


def _line(panel, results: Mapping[str, np.ndarray], chosen: np.ndarray, name: str, color) -> float:
    """Draw one line with its band; its last value."""
    count = results["step"] if "step" in results else results["episode"]
    episodes, e = np.unique(count[chosen], return_inverse=True)
    seeds, s = np.unique(results["seed"][chosen], return_inverse=True)
    values = np.asarray(results[name][chosen], float)
    known = np.isfinite(values)
    cell = (s * len(episodes) + e)[known]
    total = np.bincount(cell, values[known], minlength=len(seeds) * len(episodes))
    count = np.bincount(cell, minlength=len(total))
    curves = np.where(count > 0, total / np.maximum(count, 1), np.nan).reshape(len(seeds), len(episodes))
    shown = np.isfinite(curves).all(axis=0)
    if not shown.any():
        return float("nan")
    middle = iqm(curves[:, shown])
    panel.plot(episodes[shown], middle, color=color, linewidth=1.4)
    if len(seeds) > 1:
        low, high = iqm_interval(curves[:, shown])
        panel.fill_between(episodes[shown], low, high, color=color, alpha=0.2, linewidth=0)
    return float(middle[-1])


def _write_cells(panel, mean: np.ndarray, low: float, high: float) -> None:
    for (row, column), value in np.ndenumerate(mean):
        if np.isfinite(value):
            dark = low < high and (value - low) < 0.55 * (high - low)
            panel.text(
                column, row, f"{value:.2g}" if abs(value) < 10 else f"{value:.0f}",
                ha="center", va="center", fontsize=6 if mean.size > 30 else 8, color="white" if dark else "black",
            )  # fmt: skip
