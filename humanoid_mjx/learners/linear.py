"""Semi-gradient Q(lambda) with linear function approximation on tiles (R. Sutton and A. Barto, "Reinforcement
Learning", 2018, chapters 9 to 12).

Tile coding turns an observation, scaled to 0..1, into features for each joint, whose choices depend on observations of
its own: `active` of `size` features are 1, all others 0.
"""

from collections.abc import Callable, Sequence
from itertools import combinations
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key
from pydantic import Field, model_validator

from humanoid_mjx.compute import Program
from humanoid_mjx.learners.approximate import ApproximateQ, Batch, chosen
from humanoid_mjx.spec import InputError, traced
from humanoid_mjx.types import FloatScalar

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


UNROLL = 16
"""Active features that are added up without a loop."""

MOST_CELLS = 16
"""Cells of a tiling up to which sums over samples are products of matrices, five times as fast as adding one by one."""


class LinearQ(ApproximateQ):
    """A weight for each feature and choice of a joint.

    The update is preconditioned: each weight moves by `learning_rate` times the mean TD error of the samples in which
    its feature is active, divided by the number of active features. One sample then moves its Q by `learning_rate`
    times its error, and a single tiling with a tile for each state is a table.

    Joints that are alike may share their weights (J. Gupta et al., "Cooperative Multi-Agent Control Using Deep
    Reinforcement Learning", 2017, section 4.1): each learns from what all have seen.
    """

    program: ClassVar[Program] = "tiles"
    resolution: int = Field(8, ge=1, le=10_000, description="tiles per observation and tiling")
    focus: float = Field(1.0, ge=1, le=10, description="1: equal tiles; above 1: finer in the middle of a range")
    tilings: int = Field(8, ge=1, le=256, description="number of overlapping tilings")
    order: int = Field(2, ge=1, le=4, description="number of observations in a feature, all of one family")
    shared: bool = Field(False, description="all joints share one set of weights")
    learning_rate: float = traced(0.1, gt=0, le=1)

    @model_validator(mode="after")
    def _tiles_must_fit(self) -> "LinearQ":
        self.features()
        if self.shared and len(set(self.env.action_bins)) > 1:
            raise ValueError("shared needs joints that have the same number of choices")
        return self

    @property
    def joints(self) -> int:
        return len(self.env.action_bins)

    def features(self) -> Tiles:
        """The tiles over the task's observations."""
        scale = Scale(*self.env.observation_bounds, self.focus)
        groups = combined(self.env.observation_families, self.order)
        return tile_coding(scale, groups, self.resolution, self.tilings)

    def init_value(self, key: Key[Array, ""]) -> tuple[Any, Any]:
        return jnp.zeros(self._shape), ()

    def q_values(
        self, value: Float[Array, "sets features bins"], obs: Float[Array, "*batch observation_size"]
    ) -> Float[Array, "*batch joints bins"]:
        places = self.features().encode(obs)
        if places.shape[-2] == 1:  # a row of the weights of all joints for each feature
            rows = jnp.moveaxis(value, 0, 1).reshape(value.shape[1], -1)
            q = _sum(lambda place: rows[place], places[..., 0, :])
            return jnp.broadcast_to(q.reshape(*q.shape[:-1], -1, self.bins), (*q.shape[:-1], self.joints, self.bins))
        return _sum(lambda place: value[self._set, place], places)

    def learn(
        self, rate: FloatScalar, value: Any, optimizer: Any, batch: Batch, key: Key[Array, ""]
    ) -> tuple[Any, Any, FloatScalar]:
        tiles = self.features()
        td_error = batch.target - chosen(self.q_values(value, batch.obs), batch.action)
        # Sums over each weight's samples: of their errors, and of their number.
        parts = jnp.stack([td_error, jnp.ones_like(td_error)], axis=-1)
        change, number = jnp.moveaxis(self._sums(tiles, tiles.encode(batch.obs), batch.action, parts), -1, 0)
        # Without the gradient's factor 1 / joints: all joints' values move by the error, and so does their mean, Q.
        step = change / jnp.maximum(number, 1.0) / tiles.active
        return value + rate * step, optimizer, jnp.mean(td_error**2)

    def _sums(
        self, tiles: Tiles, places: Array, action: Int[Array, "batch joints"], parts: Float[Array, "batch parts"]
    ) -> Float[Array, "sets features bins parts"]:
        """Sums of the parts of the samples in which a weight is active."""
        cells = tiles.size // tiles.active
        if places.shape[1] == 1 and cells <= MOST_CELLS:
            cell = places[:, 0].T[:, None] - tiles.first[:, None, None]
            is_cell = (cell == np.arange(cells)[:, None]).astype(parts.dtype)
            by_choice = jax.nn.one_hot(action, self.bins)[..., None] * parts[:, None, None]
            sums = jnp.einsum("acn,njbp->jacbp", is_cell, by_choice, precision="highest")
            sums = sums[:, np.argsort(tiles.first)].reshape(self.joints, *self._shape[1:], parts.shape[-1])
            return sums.sum(axis=0, keepdims=True) if self.shared else sums
        places = jnp.broadcast_to(places, (len(action), self.joints, tiles.active))
        at = self._set[:, None], places, action[:, :, None]
        parts = jnp.broadcast_to(parts[:, None, None], (*places.shape, parts.shape[-1]))
        return jnp.zeros((*self._shape, parts.shape[-1]), parts.dtype).at[at].add(parts)

    @property
    def _shape(self) -> tuple[int, int, int]:
        """Shape of the weights: sets of them, features, choices."""
        return 1 if self.shared else self.joints, self.features().size, self.bins

    @property
    def _set(self) -> Int[np.ndarray, " joints"]:
        """Each joint's set of weights."""
        return np.zeros(self.joints, int) if self.shared else np.arange(self.joints)


def _sum(part: Callable[[Int[Array, "*batch"]], Array], places: Int[Array, "*batch active"]) -> Array:
    """The sum of the parts of all active features, added one after another. XLA then uses one kernel on a CPU, twice as
    fast as gathering all parts and summing along their axis."""
    by_feature = jnp.moveaxis(places, -1, 0)
    first, rest = by_feature[0], by_feature[1:]
    unroll = min(len(by_feature), UNROLL)
    return jax.lax.scan(lambda total, place: (total + part(place), None), part(first), rest, unroll=unroll)[0]
