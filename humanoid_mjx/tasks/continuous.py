"""The protocol of continuous tasks: a learner sees numbers, and chooses one of a few values for each joint."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from humanoid_mjx.tasks.base import Task
from humanoid_mjx.tasks.finite import FiniteTask
from humanoid_mjx.types import BoolScalar, FloatScalar, IntScalar


class State(NamedTuple):
    """One episode under way."""

    data: Any
    """The task's own data: any pytree."""
    obs: Float[Array, " observation_size"]
    """Observation of the learner; after an automatic reset, the first one of the new episode."""
    reward: FloatScalar
    terminated: BoolScalar
    """The episode ended in a state beyond which there is no value."""
    truncated: BoolScalar
    """The episode was cut off; its last state has a value like any other."""
    success: BoolScalar
    """True if the episode, ended now, would count as one that reached its aim."""
    final_obs: Float[Array, " observation_size"]
    """The observation that the step led to; it differs from `obs` where an automatic reset followed."""
    metrics: dict[str, FloatScalar]
    """The reward's terms by name."""
    executed: Int[Array, " joints"] | None = None
    """The action carried out, in a task that may replace the chosen one."""

    @property
    def done(self) -> Bool[Array, "*batch"]:
        """True if the episode ended with this step."""
        return jnp.logical_or(self.terminated, self.truncated)


class ContinuousTask(Task):
    """Base of continuous tasks. Derive from it, declare fields, implement what raises here.

    A constant may take the place of a property: `action_bins: ClassVar[tuple[int, ...]] = (3,)`.
    """

    @property
    def observation_size(self) -> int:
        raise NotImplementedError

    @property
    def observation_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """(observation_size,) twice: the range of each observation, beyond which a basis may saturate."""
        return np.full(self.observation_size, -1.0), np.full(self.observation_size, 1.0)

    @property
    def observation_families(self) -> tuple[tuple[tuple[int, ...], ...], ...]:
        """Families of observations for each joint, as indices: those that matter together for its choice.

        Bases are built from them. Here all observations are one family, the same for every joint.
        """
        return ((tuple(range(self.observation_size)),),) * len(self.action_bins)

    @property
    def action_bins(self) -> tuple[int, ...]:
        """Number of values to choose from, for each joint."""
        raise NotImplementedError

    def flat_action(self, action: Int[Array, " joints"]) -> IntScalar:
        """Flat index of a joint action; the first joint varies fastest."""
        return jnp.sum(action * self._strides, dtype=jnp.int32)

    def joint_action(self, flat: IntScalar) -> Int[Array, " joints"]:
        """The joint action with this flat index."""
        return flat // self._strides % np.array(self.action_bins)

    def as_numbers(self, action: Array) -> Float[Array, " joints"]:
        """An action as numbers in [-1, 1]: choice k of n is `linspace(-1, 1, n)[k]`; numbers stay as they are."""
        if jnp.issubdtype(action.dtype, jnp.floating):
            return action
        return 2.0 * action / (np.array(self.action_bins) - 1) - 1.0

    def allows(self, action: Array) -> BoolScalar:
        """Return whether all choices of an action, or all its numbers, lie in their range."""
        commands = jnp.issubdtype(action.dtype, jnp.floating)
        low, high = (-1, 1) if commands else (0, np.array(self.action_bins) - 1)
        return ((action >= low) & (action <= high)).all()

    @property
    def _strides(self) -> Int[np.ndarray, " joints"]:
        return np.cumprod((1, *self.action_bins[:-1]))

    def reset(self, key: Key[Array, ""]) -> State:
        """The start of an episode, another for each key."""
        raise NotImplementedError

    def step(self, state: State, action: Int[Array, " joints"], key: Key[Array, ""]) -> State:
        """One decision carried out. No reset follows here; `auto_reset` adds it."""
        raise NotImplementedError

    def step_continuous(self, state: State, command: Float[Array, " joints"], key: Key[Array, ""]) -> State:
        """`step` for numbers in [-1, 1], one a joint: the nearest choices; choice k of n is `linspace(-1, 1, n)[k]`.

        A task whose choices stand for such numbers carries out the numbers themselves.
        """
        last = np.array(self.action_bins) - 1
        action = jnp.round((jnp.clip(command, -1.0, 1.0) + 1.0) * 0.5 * last).astype(jnp.int32)
        return self.step(state, action, key)


def begin(data: Any, obs: Float[Array, " observation_size"], terms: tuple[str, ...]) -> State:
    """The state of an episode in which nothing has happened; `terms` are the names of the reward's terms."""
    no = jnp.bool_(False)
    return State(data, obs, jnp.float32(0), no, no, no, obs, {name: jnp.float32(0) for name in terms})


def auto_reset(task: ContinuousTask, state: State, key: Key[Array, ""]) -> State:
    """Begin anew where the episode is done. Reward, flags, metrics and `final_obs` remain those of the step."""
    fresh = task.reset(key)
    pairs = (fresh.data, fresh.obs), (state.data, state.obs)
    data, obs = jax.tree.map(lambda new, old: jnp.where(state.done, new, old), *pairs)
    return state._replace(data=data, obs=obs)


class Tabulated(ContinuousTask):
    """A finite task as a continuous one.

    Where the only observation is the row's place in the table, a learner that gives each row a feature of its own sees
    what a tabular learner sees.
    """

    finite: FiniteTask

    @property
    def observation_size(self) -> int:
        return self.finite.observation_size

    @property
    def observation_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(self.observation_size), np.ones(self.observation_size)

    @property
    def action_bins(self) -> tuple[int, ...]:
        return self.finite.action_bins

    def reset(self, key: Key[Array, ""]) -> State:
        state = self.finite.reset(key)
        first = begin((state, jnp.int32(0)), self.finite.observe(state), ())
        return first._replace(executed=jnp.zeros(len(self.action_bins), jnp.int32))

    def step(self, state: State, action: Int[Array, " joints"], key: Key[Array, ""]) -> State:
        inner, length = state.data
        chosen = self.flat_action(action)
        obey_key, choice_key, step_key = jax.random.split(key, 3)
        obeys = jax.random.uniform(obey_key) < self.finite.execution_rate
        random = jax.random.randint(choice_key, (), 0, self.finite.num_actions)
        executed = jnp.where(obeys, chosen, random)
        inner, reward, terminated = self.finite.step(inner, executed, step_key)
        obs = self.finite.observe(inner)
        reward, terminated = jnp.asarray(reward, jnp.float32), jnp.asarray(terminated)
        truncated = ~terminated & (length + 1 >= self.finite.max_episode_steps)
        executed = self.joint_action(executed).astype(jnp.int32)
        return State((inner, length + 1), obs, reward, terminated, truncated, terminated, obs, {}, executed)


def as_continuous(task: Task) -> ContinuousTask:
    """`task` itself, or its continuous form where it is finite."""
    if isinstance(task, FiniteTask):
        return Tabulated(finite=task)
    assert isinstance(task, ContinuousTask)
    return task
