"""A joint that has gone beyond its goal: the one way to it is back, and stepping back may cost something."""

import jax.numpy as jnp
from jaxtyping import Array, Key
from pydantic import Field

from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.finite import FiniteTask
from humanoid_mjx.types import BoolScalar, FloatScalar, IntScalar


class SteppingBack(FiniteTask):
    """A joint stands `steps` steps beyond its goal; the actions are to stay, to step forwards, and to step back.

    A step back earns `back_reward`, reaching the goal `bonus` and ends the episode. Forwards there is room for as many
    steps again.
    """

    steps: int = Field(12, ge=1, le=1000, description="from the start back to the goal")
    bonus: float = traced(100.0)
    back_reward: float = traced(0.0, le=0, description="of every step back")

    @property
    def num_states(self) -> int:
        return 2 * self.steps + 1

    @property
    def num_actions(self) -> int:
        return 3

    def reset(self, key: Key[Array, ""]) -> IntScalar:
        """Number of steps that the joint is beyond the goal."""
        return jnp.int32(self.steps)

    def step(
        self, state: IntScalar, action: IntScalar, key: Key[Array, ""]
    ) -> tuple[IntScalar, FloatScalar, BoolScalar]:
        back = action == 2
        state = jnp.clip(state + jnp.where(back, -1, action), 0, 2 * self.steps).astype(jnp.int32)
        there = state == 0
        return state, jnp.where(back, self.back_reward, 0.0) + jnp.where(there, self.bonus, 0.0), there


def largest_cost(steps: int, bonus: float, discount: float) -> float:
    """The largest cost of a step back at which going to the goal is worth more than staying forever.

    The way is worth `discount**(steps - 1) * bonus - cost * (1 - discount**steps) / (1 - discount)`, staying 0.
    """
    return discount ** (steps - 1) * bonus * (1 - discount) / (1 - discount**steps)
