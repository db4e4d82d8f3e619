"""Check a user's own task against its protocol: trace it once, before anything is compiled."""

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx.compute import rng
from humanoid_mjx.spec import InputError
from humanoid_mjx.tasks.base import Task
from humanoid_mjx.tasks.continuous import ContinuousTask, State, as_continuous, auto_reset
from humanoid_mjx.tasks.finite import FiniteTask
from humanoid_mjx.user_code import place

EPISODES, STEPS = 8, 64
"""Size of the trial that looks for numbers that are not finite: episodes side by side, and random actions in each."""


def check_task(task: Task) -> None:
    """Trace `reset` and `step` of a task that does not ship with this package; without a robot, also try them.

    Raises:
      InputError: something is missing, or has a wrong structure, shape or dtype; an array shape or a Python branch
        depends on a traced value; or an observation or reward of the trial is not finite.
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
        if getattr(task, "simulator", None) is None:  # the physics of a robot takes long to compile
            _check_numbers(task)


@contextmanager
def _faults_as_sentences(cls: type[Task]) -> Iterator[None]:
    try:
        yield
    except NotImplementedError as error:
        method = traceback.extract_tb(error.__traceback__)[-1].name
        raise InputError(f"task: {cls.__name__} must implement {method}.") from error
    except (jax.errors.JAXTypeError, TypeError) as error:
        if not isinstance(error, jax.errors.JAXTypeError) and "concrete" not in str(error):
            raise
        raise InputError(
            f"task: {cls.__name__} lets an array's shape or a Python branch depend on a traced value{place(error)}; "
            "make that field static by declaring it without traced(), or compute with jnp.where."
        ) from error


def _check_continuous(traced: Any) -> None:
    name, size, choices = type(traced).__name__, traced.observation_size, traced.action_bins
    if not choices or min(choices) < 2:
        raise InputError(f"task: {name}.action_bins must hold a number of at least 2 for each joint, got {choices}.")

    def checked(method: str, *arguments: Any) -> State:
        state = _shapes(traced, method, *arguments)
        if not isinstance(state, State):
            raise InputError(f"task: {name}.{method} must return a State, got a {type(state).__name__}.")
        for field in ("obs", "final_obs"):
            if (shape := getattr(state, field).shape) != (size,):
                raise InputError(f"task: {name}.{method} must return {field} of shape ({size},), got {shape}.")
        scalars = ("reward", "terminated", "truncated", "success")
        _check_scalars(f"{name}.{method}", {field: getattr(state, field) for field in scalars})
        return state

    state = checked("reset")
    _check_same(f"{name}.step", state, checked("step", state, jax.ShapeDtypeStruct((len(choices),), jnp.int32)))


def _check_finite(traced: Any) -> None:
    name, state = type(traced).__name__, _shapes(traced, "reset")
    result = _shapes(traced, "step", state, jax.ShapeDtypeStruct((), jnp.int32))
    if not (isinstance(result, tuple) and len(result) == 3):
        raise InputError(f"task: {name}.step must return (state, reward, terminated), got a {type(result).__name__}.")
    after, reward, terminated = result
    _check_scalars(f"{name}.step", {"reward": reward, "terminated": terminated})
    _check_same(f"{name}.step", state, after)


def _shapes(traced: Any, method: str, *arguments: Any) -> Any:
    """Shapes of what a method returns for these arguments and a key."""
    key = jax.eval_shape(lambda: rng.key(0))
    return jax.eval_shape(lambda task, *args: getattr(task, method)(*args), traced, *arguments, key)


def _check_scalars(what: str, values: dict[str, Any]) -> None:
    for field, value in values.items():
        if shape := jnp.shape(value):
            raise InputError(f"task: {what} must return a scalar {field}, got shape {shape}.")


def _check_numbers(task: Task) -> None:
    for field, good in _trial(task, jax.random.split(rng.key(0), EPISODES)).items():
        if not good.all():
            where = f"in step {int(good.all(axis=0).argmin()) + 1} of a trial with random actions"
            raise InputError(f"task: {type(task).__name__} has a {field} that is not finite {where}.")


@jax.jit
def _trial(task: Any, keys: Any) -> dict[str, Any]:
    """Return whether the observations and the rewards of some episodes are finite, bool (episodes, steps)."""
    env = as_continuous(task)

    def step(state: State, key: Any) -> tuple[State, dict[str, Any]]:
        act_key, step_key, reset_key = jax.random.split(key, 3)
        action = jax.random.randint(act_key, (len(env.action_bins),), 0, np.array(env.action_bins))
        after = env.step(state, action, step_key)
        seen = {"obs": state.obs, "final_obs": after.final_obs, "reward": after.reward}
        return auto_reset(env, after, reset_key), {name: jnp.isfinite(x).all() for name, x in seen.items()}

    return jax.vmap(lambda key: jax.lax.scan(step, env.reset(key), jax.random.split(key, STEPS))[1])(keys)


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
