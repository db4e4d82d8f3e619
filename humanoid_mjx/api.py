"""Training and policies as functions of JAX: pure, without a folder, and to be mapped by `jax.vmap`.

    learner = make_learner("tabular_q", make_task("joint_reach"), episodes=500)
    trained = jax.vmap(lambda epsilon: train(learner.replace(epsilon=epsilon), key(0)))(jnp.linspace(0.05, 0.95, 10))

`humanoid_mjx.sweep` trains the same by the same steps; it adds checkpoints, several devices, GPU kernels and tables.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar, overload

import jax
import jax.numpy as jnp
from jax.tree_util import Partial
from jaxtyping import Array, Float, Key

from humanoid_mjx.evaluation.policy import find_policy
from humanoid_mjx.learners import Learner
from humanoid_mjx.learners import rollout as rollouts
from humanoid_mjx.learners.approximate import ApproximateQ, Weights
from humanoid_mjx.learners.rollout import Episode
from humanoid_mjx.learners.tabular import TabularQ
from humanoid_mjx.tasks.base import Task
from humanoid_mjx.tasks.continuous import ContinuousTask, State, as_continuous
from humanoid_mjx.training import program

W_co = TypeVar("W_co", covariant=True)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Policy(Generic[W_co]):
    """A learned policy as a function of an observation: a pytree, to be passed to `jax.jit` and `jax.vmap`."""

    learner: Learner
    """The learner, which knows how `weights` act and in which task."""
    weights: W_co
    """The arrays that acting needs: a table (states, actions), or the weights of a network."""

    def __call__(self, obs: Array, key: Key[Array, ""]) -> Array:
        """Return the greedy action.

        Args:
          obs: an observation as `observation` returns it; in continuous tasks `state.obs`, (observation_size,).
          key: the key that chooses among equally good actions.

        Returns:
          The choice of each joint, int (joints,), or commands in [-1, 1], float (joints,): the action that
          `task.step` or `task.step_continuous` takes.
        """
        return _act(self, obs, key)

    def observation(self, state: State) -> Array:
        """Return what the policy observes in a state of `task`: `state.obs`, or the row of a table, int ()."""
        return self.learner.observation(state)

    @property
    def task(self) -> ContinuousTask:
        """The task of training, a finite one in its continuous form: `reset(key)`, `step(state, action, key)`."""
        return self.learner.env


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Trained(Generic[W_co]):
    """Result of `train`. Under `jax.vmap` every array has leading axes."""

    policy: Policy[W_co]
    curve: dict[str, Float[Array, "*runs record"]]
    """Learning curve by name, such as `success`, `return` and `steps`: means over the episodes that ended in each of
    `learner.record` equal parts of training, NaN where none ended."""
    scores: dict[str, Array]
    """`greedy_success`, `greedy_return`, `greedy_steps`: means over `learner.evaluation_envs` greedy episodes; and
    `diverged`: True if training stopped before numbers that are not finite."""
    carry: object
    """The final training state, with which `learner.train_step` goes on."""


@overload
def train(learner: TabularQ, key: Key[Array, ""]) -> Trained[Array]: ...
@overload
def train(learner: ApproximateQ, key: Key[Array, ""]) -> Trained[Weights]: ...
@overload
def train(learner: Learner, key: Key[Array, ""]) -> Trained[object]: ...
def train(learner: Learner, key: Key[Array, ""]) -> Trained[Any]:
    """Train a learner to its end.

    The function is pure and compiled at its first call for each structure of learner. `jax.vmap` maps it over keys and
    over any traced field of the learner or its task, such as `learner.replace(epsilon=...)`; arrays that are sharded
    over devices train where they are. The steps are those of `humanoid_mjx.sweep`, without its GPU kernels; programs of
    another shape round differently. Call `humanoid_mjx.start()` before jax computes: XLA's defaults slow MJX down and
    abort on a few programs.

    Args:
      learner: what `make_learner` returns; its `replace` sets traced fields without a check.
      key: `humanoid_mjx.key(seed)`, or any key of `jax.random`, whose generator is slower.

    Returns:
      The policy, the learning curve and scores of greedy episodes. Nothing is raised: numbers that are not finite stop
      the training and set `scores["diverged"]`.
    """
    return _train(learner, key)


@jax.jit
def _train(learner: Learner, key: Key[Array, ""]) -> Trained[Any]:
    updates = jnp.ceil(jnp.asarray(learner.budget) / learner.update_steps).astype(jnp.int32)
    last = jax.lax.while_loop(
        lambda state: ~state.failed & (learner.progress(state.carry) < 1.0),
        lambda state: program.advance(learner, state, updates)[0],
        program.begin(learner, key),
    )
    found = program.finish(learner, last, jax.random.fold_in(key, 1))
    return Trained(Policy(learner, found["policy"]), found["curve"], found["final"], last.carry)


@jax.jit
def _act(policy: Policy[Any], obs: Array, key: Key[Array, ""]) -> Array:
    return policy.learner.act(policy.weights, obs, key)


def rollout(
    task: Task, policy: Callable[[Array, Key[Array, ""]], Array], key: Key[Array, ""], discount: float | Array = 1.0
) -> Episode:
    """Play one episode to its end; compiled, pure, and to be mapped by `jax.vmap`.

    Args:
      task: the task, which may differ from that of training: `policy.task.replace(friction=0.5)`.
      policy: from an observation and a key to an action; a `Policy`, or a function of one's own, which gets
        `state.obs`, (observation_size,), of a finite task numbers from 0 to 1 (`FiniteTask.observe`).
      key: the key of the episode.
      discount: the factor of `discounted_return` per step.

    Returns:
      Scalars `success`, `episode_return`, `steps`, `discounted_return`.
    """
    observes = Partial(_by_policy, policy) if isinstance(policy, Policy) else Partial(_by_function, Partial(policy))
    return _rollout(as_continuous(task), observes, key, discount)


def _by_policy(policy: Policy[Any], state: State, key: Key[Array, ""]) -> Array:
    return policy(policy.observation(state), key)


def _by_function(policy: Partial, state: State, key: Key[Array, ""]) -> Array:
    return policy(state.obs, key)


_rollout = jax.jit(rollouts.rollout)


def load_policy(name: str, point: int | None = None) -> Policy[object]:
    """Return a policy as a function of an observation and a key.

    Args:
      name: a shipped policy, such as "walk"; a policy file; or a run folder, whose best policy is taken.
      point: the point of the run's sweep; by default the best.

    Raises:
      InputError: there is no such policy, or its file cannot be read.
    """
    trained = find_policy(name, point)
    return Policy(trained.learner, trained.policy)
