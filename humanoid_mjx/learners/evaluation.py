"""How well a policy does: whole episodes, side by side, nothing learned meanwhile."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Key

from humanoid_mjx.tasks.continuous import ContinuousTask
from humanoid_mjx.types import BoolScalar, FloatScalar

MAX_EVALUATION_STEPS = 100_000
"""An episode is given up after so many steps, should its task never end it."""


def evaluate(
    task: ContinuousTask,
    params: Any,
    act: Callable[[Array, Key[Array, ""]], Array],
    episodes: int,
    key: Key[Array, ""],
    step: Callable[..., Any] | None = None,
) -> dict[str, FloatScalar]:
    """Means over `episodes` episodes in which `act` decides: `greedy_return`, `greedy_steps`, `greedy_success`.

    `act` is given the observations, (episodes, observation_size), and a key; it returns an action for each. `step` is
    what carries out one of them: `task.step`, or `task.step_continuous` where actions are continuous.
    """
    step = step or task.step
    reset_key, key = jax.random.split(key)
    state = jax.vmap(task.reset, in_axes=(None, 0))(params, jax.random.split(reset_key, episodes))
    zero = jnp.zeros(episodes)

    def running(loop: tuple) -> BoolScalar:
        _, over, _, _, _, count = loop
        return ~over.all() & (count < MAX_EVALUATION_STEPS)

    def body(loop: tuple) -> tuple:
        state, over, total, steps, success, count = loop
        act_key, step_key = jax.random.split(jax.random.fold_in(key, count))
        action = act(state.obs, act_key)
        state = jax.vmap(step, in_axes=(None, 0, 0, 0))(params, state, action, jax.random.split(step_key, episodes))
        total, steps = total + jnp.where(over, 0.0, state.reward), steps + ~over
        success = jnp.where(over, success, state.success)
        return state, over | state.over, total, steps, success, count + 1

    first = state, zero > 0, zero, zero, zero > 0, jnp.int32(0)
    _, _, total, steps, success, _ = jax.lax.while_loop(running, body, first)
    return {"greedy_return": total.mean(), "greedy_steps": steps.mean(), "greedy_success": success.mean()}
