"""The protocol of finite tasks: Markov decision processes that a learner sees through the rows of a table."""

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from humanoid_mjx.tasks.base import Task
from humanoid_mjx.types import BoolScalar, FloatScalar, IntScalar


class Rules(NamedTuple):
    """How a tabular learner treats a task. The defaults are Q-learning as section 6.2 of the thesis means it."""

    update: Literal["every", "terminal"] = "every"
    """The transitions that write to the table: every one, or only the one that reaches the end."""
    bootstrap_at_end: bool = False
    """Whether the value of a terminal state's row enters the target."""
    ties: Literal["random", "first"] = "random"
    """Which of several equally good actions the greedy choice takes."""
    episode: Literal["restart", "step"] = "restart"
    """What counts as an episode: a trajectory, after which the next starts anew; or one step of the only trajectory,
    which stops at the end state and whose last step is greedy."""


class FiniteTask(Task):
    """Base of finite tasks. Derive from it, name the traced fields in `Params`, and implement `reset` and `step`.

    `Params` must have a field `max_episode_steps`: an episode that has lasted so long is truncated.
    """

    @property
    def compiler_options(self) -> Mapping[str, str | bool]:
        """For XLA, of the programs that train tables on the task: `runtime.SHARED_KERNELS` where they pass with it."""
        return {}

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

    def reset(self, params: Any, key: Key[Array, ""]) -> Any:
        """The state at the start of an episode: any pytree; an index into the table where `row` is not overridden."""
        raise NotImplementedError

    def step(
        self, params: Any, state: Any, action: IntScalar, key: Key[Array, ""]
    ) -> tuple[Any, FloatScalar, BoolScalar]:
        """Carry out `action`: the next state, the reward, and whether the state is terminal."""
        raise NotImplementedError

    def row(self, params: Any, state: Any) -> IntScalar:
        """The table row that stands for `state`. Several states may share one."""
        return state

    @property
    def observation_size(self) -> int:
        """How many numbers `observe` gives."""
        return 1

    def observe(self, params: Any, state: Any) -> Float[Array, " observation_size"]:
        """What a learner without a table sees of `state`, numbers from 0 to 1: here the row's place in the table."""
        return jnp.asarray(self.row(params, state), jnp.float32)[None] / (self.num_states - 1)

    @property
    def action_choices(self) -> tuple[int, ...]:
        """What an action consists of for such a learner, the fastest first: choices whose numbers multiply up to
        `num_actions`."""
        return (self.num_actions,)

    def initial_q(self, params: Any) -> Float[Array, "num_states num_actions"]:
        """The table before learning."""
        return jnp.zeros((self.num_states, self.num_actions))

    def obedience(self, params: Any) -> FloatScalar:
        """The probability that a greedy choice is carried out; else a random action takes its place (section 6.3's
        `successRate`). The learner knows which action was carried out, and learns about that one."""
        return jnp.float32(1)
