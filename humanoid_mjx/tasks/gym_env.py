# pyright: reportMissingImports=false
"""Tasks as environments of Gymnasium (M. Towers et al., "Gymnasium", 2024), for its wrappers and the libraries on it.

`TaskVectorEnv` steps environments side by side in one compiled program, which is what a fast training wants. `TaskEnv`
is one environment alone, for libraries that batch environments themselves. Both need the extra `gym`.
"""

from typing import Any, Literal, get_args

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jaxtyping import Array, Key

from humanoid_mjx.compute import rng
from humanoid_mjx.spec import InputError, check_count, shown
from humanoid_mjx.tasks.base import Task
from humanoid_mjx.tasks.continuous import ContinuousTask, State, as_continuous, auto_reset
from humanoid_mjx.tasks.finite import FiniteTask

Actions = Literal["choices", "numbers"]
"""An action as a choice of each joint, or as a number in [-1, 1] for each (`ContinuousTask.step_continuous`)."""


class TaskVectorEnv(VectorEnv):
    """A task as a vector environment.

    An episode that is done begins anew in the same step (`AutoresetMode.SAME_STEP`). The observation that the step led
    to is then in `infos["final_obs"]`, (num_envs, size), and `infos["_final_obs"]` says for which environments. The
    infos also have `success`, true in the step that ends an episode well, and the terms of the reward by name.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012

    def __init__(self, task: Task, num_envs: int, actions: Actions | None = None):
        """Wrap a task.

        Args:
          task: a finite or a continuous task, as `make_task` returns it.
          num_envs: environments side by side.
          actions: `choices` or `numbers`; by default choices for finite tasks and numbers for continuous ones.

        Raises:
          InputError: the task is neither finite nor continuous, or `actions` another word.
        """
        if not isinstance(task, (FiniteTask, ContinuousTask)):
            raise InputError(f"an environment takes a FiniteTask or a ContinuousTask, got a {type(task).__name__}.")
        if actions not in (None, *get_args(Actions)):
            raise InputError(f"actions must be {' or '.join(get_args(Actions))}, got {shown(actions)}.")
        check_count("TaskVectorEnv: num_envs", num_envs, 1)
        actions = actions or ("choices" if isinstance(task, FiniteTask) else "numbers")
        self._task, self.num_envs = as_continuous(jax.tree.map(jnp.asarray, task)), num_envs
        self._choices, self._goes_on, self._state = actions == "choices", True, None
        bins, size = self._task.action_bins, self._task.observation_size
        space: spaces.Space[Any] = spaces.Box(-1.0, 1.0, (len(bins),), np.float32)
        if self._choices:
            space = spaces.Discrete(bins[0]) if len(bins) == 1 else spaces.MultiDiscrete(list(bins))
        self.single_observation_space = spaces.Box(-np.inf, np.inf, (size,), np.float32)
        self.single_action_space = space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._begin = jax.jit(lambda key: jax.vmap(self._task.reset)(jax.random.split(key, num_envs)))
        self._after = jax.jit(self._decide)

    def _decide(self, states: State, actions: Array, key: Key[Array, ""]) -> State:
        """The states after one decision; if `_goes_on` a new episode begins in the place of one that is done."""

        def one(state: State, action: Array, key: Key[Array, ""]) -> State:
            step_key, reset_key = jax.random.split(key)
            state = (self._task.step if self._choices else self._task.step_continuous)(state, action, step_key)
            return auto_reset(self._task, state, reset_key) if self._goes_on else state

        return jax.vmap(one)(states, actions, jax.random.split(key, self.num_envs))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in every environment, the same ones for the same seed."""
        super().reset(seed=seed)
        self._state = self._begin(self._key())
        return np.array(self._state.obs, np.float32), {}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Carry out one decision in every environment; raise an InputError before `reset`, or if these are no actions.
        Numbers are cut off at -1 and 1."""
        if self._state is None:
            raise InputError("step: call reset first.")
        given, bins = np.asarray(actions), np.array(self._task.action_bins)
        if fits := given.dtype.kind in "iuf" and given.size == self.num_envs * len(bins):
            given = given.reshape(self.num_envs, -1)
            fits = (given >= 0) & (given < bins) & (given % 1 == 0) if self._choices else np.isfinite(given)
        if not np.all(fits):
            raise InputError(f"step: each action must be of {self.single_action_space}, got {shown(actions)}.")
        given = jnp.asarray(given, jnp.int32 if self._choices else jnp.float32)
        self._state = self._after(self._state, given, self._key())
        states = jax.device_get(self._state._replace(data=None))
        done = np.asarray(states.done, bool)
        infos = {name: np.array(term) for name, term in states.metrics.items()}
        infos["success"] = done & np.asarray(states.success, bool)
        infos |= {f"_{name}": np.ones(self.num_envs, bool) for name in list(infos)}
        if done.any():
            infos |= {"final_obs": np.array(states.final_obs, np.float32), "_final_obs": done}
        ends = np.array(states.terminated, bool), np.array(states.truncated, bool)
        return np.array(states.obs, np.float32), np.array(states.reward, np.float64), *ends, infos

    def _key(self) -> Key[Array, ""]:
        return rng.key(int(self.np_random.integers(2**31)))


class TaskEnv(gymnasium.Env):
    """A task as one environment. `step` returns the infos of `TaskVectorEnv`, and no episode begins by itself."""

    metadata = {"render_modes": []}  # noqa: RUF012

    def __init__(self, task: Task, actions: Actions | None = None):
        """Wrap a task; see `TaskVectorEnv`."""
        self._one = TaskVectorEnv(task, 1, actions)
        self._one._goes_on = False
        self.observation_space, self.action_space = self._one.single_observation_space, self._one.single_action_space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode, the same one for the same seed."""
        super().reset(seed=seed)
        observations, _ = self._one.reset(seed=seed)
        return observations[0], {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Carry out one decision."""
        observations, rewards, terminated, truncated, infos = self._one.step(action)
        info = {name: values[0].item() for name, values in infos.items() if f"_{name}" in infos and name != "final_obs"}
        return observations[0], float(rewards[0]), bool(terminated[0]), bool(truncated[0]), info
