"""Results of `evaluate --gait`: the figures of gaits with their intervals, over episodes and over training seeds."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from humanoid_mjx.evaluation.gait.figures import FIGURES, RATES
from humanoid_mjx.runs.evaluations import Estimate
from humanoid_mjx.runs.statistics import mean_interval, rate_interval


class Summary(NamedTuple):
    """A figure under one command."""

    seeds: tuple[Estimate, ...]
    """The mean over the episodes of each training seed with its 95 % interval; NaN where the figure has no meaning."""
    median: float
    """Over the training seeds."""
    worst: float
    """The least favourable of the training seeds; NaN for a figure of which neither more nor less is better."""
    better: int
    """As `Figure.better`."""

    def as_json(self) -> dict[str, Any]:
        """The figure as plain values: of the seeds [value, low, high] each; None in the place of NaN."""
        seeds = [[_plain(number) for number in seed] for seed in self.seeds]
        return {"median": _plain(self.median), "worst": _plain(self.worst), "seeds": seeds}


class Gait(NamedTuple):
    """The gait of an agent under one command."""

    agent: str
    scenario: str
    command: tuple[float, float, float]
    """Velocity forward and to the left, m/s, and turn rate to the left, rad/s."""
    figures: dict[str, Summary]

    def as_json(self) -> dict[str, Any]:
        """The gait as plain values."""
        figures = {name: summary.as_json() for name, summary in self.figures.items()}
        return {"agent": self.agent, "scenario": self.scenario, "command": list(self.command), "figures": figures}


def summarised(episodes: Mapping[str, Float[np.ndarray, "seeds episodes"]]) -> dict[str, Summary]:
    """The figures of one command from those of each episode, in the order of `FIGURES`."""
    names = [name for name in FIGURES if name in episodes]
    values = np.stack([np.asarray(episodes[name], float) for name in names], axis=-1)
    known = np.isfinite(values)
    total, number = np.where(known, values, 0.0).sum(axis=1), known.sum(axis=1)
    means = np.divide(total, number, out=np.full(total.shape, np.nan), where=number > 0)
    intervals = [mean_interval(of_seed) for of_seed in values]
    found = {}
    for column, name in enumerate(names):
        estimates, better = [], FIGURES[name].better
        for seed, (low, high) in enumerate(intervals):
            one = values[seed, known[seed, :, column], column]
            ends = rate_interval(one > 0.5) if name in RATES and len(one) else (low[column], high[column])
            estimates.append(Estimate(float(means[seed, column]), *map(float, ends)))
        found[name] = Summary(tuple(estimates), *_over_seeds(means[:, column], better), better)
    return found


def _over_seeds(means: Float[np.ndarray, " seeds"], better: int) -> tuple[float, float]:
    """Median and worst of what is known."""
    known = means[np.isfinite(means)]
    if not len(known):
        return np.nan, np.nan
    worst = {1: known.min(), -1: known.max(), 0: np.nan}[better]
    return float(np.median(known)), float(worst)


def _plain(value: float) -> float | None:
    """The number to six digits, which is what float32 holds; None for NaN."""
    return float(f"{value:.6g}") if np.isfinite(value) else None
