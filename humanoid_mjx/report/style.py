"""How figures look: plain, labelled at the line, in colours that survive colour blindness."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
"""Okabe and Ito's palette, for things without an order."""

SEQUENTIAL = "viridis"

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
}


@contextmanager
def figure(path: Path, rows: int, columns: int, size: tuple[float, float] = (4.2, 3.0), **kwargs: Any) -> Iterator[Any]:
    """A grid of axes, (rows, columns), saved to `path` at the end; `size` is of one of them, in inches."""
    with plt.rc_context(_RC):  # pyright: ignore[reportArgumentType]
        fig, axes = plt.subplots(
            rows,
            columns,
            figsize=(size[0] * columns, size[1] * rows),
            squeeze=False,
            layout="constrained",
            **kwargs,
        )
        yield fig, axes
        path.parent.mkdir(parents=True, exist_ok=True)
        fig.savefig(path)
        plt.close(fig)


def shades(count: int) -> list[Any]:
    """Colours for ordered things, dark to light, all readable on white."""
    return [plt.get_cmap(SEQUENTIAL)(x) for x in np.linspace(0.0, 0.85, count)]


def label_lines(axis: Any, ends: Sequence[float], labels: Sequence[str], colors: Sequence[Any]) -> None:
    """Write each line's label at its right end, moved apart where they would overlap, and led back by a line.

    To be called when the limits of the axes are final.
    """
    to_height = axis.transData + axis.transAxes.inverted()
    finite = np.nan_to_num(np.asarray(ends, float), nan=axis.get_ylim()[0])
    heights = to_height.transform(np.stack([np.full(len(ends), axis.get_xlim()[1]), finite], axis=1))[:, 1]
    for end, place, label, color in zip(heights, spread(heights, 0.055), labels, colors, strict=True):
        axis.annotate(
            label,
            (1.0, end),
            xycoords="axes fraction",
            xytext=(1.05, place),
            textcoords="axes fraction",
            color=color,
            va="center",
            fontsize=7.5,
            annotation_clip=False,
            arrowprops={
                "arrowstyle": "-",
                "color": color,
                "linewidth": 0.6,
                "shrinkA": 1,
                "shrinkB": 0,
                "relpos": (0, 0.5),
            },
        )


def spread(places: Any, gap: float) -> np.ndarray:
    """Places at least `gap` apart, in the same order, moved as little as can be (least squares)."""
    wanted = np.nan_to_num(np.asarray(places, float))
    order = np.argsort(wanted, kind="stable")
    pools: list[list[float]] = []
    for rank, place in enumerate(wanted[order]):
        pools.append([place - rank * gap])
        while len(pools) > 1 and np.mean(pools[-2]) > np.mean(pools[-1]):
            pools[-2:] = [pools[-2] + pools[-1]]
    moved = np.empty(len(wanted))
    moved[order] = np.repeat([np.mean(p) for p in pools], [len(p) for p in pools]) + np.arange(len(wanted)) * gap
    return moved


def short(value: Any) -> str:
    """A value as a label."""
    return f"{value:.3g}" if isinstance(value, (float, np.floating)) else str(value)
