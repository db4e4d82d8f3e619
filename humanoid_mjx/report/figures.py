"""The figures of a sweep: learning curves by swept value or by point, what the parameters do, heat maps."""

import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import cycle, product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from humanoid_mjx.report.drawing import COUNTED, CURVES, HEAT_MAPS, TERMS, draw_band, draw_bar, over_seeds, possible
from humanoid_mjx.report.parameters import draw_importance, draw_parallel, draw_points, heat_maps
from humanoid_mjx.report.style import COLORS, count_axis, figure, label_lines, shades
from humanoid_mjx.runs.curves import Learning, read_learning
from humanoid_mjx.runs.folder import read_config
from humanoid_mjx.runs.ranking import MEASURES, SAME, find_levels, short
from humanoid_mjx.runs.statistics import mean_known
from humanoid_mjx.training.sweep import Run

MAX_CURVES = 8
"""Points of a `zip` or `random` sweep whose curves are drawn, the best of them."""

PANELS_IN_A_ROW = 3


class Figure(NamedTuple):
    """A figure of a learning curve, drawn panel by panel."""

    title: str
    needed: tuple[str, ...]
    """Columns without which it is not drawn."""
    draw: Callable[[Any, Learning, str | None], dict[str, float]]
    """(panel, curves, swept parameter) -> the last value of each line by its label."""
    by_axis: bool = True
    """True if it tells the values of a swept parameter apart."""


def draw_run(run: Run, summary: Mapping[str, np.ndarray]) -> tuple[Learning, list[Path]]:
    """Draw all figures of a run, whose table of summaries is given, into its folder.

    Returns:
      the run's learning curves, and the paths of what was drawn.
    """
    config = run.config
    learning = read_learning(run.path, read_config(run.path), summary, config.episodes is not None)
    return learning, sweep_figures(run.path / "figures", config.name, learning)


def sweep_figures(folder: Path, title: str, learning: Learning) -> list[Path]:
    """Draw all figures of a run folder from its tables; the paths of what was drawn."""
    paths = [folder / "learning_curves.png"]
    learning_curves(paths[0], title, learning)
    if others := parameters(learning):
        paths.append(folder / "parameters.png")
        with side_by_side(paths[-1], [each.title for each in others], f"{title}: {EFFECTS[learning.mode]}") as panels:
            for each, panel in zip(others, panels, strict=True):
                each.draw(panel, learning, None)
    for name in mapped(learning):
        paths.append(folder / f"{name}.png")
        heat_maps(paths[-1], f"{title}: {HEAT_MAPS[name]}", learning, name)
    return paths


EFFECTS = {
    "grid": "share of the differences between points that a parameter explains, with its 95 % interval over seeds",
    "zip": "",
    "random": "each dot a point, its mean success or median over seeds, orange if not told apart from the best; lines: "
    "local means of the points; bars: the share that a parameter explains by itself; all with 95 % intervals",
}
"""What the figure of the parameters shows, by the mode of the sweep."""


def mapped(learning: Learning) -> list[str]:
    """The measures worth a heat map: a grid has two swept parameters, and the measure is not the same everywhere."""
    finals = {name: learning.finals(name) for name in HEAT_MAPS if by_value(learning) and len(learning.axes) > 1}
    return [name for name, values in finals.items() if values is not None and _tells(values)]


def curved(learning: Learning) -> list[Figure]:
    """The figures worth drawing: of what was recorded those that change, or if none does all."""
    measures = [Figure(title, (name,), partial(draw_curves, name=name)) for name, title in CURVES.items()]
    # A term of the reward is nothing else that is recorded.
    terms = tuple(name for name in learning.names if name not in CURVES and not name.startswith("greedy_"))
    every = *measures, *([Figure(TERMS, terms, partial(draw_terms, names=terms), by_axis=False)] if terms else [])
    recorded = [each for each in every if set(each.needed) <= set(learning.names)]
    tell = {name: _tells(learning.read(name)) for each in recorded for name in each.needed}
    if {"steps", "return"} <= tell.keys() and _mirrors(learning.read("steps"), learning.read("return")):
        tell["return"] = False
    drawn = [each for each in recorded if any(tell[name] for name in each.needed)] or recorded
    return drawn + [Figure(title, (name,), partial(draw_greedy, name=name)) for name, title in _greedy(learning)]


def _greedy(learning: Learning) -> list[tuple[str, str]]:
    """The measure of greedy episodes after training to draw beside the curves; none where points have no parameters."""
    finals = {name: learning.finals(name) for name in HEAT_MAPS if learning.axes and name not in learning.names}
    told = [(name, HEAT_MAPS[name]) for name, values in finals.items() if values is not None and _tells(values)]
    return told[:1] if by_value(learning) else []


def by_value(learning: Learning) -> bool:
    """True if figures tell values of each parameter apart; of a `zip` or a `random` sweep they show points."""
    return learning.mode == "grid" and bool(learning.axes)


def averaged(learning: Learning) -> str:
    """Meaning of the lines and bands of learning curves, in words."""
    each = over_seeds(learning.seeds)
    if not by_value(learning):
        axes, points = ", ".join(axis.rpartition(".")[2] for axis in learning.axes), len(learning.points)
        some = f"the best {MAX_CURVES} of {points} points" if points > MAX_CURVES else "a line a point"
        return f"{some}, by {axes}; {each}" if axes else each
    if len(learning.axes) == 1:
        return each
    return (
        f"solid: the setting of the other parameters that is best after training, {each}; dashed: the mean over all "
        "their settings"
    )


@contextmanager
def side_by_side(path: Path, titles: Sequence[str], heading: str) -> Iterator[list[Any]]:
    """A figure of panels in rows of `PANELS_IN_A_ROW`, each under its title."""
    columns = min(len(titles), PANELS_IN_A_ROW)
    with figure(path, -(-len(titles) // columns), columns, heading=heading) as (_, panels):
        for panel in panels.flat[len(titles) :]:
            panel.set_axis_off()
        for panel, title in zip(panels.flat, titles, strict=False):
            panel.set_title(title)
        yield list(panels.flat[: len(titles)])


def learning_curves(path: Path, title: str, learning: Learning) -> None:
    """Learning curves: of a grid a row of panels for each figure, a panel for each swept parameter, two lines for each
    of its values (`averaged`); else the figures side by side."""
    rows, axes, heading = curved(learning), list(learning.axes), f"{title}: {averaged(learning)}"
    if len(axes) < 2 or not by_value(learning):
        axis = axes[0] if axes and by_value(learning) else None
        with side_by_side(path, [axis or ""] * len(rows), heading) as panels:
            for panel, each in zip(panels, rows, strict=True):
                each.draw(panel, learning, axis)
        return
    with figure(path, len(rows), len(axes), heading=heading, sharey="row") as (_, panels):
        for (row, each), (column, axis) in product(enumerate(rows), enumerate(axes)):
            panel = panels[row, column]
            if column > 0 and not each.by_axis:
                panel.set_axis_off()
                continue
            each.draw(panel, learning, axis)
            if row == 0:
                panel.set_title(axis)
            if column > 0:
                panel.set_ylabel("")


class Drawn(NamedTuple):
    """A line to draw."""

    label: str
    color: Any
    best: Float[np.ndarray, "seeds record"]
    """Of the best point that it is about."""
    mean: Float[np.ndarray, "seeds record"] | None
    """Over all points that it is about; None where there is one."""


def _drawn(learning: Learning, axis: str | None, values: Float[np.ndarray, "points seeds ..."]) -> list[Drawn]:
    """The lines of a panel: one for each value of a parameter, or for each of the best points."""
    rank = np.argsort(learning.order)
    if axis is None and learning.axes:
        labels = [", ".join(short(column[point]) for column in learning.axes.values()) for point in learning.order]
        best = list(zip(labels, learning.order, strict=True))[:MAX_CURVES]
        if learning.mode == "zip":
            best.sort(key=lambda each: each[1])
        colors = shades(len(best))
        return [Drawn(label, color, values[at], None) for (label, at), color in zip(best, colors, strict=True)]
    if axis is None:
        return [Drawn("all", shades(1)[0], values[0], None)]
    levels, found = find_levels(learning.axes[axis]), []
    for level, (label, color) in enumerate(zip(levels.labels, shades(len(levels.labels)), strict=True)):
        mine = np.flatnonzero(levels.index == level)
        best = mine[np.argmin(rank[mine])]
        found.append(Drawn(label, color, values[best], mean_known(values[mine]) if len(mine) > 1 else None))
    return found


def draw_curves(panel: Any, learning: Learning, axis_name: str | None, name: str) -> dict[str, float]:
    """One panel of learning curves.

    Returns:
      the last value of each solid line by its label; NaN where there is none.
    """
    lines, within = _drawn(learning, axis_name, learning.read(name)), possible(name)
    dashed: dict[str, Any] = {"band": False, "linestyle": "--", "linewidth": 0.9, "alpha": 0.8}
    for line in lines:
        if line.mean is not None:
            draw_band(panel, learning.places, line.mean, line.color, **dashed)
    ends = [draw_band(panel, learning.places, one.best, one.color, within=within, label=one.label).end for one in lines]
    if learning.axes:
        label_lines(panel, None if axis_name else ", ".join(axis.rpartition(".")[2] for axis in learning.axes))
    count_axis(panel)
    panel.set_xlabel(COUNTED[learning.unit])
    panel.set_ylabel(CURVES[name])
    return dict(zip((one.label for one in lines), ends, strict=True))


def draw_greedy(panel: Any, learning: Learning, axis_name: str | None, name: str) -> dict[str, float]:
    """One panel of greedy episodes after training, by the values of a parameter; returns as `draw_curves`."""
    values = learning.finals(name)
    lines = _drawn(learning, axis_name, np.zeros((0, 0)) if values is None else values)
    for place, each in enumerate(lines):
        draw_bar(panel, place, each.best, each.color, name, fmt="o")
        if each.mean is not None:
            draw_bar(panel, place + 0.25, each.mean, each.color, name, fmt="D", markerfacecolor="white", alpha=0.8)
    labels = [each.label for each in lines]
    crowded = len("".join(labels)) > 36
    panel.set_xticks(range(len(lines)), labels, rotation=45 if crowded else 0, ha="right" if crowded else "center")
    words = "after training" + "; dots: the best setting, diamonds: the mean" * (len(learning.axes) > 1)
    panel.set_xlabel(f"{words}\nlines: 95 % interval of the median, at times to one side")
    panel.set_ylabel(textwrap.fill(HEAT_MAPS[name], 28))
    return {each.label: float(np.median(each.best)) for each in lines}


def draw_terms(panel: Any, learning: Learning, axis_name: str | None, names: Sequence[str]) -> dict[str, float]:
    """One panel of columns, a line for each, the mean over all points; returns as `draw_curves`."""
    looks = product(("-", "--", ":"), COLORS)  # colours come again with another dash
    ends = [
        draw_band(panel, learning.places, mean_known(learning.read(name)), color, label=name, linestyle=dash).end
        for name, (dash, color) in zip(names, cycle(looks), strict=False)
    ]
    label_lines(panel)
    count_axis(panel)
    panel.set_xlabel(COUNTED[learning.unit])
    panel.set_ylabel(TERMS)
    return dict(zip(names, ends, strict=True))


def parameters(learning: Learning) -> list[Figure]:
    """The figures of what the parameters do: of `random` sweeps each one, of all but `zip` which matters."""
    judged, axes = [each for each in learning.compared[:2] if each.measure], learning.axes
    if not judged or len(axes) < 2 or learning.mode in ("zip", "halving") or len(learning.points) < 2:
        return []
    shares = [Figure(MEASURES[each.measure], (), partial(draw_importance, judged=each)) for each in judged]
    if learning.mode != "random":
        return shares
    points = [Figure(axis, (), partial(draw_points, axis=axis)) for axis in axes]
    return [*points, *shares, Figure("a line a point; bold: as good as the best", (), draw_parallel)]


def _mirrors(one: np.ndarray, other: np.ndarray) -> bool:
    """True if a measure is a multiple of another, as a return that pays for each step alike."""
    known = np.isfinite(one) & np.isfinite(other) & (one != 0)
    return bool(known.any()) and float(np.ptp(other[known] / one[known])) < SAME


def _tells(values: np.ndarray) -> bool:
    """True if a measure changes at all: where no episode ends early, their length does not."""
    known = values[np.isfinite(values)]
    return len(known) > 0 and bool(known.min() < known.max())
