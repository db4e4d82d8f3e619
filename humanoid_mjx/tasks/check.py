"""Whether a user's own task keeps to its protocol: found by tracing it once, before anything is compiled."""

from typing import Any

import jax
import jax.numpy as jnp

from humanoid_mjx import rng
from humanoid_mjx.spec import InputError
from humanoid_mjx.tasks.base import Task
from humanoid_mjx.tasks.continuous import ContinuousTask, State
from humanoid_mjx.tasks.finite import FiniteTask

SCALARS = ("reward", "terminated", "truncated", "success")


def check_task(task: Task) -> None:
    """Trace `reset` and `step` of a task that does not ship with this package.

    Raises:
      InputError: what is missing, or has another structure, shape or dtype than it must have.
    """
    cls = type(task)
    if cls.__module__.partition(".")[0] == __name__.partition(".")[0]:
        return
    if missing := [name for name in cls.Params._fields if name not in cls.model_fields]:
        raise InputError(f"task: {cls.__name__}.Params names {missing[0]!r}, which is no field of {cls.__name__}.")
    if isinstance(task, FiniteTask) and "max_episode_steps" not in cls.Params._fields:
        raise InputError(f"task: {cls.__name__}.Params must name max_episode_steps, which cuts long episodes off.")
    try:
        if isinstance(task, ContinuousTask):
            _check_continuous(task)
        elif isinstance(task, FiniteTask):
            _check_finite(task)
    except NotImplementedError as error:
        where = error.__traceback__
        while where is not None and where.tb_next is not None:
            where = where.tb_next
        name = where.tb_frame.f_code.co_name if where is not None else "a method"
        raise InputError(f"task: {cls.__name__} must implement {name}.") from error


def _check_continuous(task: ContinuousTask) -> None:
    name, size, choices = type(task).__name__, task.observation_size, task.action_choices
    if not choices or min(choices) < 2:
        raise InputError(f"task: {name}.action_choices must hold a number of at least 2 for each joint, got {choices}.")
    params, key = _traced(task)
    state = jax.eval_shape(task.reset, params, key)
    action = jax.ShapeDtypeStruct((len(choices),), jnp.int32)
    if not isinstance(state, State):
        raise InputError(f"task: {name}.reset must return a State, got a {type(state).__name__}.")
    after = jax.eval_shape(task.step, params, state, action, key)
    if not isinstance(after, State):
        raise InputError(f"task: {name}.step must return a State, got a {type(after).__name__}.")
    for method, found in (("reset", state), ("step", after)):
        for field in ("obs", "final_obs"):
            shape = getattr(found, field).shape
            if shape != (size,):
                raise InputError(f"task: {name}.{method} must return {field} of shape ({size},), got {shape}.")
        for field in SCALARS:
            shape = jnp.shape(getattr(found, field))
            if shape:
                raise InputError(f"task: {name}.{method} must return a scalar {field}, got shape {shape}.")
    _check_same(f"{name}.step", state, after)


def _check_finite(task: FiniteTask) -> None:
    name = type(task).__name__
    params, key = _traced(task)
    state = jax.eval_shape(task.reset, params, key)
    result: Any = jax.eval_shape(task.step, params, state, jax.ShapeDtypeStruct((), jnp.int32), key)
    if not (isinstance(result, tuple) and len(result) == 3):
        raise InputError(f"task: {name}.step must return (state, reward, terminated), got a {type(result).__name__}.")
    after, reward, terminated = result
    for field, value in (("reward", reward), ("terminated", terminated)):
        if jnp.shape(value):
            raise InputError(f"task: {name}.step must return a scalar {field}, got shape {jnp.shape(value)}.")
    _check_same(f"{name}.step", state, after)


def _traced(task: Task) -> tuple[Any, Any]:
    """Shapes of the traced values, as training has them, and of a key."""
    return jax.eval_shape(lambda: jax.tree.map(jnp.asarray, task.params)), jax.eval_shape(lambda: rng.key(0))


def _check_same(what: str, before: Any, after: Any) -> None:
    """A step must lead from a state to one of the same structure, shapes and dtypes."""
    if jax.tree.structure(before) != jax.tree.structure(after):
        raise InputError(f"{what} must return a state of the structure that reset returns.")
    pairs = zip(jax.tree_util.tree_leaves_with_path(before), jax.tree.leaves(after), strict=True)
    for (path, old), new in pairs:
        if (old.shape, old.dtype) != (new.shape, new.dtype):
            place = jax.tree_util.keystr(path).lstrip(".") or "the state"
            raise InputError(
                f"{what} must return {place} as reset does, {old.dtype}{list(old.shape)}, "
                f"got {new.dtype}{list(new.shape)}."
            )
