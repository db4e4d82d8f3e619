"""Features of an observation for linear Q-learning (R. Sutton and A. Barto, "Reinforcement Learning", 2018, 9.5).

A basis turns an observation, scaled to 0..1 by the task's bounds, into `active` places among `size` features and the
values that stand there; all other features are zero.
"""

from collections.abc import Callable, Sequence
from itertools import combinations, product
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from humanoid_mjx.spec import InputError

MAX_FEATURES = 1_000_000


class Encoded(NamedTuple):
    """The features that are not zero."""

    place: Int[Array, "*batch active"]
    value: Float[Array, "*batch active"]


Groups = Sequence[Sequence[int]]
"""Observations whose features depend on them together."""


class Basis(NamedTuple):
    """A fixed map from observations to features."""

    size: int
    active: int
    encode: Callable[[Float[Array, "*batch observation_size"]], Encoded]


def combined(families: Groups, order: int) -> Groups:
    """Every `order` observations of each family, or the whole family where it is smaller; all groups of one size."""
    order = min(order, min(map(len, families)))
    return sorted({group for family in families for group in combinations(sorted(family), order)})


def tile_coding(low: np.ndarray, high: np.ndarray, groups: Groups, tiles: int, tilings: int) -> Basis:
    """Overlapping grids, `tilings` of them over every group of observations, each shifted by a fraction of a tile.

    With one tiling of a single observation, and a tile for each of its values, this is a table.
    """
    members = np.array(groups)
    width = members.shape[1]
    # Shifts by odd multiples of a tilings-th of a tile (W. Miller and F. Glanz), which spread better than equal ones.
    shift = (np.arange(tilings)[:, None] * (2 * np.arange(width) + 1) % tilings) / tilings
    side = tiles if tilings == 1 else tiles + 1
    cells, count = side**width, len(groups) * tilings
    _check_size(cells * count)
    first = (np.arange(count) * cells).reshape(len(groups), tilings)
    stride = side ** np.arange(width)

    def encode(obs: Float[Array, "*batch observation_size"]) -> Encoded:
        unit = _unit(obs, low, high)[..., members]
        cell = jnp.floor(unit[..., :, None, :] * (tiles - 1e-4) + shift).astype(jnp.int32)
        place = first + (cell * stride).sum(axis=-1)
        place = place.reshape(*obs.shape[:-1], count)
        return Encoded(place, jnp.ones(place.shape, obs.dtype))

    return Basis(cells * count, count, encode)


def fourier(low: np.ndarray, high: np.ndarray, groups: Groups, frequencies: int) -> Basis:
    """Cosines of up to `frequencies` half periods along the observations of each group (G. Konidaris, 2011)."""
    size = len(low)
    waves = {(0,) * size}
    for group in groups:
        for counts in product(range(frequencies + 1), repeat=len(group)):
            wave = [0] * size
            for place, count in zip(group, counts, strict=True):
                wave[place] = count
            waves.add(tuple(wave))
    return _dense(low, high, lambda unit: jnp.cos(np.pi * unit @ np.array(sorted(waves), np.float32).T), len(waves))


def radial(low: np.ndarray, high: np.ndarray, groups: Groups, centres: int) -> Basis:
    """Bells on a grid of `centres` along the observations of each group, as wide as the distance to the neighbour.

    The bells over one group of observations are scaled to add up to 1.
    """
    members = np.array(groups)
    grid = np.array(list(product(np.linspace(0.0, 1.0, centres), repeat=members.shape[1])), np.float32)
    width = 1.0 / max(centres - 1, 1)
    _check_size(len(members) * len(grid))

    def bells(unit: Float[Array, "*batch observation_size"]) -> Float[Array, "*batch features"]:
        distance = ((unit[..., members][..., None, :] - grid) ** 2).sum(axis=-1)
        bell = jnp.exp(-distance / (2 * width**2))
        return (bell / bell.sum(axis=-1, keepdims=True)).reshape(*unit.shape[:-1], -1)

    return _dense(low, high, bells, len(members) * len(grid))


def _dense(low: np.ndarray, high: np.ndarray, values: Callable[[Array], Array], size: int) -> Basis:
    _check_size(size)

    def encode(obs: Float[Array, "*batch observation_size"]) -> Encoded:
        value = values(_unit(obs, low, high))
        return Encoded(jnp.broadcast_to(jnp.arange(size), value.shape), value)

    return Basis(size, size, encode)


def _unit(obs: Float[Array, "*batch observation_size"], low: np.ndarray, high: np.ndarray) -> Float[Array, "*batch n"]:
    return jnp.clip((obs - jnp.asarray(low, obs.dtype)) / jnp.asarray(np.subtract(high, low), obs.dtype), 0.0, 1.0)


def _check_size(size: int) -> None:
    if size > MAX_FEATURES:
        raise InputError(f"the basis has {size:,} features; at most {MAX_FEATURES:,} are handled: make it coarser.")
