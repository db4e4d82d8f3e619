"""Features of an observation for linear Q-learning (R. Sutton and A. Barto, "Reinforcement Learning", 2018, 9.5).

A basis turns an observation, scaled to 0..1, into features for each joint, whose choices depend on observations of its
own: `active` places among `size` features and the values that stand there; all others are zero.
"""

from collections.abc import Callable, Sequence
from itertools import combinations, product
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from humanoid_mjx.spec import InputError

MAX_FEATURES = 1_000_000


class Scale(NamedTuple):
    """From observations between bounds to numbers from 0 to 1; what lies beyond is clipped.

    `focus` is a power: with 2 the distance from the middle goes by its square root, so that a basis that is even in the
    scaled numbers resolves the middle of a range best, where what is to vanish is small.
    """

    low: Float[np.ndarray, " observation_size"]
    high: Float[np.ndarray, " observation_size"]
    focus: float = 1.0

    def __call__(self, obs: Float[Array, "*batch observation_size"]) -> Float[Array, "*batch observation_size"]:
        low, width = (jnp.asarray(x, obs.dtype) for x in (self.low, np.subtract(self.high, self.low)))
        unit = jnp.clip((obs - low) / width, 0.0, 1.0)
        if self.focus == 1.0:
            return unit
        side = 2.0 * unit - 1.0
        return 0.5 + 0.5 * jnp.sign(side) * jnp.abs(side) ** (1.0 / self.focus)


class Encoded(NamedTuple):
    """The features that are not zero."""

    place: Int[Array, "*batch joints active"]
    value: Float[Array, "*batch joints active"]


Groups = Int[np.ndarray, "joints groups width"]
"""Observations whose features depend on them together."""


class Basis(NamedTuple):
    """A fixed map from observations to features; `size` and `active` count those of one joint."""

    size: int
    active: int
    encode: Callable[[Float[Array, "*batch observation_size"]], Encoded]

    @property
    def dense(self) -> bool:
        """Whether all features are active, each at its own place."""
        return self.active == self.size


def combined(families: Sequence[Sequence[Sequence[int]]], order: int) -> Groups:
    """Every `order` observations of each family of a joint; fewer where any family is smaller, as groups have one size.

    Raises:
      InputError: the families of one joint have more such groups than those of another.
    """
    order = min(order, min(len(family) for own in families for family in own))
    groups = [sorted({group for family in own for group in combinations(sorted(family), order)}) for own in families]
    if len({len(own) for own in groups}) > 1:
        raise InputError("observation_families must have as many groups of observations for each joint.")
    return np.array(groups)


def tile_coding(scale: Scale, groups: Groups, tiles: int, tilings: int) -> Basis:
    """Overlapping grids, `tilings` of them over every group of observations, each shifted by a fraction of a tile.

    With one tiling of a single observation, and a tile for each of its values, this is a table.
    """
    joints, number, width = groups.shape
    # Shifts by odd multiples of a tilings-th of a tile (W. Miller and F. Glanz), which spread better than equal ones.
    shift = (np.arange(tilings)[:, None] * (2 * np.arange(width) + 1) % tilings) / tilings
    side = tiles if tilings == 1 else tiles + 1
    cells, count = side**width, number * tilings
    _check_size(joints * cells * count)
    first = (np.arange(count) * cells).reshape(number, tilings).T

    def encode(obs: Float[Array, "*batch observation_size"]) -> Encoded:
        # By (tiling, group, batch, joint): so each feature's places lie side by side, as they are used.
        lift = (slice(None), *(None,) * (obs.ndim + 1))
        unit, place = scale(obs) * (tiles - 1e-4), first[..., *(None,) * obs.ndim]
        for dimension in range(width):
            at = jnp.moveaxis(unit[..., groups[:, :, dimension]], -1, 0)
            cell = jnp.floor(at + shift[:, dimension][lift].astype(obs.dtype))
            place = place + cell.astype(jnp.int32) * side**dimension
        place = jnp.moveaxis(place.reshape(count, *obs.shape[:-1], joints), 0, -1)
        return Encoded(place, jnp.ones(place.shape, obs.dtype))

    return Basis(cells * count, count, encode)


def fourier(scale: Scale, groups: Groups, frequencies: int) -> Basis:
    """Cosines of up to `frequencies` half periods along the observations of each group (G. Konidaris, 2011)."""
    joints, number, width = groups.shape
    observations = len(scale.low)
    _check_size(joints * number * (frequencies + 1) ** width)
    counts = np.array(list(product(range(frequencies + 1), repeat=width)))
    waves = np.zeros((joints, number, len(counts), observations), np.float32)
    np.put_along_axis(waves, np.broadcast_to(groups[:, :, None], (*waves.shape[:3], width)), counts, axis=-1)
    # Groups share their waves along fewer observations; every joint has the same number of different ones.
    angles = np.pi * np.array([np.unique(own.reshape(-1, observations), axis=0) for own in waves])
    return _dense(scale, lambda unit: jnp.cos(jnp.einsum("...n,jfn->...jf", unit, angles)), angles.shape[1])


def radial(scale: Scale, groups: Groups, centres: int) -> Basis:
    """Bells on a grid of `centres` along the observations of each group, as wide as the distance to the neighbour.

    The bells over one group of observations are scaled to add up to 1.
    """
    joints, number, dimensions = groups.shape
    _check_size(joints * number * centres**dimensions)
    grid = np.array(list(product(np.linspace(0.0, 1.0, centres), repeat=dimensions)), np.float32)
    width = 1.0 / max(centres - 1, 1)

    def bells(unit: Float[Array, "*batch observation_size"]) -> Float[Array, "*batch joints features"]:
        distance = ((unit[..., groups][..., None, :] - grid) ** 2).sum(axis=-1)
        bell = jnp.exp(-distance / (2 * width**2))
        return (bell / bell.sum(axis=-1, keepdims=True)).reshape(*unit.shape[:-1], joints, -1)

    return _dense(scale, bells, number * len(grid))


def _dense(scale: Scale, values: Callable[[Array], Array], size: int) -> Basis:
    def encode(obs: Float[Array, "*batch observation_size"]) -> Encoded:
        value = values(scale(obs))
        return Encoded(jnp.broadcast_to(jnp.arange(size), value.shape), value)

    return Basis(size, size, encode)


def _check_size(size: int) -> None:
    if size > MAX_FEATURES:
        raise InputError(f"the basis has {size:,} features; at most {MAX_FEATURES:,} are handled: make it coarser.")
