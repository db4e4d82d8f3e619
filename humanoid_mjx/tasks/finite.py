"""The protocol of finite tasks: Markov decision processes that a learner sees through the rows of a table."""

from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.base import Task
from humanoid_mjx.types import BoolScalar, FloatScalar, IntScalar


class Rules(NamedTuple):
    """Rules by which a tabular learner treats a task. The defaults are the Q-learning of section 6.2 of the thesis."""

    update: Literal["every", "terminal"] = "every"
    """The transitions that write to the table: every one, or only the one that reaches the end."""
    bootstrap_at_end: bool = False
    """True if the value of a terminal state's row enters the target."""
    ties: Literal["random", "first"] = "random"
    """Rule by which the greedy choice breaks ties."""
    episode: Literal["restart", "step"] = "restart"
    """Meaning of an episode: a trajectory, after which the next starts anew; or one step of the only trajectory,
    which stops at the end state and whose last step is greedy."""


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
    def learning_rules(self) -> Rules:
        return Rules()

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
