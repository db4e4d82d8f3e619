"""How figures look: plain, labelled at the line, in colours that colour-blind readers can tell apart."""

import io
import textwrap
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.ticker import EngFormatter, MaxNLocator, NullFormatter, StrMethodFormatter

from humanoid_mjx.files import whole_file

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
"""Okabe and Ito's palette, for things without an order."""

SEQUENTIAL = "viridis"

LETTERS_PER_INCH = 12.5
"""Letters of a heading that fit in an inch."""

LABEL_POINTS = 9.0
"""The height of a label's line."""

_RC = {
    "axes.grid": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": "medium",
    "font.size": 9,
    "grid.alpha": 0.3,
    "grid.linewidth": 0.6,
    "savefig.dpi": 150,
    "svg.hashsalt": "humanoid_mjx",
    "text.parse_math": False,
}


DRAWING = threading.RLock()
"""Held by the thread that draws, since matplotlib is for one at a time."""


@contextmanager
def figure(
    path: Path | io.BytesIO, rows: int, columns: int, size: tuple[float, float] = (4.2, 3.0), **kwargs: Any
) -> Iterator[Any]:
    """A grid of axes, (rows, columns), saved to `path` at the end; `size` is of one of them, in inches.

    One thread draws at a time. A figure saved in memory is SVG without a background, its letters drawn as paths; its
    bytes are the same each time.
    """
    with DRAWING, plt.rc_context(_RC):  # pyright: ignore[reportArgumentType]
        fig, axes = plt.subplots(
            rows,
            columns,
            figsize=(size[0] * columns, size[1] * rows),
            squeeze=False,
            layout="constrained",
            **kwargs,
        )
        _LABELS[fig] = []
        try:
            yield fig, axes
            place_labels(fig)
            if isinstance(path, Path):
                path.parent.mkdir(exist_ok=True)  # not those above: a run folder that is gone stays so
                with whole_file(path) as temporary:
                    fig.savefig(temporary)
            else:
                fig.savefig(path, format="svg", metadata={"Date": None}, transparent=True)
        finally:
            plt.close(fig)


_LABELS: WeakKeyDictionary[Any, list[Callable[[], None]]] = WeakKeyDictionary()
"""Labels of lines, by figure, that wait until all is drawn: panels that share an axis change one another's limits."""


def shades(count: int) -> list[Any]:
    """Colours for ordered things, dark to light, all readable on white."""
    return [plt.get_cmap(SEQUENTIAL)(x) for x in np.linspace(0.0, 0.85, count)]


def count_axis(axis: Any) -> None:
    """Large counts below a panel as 200k or 1.5M, few enough not to touch."""
    axis.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
    axis.xaxis.set_major_formatter(EngFormatter(sep=""))


def log_axis(axis: Any, counted: bool = False, upright: bool = False) -> None:
    """A logarithmic scale below a panel, or at its left where `upright`, whose ticks are plain numbers: 0.01, or for
    large counts 200k."""
    (axis.set_yscale if upright else axis.set_xscale)("log")
    ticks = axis.yaxis if upright else axis.xaxis
    ticks.set_major_formatter(EngFormatter(sep="") if counted else StrMethodFormatter("{x:g}"))
    ticks.set_minor_formatter(NullFormatter())


def wrapped(text: str, fig: Any) -> str:
    """A heading broken into lines that fit the width of a figure."""
    return textwrap.fill(text, max(20, int(LETTERS_PER_INCH * fig.get_size_inches()[0])))


def label_lines(axis: Any, ends: Sequence[float], labels: Sequence[str], colors: Sequence[Any]) -> None:
    """Write each line's label beside its right end, moved apart where they would overlap; none where the end is NaN.

    A label that had to move is tied to its line by a thin one.
    """
    _LABELS.get(axis.figure, []).append(partial(_place_labels, axis, ends, labels, colors))


def place_labels(fig: Any) -> None:
    """Write the labels that wait, as is done before a figure is saved: its axes keep their limits from now on."""
    waiting = _LABELS[fig]
    while waiting:
        waiting.pop(0)()


def _place_labels(axis: Any, ends: Sequence[float], labels: Sequence[str], colors: Sequence[Any]) -> None:
    low, high = axis.get_ylim()
    shown = [i for i, end in enumerate(ends) if np.isfinite(end)]
    gap = LABEL_POINTS / (72.0 * axis.figure.get_size_inches()[1] * axis.get_position().height) * (high - low)
    places = spread([ends[i] for i in shown], gap, low, high)
    for place, i in zip(places, shown, strict=True):
        look = {"arrowstyle": "-", "color": colors[i], "linewidth": 0.5, "shrinkA": 0, "shrinkB": 0}
        axis.annotate(
            labels[i],
            (1.0, ends[i]),
            xycoords=("axes fraction", "data"),
            xytext=(1.06, place),
            textcoords=("axes fraction", "data"),
            color=colors[i],
            va="center",
            fontsize=7.5,
            arrowprops=look | {"relpos": (0.0, 0.5)},  # from the label's left end, not across it
            annotation_clip=False,
        )


def spread(places: Sequence[float], gap: float, low: float = -np.inf, high: float = np.inf) -> np.ndarray:
    """Places at least `gap` apart from `low` to `high`, in the same order, moved as little as can be (least squares).

    Where there is no room for all, they begin at `low`.
    """
    wanted = np.nan_to_num(np.asarray(places, float))
    order = np.argsort(wanted, kind="stable")
    pools: list[list[float]] = []
    for rank, place in enumerate(wanted[order]):
        pools.append([place - rank * gap])
        while len(pools) > 1 and np.mean(pools[-2]) > np.mean(pools[-1]):
            pools[-2:] = [pools[-2] + pools[-1]]
    moved = np.empty(len(wanted))
    level = np.repeat([np.mean(p) for p in pools], [len(p) for p in pools])
    room = max(low, high - (len(wanted) - 1) * gap)
    moved[order] = np.clip(level, low, room) + np.arange(len(wanted)) * gap
    return moved


def short(value: Any) -> str:
    """A value as a label."""
    return f"{value:.3g}" if isinstance(value, (float, np.floating)) else str(value)
