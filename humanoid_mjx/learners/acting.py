"""Environments side by side, in which a learner acts."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from humanoid_mjx.compute.ways import ways
from humanoid_mjx.tasks.continuous import ContinuousTask, State, auto_reset
from humanoid_mjx.types import FloatScalar, IntScalar

RESETS = 16
"""Number of resets at a time, on a CPU. A reset costs a fifth of a step, and most steps end few episodes."""


class Envs(NamedTuple):
    """The environments; every array leads with an axis of environments."""

    state: State
    episode: Int[Array, " envs"]
    """Number of the episode under way."""
    length: Int[Array, " envs"]
    """Steps of the episode so far."""
    totals: dict[str, Float[Array, " envs"]]
    """Sums of the reward (`return`) and of its terms over the episode so far."""


def start_all(env: ContinuousTask, count: int, key: Key[Array, ""]) -> Envs:
    """Begin an episode in each of `count` environments."""
    none, state = jnp.zeros(count, jnp.int32), jax.vmap(env.reset)(jax.random.split(key, count))
    return Envs(state, none, none, {name: jnp.zeros(count) for name in ("return", *state.metrics)})


def step_all(
    env: ContinuousTask, envs: Envs, action: Array, step_key: Key[Array, ""], reset_key: Key[Array, ""]
) -> tuple[Envs, State, dict[str, FloatScalar]]:
    """Carry out one decision in every environment: choices of the joints, or commands in [-1, 1].

    Return the environments, new episodes begun; the states that the step led to; sums over the ended episodes.
    """
    step = env.step_continuous if jnp.issubdtype(action.dtype, jnp.floating) else env.step
    step_keys, reset_keys = (jax.random.split(key, len(action)) for key in (step_key, reset_key))
    state = jax.vmap(step)(envs.state, action, step_keys)
    done = state.done
    length, now = envs.length + 1, {"return": state.reward} | state.metrics
    totals = {name: total + now[name] for name, total in envs.totals.items()}
    sums = {"episodes": done, "steps": done * length, "success": jnp.logical_and(done, state.success)}
    sums |= {name: done * total for name, total in totals.items()}
    sums = {name: jnp.sum(x, dtype=jnp.float32) for name, x in sums.items()}
    few = ways().resets_apart and len(done) > RESETS
    resets = _reset_done if few else jax.vmap(auto_reset, (None, 0, 0))
    totals = {name: total * ~done for name, total in totals.items()}
    return Envs(resets(env, state, reset_keys), envs.episode + done, length * ~done, totals), state, sums


def _reset_done(env: ContinuousTask, state: State, keys: Key[Array, " envs"]) -> State:
    """`auto_reset` of all, for the ended episodes alone, `RESETS` at a time."""
    count = jnp.cumsum(state.done)

    def some(block: IntScalar, old: tuple[Any, Array]) -> tuple[Any, Array]:
        first = block * RESETS
        rows = jnp.sum(count <= first + jnp.arange(RESETS)[:, None], axis=-1)
        fresh = jax.vmap(env.reset)(keys[rows])
        place = count - 1 - first
        chosen = state.done & (place >= 0) & (place < RESETS)

        def put(new: Array, old: Array) -> Array:
            return jnp.where(chosen.reshape(-1, *[1] * (old.ndim - 1)), new[place], old)

        return jax.tree.map(put, (fresh.data, fresh.obs), old)

    data, obs = jax.lax.fori_loop(0, -(-count[-1] // RESETS), some, (state.data, state.obs))
    return state._replace(data=data, obs=obs)


def of_all_devices(part: Any, axis: str) -> Any:
    """Gather arrays from the devices along an axis of a mesh; join them along their first axis.

    One exchange carries all arrays as rows of 32-bit words, since an exchange costs more than its words.
    """
    leaves, structure = jax.tree.flatten(part)

    def words(x: Array) -> Array:
        return x.astype(jnp.int32) if x.dtype == bool else jax.lax.bitcast_convert_type(x, jnp.int32)

    rows = [words(x).reshape(len(x), -1) for x in leaves]
    whole = jax.lax.all_gather(jnp.concatenate(rows, axis=1), axis, tiled=True)
    parts = jnp.split(whole, np.cumsum([row.shape[1] for row in rows])[:-1], axis=1)

    def back(words: Array, like: Array) -> Array:
        words = words.reshape(len(words), *like.shape[1:])
        return words.astype(bool) if like.dtype == bool else jax.lax.bitcast_convert_type(words, like.dtype)

    return jax.tree.unflatten(structure, map(back, parts, leaves))
