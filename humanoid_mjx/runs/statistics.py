"""Robust aggregates over seeds (R. Agarwal et al., "Deep RL at the Edge of the Statistical Precipice", 2021), with
intervals of 95 %, and the results of an evaluation."""

from collections.abc import Mapping
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Num

ENDS = 0.025, 0.975
"""Quantiles at the ends of an interval."""

RESAMPLES = 500

RESAMPLED_NUMBERS = 10_000_000
"""Approximate number of resampled values held at once."""


def iqm(values: Num[np.ndarray, "n ..."]) -> Float[np.ndarray, "..."]:
    """Interquartile mean over the first axis: the mean of the middle half, entries at its ends by their share."""
    n = len(values)
    ordered = np.sort(values, axis=0)
    low, high = n / 4, 3 * n / 4
    places = np.arange(n)
    weights = np.clip(np.minimum(places + 1, high) - np.maximum(places, low), 0, None)
    # Not a product of matrices: columns of equal values have to get equal means to the last bit, as ranks do.
    return np.asarray((ordered.T * (weights / weights.sum())).T.sum(axis=0))


def iqm_interval(values: Num[np.ndarray, "n ..."]) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."]]:
    """Percentile bootstrap interval of the interquartile mean over the first axis, the entries resampled whole."""
    n, rng = len(values), np.random.default_rng(0)
    batches = np.array_split(np.arange(RESAMPLES), -(-RESAMPLES * values.size // RESAMPLED_NUMBERS))
    draws = (rng.integers(n, size=(len(batch), n)) for batch in batches)
    estimates = np.concatenate([iqm(np.swapaxes(values[rows], 0, 1)) for rows in draws])
    low, high = np.quantile(estimates, ENDS, axis=0)
    return np.asarray(low), np.asarray(high)


def rate_interval(successes: Bool[np.ndarray, " n"]) -> tuple[float, float]:
    """Interval of a probability (E. Wilson, 1927), which keeps a width even where all trials or none succeeded."""
    n, share = len(successes), float(np.mean(successes))
    z2 = NormalDist().inv_cdf(ENDS[1]) ** 2
    middle = (share + z2 / (2 * n)) / (1 + z2 / n)
    half = (z2 * (share * (1 - share) / n + z2 / (4 * n**2))) ** 0.5 / (1 + z2 / n)
    return max(0.0, middle - half), min(1.0, middle + half)


def mean_interval(values: Float[np.ndarray, "n ..."]) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."]]:
    """Percentile bootstrap interval of the mean over the first axis, whose NaN entries are left out; NaN where fewer
    than two others remain."""
    n, known = len(values), np.isfinite(values)
    draws = np.random.default_rng(0).multinomial(n, np.full(n, 1 / n), RESAMPLES).astype(float)
    totals, counts = (np.tensordot(draws, part, axes=1) for part in (np.where(known, values, 0.0), known.astype(float)))
    means = np.divide(totals, counts, out=np.full(totals.shape, np.nan), where=counts > 0)
    enough = known.sum(axis=0) > 1
    # A resample that holds no known entry says nothing; the others always do.
    ends = np.nanquantile(np.where(enough, means, 0.0), ENDS, axis=0)
    low, high = np.where(enough, ends, np.nan)
    return np.asarray(low), np.asarray(high)


class Estimate(NamedTuple):
    """A number and its 95 % interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.4g} ({self.low:.4g} to {self.high:.4g})"


class Evaluation(NamedTuple):
    """Success, return and steps of an agent on a task."""

    policy: str
    agent: str
    success: Estimate
    """The share of episodes, with Wilson's interval."""
    episode_return: Estimate
    """Interquartile means, with bootstrap intervals over the episodes."""
    steps: Estimate
    mean_return: float
    discounted_return: float
    """Interquartile mean; what Q-learning maximises."""

    def as_json(self) -> dict[str, Any]:
        """The evaluation as plain values, with each number's interval beside it."""
        estimates = {"success": self.success, "return": self.episode_return, "steps": self.steps}
        found = {name: getattr(self, name) for name in ("policy", "agent", "mean_return", "discounted_return")}
        for name, estimate in estimates.items():
            found |= {name: estimate.value, f"{name}_interval": [estimate.low, estimate.high]}
        return found


def estimated(policy: str, agent: str, episodes: Mapping[str, np.ndarray]) -> Evaluation:
    """The evaluation of episodes from the results of each."""
    success = np.asarray(episodes["success"], bool)
    measures = (np.asarray(episodes[name], float) for name in ("return", "steps"))
    total, steps = (Estimate(float(iqm(x)), *map(float, iqm_interval(x))) for x in measures)
    rate = Estimate(float(success.mean()), *rate_interval(success))
    means = float(np.mean(episodes["return"])), float(iqm(np.asarray(episodes["discounted_return"], float)))
    return Evaluation(policy, agent, rate, total, steps, *means)
