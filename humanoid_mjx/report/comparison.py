"""One figure of several runs: their learning curves in samples and in wall time, beside agents that do not learn."""

from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from humanoid_mjx.evaluation.policy import Trained
from humanoid_mjx.report.style import COLORS, count_axis, figure, label_lines, log_axis, wrapped
from humanoid_mjx.runs.evaluations import Evaluation
from humanoid_mjx.runs.statistics import iqm, iqm_interval
from humanoid_mjx.runs.tables import read_table

MEASURES = {"success": "success", "return": "return per episode, undiscounted"}

BASELINES = {"zero": ":", "random": "--"}
"""Agents that do not learn, and how their lines look."""

FAR_APART = 10.0
"""Where lengths of training differ by more than this factor the axis is logarithmic."""


class Curve(NamedTuple):
    """The learning curve of one sweep point, for each of its seeds."""

    name: str
    samples: Float[np.ndarray, "seeds record"]
    """Control steps since the start of training."""
    wall_s: Float[np.ndarray, "seeds record"] | None
    measures: dict[str, Float[np.ndarray, "seeds record"]]
    """By names of `MEASURES`."""
    greedy: bool
    """Whether they are of greedy episodes rather than of those of training."""


def curve_of(name: str, results: Mapping[str, np.ndarray], point: int, agents: int = 1) -> Curve:
    """The curve of a sweep point, from the table `results` of its run: of greedy episodes where there are any.

    Args:
      name: for the label.
      results: the columns of results.parquet.
      point: the number of the sweep point.
      agents: how many episodes ran at once, where its curves count episodes.
    """
    mine = results["point"] == point
    seeds = len(np.unique(results["seed"][mine]))

    def by_seed(column: str) -> Float[np.ndarray, "seeds record"]:
        return np.asarray(results[column][mine], float).reshape(seeds, -1)

    if "step" in results:
        samples = by_seed("step")
    else:
        episodes = np.diff(by_seed("episode"), axis=1, prepend=0.0)
        samples = np.cumsum(episodes * np.nan_to_num(by_seed("steps")) * agents, axis=1)
    wall = by_seed("wall_s") if "wall_s" in results else None
    greedy = any(np.isfinite(results[f"greedy_{name}"]).any() for name in MEASURES if f"greedy_{name}" in results)
    columns = {name: f"greedy_{name}" if greedy else name for name in MEASURES}
    measures = {name: by_seed(column) for name, column in columns.items() if column in results}
    return Curve(name, samples, wall, measures, greedy)


def curve_of_run(path: Path, trained: Trained) -> Curve:
    """The curve of a policy's sweep point, from the tables of its run folder.

    Raises:
      InputError: a table is missing or damaged.
    """
    results, timing, learner = read_table(path / "results.parquet"), path / "timing.parquet", trained.learner
    if timing.is_file():
        results["wall_s"] = read_table(timing)["wall_s"]
    several = len(np.unique(results["point"])) > 1
    name = f"{trained.name}, point {trained.point}" if several else trained.name
    return curve_of(name, results, trained.point, getattr(learner, "agents", 1))


def compare_curves(path: Path, curves: Sequence[Curve], agents: Sequence[Evaluation]) -> None:
    """A row of panels for each measure; in samples and, where runs recorded it, in wall time.

    A line is the interquartile mean over seeds, its band the 95 % bootstrap interval. `agents` are drawn as horizontal
    lines, where each kind is there once: on one task.
    """
    kinds = [agent.agent for agent in agents]
    level = [agent for agent in agents if kinds.count(agent.agent) == 1]
    colored = list(zip(curves, cycle(COLORS[:-1])))
    timed = [(curve, color) for curve, color in colored if curve.wall_s is not None]
    kinds_of_episode = " or ".join(sorted({"greedy" if curve.greedy else "training" for curve in curves}))
    names = [name for name in MEASURES if any(name in curve.measures for curve in curves)]
    columns = [("control steps", colored)] + ([("seconds of training", timed)] if timed else [])
    with figure(path, len(names), len(columns), size=(5.2, 3.0), sharex="col", sharey="row") as (fig, panels):
        band = "; band: 95 % bootstrap" if any(len(curve.samples) > 1 for curve in curves) else ""
        fig.suptitle(wrapped(f"Interquartile mean over seeds{band}", fig), x=0.01, ha="left")
        for row, name in enumerate(names):
            for column, (unit, drawn) in enumerate(columns):
                panel = panels[row, column]
                shown = [(curve, color) for curve, color in drawn if name in curve.measures]
                ends = [_draw(panel, curve, name, column == 1, color) for curve, color in shown]
                heights = [_height(agent, name) for agent in level]
                for agent, height in zip(level, heights, strict=True):
                    panel.axhline(height, color="0.35", linestyle=BASELINES.get(agent.agent, "-."), linewidth=1.0)
                labels = [curve.name for curve, _ in shown] + [agent.agent for agent in level]
                colors = [color for _, color in shown] + ["0.35"] * len(level)
                if name == "success":
                    panel.set_ylim(-0.03, 1.03)
                label_lines(panel, ends + heights, labels, colors)
                if _far_apart([curve for curve, _ in drawn], column == 1):
                    log_axis(panel, counted=True)
                else:
                    count_axis(panel)
                if row == len(names) - 1:
                    panel.set_xlabel(unit)
                if column == 0:
                    panel.set_ylabel(f"{MEASURES[name]}\n({kinds_of_episode} episodes)")


def _draw(panel: Any, curve: Curve, name: str, timed: bool, color: str) -> float:
    """Draw one line with its band; its last value."""
    across = curve.wall_s if timed and curve.wall_s is not None else curve.samples
    values = curve.measures[name]
    shown = np.isfinite(values).all(axis=0) & np.isfinite(across).all(axis=0)
    if not shown.any():
        return float("nan")
    x, middle = np.median(across[:, shown], axis=0), iqm(values[:, shown])
    panel.plot(x, middle, color=color, linewidth=1.4)
    if len(values) > 1:
        panel.fill_between(x, *iqm_interval(values[:, shown]), color=color, alpha=0.2, linewidth=0)
    return float(middle[-1])


def _height(agent: Evaluation, name: str) -> float:
    return agent.success.value if name == "success" else agent.mean_return


def _far_apart(curves: Sequence[Curve], timed: bool) -> bool:
    """Whether the longest of the trainings dwarfs the shortest."""
    ends = [np.nanmax(across) for c in curves if (across := c.wall_s if timed else c.samples) is not None]
    return bool(max(ends) > FAR_APART * max(min(ends), 1e-9))
