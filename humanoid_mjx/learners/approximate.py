"""Q-learning with function approximation: many environments, no replay (M. Gallici et al., "Simplifying Deep Temporal
Difference Learning", 2024).

An update lets all environments act for `rollout` steps, computes Q(lambda) targets over what they saw, and moves the
weights towards them. Where a task has several joints Q is the mean of a value for each joint's choice (T. Seyde et al.,
"Solving Continuous Control via Q-Learning", 2023), so that the best action is the best choice of every joint.
"""

from functools import partial
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key
from pydantic import Field

from humanoid_mjx.spec import traced
from humanoid_mjx.learners import exploration
from humanoid_mjx.learners.base import Learner
from humanoid_mjx.learners.evaluation import evaluate
from humanoid_mjx.learners.normalisation import Moments, moments, observe
from humanoid_mjx.learners.targets import lambda_targets
from humanoid_mjx.tasks.continuous import ContinuousTask, State, Tabulated, auto_reset
from humanoid_mjx.tasks.finite import FiniteTask
from humanoid_mjx.types import BoolScalar, FloatScalar, IntScalar


class Weights(NamedTuple):
    """What is learned: all that acting needs."""

    value: Any
    moments: Moments
    """Of the raw observations seen so far."""


class Workers(NamedTuple):
    """The environments, side by side; every array has a leading axis of them."""

    state: State
    holding: exploration.Holding
    episode: Int[Array, " envs"]
    length: Int[Array, " envs"]
    episode_return: Float[Array, " envs"]


class Carry(NamedTuple):
    """The training state of one sweep point."""

    weights: Weights
    optimizer: Any
    workers: Workers
    key: Key[Array, ""]
    update: IntScalar
    failed: BoolScalar
    """Whether the next update leads to numbers that are not finite; training has stopped before it."""
    record: dict[str, Float[Array, " record"]]
    snapshots: Weights
    """What was known at the end of each part of training, for evaluation: a leading axis of `evaluations`."""


class Experience(NamedTuple):
    """What the environments saw in one update; every array leads with (steps, envs)."""

    obs: Float[Array, "steps envs observation_size"]
    action: Int[Array, "steps envs joints"]
    reward: Float[Array, "steps envs"]
    terminated: Bool[Array, "steps envs"]
    truncated: Bool[Array, "steps envs"]
    final_obs: Float[Array, "steps envs observation_size"]


class ApproximateQ(Learner):
    """Base of learners that approximate Q. A derived class gives the approximation and how it learns."""

    unit: ClassVar[str] = "steps"

    task: FiniteTask | ContinuousTask = Field(exclude=True, repr=False)
    epsilon: float = traced(1.0, ge=0, le=1, description="of each joint by itself")
    epsilon_decay: float = traced(0.99, ge=0, le=1, description="per episode of an environment")
    epsilon_min: float = traced(0.02, ge=0, le=1)
    ladder: float = traced(0.0, ge=0, le=100, description="epsilon is raised to 1 ... 1 + ladder over the environments")
    hold: int = Field(1, ge=1, le=1000, description="longest time in steps that a random action is held")
    learning_rate: float = traced(gt=0, le=1)
    learning_rate_end: float = traced(1.0, ge=0, le=1, description="its share at the end, reached linearly")
    discount: float = traced(0.97, ge=0, lt=1)
    trace_decay: float = traced(0.65, ge=0, le=1, description="lambda")
    envs: int = Field(128, ge=1, le=1_000_000, description="environments side by side")
    rollout: int = Field(16, ge=1, le=10_000, description="steps of each environment in an update")
    grow: bool = Field(False, description="open the choices in stages: 3, 5, 9 ... of them")
    evaluations: int = Field(10, ge=1, le=1000, description="greedy evaluations along the learning curve")
    evaluation_envs: int = Field(64, ge=1, le=100_000, description="greedy episodes of an evaluation")

    @property
    def world(self) -> ContinuousTask:
        """The task as the learner sees it: a finite one through the places of its rows."""
        return Tabulated(finite=self.task) if isinstance(self.task, FiniteTask) else self.task

    def init_value(self, key: Key[Array, ""]) -> tuple[Any, Any]:
        """The weights of the approximation and the optimizer's state before the first update."""
        raise NotImplementedError

    def q_values(
        self, value: Any, obs: Float[Array, "*batch observation_size"]
    ) -> Float[Array, "*batch joints choices"]:
        """The value of every choice of every joint; `obs` as `see` gives it."""
        raise NotImplementedError

    def learn(
        self, rate: FloatScalar, value: Any, optimizer: Any, batch: "Batch", key: Key[Array, ""]
    ) -> tuple[Any, Any, FloatScalar]:
        """Move the weights towards the targets: new weights, optimizer state, and the mean squared TD error."""
        raise NotImplementedError

    def see(self, weights: Weights, obs: Float[Array, "*batch size"]) -> Float[Array, "*batch size"]:
        """What the approximation is given of a raw observation."""
        return obs

    def row_bytes(self) -> int:
        """About what a value of Q takes while it is computed, of one observation."""
        return 0

    def learning_bytes(self, rows: int) -> int:
        """About what `learn` takes at its peak for a batch of so many rows."""
        return 0

    def working_bytes(self, state: int) -> int:
        """A second training state, and either the experience of an update and what is learned from it, or all greedy
        episodes of the evaluations side by side. What a physics computes within a step is left out."""
        episode = jax.eval_shape(self.world.reset, self.params.task, jax.eval_shape(lambda: jax.random.key(0)))
        rows, joints = self.envs * self.rollout, len(self.world.action_choices)
        experience = 4 * rows * (3 * self.world.observation_size + 2 * joints + 4)
        greedy = sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(episode)) + self.row_bytes()
        evaluation = self.evaluations * self.evaluation_envs * greedy
        return state + max(experience + self.learning_bytes(rows), evaluation)

    @property
    def choices(self) -> int:
        """The largest number of choices of any joint."""
        return max(self.world.action_choices)

    def allowed(self, progress: FloatScalar = 1.0) -> Bool[Array, "joints choices"]:
        """The choices that exist, and that have been opened where they grow."""
        return exploration.opened(self.world.action_choices, progress if self.grow else None)

    def init(self, hyper: Params, key: Key[Array, ""], policy: Any = None) -> Carry:
        value_key, reset_key, key = jax.random.split(key, 3)
        value, optimizer = self.init_value(value_key)
        state = jax.vmap(self.world.reset, in_axes=(None, 0))(hyper.task, jax.random.split(reset_key, self.envs))
        none = jnp.zeros(self.envs, jnp.int32)
        holding = exploration.no_holding(self.envs, len(self.world.action_choices))
        workers = Workers(state, holding, none, none, jnp.zeros(self.envs))
        weights = Weights(value, moments(self.world.observation_size)) if policy is None else policy
        names = ("updates", "td_error", "episodes", "steps", "success", "return", *state.metrics)
        record = {name: jnp.zeros(self.record) for name in names}
        snapshots = jax.tree.map(lambda x: jnp.zeros((self.evaluations, *x.shape), x.dtype), weights)
        return Carry(weights, optimizer, workers, key, jnp.int32(0), jnp.bool_(False), record, snapshots)

    def progress(self, hyper: Params, carry: Carry) -> FloatScalar:
        """The share of the training that is done."""
        return carry.update.astype(jnp.float32) * (self.rollout * self.envs) / hyper.episodes

    def train_chunk(self, hyper: Params, carry: Carry, steps: IntScalar) -> tuple[Carry, dict[str, Array]]:
        def guarded(_: IntScalar, carry: Carry) -> Carry:
            new = self.train_step(hyper, carry)
            finite = jnp.stack([jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(new.weights)]).all()
            stop = carry.failed | ~finite | (self.progress(hyper, carry) >= 1.0)
            new = jax.tree.map(lambda new, old: jnp.where(stop, old, new), new, carry)
            last = self.progress(hyper, new._replace(update=jnp.maximum(new.update - 1, 0)))
            part = _part(last, self.evaluations)
            snapshots = jax.tree.map(lambda old, new: old.at[part].set(new), new.snapshots, new.weights)
            return new._replace(failed=carry.failed | ~finite, snapshots=snapshots)

        carry = jax.lax.fori_loop(0, steps, guarded, carry)
        done = jnp.where(carry.failed, 1.0, self.progress(hyper, carry))
        return carry, {"progress": done}

    def train_step(self, hyper: Params, carry: Carry) -> Carry:
        """One update. The snapshots stay as they are: a training that stops would have to copy all of them."""
        key, act_key, learn_key = jax.random.split(carry.key, 3)
        progress = self.progress(hyper, carry)
        allowed = self.allowed(progress)
        workers, experience, record = self._collect(hyper, carry, allowed, act_key)
        target = self._targets(hyper, carry.weights, experience, allowed)
        batch = Batch(self.see(carry.weights, experience.obs), experience.action, target)
        batch = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), batch)
        rate = hyper.learning_rate * (1.0 + (hyper.learning_rate_end - 1.0) * jnp.minimum(progress, 1.0))
        value, optimizer, td_error = self.learn(rate, carry.weights.value, carry.optimizer, batch, learn_key)
        weights = Weights(
            value, observe(carry.weights.moments, experience.obs.reshape(-1, self.world.observation_size))
        )
        point = _part(progress, self.record)
        record = record | {"updates": 1.0, "td_error": td_error}
        record = {name: old.at[point].add(record[name]) for name, old in carry.record.items()}
        return Carry(weights, optimizer, workers, key, carry.update + 1, carry.failed, record, carry.snapshots)

    def policy(self, carry: Carry) -> Weights:
        return carry.weights

    def diverged(self, carry: Carry) -> BoolScalar:
        return carry.failed

    def act(
        self, hyper: Params, policy: Weights, observation: Float[Array, "*batch size"], key: Key[Array, ""]
    ) -> Int[Array, "*batch joints"]:
        """The greedy action for a raw observation."""
        return exploration.greedy(self.q_values(policy.value, self.see(policy, observation)), self.allowed(), key)

    def curve(self, hyper: Params, carry: Carry) -> dict[str, Float[Array, " record"]]:
        """Means over the episodes that ended in each point; of the reward's terms, sums per episode."""
        updates, episodes = carry.record["updates"], carry.record["episodes"]
        means = {name: total / episodes for name, total in carry.record.items() if name not in ("updates", "episodes")}
        return means | {"td_error": jnp.sqrt(carry.record["td_error"] / updates)}

    def results(self, hyper: Params, carry: Carry, key: Key[Array, ""]) -> tuple[dict[str, Array], dict[str, Array]]:
        """What is called `greedy_` in the curve was evaluated at the end of each of `evaluations` parts of training. It
        is NaN at all points but the last of a part, and in parts that training did not reach."""
        scores = jax.vmap(self.evaluate, in_axes=(None, 0, None))(hyper, carry.snapshots, key)
        part = np.arange(self.evaluations)
        reached = part < self.progress(hyper, carry) * self.evaluations
        place = -(-(part + 1) * self.record // self.evaluations) - 1
        blank = jnp.full(self.record, jnp.nan)
        greedy = {name: blank.at[place].set(jnp.where(reached, score, jnp.nan)) for name, score in scores.items()}
        last = jnp.maximum(reached.sum() - 1, 0)
        return self.curve(hyper, carry) | greedy, {name: score[last] for name, score in scores.items()}

    def evaluate(self, hyper: Params, policy: Weights, key: Key[Array, ""]) -> dict[str, FloatScalar]:
        """Means over `evaluation_envs` greedy episodes: `greedy_return`, `greedy_steps`, `greedy_success`."""
        return evaluate(self.world, hyper.task, partial(self.act, hyper, policy), self.evaluation_envs, key)

    def _collect(
        self, hyper: Params, carry: Carry, allowed: Bool[Array, "joints choices"], key: Key[Array, ""]
    ) -> tuple[Workers, Experience, dict[str, FloatScalar]]:
        """Let the environments act for `rollout` steps: where they are then, what they saw, sums to record."""

        def step(workers: Workers, key: Key[Array, ""]) -> tuple[Workers, tuple[Experience, dict[str, FloatScalar]]]:
            greedy_key, explore_key, step_key, reset_key = jax.random.split(key, 4)
            obs = workers.state.obs
            q = self.q_values(carry.weights.value, self.see(carry.weights, obs))
            best = exploration.greedy(q, allowed, greedy_key)
            epsilon = exploration.epsilons(hyper, workers.episode)
            action, holding = exploration.explore(best, allowed, epsilon, self.hold, workers.holding, explore_key)
            step_keys, reset_keys = (jax.random.split(key, self.envs) for key in (step_key, reset_key))
            state = jax.vmap(self.world.step, in_axes=(None, 0, 0, 0))(hyper.task, workers.state, action, step_keys)
            over = state.over
            seen = Experience(obs, action, state.reward, state.terminated, state.truncated, state.final_obs)
            length, total = workers.length + 1, workers.episode_return + state.reward
            sums = {"episodes": over, "steps": over * length, "success": over & state.success, "return": over * total}
            sums = {name: jnp.sum(x, dtype=jnp.float32) for name, x in (sums | state.metrics).items()}
            state = jax.vmap(auto_reset, in_axes=(None, None, 0, 0))(self.world, hyper.task, state, reset_keys)
            holding = holding._replace(steps_left=jnp.where(over[:, None], 0, holding.steps_left))
            workers = Workers(state, holding, workers.episode + over, length * ~over, total * ~over)
            return workers, (seen, sums)

        workers, (experience, sums) = jax.lax.scan(step, carry.workers, jax.random.split(key, self.rollout))
        return workers, experience, {name: x.sum() for name, x in sums.items()}

    def _targets(
        self, hyper: Params, weights: Weights, experience: Experience, allowed: Bool[Array, "joints choices"]
    ) -> Float[Array, "steps envs"]:
        q = self.q_values(weights.value, self.see(weights, experience.final_obs))
        next_value = jnp.where(allowed, q, -jnp.inf).max(axis=-1).mean(axis=-1)
        return lambda_targets(
            experience.reward,
            experience.terminated,
            experience.truncated,
            next_value,
            hyper.discount,
            hyper.trace_decay,
        )


def _part(progress: FloatScalar, parts: int) -> IntScalar:
    """In which of so many equal parts of training."""
    return jnp.minimum((progress * parts).astype(jnp.int32), parts - 1)


class Batch(NamedTuple):
    """What to learn from; every array leads with a batch axis."""

    obs: Float[Array, "batch observation_size"]
    action: Int[Array, "batch joints"]
    target: Float[Array, " batch"]


def chosen(q: Float[Array, "*batch joints choices"], action: Int[Array, "*batch joints"]) -> Float[Array, "*batch"]:
    """Q of an action: the mean over the joints of their choices' values."""
    return jnp.take_along_axis(q, action[..., None], axis=-1)[..., 0].mean(axis=-1)
