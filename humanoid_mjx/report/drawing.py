"""Lines with intervals, and the names of what is drawn."""

from typing import Any

import numpy as np
from jaxtyping import Float, Num

from humanoid_mjx.runs.statistics import interval

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


def over_seeds(count: int | str, shape: str = "band") -> str:
    """Meaning of a line and its interval, in words; `shape` names the drawing of the interval."""
    return "1 seed" if count == 1 else f"median over {count} seeds, {shape}: its 95 % interval"


def possible(name: str) -> tuple[float, float]:
    """The least and the greatest possible value of a measure: success is a share, and steps are counted."""
    least = 0.0 if name.endswith("success") or name in ("steps", "whole_steps", "greedy_steps") else -np.inf
    return least, 1.0 if name.endswith("success") else np.inf


def draw_band(
    panel: Any,
    x: Num[np.ndarray, " places"],
    curves: Float[np.ndarray, "seeds places"],
    color: Any,
    *,
    band: bool = True,
    joined: bool = True,
    within: tuple[float, float] = (-np.inf, np.inf),
    **look: Any,
) -> tuple[float, int]:
    """Draw the median over seeds and its 95 % interval where every seed that has any number has one.

    Args:
      x: the places, ordered if `joined`.
      curves: NaN where there is no number.
      band: whether to draw the interval.
      joined: whether to draw a line through the places; else each has a bar for its interval.
      within: the possible values.
      look: how the line looks, such as `linestyle`.

    Returns:
      the last value of the line, NaN where nothing is drawn; and the number of places left out because only some of the
      seeds have a number there.
    """
    known = np.isfinite(curves)
    curves, known = curves[known.any(axis=1)], known[known.any(axis=1)]
    shown = known.all(axis=0) & bool(len(known))
    left_out = int((known.any(axis=0) & ~shown).sum())
    if not shown.any():
        return float("nan"), left_out
    at, middle = x[shown], np.median(curves[:, shown], axis=0)
    low, high = interval(curves[:, shown], *within) if band else (middle, middle)
    if joined:
        panel.plot(at, middle, color=color, **{"linewidth": 1.4} | look)
        if band and len(curves) > 1:
            panel.fill_between(at, low, high, color=color, alpha=0.2, linewidth=0)
    else:
        look = {"fmt": "o", "markersize": 3, "elinewidth": 0.8} | look
        panel.errorbar(at, middle, yerr=np.maximum([middle - low, high - middle], 0.0), color=color, **look)
    return float(middle[-1]), left_out


def draw_line(
    panel: Any,
    x: np.ndarray,
    seed: np.ndarray,
    y: np.ndarray,
    color: Any,
    *,
    place: np.ndarray | None = None,
    **look: Any,
) -> tuple[float, int]:
    """Draw one line as `draw_band` does from rows of a table: the value of a seed at a place is the mean of its rows.

    `y` is NaN where there is none. `place` says which rows belong together, by default those of equal `x`; a place is
    drawn at its mean `x`.
    """
    places, p = np.unique(x if place is None else place, return_inverse=True)
    seeds, s = np.unique(seed, return_inverse=True)
    across = places if place is None else cell_mean(np.zeros_like(p), p, x, (1, len(places)))[0]
    return draw_band(panel, across, cell_mean(s, p, y, (len(seeds), len(places))), color, **look)


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
