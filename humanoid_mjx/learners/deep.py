"""Deep Q-learning without replay or target network: PQN (M. Gallici et al., 2024), decoupled over joints.

A LayerNorm after every layer keeps learning stable. The optimizer is RAdam with a clipped gradient norm.
"""

import math
from typing import Any, Literal

import jax
import jax.numpy as jnp
import optax
from flax import linen as nn
from flax.errors import FlaxError
from jaxtyping import Array, Float, Key
from pydantic import Field, model_validator

from humanoid_mjx.compute.ways import ways
from humanoid_mjx.learners.approximate import ApproximateQ, Batch, Weights, chosen
from humanoid_mjx.learners.normalisation import normalise
from humanoid_mjx.spec import InputError, traced
from humanoid_mjx.types import FloatScalar
from humanoid_mjx.user_code import in_words

PARTS = 8
"""Parts of a minibatch whose gradients of small arrays are summed apart on a GPU, which sums over many rows slowly."""

SMALL = 2**14
"""Numbers of an array. Of larger ones, matrices of a hidden layer, one product over the whole minibatch is faster."""

ALIGNED = 16
"""Multiple of columns with which a GPU multiplies matrices fast."""

Precision = Literal["float32", "tensorfloat32", "bfloat16"]


class QNetwork(nn.Module):
    """Layers with LayerNorm and ReLU, and a value for each choice of each joint."""

    width: int
    layers: int
    joints: int
    bins: int
    precision: Precision = "float32"

    @nn.compact
    def __call__(self, obs: Float[Array, "*batch size"]) -> Float[Array, "*batch joints bins"]:
        half = self.precision == "bfloat16" and ways().short_numbers
        dtype, precision = (jnp.bfloat16, None) if half else (None, self.precision)
        x = obs
        for _ in range(self.layers):
            x = nn.relu(nn.LayerNorm(dtype=dtype)(nn.Dense(self.width, dtype=dtype, precision=precision)(x)))
        last = "tensorfloat32" if half else self.precision
        product = _aligned if ways().columns_filled else None
        q = nn.Dense(self.joints * self.bins, dtype=jnp.float32, precision=last, dot_general=product)(x)
        return q.reshape(*q.shape[:-1], self.joints, self.bins)


class DeepQ(ApproximateQ):
    """Parallel Q-learning with a network."""

    width: int = Field(128, ge=1, le=65_536, description="units of a hidden layer")
    layers: int = Field(2, ge=1, le=100, description="hidden layers")
    epochs: int = Field(2, ge=1, le=1000, description="passes over the experience of an update")
    minibatches: int = Field(4, ge=1, le=10_000, description="parts of a rollout, a gradient step for each")
    max_gradient: float = Field(10.0, gt=0, description="norm at which a gradient is clipped")
    precision: Precision = Field(
        "float32", description="of matrix products on a GPU; bfloat16: of all but the last layer's numbers"
    )
    learning_rate: float = traced(5e-4, gt=0, le=1)

    @model_validator(mode="after")
    def _minibatches_must_fit(self) -> "DeepQ":
        if self.envs * self.rollout % self.minibatches:
            raise ValueError(f"minibatches must divide envs * rollout ({self.envs * self.rollout})")
        return self

    def network(self) -> nn.Module:
        """Return the module from observations, (..., size), to values of choices, (..., joints, bins).

        It has parameters, but no state, as BatchNorm has, and takes no random numbers, as Dropout does.
        """
        return QNetwork(self.width, self.layers, len(self.env.action_bins), self.bins, self.precision)

    def init_value(self, key: Key[Array, ""]) -> tuple[Any, Any]:
        shape, obs = (len(self.env.action_bins), self.bins), jnp.zeros(self.env.observation_size)
        try:
            value = self.network().init(key, obs)
            got: Any = (*value, jax.eval_shape(self.network().apply, value, obs[None]).shape[1:])
        except (AttributeError, TypeError, FlaxError) as error:
            got = in_words(error)
        if got != ("params", shape):
            wanted = f"a Flax module from (..., {len(obs)}) to (..., joints, bins), here (..., {shape[0]}, {shape[1]})"
            raise InputError(f"{type(self).__name__}.network() must return {wanted}, with 'params' alone; got {got}.")
        return value, self._optimizer(0.0).init(value)

    def preprocess(self, weights: Weights, obs: Float[Array, "*batch size"]) -> Float[Array, "*batch size"]:
        return normalise(weights.moments, obs)

    def q_values(self, value: Any, obs: Float[Array, "*batch size"]) -> Float[Array, "*batch joints bins"]:
        q: Any = self.network().apply(value, obs)
        return q

    def learn(
        self, rate: FloatScalar, value: Any, optimizer: Any, batch: Batch, key: Key[Array, ""]
    ) -> tuple[Any, Any, FloatScalar]:
        transform = self._optimizer(rate)

        def loss(value: Any, part: Batch) -> FloatScalar:
            return jnp.mean((chosen(self.q_values(value, part.obs), part.action) - part.target) ** 2)

        def loss_by_parts(value: Any, batch: Batch) -> FloatScalar:
            count = math.gcd(PARTS, len(batch.target))
            parts = jax.tree.map(lambda x: x.reshape(count, -1, *x.shape[1:]), batch)
            # Without the barrier XLA joins the sums again.
            copies = jax.tree.map(lambda x: jnp.broadcast_to(x, (count, *x.shape)) if x.size < SMALL else x, value)
            axes = jax.tree.map(lambda x: 0 if x.size < SMALL else None, value)
            return jax.vmap(loss, (axes, 0))(jax.lax.optimization_barrier(copies), parts).mean()

        def step(carry: tuple[Any, Any], part: Batch) -> tuple[tuple[Any, Any], FloatScalar]:
            value, optimizer = carry
            error, gradient = jax.value_and_grad(loss_by_parts if ways().loss_by_parts else loss)(value, part)
            change, optimizer = transform.update(gradient, optimizer, value)
            return (optax.apply_updates(value, change), optimizer), error

        def epoch(carry: tuple[Any, Any], key: Key[Array, ""]) -> tuple[tuple[Any, Any], FloatScalar]:
            order = jax.random.permutation(key, len(batch.target)).reshape(self.minibatches, -1)
            carry, errors = jax.lax.scan(
                lambda carry, rows: step(carry, jax.tree.map(lambda x: x[rows], batch)), carry, order
            )
            return carry, errors.mean()

        (value, optimizer), errors = jax.lax.scan(epoch, (value, optimizer), jax.random.split(key, self.epochs))
        return value, optimizer, errors[0]

    def _optimizer(self, rate: FloatScalar) -> optax.GradientTransformation:
        # Of one vector, which a GPU needs fewer kernels for than of many arrays.
        return optax.flatten(optax.chain(optax.clip_by_global_norm(self.max_gradient), optax.radam(rate)))


def _aligned(x: Array, matrix: Float[Array, "rows columns"], *args: Any, **options: Any) -> Array:
    """`lax.dot_general` with a matrix that is filled up with columns of zeros."""
    columns = matrix.shape[-1]
    filled = jnp.pad(matrix, ((0, 0), (0, -columns % ALIGNED)))
    return jax.lax.dot_general(x, filled, *args, **options)[..., :columns]
