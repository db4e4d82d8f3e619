"""A policy that nobody trained: a robot's servo alone, which shows what the robot does before it has learned."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from flax import linen as nn
from jaxtyping import Array, Float

from humanoid_mjx.learners.deep import DeepQ


class Middle(nn.Module):
    """Values that are greatest for the middle choice of each joint."""

    choices: tuple[int, ...]

    @nn.compact
    def __call__(self, obs: Float[Array, "*batch size"]) -> Float[Array, "*batch joints bins"]:
        scale: Any = self.param("scale", nn.initializers.ones, ())  # optimizers want something to learn
        middle = (np.array(self.choices)[:, None] - 1) // 2
        values = -scale * jnp.abs(jnp.arange(max(self.choices)) - middle)
        return jnp.broadcast_to(values, (*obs.shape[:-1], *values.shape))


class AtRest(DeepQ):
    """The middle choice always: each set-point stays at the posture that the task begins with."""

    def network(self) -> nn.Module:
        return Middle(tuple(self.env.action_bins))
