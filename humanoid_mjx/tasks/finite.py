"""The protocol of finite tasks: Markov decision processes that a learner sees through the rows of a table."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.base import Task
from humanoid_mjx.types import BoolScalar, FloatScalar, IntScalar


class FiniteTask(Task):
    """Base of finite tasks. Derive from it and implement `num_states`, `num_actions`, `reset` and `step`."""

    max_episode_steps: int = traced(500, ge=1, le=10_000_000, description="steps after which an episode is truncated")

    @property
    def num_states(self) -> int:
        """Rows of the table."""
        raise NotImplementedError

    @property
    def num_actions(self) -> int:
        raise NotImplementedError

    @property
    def as_printed(self) -> bool:
        """True if a table learns by the pseudo-code of section 6.3 to the letter, False for the Q-learning of 6.2.

        By the pseudo-code only the transition that reaches the end writes to the table, and the value of the end's own
        row enters its target; the first of equally good actions is the greedy one; and an episode is one step of the
        only trajectory, which stops at the end and whose last step is greedy.
        """
        return False

    def reset(self, key: Key[Array, ""]) -> Any:
        """The state at the start of an episode: any pytree; a row of the table unless `state_index` is overridden."""
        raise NotImplementedError

    def step(self, state: Any, action: IntScalar, key: Key[Array, ""]) -> tuple[Any, FloatScalar, BoolScalar]:
        """Carry out `action`: the next state, the reward, and whether the next state is terminal."""
        raise NotImplementedError

    def state_index(self, state: Any) -> IntScalar:
        """The table row that stands for `state`. Several states may share one."""
        return state

    @property
    def observation_size(self) -> int:
        """Number of values that `observe` returns."""
        return 1

    def observe(self, state: Any) -> Float[Array, " observation_size"]:
        """Return the observation of a learner without a table, numbers from 0 to 1: here the row's place in the
        table."""
        return jnp.asarray(self.state_index(state), jnp.float32)[None] / max(self.num_states - 1, 1)

    @property
    def action_bins(self) -> tuple[int, ...]:
        """Choices per joint, fastest first; their product is `num_actions`."""
        return (self.num_actions,)

    def initial_q(self) -> Float[Array, "num_states num_actions"]:
        """The table before learning."""
        return jnp.zeros((self.num_states, self.num_actions))

    @property
    def execution_rate(self) -> FloatScalar:
        """The probability that a greedy choice is carried out; otherwise a random action takes its place (section 6.3's
        `successRate`). The learner knows which action was carried out, and learns about that one."""
        return jnp.float32(1)
