"""Statistics of outcomes: over the seeds of a training, which are few and of any distribution, and over episodes.

Over seeds the middle is the median. Its interval rests on order statistics, so it covers as often as it says whatever
the outcomes' distribution; means and interquartile means of five seeds, half of which fail, have no such interval.
Seeds are common random numbers of all points of a sweep, so points are compared seed by seed.
"""

from collections.abc import Mapping
from functools import lru_cache
from math import comb, inf
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Num

ERROR = 0.05
"""One minus the level of intervals; the share of false alarms that a comparison may have."""

WIDER = {2: 5.87, 3: 0.813, 4: 0.242}
"""By number of values: share of their range by which it grows at each end to cover the median of a normal distribution
in 95 %. The range alone covers any median in 50, 75 and 87.5 %, that of five in 93.75 %."""

RESAMPLES = 399

ROUNDING = 1e-9

BLOCKS = 32
"""More seeds than this, or seeds of other points, are averaged in so many blocks before points are compared."""


class Estimate(NamedTuple):
    """A number and its 95 % interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.4g} ({self.low:.4g} to {self.high:.4g})"


def interval(
    values: Num[np.ndarray, "n ..."], least: float = -inf, most: float = inf
) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."]]:
    """The 95 % interval of the median over the first axis, within the values that are possible.

    Its ends are two of the sorted values, interpolated (T. Hettmansperger and S. Sheather, 1986); of five values they
    are the least and the greatest, of fewer they lie beyond (`WIDER`). Of a single value it is the value. With a NaN
    it is NaN, as the median is.
    """
    n, ordered = len(values), np.sort(np.asarray(values, float), axis=0)
    ordered, outside = np.where(np.isnan(ordered[-1]), np.nan, ordered), _outside(n)
    if n < 2 or outside[0] > ERROR:
        beyond = WIDER.get(n, 0.0) * (ordered[-1] - ordered[0])
        low, high = ordered[0] - beyond, ordered[-1] + beyond
    else:
        k = int(np.flatnonzero(outside <= ERROR)[-1]) + 1
        inner = min(outside[k], 1.0) if k < len(outside) else 1.0
        part = (ERROR - outside[k - 1]) / (inner - outside[k - 1])
        part = (n - k) * part / (k + (n - 2 * k) * part)
        low, high = ((1 - part) * ordered[a] + part * ordered[b] for a, b in ((k - 1, k), (n - k, n - k - 1)))
    return np.asarray(np.clip(low, least, most)), np.asarray(np.clip(high, least, most))


@lru_cache
def _outside(n: int) -> Float[np.ndarray, " ranks"]:
    """Share of samples whose median lies below their k-th smallest value or above their k-th largest one, by k."""
    return 2 * np.cumsum([comb(n, i) / 2**n for i in range(n // 2 + 1)])


def estimate(values: Num[np.ndarray, " n"], least: float = -inf, most: float = inf) -> Estimate:
    """The median of the seeds, and its interval."""
    return Estimate(float(np.median(values)), *map(float, interval(values, least, most)))


def difference(one: Num[np.ndarray, " seeds"], other: Num[np.ndarray, " seeds"], most: float = inf) -> Estimate:
    """The difference of two points by their common seeds; they differ if its interval does not hold 0."""
    return estimate(np.asarray(one, float) - np.asarray(other, float), -most, most)


def improvement(one: Num[np.ndarray, " n"], other: Num[np.ndarray, " m"]) -> float:
    """Probability that a run of one is above a run of the other (R. Agarwal et al., 2021), equal ones counted half."""
    gaps = np.subtract.outer(one, other)
    return float(np.mean(gaps > 0) + np.mean(gaps == 0) / 2)


def profile(values: Num[np.ndarray, " runs"], marks: Num[np.ndarray, " marks"]) -> Float[np.ndarray, " marks"]:
    """Performance profile (R. Agarwal et al., 2021): the share of runs above each mark."""
    return np.mean(np.asarray(values)[:, None] > marks, axis=0)


def not_worse(values: Float[np.ndarray, "points seeds"], error: float = ERROR) -> Bool[np.ndarray, " points"]:
    """The points that are not worse than the best: the model confidence set (P. Hansen et al., 2011).

    The worst point leaves while the points that are left are not alike (`_are_alike`). Where points are alike, a sweep
    loses one in 5 % of the cases, however many points it has, whatever their distribution. NaN is worst.
    """
    known = np.isfinite(values)
    values = np.where(known, values, np.min(values, where=known, initial=inf) if known.any() else 0.0)
    values = _in_blocks(values)
    means = values.mean(axis=1)
    order = np.argsort(-means, kind="stable")
    ends = [*np.flatnonzero(-np.diff(means[order]) > ROUNDING) + 1, len(values)]  # equal points leave together
    alike, left = 0, len(ends) - 1
    if _are_alike(values, error):
        alike = left
    while left - alike > 1:
        middle = (alike + left) // 2
        alike, left = (middle, left) if _are_alike(values[order[: ends[middle]]], error) else (alike, middle)
    return np.isin(np.arange(len(values)), order[: ends[alike]])


def _are_alike(values: Float[np.ndarray, "points seeds"], error: float) -> bool:
    """True if the means of points differ no more than chance makes them differ.

    Chance is to deal out the values of each seed anew among the points. The probability of the range of the means, and
    of their variance, is the share of deals in which it is as great; the smaller of both is compared with that of all
    deals (P. Westfall and S. Young, 1993). Two points have too few deals; Student's test compares them.
    """
    points, seeds = values.shape
    if np.ptp(means := values.mean(axis=1)) < ROUNDING or seeds < 2:
        return True
    if points == 2:
        from scipy.special import stdtr

        gaps = values[0] - values[1]
        return bool(2 * stdtr(seeds - 1, -abs(gaps.mean()) / max(gaps.std(ddof=1) / seeds**0.5, ROUNDING)) > error)
    rng, as_far = np.random.default_rng(0), np.ones(2)
    deals = np.array([[np.ptp(means), means.var()]] * (RESAMPLES + 1))
    for i in range(1, len(deals)):
        dealt = rng.permuted(values, axis=0).mean(axis=1)
        deals[i] = np.ptp(dealt), dealt.var()
        as_far += deals[i] >= deals[0] * (1 - ROUNDING)
        if (as_far > error * len(deals)).all():
            return True
    nearer = np.max([np.searchsorted(np.sort(each), each * (1 - ROUNDING)) for each in deals.T], axis=0)
    return bool(np.mean(nearer >= nearer[0]) > error)


def is_chance(table: Float[np.ndarray, "levels others repeats"]) -> bool:
    """True if chance makes the levels of a parameter differ as much: in more than 5 % of the deals.

    A deal is to shuffle the levels of each repeat, a seed with values of all other parameters; so the test holds
    whatever the distribution (M. Anderson and C. ter Braak, 2003). With more than one column it tests what levels and
    columns do together: the means of both are taken away, and the columns of each repeat are shuffled, too.
    """
    table = _in_blocks(table[..., np.isfinite(table).all(axis=(0, 1))])
    table = table - table.mean(axis=0)
    table = table - table.mean(axis=1, keepdims=True) * (table.shape[1] > 1)
    rng, as_far, spread = np.random.default_rng(0), 1, np.square(table.mean(axis=2)).sum() * (1 - ROUNDING)
    for _ in range(RESAMPLES if table.size else 0):
        dealt = table
        for axis in (0, 1):
            keys = rng.random([n if i in (axis, 2) else 1 for i, n in enumerate(table.shape)])
            dealt = np.take_along_axis(dealt, np.argsort(keys, axis=axis), axis)
        as_far += np.square(dealt.mean(axis=2)).sum() >= spread
        if as_far > ERROR * (RESAMPLES + 1):
            break
    return not table.size or bool(as_far > ERROR * (RESAMPLES + 1))


def _in_blocks(values: Float[np.ndarray, "*points repeats"]) -> Float[np.ndarray, "*points blocks"]:
    """The means of at most `BLOCKS` parts of the last axis."""
    if values.shape[-1] <= BLOCKS:
        return values
    return np.stack([block.mean(axis=-1) for block in np.array_split(values, BLOCKS, axis=-1)], axis=-1)


def of_levels(
    level: Int[np.ndarray, " points"], values: Num[np.ndarray, "points ..."]
) -> Float[np.ndarray, "levels ..."]:
    """The mean over the points of each value of a parameter, seed by seed: its main effect."""
    return np.stack([values[level == each].mean(axis=0, dtype=float) for each in range(int(level.max()) + 1)])


def importance(
    level: Int[np.ndarray, " points"], values: Float[np.ndarray, "points seeds"], drawn: bool = False
) -> Float[np.ndarray, " seeds"]:
    """The share of the variance between points that the value of a parameter explains, each seed against the others.

    Chance of a seed is not counted, since no other seed repeats it. With `level` the number of a pair of values, what
    is above the shares of the two parameters is their interaction. 0 where there is one seed only.

    `drawn`: of points drawn at random; corrected for the chance of the other parameters (T. Kelley, 1935).
    """
    points, seeds = values.shape
    if seeds < 2:
        return np.zeros(seeds)
    values = values - values.mean(axis=0)
    others = (values.sum(axis=1, keepdims=True) - values) / (seeds - 1)
    counts = np.bincount(level)[:, None]
    explained = (counts * of_levels(level, values) * of_levels(level, others)).sum(axis=0)
    total = (values * others).sum(axis=0)
    share = np.where(total > 0, explained / np.where(total > 0, total, 1.0), 0.0)
    share = 1 - (1 - share) * (points - 1) / max(points - len(counts), 1) if drawn else share
    return np.clip(share, -1.0, 1.0)


def importance_of_drawn(level: Int[np.ndarray, " points"], values: Float[np.ndarray, "points seeds"]) -> Estimate:
    """The importance of a parameter whose points were drawn at random, with the interval of other draws of points.

    The interval is Student's by the jackknife over at most `BLOCKS` groups of points (M. Quenouille, 1956; J. Tukey,
    1958); an interval over seeds alone would hold what other points would show in a third of the cases. With fewer than
    two points a level it is -1 to 1: any number of values explains as many points.
    """

    def share(kept: np.ndarray) -> float:
        return float(importance(np.unique(level[kept], return_inverse=True)[1], values[kept], drawn=True).mean())

    every = np.arange(len(level))
    groups = np.array_split(every, min(len(level), BLOCKS))
    if len(groups) < 3 or values.shape[1] < 2 or len(level) < 2 * len(np.unique(level)):
        return Estimate(0.0, -1.0, 1.0)
    without = np.array([share(np.delete(every, group)) for group in groups])
    half = _student(len(groups) - 1) * np.sqrt((len(groups) - 1) * without.var())
    return Estimate(found := share(every), max(found - half, -1.0), min(found + half, 1.0))


def iqm(values: Num[np.ndarray, "n ..."]) -> Float[np.ndarray, "..."]:
    """Interquartile mean over the first axis: the mean of the middle half, entries at its ends by their share."""
    n = len(values)
    ordered = np.sort(values, axis=0)
    low, high = n / 4, 3 * n / 4
    places = np.arange(n)
    weights = np.clip(np.minimum(places + 1, high) - np.maximum(places, low), 0, None)
    return np.asarray((ordered.T * (weights / weights.sum())).T.sum(axis=0))


def rate_interval(successes: Bool[np.ndarray, " n"]) -> tuple[float, float]:
    """Interval of a probability (E. Wilson, 1927), which keeps a width even where all trials or none succeeded."""
    n, share = len(successes), float(np.mean(successes))
    z2 = NormalDist().inv_cdf(1 - ERROR / 2) ** 2
    middle = (share + z2 / (2 * n)) / (1 + z2 / n)
    half = (z2 * (share * (1 - share) / n + z2 / (4 * n**2))) ** 0.5 / (1 + z2 / n)
    return max(0.0, middle - half), min(1.0, middle + half)


def _student(freedom: Any) -> Any:
    """The factor of Student's interval of level 1 - `ERROR`."""
    from scipy.special import stdtrit  # slow to import, and most commands do without

    return stdtrit(freedom, 1 - ERROR / 2)


def mean_known(values: Num[np.ndarray, "n ..."], axis: int = 0) -> Float[np.ndarray, "..."]:
    """The mean over an axis of the values that are finite; NaN where none is."""
    return np.ma.filled(np.ma.masked_invalid(values).mean(axis=axis, dtype=float), np.nan)


def mean_interval(values: Float[np.ndarray, "n ..."]) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."]]:
    """Student's interval of the mean of many episodes, the first axis, whose NaN entries are left out; NaN where fewer
    than two others remain."""
    known = np.ma.masked_invalid(values)
    n = known.count(axis=0)
    mean, half = known.mean(axis=0), _student(n - 1) * known.std(axis=0, ddof=1) / np.sqrt(n)
    return np.ma.filled(mean - half, np.nan), np.ma.filled(mean + half, np.nan)


def iqm_interval(values: Num[np.ndarray, " n"]) -> tuple[float, float]:
    """Interval of the interquartile mean of episodes (J. Tukey and D. McLaughlin, 1963): Student's of the values
    between the quartiles, by the spread of all, those beyond the quartiles moved to these."""
    n, ordered, middle = len(values), np.sort(values), float(iqm(values))
    spread = np.clip(ordered, ordered[n // 4], ordered[-1 - n // 4]).std(ddof=n > 1, dtype=float)
    half = 2 * float(_student(n - 2 * (n // 4) - 1) * spread / n**0.5) if n > 1 else 0.0
    return middle - half, middle + half


class Evaluation(NamedTuple):
    """Success, return and steps of an agent on a task."""

    policy: str
    agent: str
    success: Estimate
    """The share of episodes, with Wilson's interval."""
    episode_return: Estimate
    """Interquartile means over the episodes."""
    steps: Estimate
    mean_return: float
    discounted_return: float
    """Interquartile mean; what Q-learning maximises."""
    lost: float
    """The share of episodes in which the physics gave up; they are no success."""

    def as_json(self) -> dict[str, Any]:
        """The evaluation as plain values, with each number's interval beside it."""
        estimates = {"success": self.success, "return": self.episode_return, "steps": self.steps}
        found = {name: getattr(self, name) for name in ("policy", "agent", "mean_return", "discounted_return", "lost")}
        for name, estimate in estimates.items():
            found |= {name: estimate.value, f"{name}_interval": [estimate.low, estimate.high]}
        return found


def estimated(policy: str, agent: str, episodes: Mapping[str, np.ndarray]) -> Evaluation:
    """The evaluation of episodes from the results of each."""
    success = np.asarray(episodes["success"], bool)
    measures = (np.asarray(episodes[name], float) for name in ("return", "steps"))
    total, steps = (Estimate(float(iqm(x)), *map(float, iqm_interval(x))) for x in measures)
    rate = Estimate(float(success.mean()), *rate_interval(success))
    steps = steps._replace(low=max(steps.low, 0.0))
    means = float(np.mean(episodes["return"])), float(iqm(np.asarray(episodes["discounted_return"], float)))
    return Evaluation(policy, agent, rate, total, steps, *means, float(np.mean(episodes.get("lost", False))))
