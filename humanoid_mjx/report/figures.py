"""The figures of a sweep: learning curves by swept value or by point, what the parameters do, heat maps."""

import textwrap
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import combinations, cycle, product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from humanoid_mjx.report.drawing import COUNTED, CURVES, HEAT_MAPS, TERMS, draw_band, over_seeds, possible
from humanoid_mjx.report.parameters import draw_importance, draw_map, draw_parallel, draw_points, limits
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
    """A figure, drawn panel by panel."""

    title: str
    draw: Callable[[Any, str | None], dict[str, float] | None]
    """(panel, swept parameter) -> numbers for its description by label, such as the last value of each line."""
    by_axis: bool = True
    """True if it tells the values of a swept parameter apart."""


def draw_run(run: Run, summary: Mapping[str, np.ndarray]) -> tuple[Learning, list[Path]]:
    """Draw all figures of a run, whose table of summaries is given, into its folder; its learning curves, and the paths
    of what was drawn."""
    config = run.config
    learning = read_learning(run.path, read_config(run.path), summary, config.episodes is not None)
    return learning, sweep_figures(run.path / "figures", config.name, learning)


def sweep_figures(folder: Path, title: str, learning: Learning) -> list[Path]:
    """Draw all figures of a run folder from its tables; the paths of what was drawn."""
    paths = [folder / "learning_curves.png"]
    learning_curves(paths[0], title, learning)
    if others := parameters(learning):
        paths.append(folder / "parameters.png")
        side_by_side(paths[-1], f"{title}: {EFFECTS[learning.mode]}", others)
    for name in mapped(learning):
        paths.append(folder / f"{name}.png")
        of = "mean" if name == "greedy_success" else "median"
        heading = f"{title}: {HEAT_MAPS[name]}, {of} over seeds; yellow is best"
        side_by_side(paths[-1], heading, heat_maps(learning, name))
    return paths


EFFECTS = {
    "grid": "share of the differences between points that a parameter explains, with its 95 % interval over seeds",
    "zip": "",
    "random": "each dot a point, its mean success or median over seeds, orange if not told apart from the best; lines: "
    "local means of the points; bars: the share that a parameter explains by itself; all with 95 % intervals",
}
"""Captions of the figure of the parameters, by the mode of the sweep."""


def mapped(learning: Learning) -> list[str]:
    """The measures worth a heat map: a grid has two swept parameters, and the measure is not the same everywhere."""
    return _final(learning) if len(learning.axes) > 1 else []


def heat_maps(learning: Learning, name: str) -> list[Figure]:
    """A map of a measure for every two swept parameters; of more than two with the best setting of the others, and with
    the mean over them. All share their colours."""
    several = {",\nthe best setting of the others": True, ",\nthe mean over the others": False}
    ways, span = several if len(learning.axes) > 2 else {"": False}, limits(learning, name)
    return [
        Figure(f"{pair[0]} and {pair[1]}{of}", partial(draw_map, learning, pair, name, span, best))
        for (of, best), pair in product(ways.items(), combinations(learning.axes, 2))
    ]


def _final(learning: Learning) -> list[str]:
    """The measures of greedy episodes after training that differ between the points of a grid or their seeds."""
    finals = {name: learning.finals(name) for name in HEAT_MAPS if by_value(learning)}
    return [name for name, values in finals.items() if values is not None and _tells(values)]


def curved(learning: Learning) -> list[Figure]:
    """The figures worth drawing: of what was recorded those that change, or if none does all; and one of greedy
    episodes after training that have no curve."""
    recorded: dict[tuple[str, ...], Figure] = {
        (name,): Figure(title, partial(draw_curves, learning, name))
        for name, title in CURVES.items()
        if name in learning.names
    }
    # A term of the reward is nothing else that is recorded.
    if terms := tuple(name for name in learning.names if name not in CURVES and not name.startswith("greedy_")):
        recorded[terms] = Figure(TERMS, partial(draw_terms, learning, terms), by_axis=False)
    tell = {name: _tells(learning.read(name)) for names in recorded for name in names}
    if {"steps", "return"} <= tell.keys() and _mirrors(learning.read("steps"), learning.read("return")):
        tell["return"] = False
    drawn = [each for names, each in recorded.items() if any(tell[name] for name in names)] or [*recorded.values()]
    greedy = [name for name in _final(learning) if name not in learning.names][:1]
    return drawn + [Figure(HEAT_MAPS[name], partial(draw_greedy, learning, name)) for name in greedy]


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


def side_by_side(path: Path, heading: str, figures: Sequence[Figure], axis: str | None = None) -> None:
    """Draw figures by a parameter, if any, in rows of `PANELS_IN_A_ROW`, each under its title."""
    columns = min(len(figures), PANELS_IN_A_ROW)
    with figure(path, -(-len(figures) // columns), columns, heading=heading) as (_, panels):
        for panel in panels.flat[len(figures) :]:
            panel.set_axis_off()
        for panel, each in zip(panels.flat, figures, strict=False):
            panel.set_title(each.title)
            each.draw(panel, axis)


def learning_curves(path: Path, title: str, learning: Learning) -> None:
    """Learning curves: of a grid a row of panels for each figure, a panel for each swept parameter, two lines for each
    of its values (`averaged`); else the figures side by side."""
    rows, axes, heading = curved(learning), list(learning.axes), f"{title}: {averaged(learning)}"
    if len(axes) < 2 or not by_value(learning):
        axis = axes[0] if axes and by_value(learning) else None
        side_by_side(path, heading, [each._replace(title=axis or "") for each in rows], axis)
        return
    with figure(path, len(rows), len(axes), heading=heading, sharey="row") as (_, panels):
        for (row, each), (column, axis) in product(enumerate(rows), enumerate(axes)):
            panel = panels[row, column]
            if column > 0 and not each.by_axis:
                panel.set_axis_off()
                continue
            each.draw(panel, axis)
            if row == 0:
                panel.set_title(axis)
            if column > 0:
                panel.set_ylabel("")


def _drawn(
    learning: Learning, axis: str | None, values: Float[np.ndarray, "points seeds ..."]
) -> list[tuple[Any, ...]]:
    """The lines of a panel, one for each value of a parameter, or for each of the best points: label, colour, the
    values (seeds, ...) of the best point that it is about, and the mean over all such points; None where there is one.
    """
    if axis is None:
        best = sorted(learning.order[:MAX_CURVES]) if learning.mode == "zip" else learning.order[:MAX_CURVES]
        labels = [", ".join(short(column[point]) for column in learning.axes.values()) or "all" for point in best]
        return [(*line, values[at], None) for *line, at in zip(labels, shades(len(best)), best, strict=True)]
    rank, levels, found = np.argsort(learning.order), find_levels(learning.axes[axis]), []
    for level, (label, color) in enumerate(zip(levels.labels, shades(len(levels.labels)), strict=True)):
        mine = np.flatnonzero(levels.index == level)
        best = mine[np.argmin(rank[mine])]
        found.append((label, color, values[best], mean_known(values[mine]) if len(mine) > 1 else None))
    return found


def draw_curves(learning: Learning, name: str, panel: Any, axis_name: str | None) -> dict[str, float]:
    """One panel of learning curves; the last value of each solid line by its label, NaN where there is none."""
    lines, x, ends = _drawn(learning, axis_name, learning.read(name)), learning.places, {}
    dashed: dict[str, Any] = {"band": False, "linestyle": "--", "linewidth": 0.9, "alpha": 0.8}
    for _, color, _, mean in lines:
        if mean is not None:
            draw_band(panel, x, mean, color, **dashed)
    for label, color, best, _ in lines:
        ends[label] = draw_band(panel, x, best, color, within=possible(name), label=label)[0]
    if learning.axes:
        label_lines(panel, None if axis_name else ", ".join(axis.rpartition(".")[2] for axis in learning.axes))
    count_axis(panel)
    panel.set_xlabel(COUNTED[learning.unit])
    panel.set_ylabel(CURVES[name])
    return ends


def draw_greedy(learning: Learning, name: str, panel: Any, axis_name: str | None) -> dict[str, float]:
    """One panel of greedy episodes after training, by the values of a parameter; returns as `draw_curves`."""
    values = learning.finals(name)
    lines = _drawn(learning, axis_name, np.zeros((0, 0)) if values is None else values)
    bar = partial(draw_band, panel, joined=False, within=possible(name))
    for place, (_, color, best, mean) in enumerate(lines):
        bar(np.array([place]), best[:, None], color, fmt="o")
        if mean is not None:
            bar(np.array([place + 0.25]), mean[:, None], color, fmt="D", markerfacecolor="white", alpha=0.8)
    labels = [label for label, *_ in lines]
    crowded = len("".join(labels)) > 36
    panel.set_xticks(range(len(lines)), labels, rotation=45 if crowded else 0, ha="right" if crowded else "center")
    words = "after training" + "; dots: the best setting, diamonds: the mean" * (len(learning.axes) > 1)
    panel.set_xlabel(f"{words}\nlines: 95 % interval of the median, at times to one side")
    panel.set_ylabel(textwrap.fill(HEAT_MAPS[name], 28))
    return {label: float(np.median(best)) for label, _, best, _ in lines}


def draw_terms(learning: Learning, names: Sequence[str], panel: Any, _: str | None) -> dict[str, float]:
    """One panel of columns, a line for each, the mean over all points; returns as `draw_curves`."""
    looks = product(("-", "--", ":"), COLORS)  # colours come again with another dash
    ends = [
        draw_band(panel, learning.places, mean_known(learning.read(name)), color, label=name, linestyle=dash)[0]
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
    shares = [Figure(MEASURES[each.measure], partial(draw_importance, each)) for each in judged]
    if learning.mode != "random":
        return shares
    points = [Figure(axis, partial(draw_points, learning, axis)) for axis in axes]
    return [*points, *shares, Figure("a line a point; bold: as good as the best", partial(draw_parallel, learning))]


def _mirrors(one: np.ndarray, other: np.ndarray) -> bool:
    """True if a measure is a multiple of another, as a return that pays for each step alike."""
    known = np.isfinite(one) & np.isfinite(other) & (one != 0)
    return bool(known.any()) and float(np.ptp(other[known] / one[known])) < SAME


def _tells(values: np.ndarray) -> bool:
    """True if a measure changes at all: where no episode ends early, their length does not."""
    known = values[np.isfinite(values)]
    return len(known) > 0 and bool(known.min() < known.max())
