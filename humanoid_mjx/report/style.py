"""The look of figures: plain, labelled at the line, in colours that colour-blind readers can tell apart."""

import io
import textwrap
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

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
    path: Path | io.BytesIO | None,
    rows: int,
    columns: int,
    size: tuple[float, float] = (4.2, 3.0),
    heading: str = "",
    **kwargs: Any,
) -> Iterator[Any]:
    """A grid of axes, (rows, columns), under a heading, saved to `path` at the end; `size` is of one, in inches.

    One thread draws at a time. Without a path nothing is saved. A figure saved in memory is SVG without a background,
    its letters drawn as paths; its bytes are the same each time.
    """
    with DRAWING, plt.rc_context(_RC):  # pyright: ignore[reportArgumentType]
        fig, axes = plt.subplots(
            rows, columns, figsize=(size[0] * columns, size[1] * rows), squeeze=False, layout="constrained", **kwargs
        )
        try:
            if heading:
                fig.suptitle(wrapped(heading, fig), x=0.01, ha="left")
            yield fig, axes
            if isinstance(path, Path):
                path.parent.mkdir(exist_ok=True)  # not those above: a run folder that is gone stays so
                with whole_file(path) as temporary:
                    fig.savefig(temporary)
            elif path:
                fig.savefig(path, format="svg", metadata={"Date": None}, transparent=True)
        finally:
            plt.close(fig)


def shades(count: int) -> list[Any]:
    """Colours for ordered things, dark to light, all readable on white."""
    return [plt.get_cmap("plasma")(x) for x in np.linspace(0.0, 0.88, count)]


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


def label_lines(axis: Any, title: str | None = None) -> None:
    """Write the labels of an axes' lines beside it, in the order in which they were drawn."""
    lines = [line for line in axis.get_lines() if not str(line.get_label()).startswith("_") and len(line.get_ydata())]
    look = {"frameon": False, "handlelength": 1.2, "borderpad": 0.0, "fontsize": 7.5, "title_fontsize": 7.5}
    axis.legend(handles=lines, loc="center left", bbox_to_anchor=(1.01, 0.5), title=title, **look)


def is_geometric(values: np.ndarray) -> bool:
    """True if the ratios of numbers in order are more even than their differences."""
    values = np.unique(values)
    if len(values) < 3 or values[0] <= 0 or values[-1] < 10 * values[0]:
        return False
    ratios, gaps = np.diff(np.log(values)), np.diff(values)
    return bool(np.std(ratios) / np.mean(ratios) < np.std(gaps) / np.mean(gaps))
