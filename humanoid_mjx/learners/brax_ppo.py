# pyright: reportArgumentType=false, reportCallIssue=false
"""Proximal policy optimization (J. Schulman et al., 2017) with Brax's networks, distribution and loss.

Hyper-parameters have the names and meanings of `brax.training.agents.ppo.train`, and an update is that function's.
Actions are numbers in [-1, 1] for each joint: `ContinuousTask.step_continuous` carries them out.
"""

import io
from contextlib import redirect_stdout
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Key
from pydantic import Field, model_validator

from humanoid_mjx.learners.acting import Envs, start_all, step_all
from humanoid_mjx.learners.base import Outcome, StepLearner
from humanoid_mjx.learners.normalisation import Moments, moments, normalise, observe
from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.continuous import ContinuousTask
from humanoid_mjx.tasks.finite import FiniteTask
from humanoid_mjx.types import FloatScalar

with redirect_stdout(io.StringIO()):  # mujoco.mjx prints two lines about warp
    from brax.training.agents.ppo.losses import PPONetworkParams, compute_ppo_loss
    from brax.training.agents.ppo.networks import make_ppo_networks
    from brax.training.types import Transition

OF_LOSS = "entropy_cost", "discounting", "reward_scaling", "gae_lambda", "clipping_epsilon"
"""Hyper-parameters of Brax's loss."""


class Policy(NamedTuple):
    """Learned values."""

    moments: Moments
    """Running mean and variance of the raw observations seen so far."""
    networks: Any
    """Weights of the policy's network and of the value's."""


class Carry(NamedTuple):
    """The training state of one run."""

    policy: Policy
    optimizer: Any
    envs: Envs
    key: Key[Array, ""]
    update: Array


class BraxPPO(StepLearner):
    """Brax's PPO."""

    task: FiniteTask | ContinuousTask = Field(exclude=True, repr=False)
    num_envs: int = Field(128, ge=1, le=1_000_000, description="environments side by side")
    unroll_length: int = Field(16, ge=1, le=10_000, description="steps of each environment in one piece of experience")
    batch_size: int = Field(32, ge=1, le=1_000_000, description="pieces of experience in a minibatch")
    num_minibatches: int = Field(4, ge=1, le=10_000, description="gradient steps of a pass")
    num_updates_per_batch: int = Field(4, ge=1, le=1000, description="passes over the experience of an update")
    learning_rate: float = traced(3e-4, gt=0, le=1, description="step size of Adam")
    entropy_cost: float = traced(1e-2, ge=0, description="weight of the entropy bonus")
    discounting: float = traced(0.97, ge=0, le=1, description="discount factor per step")
    gae_lambda: float = traced(0.95, ge=0, le=1, description="decay of the advantage's traces")
    clipping_epsilon: float = traced(0.3, gt=0, description="the probability ratio is clipped to 1 -+ this")
    max_grad_norm: float | None = Field(1.0, gt=0, description="norm at which a gradient is clipped; null for none")
    reward_scaling: float = traced(1.0, gt=0, description="factor on rewards")
    normalize_observations: bool = Field(True, description="scale observations by their running statistics")
    policy_hidden_layer_sizes: tuple[int, ...] = Field(
        (32, 32, 32, 32), strict=False, description="units of the policy's hidden layers"
    )
    value_hidden_layer_sizes: tuple[int, ...] = Field(
        (256, 256, 256, 256, 256), strict=False, description="units of the value's hidden layers"
    )
    evaluations: int = Field(10, ge=1, le=1000, description="greedy evaluations along the learning curve")
    evaluation_envs: int = Field(64, ge=1, le=100_000, description="greedy episodes of an evaluation")

    @model_validator(mode="after")
    def _experience_must_fill_the_minibatches(self) -> "BraxPPO":
        if self._pieces % self.num_envs:
            raise ValueError(f"num_envs must divide batch_size * num_minibatches ({self._pieces}), got {self.num_envs}")
        if any(size < 1 for size in (*self.policy_hidden_layer_sizes, *self.value_hidden_layer_sizes)):
            raise ValueError("a layer must have at least 1 unit")
        return self

    @property
    def update_steps(self) -> int:
        return self._pieces * self.unroll_length

    @property
    def _pieces(self) -> int:
        """Pieces of experience of an update."""
        return self.batch_size * self.num_minibatches

    def init(self, key: Key[Array, ""], policy: Policy | None = None) -> Carry:
        policy_key, value_key, reset_key, key = jax.random.split(key, 4)
        if policy is None:
            networks = self._networks()
            weights = networks.policy_network.init(policy_key), networks.value_network.init(value_key)
            policy = Policy(moments(self.env.observation_size), PPONetworkParams(*weights))
        optimizer = self._optimizer().init(policy.networks)
        return Carry(policy, optimizer, start_all(self.env, self.num_envs, reset_key), key, jnp.int32(0))

    def train_step(self, carry: Carry) -> tuple[Carry, Outcome]:
        """One update: act, then take `num_updates_per_batch * num_minibatches` steps down the gradient."""
        key, act_key, learn_key = jax.random.split(carry.key, 3)
        envs, seen, totals = self._collect(carry, act_key)
        known = observe(carry.policy.moments, seen.observation.reshape(-1, self.env.observation_size))
        weights, optimizer = self._learn(carry, known, seen, learn_key)
        after = Carry(Policy(known, weights), optimizer, envs, key, carry.update + 1)
        return after, Outcome(self.steps_done(carry), totals.pop("episodes"), totals, {})

    def policy(self, carry: Carry) -> Policy:
        return carry.policy

    def act(
        self, policy: Policy, observation: Float[Array, "*batch size"], key: Key[Array, ""]
    ) -> Float[Array, "*batch joints"]:
        """The greedy command for a raw observation, in [-1, 1]: the mode of the policy's distribution."""
        networks = self._networks()
        values = networks.policy_network.apply(policy.moments, policy.networks.policy, observation)
        return networks.parametric_action_distribution.mode(values)

    def _collect(self, carry: Carry, key: Key[Array, ""]) -> tuple[Envs, Any, dict[str, FloatScalar]]:
        """Act as the policy's distribution says: where the environments are then, pieces of experience, (pieces,
        unroll_length, ...), and sums over ended episodes."""
        networks = self._networks()
        distribution = networks.parametric_action_distribution

        def step(envs: Envs, key: Key[Array, ""]) -> tuple[Envs, tuple[Any, dict[str, FloatScalar]]]:
            sample_key, step_key, reset_key = jax.random.split(key, 3)
            obs = envs.state.obs
            values = networks.policy_network.apply(carry.policy.moments, carry.policy.networks.policy, obs)
            raw = distribution.sample_no_postprocessing(values, sample_key)
            envs, state, sums = step_all(self.env, envs, distribution.postprocess(raw), step_key, reset_key)
            chosen = {"distribution_params": values, "raw_action": raw, "log_prob": distribution.log_prob(values, raw)}
            extras = {"policy_extras": chosen, "state_extras": {"truncation": state.truncated.astype(jnp.float32)}}
            going_on = 1.0 - state.done.astype(jnp.float32)
            return envs, (Transition(obs, raw, state.reward, going_on, state.final_obs, extras), sums)

        def pieces(x: Float[Array, "steps envs ..."]) -> Float[Array, "pieces unroll_length ..."]:
            x = x.reshape(-1, self.unroll_length, *x.shape[1:]).swapaxes(1, 2)
            return x.reshape(-1, *x.shape[2:])

        keys = jax.random.split(key, self._pieces // self.num_envs * self.unroll_length)
        envs, (seen, sums) = jax.lax.scan(step, carry.envs, keys)
        return envs, jax.tree.map(pieces, seen), {name: x.sum() for name, x in sums.items()}

    def _learn(self, carry: Carry, known: Moments, seen: Any, key: Key[Array, ""]) -> tuple[Any, Any]:
        """The weights and the state of the optimizer after the passes over this experience."""
        transform, networks = self._optimizer(), self._networks()

        def loss(weights: Any, batch: Any, key: Key[Array, ""]) -> FloatScalar:
            options = {name: getattr(self, name) for name in OF_LOSS}
            return compute_ppo_loss(weights, known, batch, key, ppo_network=networks, **options)[0]

        def step(inner: tuple[Any, Any], each: tuple[Array, Key[Array, ""]]) -> tuple[tuple[Any, Any], None]:
            rows, key = each
            gradient = jax.grad(loss)(inner[0], jax.tree.map(lambda x: x[rows], seen), key)
            change, optimizer = transform.update(gradient, inner[1])
            return (optax.apply_updates(inner[0], change), optimizer), None

        order_key, loss_key = jax.random.split(key)
        order_keys = jax.random.split(order_key, self.num_updates_per_batch)
        orders = jax.vmap(lambda key: jax.random.permutation(key, self._pieces))(order_keys)
        orders = orders.reshape(-1, self.batch_size)
        start = carry.policy.networks, carry.optimizer
        return jax.lax.scan(step, start, (orders, jax.random.split(loss_key, len(orders))))[0]

    def _networks(self) -> Any:
        def scaled(obs: Any, known: Any) -> Any:
            return normalise(known, obs) if self.normalize_observations else obs

        return make_ppo_networks(
            self.env.observation_size,
            len(self.env.action_bins),
            preprocess_observations_fn=scaled,
            policy_hidden_layer_sizes=self.policy_hidden_layer_sizes,
            value_hidden_layer_sizes=self.value_hidden_layer_sizes,
        )

    def _optimizer(self) -> optax.GradientTransformation:
        adam = optax.adam(self.learning_rate)
        return adam if self.max_grad_norm is None else optax.chain(optax.clip_by_global_norm(self.max_grad_norm), adam)
