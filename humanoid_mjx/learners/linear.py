"""Semi-gradient Q(lambda) with linear function approximation (Sutton and Barto 2018, chapters 9 to 12)."""

from typing import Any, Literal

import jax.numpy as jnp
from jaxtyping import Array, Float, Key
from pydantic import Field, model_validator

from humanoid_mjx.learners.approximate import ApproximateQ, Batch, chosen
from humanoid_mjx.learners.features import Basis, combined, fourier, radial, tile_coding
from humanoid_mjx.types import FloatScalar


class LinearQ(ApproximateQ):
    """A weight for each feature and choice.

    The update is preconditioned: each weight moves by `learning_rate` times the mean TD error of the samples that it
    had a part in, divided by the number of features that share a sample. One sample then moves its Q by
    `learning_rate` times its error whatever the basis, and a basis with a feature for each state is a table.
    """

    basis: Literal["tiles", "fourier", "radial"] = "tiles"
    resolution: int = Field(8, ge=1, le=10_000, description="tiles, half periods, or centres along an observation")
    tilings: int = Field(8, ge=1, le=256, description="grids of tiles over one another")
    order: int = Field(2, ge=1, le=4, description="observations of a family that a feature depends on")
    learning_rate: float = Field(0.1, gt=0, le=1)

    @model_validator(mode="after")
    def _basis_must_fit(self) -> "LinearQ":
        self.features()
        return self

    def features(self) -> Basis:
        """The basis over the task's observations."""
        low, high = self.world.observation_bounds
        groups = combined(self.world.observation_families, self.order)
        if self.basis == "tiles":
            return tile_coding(low, high, groups, self.resolution, self.tilings)
        return (fourier if self.basis == "fourier" else radial)(low, high, groups, self.resolution)

    def row_bytes(self) -> int:
        return 32 * self.features().active

    def learning_bytes(self, rows: int) -> int:
        """Three arrays like the weights, and the features of every row."""
        return 12 * self.features().size * len(self.world.action_choices) * self.choices + self.row_bytes() * rows

    def init_value(self, key: Key[Array, ""]) -> tuple[Any, Any]:
        return jnp.zeros((self.features().size, len(self.world.action_choices), self.choices)), ()

    def q_values(
        self, value: Float[Array, "features joints choices"], obs: Float[Array, "*batch observation_size"]
    ) -> Float[Array, "*batch joints choices"]:
        basis = self.features()
        place, strength = basis.encode(obs)
        if basis.active == basis.size:
            return jnp.einsum("...f,fjc->...jc", strength, value)
        return (value[place] * strength[..., None, None]).sum(axis=-3)

    def learn(
        self, rate: FloatScalar, value: Any, optimizer: Any, batch: Batch, key: Key[Array, ""]
    ) -> tuple[Any, Any, FloatScalar]:
        basis = self.features()
        place, strength = basis.encode(batch.obs)
        td_error = batch.target - chosen(self.q_values(value, batch.obs), batch.action)
        joints = batch.action.shape[-1]
        at = place[:, :, None], jnp.arange(joints), batch.action[:, None, :]
        change = jnp.zeros_like(value).at[at].add((strength * td_error[:, None])[:, :, None])
        weight = jnp.zeros_like(value).at[at].add((strength**2)[:, :, None])
        # The mean over joints divides a weight's part in Q by `joints`, and this gives it back.
        step = change / jnp.maximum(weight, 1e-12) / basis.active
        return value + rate * step, optimizer, jnp.mean(td_error**2)
