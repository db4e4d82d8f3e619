"""Robust aggregates over seeds (R. Agarwal et al., "Deep RL at the Edge of the Statistical Precipice", 2021)."""

import numpy as np
from jaxtyping import Float, Num

RESAMPLES = 500


def iqm(values: Num[np.ndarray, "n ..."]) -> Float[np.ndarray, "..."]:
    """Interquartile mean over the first axis: the mean of the middle half, entries at its ends by their share."""
    n = len(values)
    ordered = np.sort(values, axis=0)
    low, high = n / 4, 3 * n / 4
    places = np.arange(n)
    weights = np.clip(np.minimum(places + 1, high) - np.maximum(places, low), 0, None)
    return np.asarray(np.tensordot(weights / weights.sum(), ordered, axes=1))


def iqm_interval(
    values: Num[np.ndarray, "n ..."], confidence: float = 0.95, seed: int = 0
) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."]]:
    """Percentile bootstrap interval of the interquartile mean over the first axis, the entries resampled whole."""
    n = len(values)
    draws = np.random.default_rng(seed).integers(n, size=(RESAMPLES, n))
    estimates = iqm(np.swapaxes(values[draws], 0, 1))
    tail = (1 - confidence) / 2
    low, high = np.quantile(estimates, (tail, 1 - tail), axis=0)
    return np.asarray(low), np.asarray(high)
