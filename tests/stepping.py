"""Tasks in batches, compiled once for all tasks of one structure."""

import jax
import jax.numpy as jnp

reset = jax.jit(jax.vmap(lambda task, key: task.reset(key), in_axes=(None, 0)))
step = jax.jit(jax.vmap(lambda task, *args: task.step(*args), in_axes=(None, 0, 0, 0)))
"""Of choices."""
step_continuous = jax.jit(jax.vmap(lambda task, *args: task.step_continuous(*args), in_axes=(None, 0, 0, 0)))
"""Of numbers."""


def arrays(task):
    """The task with its traced values as arrays: data of one program."""
    return jax.tree.map(jnp.asarray, task)
