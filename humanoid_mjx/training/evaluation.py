"""Greedy episodes with what was learned."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Key

from humanoid_mjx.learners import Learner


def greedy_episode(learner: Learner, hyper: Any, policy: Any, key: Key[Array, ""]) -> dict[str, Array]:
    """One episode of a finite task under the greedy policy.

    Returns:
      `greedy_return`, `greedy_steps`, and `greedy_success`: whether it reached a terminal state before the cap.
    """
    task: Any = learner.task
    start_key, key = jax.random.split(key)

    def running(loop):
        _, _, steps, terminated = loop
        return ~terminated & (steps < hyper.task.max_episode_steps)

    def step(loop):
        state, total, steps, _ = loop
        act_key, obey_key, choice_key, step_key = jax.random.split(jax.random.fold_in(key, steps), 4)
        action = learner.act(hyper, policy, task.row(hyper.task, state), act_key)
        obeys = jax.random.uniform(obey_key) < task.obedience(hyper.task)
        random = (jax.random.uniform(choice_key) * task.num_actions).astype(jnp.int32)
        action = jnp.where(obeys, action, random)
        state, reward, terminated = task.step(hyper.task, state, action, step_key)
        return state, total + reward, steps + 1, terminated

    start = task.reset(hyper.task, start_key), jnp.float32(0), jnp.int32(0), jnp.bool_(False)
    _, total, steps, terminated = jax.lax.while_loop(running, step, start)
    return {"greedy_return": total, "greedy_steps": steps, "greedy_success": terminated.astype(jnp.float32)}
