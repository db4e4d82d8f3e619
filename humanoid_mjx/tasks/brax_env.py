# pyright: reportAttributeAccessIssue=false, reportArgumentType=false
"""Tasks as environments of Brax (C. D. Freeman et al., "Brax", 2021), for its wrappers and trainers.

`wrap` is what a trainer of Brax should be given as `wrap_env_fn`. Brax's own wrappers take every end that an
environment declares for a termination, and begin every episode of an environment in the state of its first.
"""

import io
from collections.abc import Callable
from contextlib import redirect_stdout
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key, UInt32

from humanoid_mjx.compute import rng
from humanoid_mjx.spec import InputError
from humanoid_mjx.tasks.base import Task
from humanoid_mjx.tasks.continuous import ContinuousTask, State, as_continuous
from humanoid_mjx.tasks.finite import FiniteTask

with redirect_stdout(io.StringIO()):  # mujoco.mjx prints two lines about warp
    from brax.envs.base import Env
    from brax.envs.base import State as BraxState
    from brax.envs.wrappers import training as wrappers


class BraxEnv(Env):
    """A task as a Brax environment, its actions numbers in [-1, 1] for each joint (`ContinuousTask.step_continuous`).

    A state's `pipeline_state` is the task's `State`. Its `metrics` are the reward's terms, and `success`, which is 1 in
    the step that ends an episode well. Its `info` holds

        truncation  whether the episode was cut off with this step (wrappers overwrite it)
        time_out    the same (Brax's PPO with `bootstrap_on_timeout` reads it); `done` holds for both kinds of end
        final_obs   the observation that the step led to, also where a wrapper begins a new episode
        rng         the words of the random key of the next step
    """

    def __init__(self, task: Task):
        """Wrap a finite or a continuous task, whose traced values may be arrays.

        Raises:
          InputError: the task is neither finite nor continuous.
        """
        if not isinstance(task, (FiniteTask, ContinuousTask)):
            raise InputError(f"BraxEnv takes a FiniteTask or a ContinuousTask, got a {type(task).__name__}.")
        self.task = as_continuous(jax.tree.map(jnp.asarray, task))
        self._backend = getattr(task, "physics", "none")

    @property
    def observation_size(self) -> int:
        return self.task.observation_size

    @property
    def action_size(self) -> int:
        """Joints."""
        return len(self.task.action_bins)

    @property
    def backend(self) -> str:
        """Name of the task's physics; `none` where it has no choice."""
        return self._backend

    def reset(self, rng: UInt32[Array, "..."] | Key[Array, ""]) -> BraxState:
        """The start of an episode, another for each key."""
        reset_key, key = jax.random.split(_task_key(jax.random.bits(rng, (2,), jnp.uint32)))
        return _brax_state(self.task.reset(reset_key), {}, {}, key)

    def step(self, state: BraxState, action: Float[Array, " joints"]) -> BraxState:
        """One decision carried out, its numbers cut off at -1 and 1."""
        step_key, key = jax.random.split(_task_key(state.info["rng"]))
        command = jnp.clip(action, -1.0, 1.0)
        after = self.task.step_continuous(state.pipeline_state, command, step_key)
        return _brax_state(after, state.metrics, state.info, key)


class EpisodeWrapper(wrappers.EpisodeWrapper):
    """Brax's wrapper, in which an end by the task's own time limit counts as a truncation."""

    def step(self, state: BraxState, action: Float[Array, "*batch joints"]) -> BraxState:
        state = super().step(state, action)
        truncation = jnp.maximum(state.info["truncation"], state.info["time_out"])
        return state.replace(info=state.info | {"truncation": truncation})


class AutoResetWrapper(wrappers.AutoResetWrapper):
    """Brax's wrapper, in which every episode begins in a state of its own. It goes around environments side by side."""

    def step(self, state: BraxState, action: Float[Array, "*batch joints"]) -> BraxState:
        fresh = self.env.reset(state.info["rng"])
        first = {"first_pipeline_state": fresh.pipeline_state, "first_obs": fresh.obs}
        return super().step(state.replace(info=state.info | first), action)


def wrap(
    env: Env, episode_length: int = 1000, action_repeat: int = 1, randomization_fn: Callable[..., Any] | None = None
) -> Env:
    """Environments side by side that keep truncations and begin every episode in a state of its own.

    A `wrap_env_fn` for Brax's trainers. `episode_length` cuts episodes off, where the task does not do so earlier.

    Raises:
      InputError: one of Brax's options that a task does not have is used.
    """
    if action_repeat != 1:
        raise InputError(f"action_repeat must be 1, got {action_repeat}: a step of a task is one decision.")
    if randomization_fn is not None:
        raise InputError(
            "randomization_fn changes a Brax system, which a task does not have; change the task's own values."
        )
    return AutoResetWrapper(EpisodeWrapper(wrappers.VmapWrapper(env), episode_length, action_repeat))


def _task_key(words: UInt32[Array, "2"]) -> Key[Array, ""]:
    return jax.random.wrap_key_data(words, impl=rng.FAST)


def _brax_state(state: State, metrics: dict[str, Array], info: dict[str, Any], key: Key[Array, ""]) -> BraxState:
    """The state with what wrappers have added to `metrics` and `info`."""

    def number(x: Any) -> Float[Array, ""]:
        return jnp.asarray(x, float)

    metrics = metrics | {name: number(term) for name, term in state.metrics.items()}
    metrics["success"] = number(state.done & state.success)
    truncated = number(state.truncated)
    info = info | {
        "truncation": truncated,
        "time_out": truncated,
        "final_obs": state.final_obs,
        "rng": jax.random.key_data(key),
    }
    return BraxState(state, state.obs, number(state.reward), number(state.done), metrics, info)
