"""Semi-gradient Q(lambda) with linear function approximation on tiles (Sutton and Barto 2018, chapters 9 to 12)."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key
from pydantic import Field, model_validator

from humanoid_mjx.learners.approximate import ApproximateQ, Batch
from humanoid_mjx.learners.features import Scale, Tiles, combined, tile_coding
from humanoid_mjx.spec import traced
from humanoid_mjx.types import FloatScalar

UNROLL = 16
"""Active features that are added up without a loop."""


class LinearQ(ApproximateQ):
    """A weight for each feature and choice of a joint.

    The update is preconditioned: each weight moves by `learning_rate` times the mean TD error of the samples in which
    its feature is active, divided by the number of active features. One sample then moves its Q by `learning_rate`
    times its error, and a single tiling with a tile for each state is a table.

    Joints that are alike may share their weights (J. Gupta et al., "Cooperative Multi-Agent Control Using Deep
    Reinforcement Learning", 2017, section 4.1): each learns from what all have seen.
    """

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
        return _sum(lambda place: value[self._set, place], self.features().encode(obs))

    def learn(
        self, rate: FloatScalar, value: Any, optimizer: Any, batch: Batch, key: Key[Array, ""]
    ) -> tuple[Any, Any, FloatScalar]:
        tiles = self.features()
        places = tiles.encode(batch.obs)
        q = _sum(lambda place: value[self._set, place, batch.action], places).mean(axis=-1)
        td_error = batch.target - q
        # Sums over each weight's samples: of their errors, and of their number.
        parts = jnp.stack([td_error, jnp.ones_like(td_error)], axis=-1)[:, None, None]
        at = self._set[:, None], places, batch.action[:, :, None]
        sums = jnp.zeros((*self._shape, 2), parts.dtype).at[at].add(jnp.broadcast_to(parts, (*places.shape, 2)))
        change, number = jnp.moveaxis(sums, -1, 0)
        # Without the gradient's factor 1 / joints: all joints' values move by the error, and so does their mean, Q.
        step = change / jnp.maximum(number, 1.0) / tiles.active
        return value + rate * step, optimizer, jnp.mean(td_error**2)

    @property
    def _shape(self) -> tuple[int, int, int]:
        """Shape of the weights: sets of them, features, choices."""
        return 1 if self.shared else self.joints, self.features().size, self.bins

    @property
    def _set(self) -> Int[np.ndarray, " joints"]:
        """Each joint's set of weights."""
        return np.zeros(self.joints, int) if self.shared else np.arange(self.joints)


def _sum(part: Callable[[Int[Array, "*batch joints"]], Array], places: Int[Array, "*batch joints active"]) -> Array:
    """The sum of the parts of all active features, added one after another. XLA then uses one kernel on a CPU, twice as
    fast as gathering all parts and summing along their axis."""
    by_feature = jnp.moveaxis(places, -1, 0)
    first, rest = by_feature[0], by_feature[1:]
    unroll = min(len(by_feature), UNROLL)
    return jax.lax.scan(lambda total, place: (total + part(place), None), part(first), rest, unroll=unroll)[0]
