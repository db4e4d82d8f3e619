# pyright: reportMissingImports=false
"""Tasks as environments of Gymnasium (M. Towers et al., "Gymnasium", 2024), for its wrappers and the libraries on it.

`TaskVectorEnv` steps environments side by side in one compiled program, which is what a fast training wants. `TaskEnv`
is one environment alone, for libraries that batch environments themselves. Both need the extra `gym`.
"""

from typing import Any, Literal

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jaxtyping import Array, Key

from humanoid_mjx.compute import rng
from humanoid_mjx.spec import InputError
from humanoid_mjx.tasks.base import Task
from humanoid_mjx.tasks.continuous import ContinuousTask, State, as_continuous, auto_reset
from humanoid_mjx.tasks.finite import FiniteTask

Actions = Literal["choices", "numbers"]
"""An action as a choice of each joint, or as a number in [-1, 1] for each (`ContinuousTask.step_continuous`)."""


class _Worlds:
    """Environments of a task side by side, and their spaces."""

    def __init__(self, task: Task, count: int, actions: Actions | None):
        if not isinstance(task, (FiniteTask, ContinuousTask)):
            raise InputError(f"an environment takes a FiniteTask or a ContinuousTask, got a {type(task).__name__}.")
        actions = actions or ("choices" if isinstance(task, FiniteTask) else "numbers")
        self.task, self.count = as_continuous(jax.tree.map(jnp.asarray, task)), count
        self.choices = actions == "choices"
        bins, size = self.task.action_bins, self.task.observation_size
        self.observation_space = spaces.Box(-np.inf, np.inf, (size,), np.float32)
        self.action_space: spaces.Space[Any] = spaces.Box(-1.0, 1.0, (len(bins),), np.float32)
        if self.choices:
            self.action_space = spaces.Discrete(bins[0]) if len(bins) == 1 else spaces.MultiDiscrete(list(bins))
        self.begin = jax.jit(lambda key: jax.vmap(self.task.reset)(jax.random.split(key, self.count)))
        self.step = jax.jit(self._step, static_argnums=3)

    def _step(self, states: State, actions: Array, key: Key[Array, ""], goes_on: bool) -> State:
        """The states after one decision; where `goes_on` a new episode begins in the place of one that is done."""

        def one(state: State, action: Array, key: Key[Array, ""]) -> State:
            step_key, reset_key = jax.random.split(key)
            state = (self.task.step if self.choices else self.task.step_continuous)(state, action, step_key)
            return auto_reset(self.task, state, reset_key) if goes_on else state

        return jax.vmap(one)(states, actions, jax.random.split(key, self.count))

    def actions(self, given: Any) -> Array:
        """Actions as `step` takes them, (count, joints)."""
        kind = np.int32 if self.choices else np.float32
        return jnp.asarray(np.asarray(given, kind).reshape(self.count, -1))


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
          InputError: the task is neither finite nor continuous.
        """
        self._worlds, self.num_envs = _Worlds(task, num_envs, actions), num_envs
        self.single_observation_space = self._worlds.observation_space
        self.single_action_space = self._worlds.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in every environment, the same ones for the same seed."""
        super().reset(seed=seed)
        self._state = self._worlds.begin(_key(self.np_random))
        return np.array(self._state.obs, np.float32), {}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Carry out one decision in every environment."""
        worlds = self._worlds
        self._state = worlds.step(self._state, worlds.actions(actions), _key(self.np_random), True)
        observations, rewards, terminated, truncated, infos, final_obs = _results(self._state)
        done = terminated | truncated
        infos |= {f"_{name}": np.ones(self.num_envs, bool) for name in list(infos)}
        if done.any():
            infos |= {"final_obs": final_obs, "_final_obs": done}
        return observations, rewards, terminated, truncated, infos


class TaskEnv(gymnasium.Env):
    """A task as one environment. `step` returns the infos of `TaskVectorEnv`, and no episode begins by itself."""

    metadata = {"render_modes": []}  # noqa: RUF012

    def __init__(self, task: Task, actions: Actions | None = None):
        """Wrap a task; see `TaskVectorEnv`."""
        self._worlds = _Worlds(task, 1, actions)
        self.observation_space, self.action_space = self._worlds.observation_space, self._worlds.action_space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode, the same one for the same seed."""
        super().reset(seed=seed)
        self._state = self._worlds.begin(_key(self.np_random))
        return np.array(self._state.obs[0], np.float32), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Carry out one decision."""
        worlds = self._worlds
        self._state = worlds.step(self._state, worlds.actions(action), _key(self.np_random), False)
        observations, rewards, terminated, truncated, infos, _ = _results(self._state)
        info = {name: values[0].item() for name, values in infos.items()}
        return observations[0], float(rewards[0]), bool(terminated[0]), bool(truncated[0]), info


def _key(random: np.random.Generator) -> Key[Array, ""]:
    return rng.key(int(random.integers(2**31)))


def _results(states: State) -> tuple[Any, Any, Any, Any, dict[str, Any], Any]:
    """Observations, rewards, both kinds of end, infos and final observations of states, as arrays of their own."""
    states = jax.device_get(states._replace(data=None))
    done = np.asarray(states.done, bool)
    infos = {name: np.array(term) for name, term in states.metrics.items()}
    infos["success"] = done & np.asarray(states.success, bool)
    ends = np.array(states.terminated, bool), np.array(states.truncated, bool)
    rewards, final_obs = np.array(states.reward, np.float64), np.array(states.final_obs, np.float32)
    return np.array(states.obs, np.float32), rewards, *ends, infos, final_obs
