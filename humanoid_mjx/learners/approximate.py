"""Q-learning with function approximation: many environments, no replay (M. Gallici et al., "Simplifying Deep Temporal
Difference Learning", 2024).

An update lets all environments act for `rollout` steps, computes Q(lambda) targets over what they saw, and moves the
weights towards them. Where a task has several joints Q is the mean of a value for each joint's choice (T. Seyde et al.,
"Solving Continuous Control via Q-Learning", 2023), so that the best action is the best choice of every joint.
"""

from collections.abc import Mapping
from functools import partial
from typing import Any, ClassVar, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key
from pydantic import Field, model_validator

from humanoid_mjx.compute import Program
from humanoid_mjx.learners import exploration
from humanoid_mjx.learners.acting import Envs, of_all_devices, start_all, step_all
from humanoid_mjx.learners.base import ENVS, Outcome, StepLearner
from humanoid_mjx.learners.normalisation import Moments, moments, observe
from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.continuous import ContinuousTask
from humanoid_mjx.tasks.finite import FiniteTask
from humanoid_mjx.types import FloatScalar, IntScalar


class Weights(NamedTuple):
    """The learned values that acting needs."""

    value: Any
    moments: Moments
    """Running mean and variance of the raw observations seen so far."""


class Carry(NamedTuple):
    """The training state of one sweep point."""

    weights: Weights
    average: Any
    """Running mean of `weights.value` over updates, later ones weighted more: see `weight_averaging`."""
    optimizer: Any
    envs: Envs
    key: Key[Array, ""]
    update: IntScalar


class Batch(NamedTuple):
    """Samples to learn from; every array leads with a batch axis, or with (steps, envs)."""

    obs: Float[Array, "*batch observation_size"]
    action: Int[Array, "*batch joints"]
    target: Float[Array, "*batch"]


RETIRED = {"action_repeat": 1, "basis": "tiles", "coarse_to_fine": False}
"""Keys of earlier versions, with the only value that they may still have: stored configs hold them."""

LEAST_SHARE = 64
"""Least number of environments of a device that shares a run: the loops of `physics: tree` take so many at once."""


class ApproximateQ(StepLearner):
    """Base of learners that approximate Q. A derived class gives the approximation and how it learns."""

    program: ClassVar[Program] = "approximate"
    read_with: ClassVar[Mapping[str, Mapping[str, str]]] = {
        "exploration": {"epsilon": "epsilon_greedy", "epsilon_spread": "epsilon_greedy", "temperature": "boltzmann"}
    }
    task: FiniteTask | ContinuousTask = Field(exclude=True, repr=False)
    method: Literal["q_learning", "expected_sarsa"] = Field(
        "q_learning", description="value of the next state: the largest, or the mean over the actions as it explores"
    )
    exploration: Literal["epsilon_greedy", "boltzmann"] = Field(
        "epsilon_greedy", description="rule by which training chooses actions"
    )
    temperature: float = traced(1.0, gt=0, le=1e6, description="initial temperature of boltzmann, in units of value")
    epsilon: float = traced(1.0, ge=0, le=1, description="initial probability that a joint takes a random choice")
    epsilon_decay: float = traced(0.99, ge=0, le=1, description="factor on epsilon per episode of an environment")
    epsilon_min: float = traced(0.02, ge=0, le=1, description="lower bound of epsilon")
    epsilon_spread: float = traced(
        0.0, ge=0, le=100, description="exponent of epsilon rises from 1 to 1 + epsilon_spread over the environments"
    )
    learning_rate: float = traced(gt=0, le=1, description="step size")
    learning_rate_end: float = traced(1.0, ge=0, le=1, description="factor on learning_rate at the end; linear from 1")
    weight_averaging: float = traced(
        0.0, ge=0, le=1, description="last share of training over which the policy's weights are averaged"
    )
    discount: float = traced(0.97, ge=0, lt=1, description="discount factor per step")
    trace_decay: float = traced(0.65, ge=0, le=1, description="lambda of the returns: 0 one step, 1 the whole rollout")
    envs: int = Field(128, ge=1, le=1_000_000, description="environments side by side")
    rollout: int = Field(16, ge=1, le=10_000, description="steps of each environment in an update")
    evaluations: int = Field(10, ge=1, le=1000, description="greedy evaluations along the learning curve")
    evaluation_envs: int = Field(64, ge=1, le=100_000, description="greedy episodes of an evaluation")

    @model_validator(mode="before")
    @classmethod
    def _without_retired_keys(cls, data: Any) -> Any:
        return {key: x for key, x in data.items() if RETIRED.get(key, ...) != x} if isinstance(data, dict) else data

    def can_share(self, devices: int) -> bool:
        fits = self.envs % devices == 0 and self.envs // devices >= LEAST_SHARE
        return devices == 1 or (self.task.arithmetic == "tree" and fits)

    @property
    def update_steps(self) -> int:
        return self.rollout * self.envs

    def init_value(self, key: Key[Array, ""]) -> tuple[Any, Any]:
        """The weights of the approximation and the optimizer's state before the first update."""
        raise NotImplementedError

    def q_values(self, value: Any, obs: Float[Array, "*batch observation_size"]) -> Float[Array, "*batch joints bins"]:
        """The value of every choice of every joint; `obs` as `preprocess` gives it."""
        raise NotImplementedError

    def learn(
        self, rate: FloatScalar, value: Any, optimizer: Any, batch: Batch, key: Key[Array, ""]
    ) -> tuple[Any, Any, FloatScalar]:
        """Move the weights towards the targets: new weights, optimizer state, and the mean squared TD error."""
        raise NotImplementedError

    def choose(
        self,
        q: Float[Array, "envs joints bins"],
        amount: Float[Array, " envs"],
        tie_key: Key[Array, ""],
        key: Key[Array, ""],
    ) -> Int[Array, "envs joints"]:
        """The actions that training takes. Override it for an exploration of your own.

        `q`: the value of every choice, of which those in `allowed` exist; `amount`: epsilon, or the temperature, of
        each environment; `tie_key` chooses among equally good choices.
        """
        if self.exploration == "boltzmann":
            return exploration.drawn_choices(exploration.chances(self, q, amount), key)
        return exploration.explore(exploration.greedy(q, self.allowed, tie_key), self.allowed, amount, key)

    def preprocess(self, weights: Weights, obs: Float[Array, "*batch size"]) -> Float[Array, "*batch size"]:
        """A raw observation in the form that the approximation takes."""
        return obs

    @property
    def bins(self) -> int:
        """The largest number of choices of any joint."""
        return max(self.env.action_bins)

    @property
    def allowed(self) -> Bool[np.ndarray, "joints bins"]:
        """The choices that exist."""
        return np.arange(self.bins) < np.array(self.env.action_bins)[:, None]

    def init(self, key: Key[Array, ""], policy: Any = None) -> Carry:
        value_key, reset_key, key = jax.random.split(key, 3)
        value, optimizer = self.init_value(value_key)
        weights = Weights(value, moments(self.env.observation_size)) if policy is None else policy
        envs = start_all(self.env, self.envs, reset_key)
        return Carry(weights, weights.value, optimizer, envs, key, jnp.int32(0))

    def train_step(self, carry: Carry) -> tuple[Carry, Outcome]:
        """One update: act, compute the targets of the experience, move the weights towards them."""
        key, act_key, learn_key = jax.random.split(carry.key, 3)
        progress = self.progress(carry)
        envs, (obs, action, td_target), totals = self._act(carry, act_key)
        batch = Batch(self.preprocess(carry.weights, obs), action, td_target)
        batch = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), batch)
        rate = self.learning_rate * (1.0 + (self.learning_rate_end - 1.0) * jnp.minimum(progress, 1.0))
        value, optimizer, td_error = self.learn(rate, carry.weights.value, carry.optimizer, batch, learn_key)
        seen = observe(carry.weights.moments, obs.reshape(-1, self.env.observation_size))
        # The mean with new weights in it (O. Shamir and T. Zhang, "Stochastic Gradient Descent for Non-smooth
        # Optimization", 2013, section 4, with eta + 1 = 1 / weight_averaging).
        part = 1.0 / (1.0 + self.weight_averaging * carry.update)
        average = jax.tree.map(lambda mean, new: (1.0 - part) * mean + part * new, carry.average, value)
        after = Carry(Weights(value, seen), average, optimizer, envs, key, carry.update + 1)
        return after, Outcome(self.steps_done(carry), totals.pop("episodes"), totals, {"td_error": td_error})

    def policy(self, carry: Carry) -> Weights:
        return carry.weights._replace(value=carry.average)

    def act(
        self, policy: Weights, observation: Float[Array, "*batch size"], key: Key[Array, ""]
    ) -> Int[Array, "*batch joints"]:
        """The greedy action for a raw observation."""
        q = self.q_values(policy.value, self.preprocess(policy, observation))
        return exploration.greedy(q, self.allowed, key)

    def _act(self, carry: Carry, key: Key[Array, ""]) -> tuple[Envs, Batch, dict[str, FloatScalar]]:
        """`_collect`; devices that share the environments act in one part each, and all get the whole experience."""
        if self.devices == 1:
            return self._collect(carry, key)
        index, size = jax.lax.axis_index(ENVS), self.envs // self.devices
        part = jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, index * size, size), carry.envs)
        key = jax.random.fold_in(key, index)
        envs, seen, totals = self._collect(carry._replace(envs=part), key)
        by_env = jax.tree.map(partial(jnp.swapaxes, axis1=0, axis2=1), seen)
        sums = jax.tree.map(lambda x: jnp.broadcast_to(x, (size,)), totals)
        envs, by_env, sums = of_all_devices((envs, by_env, sums), ENVS)
        seen = jax.tree.map(partial(jnp.swapaxes, axis1=0, axis2=1), by_env)
        return envs, seen, jax.tree.map(lambda x: x[::size].sum(), sums)

    def _collect(self, carry: Carry, key: Key[Array, ""]) -> tuple[Envs, Batch, dict[str, FloatScalar]]:
        """Act for `rollout` steps: the environments after them, the experience with its targets, (steps, envs), and
        sums over the ended episodes."""

        def step(envs: Envs, key: Key[Array, ""]) -> tuple[Envs, Any]:
            greedy_key, explore_key, step_key, reset_key = jax.random.split(key, 4)
            obs = envs.state.obs
            q = self.q_values(carry.weights.value, self.preprocess(carry.weights, obs))
            amount = exploration.amounts(self, envs.episode)
            action = self.choose(q, amount, greedy_key, explore_key)
            envs, state, sums = step_all(self.env, envs, action, step_key, reset_key)
            executed = action if state.executed is None else state.executed
            moved = state.reward, state.terminated, state.truncated
            return envs, (obs, executed, moved, state.final_obs, amount, sums)

        envs, seen = jax.lax.scan(step, carry.envs, jax.random.split(key, self.rollout))
        obs, action, (reward, terminated, truncated), final_obs, amount, sums = seen
        totals = {name: x.sum() for name, x in sums.items()}
        q = self.q_values(carry.weights.value, self.preprocess(carry.weights, final_obs))
        by_joint = jnp.where(self.allowed, q, -jnp.inf).max(axis=-1)
        if self.method == "expected_sarsa":
            by_joint = (exploration.chances(self, q, amount) * jnp.where(self.allowed, q, 0.0)).sum(axis=-1)
        targets = lambda_targets(reward, terminated, truncated, by_joint.mean(axis=-1), self.discount, self.trace_decay)
        return envs, Batch(obs, action, targets), totals


def chosen(q: Float[Array, "*batch joints bins"], action: Int[Array, "*batch joints"]) -> Float[Array, "*batch"]:
    """Q of an action: the mean over the joints of their choices' values."""
    return jnp.take_along_axis(q, action[..., None], axis=-1)[..., 0].mean(axis=-1)


def lambda_targets(
    reward: Float[Array, "steps envs"],
    terminated: Bool[Array, "steps envs"],
    truncated: Bool[Array, "steps envs"],
    next_value: Float[Array, "steps envs"],
    discount: FloatScalar,
    trace_decay: FloatScalar,
) -> Float[Array, "steps envs"]:
    """Peng's Q(lambda) (J. Peng and R. Williams, 1996) as parallel Q-learning uses it (M. Gallici et al., 2024, eq. 5).

        G_t = r_t + discount * (trace_decay * G_{t+1} + (1 - trace_decay) * max_a Q(s_{t+1}, a))

    with nothing beyond a terminal state, and the maximum alone beyond a truncated one and at the end of the piece.
    With trace_decay 0 these are one-step targets, with 1 the rewards to the end of the episode or piece.

    `next_value`: max_a Q of the state that each step led to, before any reset, or another value of it.
    """

    def back(following: Array, step: tuple[Array, ...]) -> tuple[Array, Array]:
        reward, terminated, truncated, value = step
        ahead = jnp.where(truncated, value, trace_decay * following + (1.0 - trace_decay) * value)
        target = reward + discount * jnp.where(terminated, 0.0, ahead)
        return target, target

    steps = reward, terminated, truncated, next_value
    return jax.lax.scan(back, next_value[-1], steps, reverse=True)[1]
