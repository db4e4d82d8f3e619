"""Semi-gradient Q(lambda) with linear function approximation (Sutton and Barto 2018, chapters 9 to 12)."""

from collections.abc import Callable
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key
from pydantic import Field, model_validator

from humanoid_mjx.learners.approximate import ApproximateQ, Batch, chosen
from humanoid_mjx.learners.features import Basis, Encoded, Scale, combined, fourier, radial, tile_coding
from humanoid_mjx.spec import traced
from humanoid_mjx.types import FloatScalar

UNROLL = 16
"""Active features that are added up without a loop."""


class LinearQ(ApproximateQ):
    """A weight for each feature and choice of a joint.

    The update is preconditioned: each weight moves by `learning_rate` times the mean TD error of the samples that it
    had a part in, divided by the number of features that share a sample. One sample then moves its Q by
    `learning_rate` times its error whatever the basis, and a basis with a feature for each state is a table.

    Joints that are alike may share their weights (J. Gupta et al., "Cooperative Multi-Agent Control Using Deep
    Reinforcement Learning", 2017, section 4.1): each learns from what all have seen.
    """

    basis: Literal["tiles", "fourier", "radial"] = Field("tiles", description="features of the observation")
    resolution: int = Field(8, ge=1, le=10_000, description="tiles, half periods, or centres along an observation")
    focus: float = Field(1.0, ge=1, le=10, description="1 resolves a range evenly; more, its middle more finely")
    tilings: int = Field(8, ge=1, le=256, description="grids of tiles over one another")
    order: int = Field(2, ge=1, le=4, description="observations of a family that a feature depends on")
    shared: bool = Field(False, description="all joints share one set of weights")
    learning_rate: float = traced(0.1, gt=0, le=1)

    @model_validator(mode="after")
    def _basis_must_fit(self) -> "LinearQ":
        self.features()
        if self.shared and len(set(self.env.action_bins)) > 1:
            raise ValueError("shared needs joints that have the same number of choices")
        return self

    def can_split(self, devices: int) -> bool:
        return self.envs % devices == 0

    @property
    def joints(self) -> int:
        return len(self.env.action_bins)

    def features(self) -> Basis:
        """The basis over the task's observations."""
        scale = Scale(*self.env.observation_bounds, self.focus)
        groups = combined(self.env.observation_families, self.order)
        if self.basis == "tiles":
            return tile_coding(scale, groups, self.resolution, self.tilings)
        return (fourier if self.basis == "fourier" else radial)(scale, groups, self.resolution)

    def init_value(self, key: Key[Array, ""]) -> tuple[Any, Any]:
        return jnp.zeros(self._shape), ()

    def q_values(
        self, value: Float[Array, "sets features bins"], obs: Float[Array, "*batch observation_size"]
    ) -> Float[Array, "*batch joints bins"]:
        basis = self.features()
        encoded = basis.encode(obs)
        if basis.dense:
            return jnp.einsum("...jf,jfc->...jc", encoded.value, value[self._set])
        return _sum(lambda place, strength: value[self._set, place] * strength[..., None], encoded)

    def learn(
        self, rate: FloatScalar, value: Any, optimizer: Any, batch: Batch, key: Key[Array, ""]
    ) -> tuple[Any, Any, FloatScalar]:
        basis = self.features()
        encoded = basis.encode(batch.obs)
        if basis.dense:
            q = chosen(self.q_values(value, batch.obs), batch.action)
        else:
            q = _sum(lambda place, part: value[self._set, place, batch.action] * part, encoded).mean(axis=-1)
        td_error = batch.target - q
        parts = jnp.stack([encoded.value * td_error[:, None, None], encoded.value**2], axis=-1)
        change, weight = jnp.moveaxis(self.mean(self._by_weight(encoded, batch.action, parts)), -1, 0)
        # The mean over joints divides a weight's part in Q by their number, and this gives it back.
        step = change / jnp.maximum(weight, 1e-12) / basis.active
        return value + rate * step, optimizer, jnp.mean(td_error**2)

    def _by_weight(
        self,
        encoded: Encoded,
        action: Int[Array, "batch joints"],
        parts: Float[Array, "batch joints active 2"],
    ) -> Float[Array, "sets features bins 2"]:
        """The sums of what belongs to each weight: to each active feature with the choice that was taken."""
        if not self.features().dense:
            at = self._set[:, None], encoded.place, action[:, :, None]
            return jnp.zeros((*self._shape, 2), parts.dtype).at[at].add(parts)
        taken = jax.nn.one_hot(action, self.bins, dtype=parts.dtype)
        if self.shared:
            return jnp.einsum("bjfp,bjc->fcp", parts, taken)[None]
        return jnp.einsum("bjfp,bjc->jfcp", parts, taken)

    @property
    def _shape(self) -> tuple[int, int, int]:
        """Shape of the weights: sets of them, features, choices."""
        return 1 if self.shared else self.joints, self.features().size, self.bins

    @property
    def _set(self) -> Int[np.ndarray, " joints"]:
        """Each joint's set of weights."""
        return np.zeros(self.joints, int) if self.shared else np.arange(self.joints)


def _sum(
    part: Callable[[Int[Array, "*batch joints"], Float[Array, "*batch joints"]], Array], encoded: Encoded
) -> Array:
    """The sum of the parts of all active features, one after another: so XLA computes it in one kernel on a CPU, twice
    as fast as it fetches all parts and then sums along their axis."""
    first, *_ = features = [jnp.moveaxis(x, -1, 0) for x in encoded]
    start = part(*(x[0] for x in features))
    rest = tuple(x[1:] for x in features)
    return jax.lax.scan(lambda total, each: (total + part(*each), None), start, rest, unroll=min(len(first), UNROLL))[0]
