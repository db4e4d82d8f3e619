"""Check a user's own task against its protocol: trace it once, before anything is compiled."""

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from humanoid_mjx.compute import rng
from humanoid_mjx.spec import InputError
from humanoid_mjx.tasks.base import Task
from humanoid_mjx.tasks.continuous import ContinuousTask, State
from humanoid_mjx.tasks.finite import FiniteTask

SCALARS = ("reward", "terminated", "truncated", "success")


def check_task(task: Task) -> None:
    """Trace `reset` and `step` of a task that does not ship with this package.

    Raises:
      InputError: something is missing, or has a wrong structure, shape or dtype; or an array shape or a Python
        branch depends on a traced value.
    """
    cls = type(task)
    if cls.__module__.partition(".")[0] == __name__.partition(".")[0]:
        return
    traced = jax.eval_shape(lambda: jax.tree.map(jnp.asarray, task))
    with _faults_as_sentences(cls):
        if isinstance(task, ContinuousTask):
            _check_continuous(traced)
        elif isinstance(task, FiniteTask):
            _check_finite(traced)


@contextmanager
def _faults_as_sentences(cls: type[Task]) -> Iterator[None]:
    try:
        yield
    except NotImplementedError as error:
        raise InputError(f"task: {cls.__name__} must implement {_raised_in(error).name}.") from error
    except (jax.errors.JAXTypeError, TypeError) as error:
        if not isinstance(error, jax.errors.JAXTypeError) and "concrete" not in str(error):
            raise
        frame = _raised_in(error)
        raise InputError(
            f"task: {cls.__name__} lets an array's shape or a Python branch depend on a traced value "
            f"({Path(frame.filename).name}, line {frame.lineno}: {frame.line}); "
            "make that field static by declaring it without traced(), or compute with jnp.where."
        ) from error


def _raised_in(error: BaseException) -> traceback.FrameSummary:
    """The innermost place of an error that is not in jax."""
    inside = str(Path(jax.__file__).parent)
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if not frame.filename.startswith(inside)]
    return [frame for frame in frames if "jaxtyping" not in frame.filename and "beartype" not in frame.filename][-1]


def _check_continuous(traced: Any) -> None:
    name, size, choices = type(traced).__name__, traced.observation_size, traced.action_bins
    if not choices or min(choices) < 2:
        raise InputError(f"task: {name}.action_bins must hold a number of at least 2 for each joint, got {choices}.")
    key, action = _key(), jax.ShapeDtypeStruct((len(choices),), jnp.int32)
    state = jax.eval_shape(lambda task, *args: task.reset(*args), traced, key)
    if not isinstance(state, State):
        raise InputError(f"task: {name}.reset must return a State, got a {type(state).__name__}.")
    after = jax.eval_shape(lambda task, *args: task.step(*args), traced, state, action, key)
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


def _check_finite(traced: Any) -> None:
    name, key = type(traced).__name__, _key()
    state = jax.eval_shape(lambda task, *args: task.reset(*args), traced, key)
    action = jax.ShapeDtypeStruct((), jnp.int32)
    result: Any = jax.eval_shape(lambda task, *args: task.step(*args), traced, state, action, key)
    if not (isinstance(result, tuple) and len(result) == 3):
        raise InputError(f"task: {name}.step must return (state, reward, terminated), got a {type(result).__name__}.")
    after, reward, terminated = result
    for field, value in (("reward", reward), ("terminated", terminated)):
        if jnp.shape(value):
            raise InputError(f"task: {name}.step must return a scalar {field}, got shape {jnp.shape(value)}.")
    _check_same(f"{name}.step", state, after)


def _key() -> Any:
    return jax.eval_shape(lambda: rng.key(0))


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
