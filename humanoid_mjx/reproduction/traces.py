"""Step-by-step traces of tabular training, for figures that show single runs."""

from typing import Any, NamedTuple

import jax
import numpy as np

from humanoid_mjx.compute import rng
from humanoid_mjx.learners import make_learner
from humanoid_mjx.tasks import make_task


class Trace(NamedTuple):
    """Runs of one learner, step by step."""

    state: np.ndarray
    """(runs, steps + 1) The task's state before each step and after the last."""
    terminated: np.ndarray
    """(runs, steps) True where the step ended the trajectory."""
    explore: np.ndarray
    """(runs, steps) The random number that decided between exploring and the greedy action."""
    q_table: np.ndarray
    """(runs, num_states, num_actions) The table at the end."""


def printed_run(joint: int, config: dict[str, Any], runs: int, steps: int) -> Trace:
    """Runs of `joint_reach` by the printed rules; `config` holds values of task and learner."""
    task = make_task("joint_reach", joint=joint, rules="printed", max_episode_steps=steps, **config["task"])
    learner = make_learner("tabular_q", task, episodes=steps, record=1, **config["learner"])

    def one(learner: Any, key: Any) -> Any:
        def step(carry: Any, _: None) -> Any:
            explore = rng.uniforms(key, carry.step, 3)[0]
            seen = carry.agents.terminated, carry.agents.state, explore
            return learner.train_step(carry)[0], seen

        first = learner.init(key)
        start = learner.task.reset(jax.random.fold_in(key, 0))
        return start, *jax.lax.scan(step, first, length=steps)

    keys = jax.vmap(jax.random.fold_in, in_axes=(None, 0))(rng.key(0), np.arange(runs, dtype=np.uint32))
    start, last, (terminated, after, explore) = jax.jit(jax.vmap(one, in_axes=(None, 0)))(learner, keys)
    state = np.concatenate([np.asarray(start)[:, None], np.asarray(after)], axis=1)
    return Trace(state, np.asarray(terminated), np.asarray(explore), np.asarray(last.q_table))
