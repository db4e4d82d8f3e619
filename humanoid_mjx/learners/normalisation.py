"""Running mean and variance of observations."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from humanoid_mjx.types import FloatScalar

VARIANCE_FLOOR = 1e-6
"""Added to variances."""

MAX_DEVIATIONS = 10.0
"""A normalised observation is cut off beyond so many standard deviations."""


class Moments(NamedTuple):
    """Number, mean and variance of all observations seen so far."""

    count: FloatScalar
    mean: Float[Array, " size"]
    variance: Float[Array, " size"]


def moments(size: int) -> Moments:
    """The moments before anything is seen: count 0, mean 0 and variance 1."""
    return Moments(jnp.float32(0), jnp.zeros(size), jnp.ones(size))


def observe(old: Moments, obs: Float[Array, "batch size"]) -> Moments:
    """Add a batch of raw observations (T. Chan et al., "Updating Formulae and a Pairwise Algorithm", 1979)."""
    mean, variance, number = obs.mean(axis=0), obs.var(axis=0), len(obs)
    count = old.count + number
    share = number / count
    difference = mean - old.mean
    between = share * (1.0 - share) * difference**2
    return Moments(count, old.mean + share * difference, (1.0 - share) * old.variance + share * variance + between)


def normalise(seen: Moments, obs: Float[Array, "*batch size"]) -> Float[Array, "*batch size"]:
    """Observations scaled to mean 0 and variance 1 by the moments seen so far."""
    return jnp.clip((obs - seen.mean) / jnp.sqrt(seen.variance + VARIANCE_FLOOR), -MAX_DEVIATIONS, MAX_DEVIATIONS)
