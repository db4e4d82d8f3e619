"""Proximal policy optimization (J. Schulman et al., 2017) as Brax implements it, on the tasks of this package.

Hyper-parameters have Brax's names and meanings (`brax.training.agents.ppo.train`). Actions are numbers in [-1, 1] for
each joint: `ContinuousTask.step_continuous` carries them out.
"""

import io
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key
from pydantic import Field, model_validator

from humanoid_mjx.learners.base import WholeRunLearner
from humanoid_mjx.learners.brax_repair import repaired
from humanoid_mjx.tasks.brax_env import BraxEnv, wrap
from humanoid_mjx.tasks.continuous import ContinuousTask
from humanoid_mjx.tasks.finite import FiniteTask

with redirect_stdout(io.StringIO()):  # mujoco.mjx prints two lines about warp
    from brax.training.acme import running_statistics, specs
    from brax.training.agents.ppo import networks as ppo_networks
    from brax.training.agents.ppo import train as ppo

NEVER = 1 << 24
"""Steps after which Brax would cut an episode off: tasks do so themselves, earlier."""

HYPER = (
    "num_envs",
    "unroll_length",
    "batch_size",
    "num_minibatches",
    "num_updates_per_batch",
    "learning_rate",
    "entropy_cost",
    "discounting",
    "gae_lambda",
    "clipping_epsilon",
    "max_grad_norm",
    "reward_scaling",
    "normalize_observations",
)
"""Keyword arguments that go to Brax unchanged."""


class Carry(NamedTuple):
    """The training state of one run, as far as Brax shows it."""

    policy: Any
    """As Brax's trainer returns it: the statistics of the observations, weights of the policy, weights of the value."""
    key: Key[Array, ""]


class BraxPPO(WholeRunLearner):
    """Brax's PPO. `total_steps` is rounded up to parts of equally many updates, one for each point recorded."""

    task: FiniteTask | ContinuousTask = Field(exclude=True, repr=False)
    num_envs: int = Field(128, ge=1, le=1_000_000, description="environments side by side")
    unroll_length: int = Field(16, ge=1, le=10_000, description="steps of each environment in one piece of experience")
    batch_size: int = Field(32, ge=1, le=1_000_000, description="pieces of experience in a minibatch")
    num_minibatches: int = Field(4, ge=1, le=10_000, description="gradient steps of a pass")
    num_updates_per_batch: int = Field(4, ge=1, le=1000, description="passes over the experience of an update")
    learning_rate: float = Field(3e-4, gt=0, le=1, description="step size of Adam")
    entropy_cost: float = Field(1e-2, ge=0, description="weight of the entropy bonus")
    discounting: float = Field(0.97, ge=0, le=1, description="value of a reward one step later")
    gae_lambda: float = Field(0.95, ge=0, le=1, description="decay of the advantage's traces")
    clipping_epsilon: float = Field(0.3, gt=0, description="the most that an update changes a probability's ratio")
    max_grad_norm: float | None = Field(1.0, gt=0, description="norm at which a gradient is clipped; null for none")
    reward_scaling: float = Field(1.0, gt=0, description="factor on rewards")
    normalize_observations: bool = Field(True, description="scale observations by their running statistics")
    policy_hidden_layer_sizes: tuple[int, ...] = Field(
        (32, 32, 32, 32), strict=False, description="units of the policy's hidden layers"
    )
    value_hidden_layer_sizes: tuple[int, ...] = Field(
        (256, 256, 256, 256, 256), strict=False, description="units of the value's hidden layers"
    )
    evaluation_envs: int = Field(64, ge=1, le=100_000, description="episodes of an evaluation")

    @model_validator(mode="after")
    def _experience_must_fill_the_minibatches(self) -> "BraxPPO":
        pieces = self.batch_size * self.num_minibatches
        if pieces % self.num_envs:
            raise ValueError(f"num_envs must divide batch_size * num_minibatches ({pieces}), got {self.num_envs}")
        if any(size < 1 for size in (*self.policy_hidden_layer_sizes, *self.value_hidden_layer_sizes)):
            raise ValueError("a layer must have at least 1 unit")
        return self

    def init(self, key: Key[Array, ""], policy: Any = None) -> Carry:
        policy_key, value_key, key = jax.random.split(key, 3)
        if policy is None:
            networks = self._networks()
            seen = running_statistics.init_state(specs.Array((self.env.observation_size,), jnp.dtype("float32")))
            policy = seen, networks.policy_network.init(policy_key), networks.value_network.init(value_key)
        return Carry(jax.tree.map(jnp.asarray, policy), key)

    def train_run(self, carry: Carry, report: Callable[[float, Any], None]) -> Carry:
        policy, part, parts = carry.policy, 0, self._parts()

        def look(steps: int, _: Any, found: Any) -> None:
            nonlocal policy, part
            if steps == 0:
                return
            policy = jax.tree.map(lambda new, old: jnp.asarray(np.asarray(new), old.dtype), found, carry.policy)
            part += 1
            report(part / parts, policy)

        self._train(BraxEnv(self.task), carry, parts, look)
        return carry._replace(policy=policy)

    def policy(self, carry: Carry) -> Any:
        return carry.policy

    def act(
        self, policy: Any, observation: Float[Array, "*batch size"], key: Key[Array, ""]
    ) -> Float[Array, "*batch joints"]:
        """The greedy command for a raw observation, in [-1, 1]: the mode of the policy's distribution."""
        values, actions = self._distribution(policy, observation)
        return actions.mode(values)

    def sample(
        self, policy: Any, observation: Float[Array, "*batch size"], key: Key[Array, ""]
    ) -> Float[Array, "*batch joints"]:
        """A command drawn from the policy's distribution, as training draws it."""
        values, actions = self._distribution(policy, observation)
        return actions.postprocess(actions.sample_no_postprocessing(values, key))

    def _distribution(self, policy: Any, obs: Float[Array, "*batch size"]) -> tuple[Array, Any]:
        """The parameters of the policy's distribution, and the distribution."""
        networks = self._networks()
        return networks.policy_network.apply(policy[0], policy[1], obs), networks.parametric_action_distribution

    def _networks(self) -> Any:
        normalise = running_statistics.normalize if self.normalize_observations else lambda obs, _: obs
        size = (self.env.observation_size,), len(self.env.action_bins)
        return self._network_factory()(*size, preprocess_observations_fn=normalise)

    def _network_factory(self) -> Any:
        layers = self.policy_hidden_layer_sizes, self.value_hidden_layer_sizes
        return partial(
            ppo_networks.make_ppo_networks, policy_hidden_layer_sizes=layers[0], value_hidden_layer_sizes=layers[1]
        )

    def _parts(self) -> int:
        """How many parts of equally many updates training has, one for each point recorded: at most `record`."""
        updates = -(-int(self.total_steps) // (self.batch_size * self.num_minibatches * self.unroll_length))
        return -(-updates // -(-updates // self.record))

    def _train(self, env: BraxEnv, carry: Carry, parts: int, look: Callable[[int, Any, Any], None]) -> None:
        """Let Brax train, and `look` at (steps, a function, the policy) before the first part and after each."""
        with repaired(ppo):
            ppo.train(
                environment=env,
                num_timesteps=int(self.total_steps),
                max_devices_per_host=1,
                wrap_env_fn=wrap,
                episode_length=NEVER,
                network_factory=self._network_factory(),
                seed=int(jax.random.bits(carry.key, dtype=jnp.uint32) >> 1),
                num_evals=parts + 1,
                run_evals=False,
                num_eval_envs=1,
                policy_params_fn=look,
                restore_params=carry.policy,
                **{name: getattr(self, name) for name in HYPER},
            )
