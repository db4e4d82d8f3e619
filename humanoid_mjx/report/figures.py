"""The figures of a sweep: learning curves by swept value, heat maps over any two swept parameters."""

from collections.abc import Mapping
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.ticker import EngFormatter, MaxNLocator

from humanoid_mjx.report.style import figure, label_lines, shades, short
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
    "return": "return per episode",
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
    """Draw all figures of a run folder from its tables, what is constant left out; the paths of what was drawn."""
    paths = [folder / "learning_curves.png"]
    learning_curves(paths[0], title, axes, results)
    if len(axes) >= 2:
        for name, meaning in HEAT_MAPS.items():
            if name in summary and _tells(np.asarray(summary[name], float)):
                paths.append(folder / f"{name}.png")
                heat_maps(paths[-1], f"{title}: {meaning}", axes, summary, name)
    return paths


def learning_curves(path: Path, title: str, axes: list[str], results: Mapping[str, np.ndarray]) -> None:
    """A row of panels for each measure, a panel for each swept parameter, a line for each of its values.

    A line is the interquartile mean over seeds of the mean over all points with that value; its band is the 95 %
    bootstrap interval over seeds.
    """
    recorded = [name for name in CURVES if name in results]
    names = [name for name in recorded if _tells(results[name])] or recorded
    columns: list[str | None] = list(axes) or [None]
    labels: list[tuple[Any, ...]] = []
    seeds = len(np.unique(results["seed"]))
    with figure(path, len(names), len(columns), sharex=True, sharey="row") as (fig, panels):
        band = ", band: 95 % bootstrap over seeds" if seeds > 1 else ""
        fig.suptitle(f"{title}: interquartile mean over {seeds} seed{'s' * (seeds > 1)}{band}", x=0.01, ha="left")
        for column, axis_name in enumerate(columns):
            levels = (
                find_levels(results[axis_name]) if axis_name else Levels(["all"], np.zeros(len(results["seed"]), int))
            )
            colors = shades(len(levels.labels))
            for row, name in enumerate(names):
                panel = panels[row, column]
                ends = [_line(panel, results, levels.index == level, name, color) for level, color in enumerate(colors)]
                if axis_name:
                    labels.append((panel, ends, levels.labels, colors))
                panel.xaxis.set_major_locator(MaxNLocator(4))
                panel.xaxis.set_major_formatter(EngFormatter(sep=""))
                if row == 0:
                    panel.set_title(axis_name or "")
                if row == len(names) - 1:
                    panel.set_xlabel(COUNTED["step" if "step" in results else "episode"])
                if column == 0:
                    panel.set_ylabel(CURVES[name])
        for label in labels:  # the panels of a row share their limits, which are final now
            label_lines(*label)


def heat_maps(path: Path, title: str, axes: list[str], summary: Mapping[str, np.ndarray], name: str) -> None:
    """A panel for every two swept parameters: the mean of `name` over seeds and over all other parameters."""
    pairs = list(combinations(axes, 2))
    values = np.asarray(summary[name], float)
    with figure(path, 1, len(pairs), size=(4.4, 3.8)) as (fig, panels):
        fig.suptitle(f"{title} (mean)", x=0.01, ha="left")
        low, high = np.nanmin(values), np.nanmax(values)
        for panel, (x_name, y_name) in zip(panels[0], pairs, strict=True):
            x, y = find_levels(summary[x_name]), find_levels(summary[y_name])
            cells = y.index * len(x.labels) + x.index
            count = np.bincount(cells, minlength=len(x.labels) * len(y.labels))
            total = np.bincount(cells, values, minlength=len(count))
            mean = np.where(count > 0, total / np.maximum(count, 1), np.nan).reshape(len(y.labels), len(x.labels))
            image = panel.imshow(mean, origin="lower", aspect="auto", cmap="cividis", vmin=low, vmax=high)
            panel.grid(False)
            panel.set_xticks(range(len(x.labels)), x.labels, rotation=45 if len(x.labels) > 5 else 0, ha="right")
            panel.set_yticks(range(len(y.labels)), y.labels)
            panel.set_xlabel(x_name)
            panel.set_ylabel(y_name)
            if mean.size <= 150:
                _write_cells(panel, mean, low, high)
        fig.colorbar(image, ax=list(panels[0]), fraction=0.03, pad=0.01)


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
            dark = (value - low) < 0.55 * (high - low)
            panel.text(
                column, row, f"{value:.2g}" if abs(value) < 10 else f"{value:.0f}",
                ha="center", va="center", fontsize=6, color="white" if dark else "black",
            )  # fmt: skip
