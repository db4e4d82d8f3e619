"""Rollouts: whole episodes of a learner's task, without learning.

The evaluation during training, `evaluate` and `play` use these functions.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from humanoid_mjx.learners import Learner
from humanoid_mjx.physics.base import worlds_in
from humanoid_mjx.spec import ships
from humanoid_mjx.tasks.continuous import ContinuousTask, State
from humanoid_mjx.tasks.finite import FiniteTask
from humanoid_mjx.types import BoolScalar, FloatScalar, IntScalar

MAX_EPISODE_STEPS = 100_000
"""Number of steps after which an episode is cut off if its task does not end it."""

AGENTS = ("greedy", "zero", "random")
"""The policy; the middle choice of every joint (of a finite task: action 0); any choice with equal probability."""

Choose = Callable[[State, Key[Array, ""]], Array]
"""From the state of an episode to an action: choices of the joints, or commands in [-1, 1]."""


class Episode(NamedTuple):
    """Results of a whole episode."""

    success: Bool[Array, "*episodes"]
    episode_return: Float[Array, "*episodes"]
    steps: Int[Array, "*episodes"]
    discounted_return: Float[Array, "*episodes"]
    """Sum over the steps k of `discount**k` times the reward."""
    lost: Bool[Array, "*episodes"]
    """True where the physics gave up, see `World.diverged`."""


Loop = tuple[State, Float[Array, "2"], IntScalar, Array]
"""Carry of a rollout: the state, both returns, steps, and the last action or the first outside its range."""


def rollout(
    env: ContinuousTask, choose: Choose, key: Key[Array, ""], discount: FloatScalar | float = 1.0
) -> tuple[Episode, Array]:
    """Play one episode to its end, at most `MAX_EPISODE_STEPS` steps where the task has no limit.

    Return its results, and the first action that `env` does not allow; if there is none, the last action.
    """
    most = getattr(getattr(env, "finite", None), "max_episode_steps", MAX_EPISODE_STEPS)

    def running(loop: Loop) -> BoolScalar:
        return ~loop[0].done & (loop[2] < most)

    def step(loop: Loop) -> Loop:
        state, totals, steps, before = loop
        state, action = decide(env, choose, key, state, steps)
        totals += state.reward * jnp.stack([jnp.float32(1), discount**steps])
        return state, totals, steps + 1, jnp.where(env.allows(before), action, before)

    first = start(env, key)
    loop = first, jnp.zeros(2), jnp.int32(0), jnp.zeros_like(jax.eval_shape(choose, first, key))
    state, totals, steps, action = jax.lax.while_loop(running, step, loop)
    lost = jnp.any(jnp.array([world.diverged for world in worlds_in(state.data)], bool))
    return Episode(state.success, totals[0], steps, totals[1], lost), action


def marked(episode: Episode, allowed: BoolScalar) -> Episode:
    """Return the results of an episode; one in which an action was not allowed is no success, and both its returns are
    NaN."""
    total, discounted = (jnp.where(allowed, x, jnp.nan) for x in (episode.episode_return, episode.discounted_return))
    return episode._replace(success=episode.success & allowed, episode_return=total, discounted_return=discounted)


def score(learner: Learner, choose: Choose, key: Key[Array, ""], discount: FloatScalar | float = 1.0) -> Episode:
    """Play one episode of a learner's task. Actions of learners that do not ship are checked; see `marked`."""
    episode, action = rollout(learner.env, choose, key, discount)
    return episode if ships(type(learner)) else marked(episode, learner.env.allows(action))


def start(env: ContinuousTask, key: Key[Array, ""]) -> State:
    """The first state of the episode with this key."""
    return env.reset(jax.random.split(key)[0])


def decide(
    env: ContinuousTask, choose: Choose, key: Key[Array, ""], state: State, steps: IntScalar
) -> tuple[State, Array]:
    """The decision number `steps` of the episode with this key: the state that it leads to, and the action."""
    act_key, step_key = decision_keys(key, steps)
    action = choose(state, act_key)
    commands = jnp.issubdtype(action.dtype, jnp.floating)
    return (env.step_continuous if commands else env.step)(state, action, step_key), action


def decision_keys(key: Key[Array, ""], steps: IntScalar) -> tuple[Key[Array, ""], Key[Array, ""]]:
    """Keys for the choice and for the step of decision number `steps` of the episode with this key."""
    act_key, step_key = jax.random.split(jax.random.fold_in(jax.random.split(key)[1], steps))
    return act_key, step_key


def greedy(learner: Learner, policy: Any) -> Choose:
    """Return the function that takes the action of the highest value."""
    return lambda state, key: learner.act(policy, learner.observation(state), key)


def agent(learner: Learner, policy: Any, number: IntScalar) -> Choose:
    """One of `AGENTS`, by its number, which may be traced."""
    counts = np.array(learner.env.action_bins)

    def choose(state: State, key: Key[Array, ""]) -> Array:
        best = learner.act(policy, learner.observation(state), key)
        draws = jax.random.uniform(jax.random.fold_in(key, 1), counts.shape)
        random = jnp.minimum(jnp.floor(draws * counts), counts - 1)
        zero = jnp.zeros(counts.shape) if isinstance(learner.task, FiniteTask) else jnp.asarray((counts - 1) // 2)
        others = zero, random
        if jnp.issubdtype(best.dtype, jnp.floating):
            others = tuple(2.0 * choice / np.maximum(counts - 1, 1) - 1.0 for choice in others)
        zero, random = (other.astype(best.dtype) for other in others)
        return jnp.where(number == 0, best, jnp.where(number == 1, zero, random))

    return choose


def mean_scores(learner: Learner, choose: Choose, episodes: int, key: Key[Array, ""]) -> dict[str, FloatScalar]:
    """Means over episodes side by side: `return`, `steps`, `success`."""
    played = jax.vmap(lambda key: score(learner, choose, key))(jax.random.split(key, episodes))
    scores = {"return": played.episode_return, "steps": played.steps, "success": played.success}
    return {name: jnp.mean(x, dtype=jnp.float32) for name, x in scores.items()}
