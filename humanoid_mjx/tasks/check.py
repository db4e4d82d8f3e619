"""Check a user's own task against its protocol: trace it once, before anything is compiled."""

import re
import traceback
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from humanoid_mjx.compute import rng
from humanoid_mjx.spec import InputError, kinds, ships
from humanoid_mjx.tasks.base import Task
from humanoid_mjx.tasks.continuous import ContinuousTask, State, as_continuous, auto_reset
from humanoid_mjx.tasks.finite import FiniteTask
from humanoid_mjx.user_code import in_words, place

EPISODES, STEPS = 8, 64
"""Size of the trial that looks for numbers that are not finite: episodes side by side, and random actions in each."""

TAKEN = re.compile(
    "episodes?|steps?|updates|return|success|td_error|point|seed|rung|run|diverged|wall_s|(greedy|whole)_.*"
)
"""Names of the curves and columns of every run, which no metric may have."""


def check_task(task: Task) -> str:
    """Trace `reset` and `step` of a task that does not ship with this package, or of which a part, such as its control
    law, does not; without a robot, also try them.

    Returns:
      a sentence on the trial: the episodes that ended, and the rewards; "" without a trial.

    Raises:
      InputError: something is missing, fails, or has a wrong structure, shape or dtype; an array shape or a Python
        branch depends on a traced value; or in the trial an observation or reward is not finite, or a state of a finite
        task has no row in the table.
    """
    if not (own := [kind.__name__ for kind in kinds(task) if not ships(kind)]):
        return ""
    name = " with ".join(dict.fromkeys([type(task).__name__, *own]))
    check: Any = _check_finite if isinstance(task, FiniteTask) else _check_continuous
    try:
        jax.eval_shape(lambda task: check(task, type(task).__name__, rng.key(0)), arrays(task))
        # The physics of a robot takes long to compile.
        return _check_numbers(task) if getattr(task, "simulator", None) is None else ""
    except Exception as error:
        raise fault(f"task: {name}", error) from error


def fault(what: str, error: Exception) -> InputError:
    """Return what to say of an error in a user's class, which `what` names with its key."""
    if isinstance(error, InputError):
        return error
    if isinstance(error, NotImplementedError):
        frame, _ = list(traceback.walk_tb(error.__traceback__))[-1]
        of = type(frame.f_locals["self"]).__name__ if "self" in frame.f_locals else what.partition(": ")[2]
        return InputError(f"{what.partition(':')[0]}: {of} must implement {frame.f_code.co_name}.")
    if isinstance(error, jax.errors.JAXTypeError) or (isinstance(error, TypeError) and "concrete" in str(error)):
        return InputError(
            f"{what} lets an array's shape or a Python branch depend on a traced value"
            f"{place(error)}; make that field static by declaring it without traced(), or compute with jnp.where."
        )
    return InputError(f"{what} cannot be used: {in_words(error)}.")


def _check_continuous(task: ContinuousTask, name: str, key: Any) -> None:
    size, choices = task.observation_size, task.action_bins
    if not choices or min(choices) < 2:
        raise InputError(f"task: {name}.action_bins must hold a number of at least 2 for each joint, got {choices}.")
    states: dict[str, Any] = {"reset": (state := task.reset(key))}
    if isinstance(state, State):
        states["step"] = task.step(arrays(state), jnp.zeros(len(choices), jnp.int32), key)
    for method, found in states.items():
        if not isinstance(found, State):
            raise InputError(f"task: {name}.{method} must return a State, got a {type(found).__name__}.")
        for field in ("obs", "final_obs", "reward", "terminated", "truncated", "success"):
            wanted, shape = (size,) if "obs" in field else (), jnp.shape(getattr(found, field))
            if shape != wanted:
                raise InputError(f"task: {name}.{method} must return {field} of shape {wanted}, got {shape}.")
        if not (_is(found.obs, (size,), jnp.number) and _is(found.final_obs, (size,), jnp.number)):
            raise InputError(f"task: {name}.{method} must return obs and final_obs as numbers; write 1.0 * obs.")
        if found.executed is not None and not _is(found.executed, (len(choices),), jnp.integer):
            raise InputError(f"task: {name}.{method} must return executed as an integer for each joint, or None.")
        terms: Any = found.metrics
        if not isinstance(terms, dict) or not all(isinstance(term, str) and _is(terms[term]) for term in terms):
            got = jax.tree.map(jnp.shape, terms)
            raise InputError(f"task: {name}.{method} must return metrics, a dict of scalars by name, got shapes {got}.")
        if taken := sorted(filter(TAKEN.fullmatch, terms)):
            raise InputError(f"task: {name}: every run has a curve or column {taken[0]!r}; rename this metric.")
    check_same(f"{name}.step", *states.values())


def _check_finite(task: FiniteTask, name: str, key: Any) -> None:
    state = arrays(task.reset(key))
    row = jnp.asarray(task.state_index(state))
    if row.shape or not jnp.issubdtype(row.dtype, jnp.integer):
        raise InputError(f"task: {name}: the row of a state must be an integer, got {row.dtype}{list(row.shape)}.")
    result: Any = task.step(state, jnp.int32(0), key)
    if not (isinstance(result, tuple) and len(result) == 3):
        raise InputError(f"task: {name}.step must return (state, reward, terminated), got a {type(result).__name__}.")
    after, reward, terminated = result
    for field, value in (("reward", reward), ("terminated", terminated)):
        if jnp.shape(value):
            raise InputError(f"task: {name}.step must return a scalar {field}, got shape {jnp.shape(value)}.")
    if not _is(terminated, (), jnp.bool_):
        kind = jnp.result_type(terminated)
        raise InputError(f"task: {name}.step must return terminated as a bool, got {kind}; write terminated > 0.")
    check_same(f"{name}.step", state, after)


def _check_numbers(task: Task) -> str:
    name, actions = type(task).__name__, f"{EPISODES} times {STEPS} random actions"
    faults, done, reward = _trial(task, jax.random.split(rng.key(0), EPISODES))
    if any(isinstance(x, Tracer) for x in jax.tree.leaves((faults, done, reward))):
        return ""
    for fault, found in faults.items():
        if found.any():
            raise InputError(f"task: {name} has {fault} in step {int(found.any(axis=0).argmax()) + 1} of {actions}.")
    ends = f"{int(done.sum())} episodes" if done.any() else "no episode"
    return f"{name}: in {actions} {ends} ended, with rewards from {float(reward.min()):g} to {float(reward.max()):g}."


@jax.jit
def _trial(task: Any, keys: Any) -> tuple[dict[str, Any], Any, Any]:
    """Return the faults of some episodes by name, their ends, and their rewards, (episodes, steps) each."""
    env = as_continuous(task)

    def step(state: State, key: Any) -> tuple[State, tuple[dict[str, Any], Any, Any]]:
        act_key, step_key, reset_key = jax.random.split(key, 3)
        action = jax.random.randint(act_key, (len(env.action_bins),), 0, np.array(env.action_bins))
        after = env.step(state, action, step_key)
        numbers = {"an obs": state.obs, "a final_obs": after.final_obs, "a reward": after.reward}
        faults = {f"{name} that is not finite": ~jnp.isfinite(x).all() for name, x in numbers.items()}
        if isinstance(task, FiniteTask):
            row = jnp.stack([task.state_index(each.data[0]) for each in (state, after)])
            faults[f"a state whose row is outside 0 to {task.num_states - 1}"] = (
                row != row.clip(0, task.num_states - 1)
            ).any()
        return auto_reset(env, after, reset_key), (faults, after.done, after.reward)

    return jax.vmap(lambda key: jax.lax.scan(step, env.reset(key), jax.random.split(key, STEPS))[1])(keys)


def arrays(state: Any) -> Any:
    """The leaves as arrays whose types are not weak, as in a training."""
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.result_type(x)), state)


def _is(value: Any, shape: tuple[int, ...] = (), kind: Any = jnp.generic) -> bool:
    """Return whether this is one number or array of numbers, of this shape and kind."""
    return (
        jax.tree_util.all_leaves([value]) and jnp.shape(value) == shape and jnp.issubdtype(jnp.result_type(value), kind)
    )


def check_same(what: str, before: Any, after: Any, first: str = "reset") -> None:
    """A step must lead from a state, as the method `first` returns it, to one of the same structure, shapes and
    dtypes."""
    before, after = arrays(before), arrays(after)
    if jax.tree.structure(before) != jax.tree.structure(after):
        old, new = ({_name(path) for path, _ in jax.tree_util.tree_leaves_with_path(x)} for x in (before, after))
        odd = f"; {', '.join(sorted(old ^ new))} is in one of them alone" if old != new else ""
        raise InputError(f"{what} must return a state of the structure that {first} returns{odd}.")
    pairs = zip(jax.tree_util.tree_leaves_with_path(before), jax.tree.leaves(after), strict=True)
    for (path, old), new in pairs:
        if (old.shape, old.dtype) != (new.shape, new.dtype):
            raise InputError(
                f"{what} must return {_name(path)} as {first} does, {old.dtype}{list(old.shape)}, "
                f"got {new.dtype}{list(new.shape)}."
            )


def _name(path: Any) -> str:
    return jax.tree_util.keystr(path).lstrip(".") or "the state"
