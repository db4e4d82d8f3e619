"""Targets for the value of an action: Q(lambda) over a piece of experience."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from humanoid_mjx.types import FloatScalar


def lambda_targets(
    reward: Float[Array, "steps envs"],
    terminated: Bool[Array, "steps envs"],
    truncated: Bool[Array, "steps envs"],
    next_value: Float[Array, "steps envs"],
    discount: FloatScalar,
    trace_decay: FloatScalar,
) -> Float[Array, "steps envs"]:
    """Peng's Q(lambda) (J. Peng and R. Williams, 1996) as parallel Q-learning uses it (M. Gallici et al., 2024, eq. 5).

        G_t = r_t + discount * (trace_decay * G_{t+1} + (1 - trace_decay) * max_a Q(s_{t+1}, a))

    with nothing beyond a terminal state, and the maximum alone beyond a truncated one and at the end of the piece.
    With trace_decay 0 these are one-step targets, with 1 the rewards to the end of the episode or piece.

    Args:
      next_value: max_a Q of the state that each step led to, before any reset, or another value of it.
    """

    def back(
        following: Float[Array, " envs"], step: tuple[Array, ...]
    ) -> tuple[Float[Array, " envs"], Float[Array, " envs"]]:
        reward, terminated, truncated, value = step
        ahead = jnp.where(truncated, value, trace_decay * following + (1.0 - trace_decay) * value)
        target = reward + discount * jnp.where(terminated, 0.0, ahead)
        return target, target

    steps = reward, terminated, truncated, next_value
    return jax.lax.scan(back, next_value[-1], steps, reverse=True)[1]
