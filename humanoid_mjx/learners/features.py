"""Features of an observation for linear Q-learning (R. Sutton and A. Barto, "Reinforcement Learning", 2018, 9.5).

Tile coding turns an observation, scaled to 0..1, into features for each joint, whose choices depend on observations of
its own: `active` of `size` features are 1, all others 0.
"""

from collections.abc import Callable, Sequence
from itertools import combinations
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from humanoid_mjx.spec import InputError

MAX_FEATURES = 1_000_000


class Scale(NamedTuple):
    """Scaling of observations from their bounds to 0 ... 1; values outside the bounds are clipped.

    The distance from the middle of a range is raised to the power 1 / `focus`. Above 1, tiles of equal width in scaled
    numbers are finest in the middle of the range, where errors are small.
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


Groups = Int[np.ndarray, "joints groups width"]
"""Observations whose features depend on them together."""


class Tiles(NamedTuple):
    """A fixed map from observations to features that are 0 or 1; `size` and `active` count those of one joint."""

    size: int
    active: int
    first: Int[np.ndarray, " active"]
    """The first of the features of which an active one is 1; each has `size / active` to choose from."""
    encode: Callable[[Float[Array, "*batch observation_size"]], Int[Array, "*batch joints active"]]
    """Function from observations to the indices of the features that are 1; those of one joint if all are alike."""


def combined(families: Sequence[Sequence[Sequence[int]]], order: int) -> Groups:
    """Every `order` observations of each family of a joint; fewer where any family is smaller, as groups have one size.
    Those of one joint if all joints have the same.

    Raises:
      InputError: the families of one joint have more such groups than those of another.
    """
    order = min(order, min(len(family) for own in families for family in own))
    groups = [sorted({group for family in own for group in combinations(sorted(family), order)}) for own in families]
    if len({len(own) for own in groups}) > 1:
        raise InputError("observation_families must have as many groups of observations for each joint.")
    return np.array(groups if any(own != groups[0] for own in groups) else groups[:1])


def tile_coding(scale: Scale, groups: Groups, tiles: int, tilings: int) -> Tiles:
    """Overlapping grids, `tilings` of them over every group of observations, each shifted by a fraction of a tile.

    With one tiling of a single observation, and a tile for each of its values, this is a table.
    """
    joints, number, width = groups.shape
    # Shifts by odd multiples of a tilings-th of a tile (W. Miller and F. Glanz), which spread better than equal ones.
    shift = (np.arange(tilings)[:, None] * (2 * np.arange(width) + 1) % tilings) / tilings
    side = tiles if tilings == 1 else tiles + 1
    cells, count = side**width, number * tilings
    if (total := joints * cells * count) > MAX_FEATURES:
        raise InputError(f"the basis has {total:,} features; at most {MAX_FEATURES:,} are handled: make it coarser.")
    first = (np.arange(count) * cells).reshape(number, tilings).T

    def encode(obs: Float[Array, "*batch observation_size"]) -> Int[Array, "*batch joints active"]:
        # By (tiling, group, batch, joint): so each feature's places lie side by side, as they are used.
        lift = (slice(None), *(None,) * (obs.ndim + 1))
        unit, place = scale(obs) * (tiles - 1e-4), first[..., *(None,) * obs.ndim]
        for dimension in range(width):
            at = jnp.moveaxis(unit[..., groups[:, :, dimension]], -1, 0)
            cell = jnp.floor(at + shift[:, dimension][lift].astype(obs.dtype))
            place = place + cell.astype(jnp.int32) * side**dimension
        return jnp.moveaxis(place.reshape(count, *obs.shape[:-1], joints), 0, -1)

    return Tiles(cells * count, count, first.ravel(), encode)
