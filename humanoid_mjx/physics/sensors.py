"""Sensor models: noise, bias and delay between true and measured values. Off by default."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key
from pydantic import Field

from humanoid_mjx.kernels.worlds import worlds_last
from humanoid_mjx.physics.base import Readings
from humanoid_mjx.spec import Spec, traced
from humanoid_mjx.types import FloatScalar, IntScalar

ABOVE_MINUS_1 = np.nextafter(np.float32(-1.0), np.float32(0.0))
"""Least of the uniform numbers that `jax.random.normal` is a function of."""


class SensorState(NamedTuple):
    """State of one world's sensors."""

    bias: Readings
    """Biases, drawn at the start of an episode."""
    past: Readings
    """The last `delay + jitter` readings, the oldest first: a leading axis on each array."""
    late: IntScalar | None
    """Control cycles by which the delay of this episode is longer; None without `jitter`."""


class Sensors(Spec):
    """Errors of the sensors: white noise at each reading, and a bias and a delay for each episode.

    Noise and bias are standard deviations of normal distributions, for each component alone.
    """

    encoder_noise: float = traced(0.0, ge=0, description="standard deviation at each reading, rad")
    encoder_bias: float = traced(0.0, ge=0, description="standard deviation over episodes, rad")
    gyroscope_noise: float = traced(0.0, ge=0, description="standard deviation at each reading, rad/s")
    gyroscope_bias: float = traced(0.0, ge=0, description="standard deviation over episodes, rad/s")
    accelerometer_noise: float = traced(0.0, ge=0, description="standard deviation at each reading, m/s^2")
    accelerometer_bias: float = traced(0.0, ge=0, description="standard deviation over episodes, m/s^2")
    foot_contact_noise: float = traced(0.0, ge=0, description="standard deviation at each reading, N")
    delay: int = Field(0, ge=0, le=100, description="age of a reading, control cycles")
    jitter: int = Field(0, ge=0, le=100, description="largest addition to the delay, drawn per episode, control cycles")
    averages: bool = Field(False, description="gyroscope and accelerometer read means of a control cycle")

    def start(self, readings: Readings, key: Key[Array, ""]) -> SensorState:
        """Draw the biases and the delay. The readings before the first are set to `readings`."""
        spread = self.encoder_bias, self.gyroscope_bias, self.accelerometer_bias, 0.0
        past = jax.tree.map(lambda x: jnp.broadcast_to(x, (self.delay + self.jitter, *x.shape)), readings)
        late = jax.random.randint(jax.random.fold_in(key, 1), (), 0, self.jitter + 1) if self.jitter else None
        return SensorState(_normal(spread, readings, key), past, late)

    def read(self, state: SensorState, readings: Readings, key: Key[Array, ""]) -> tuple[SensorState, Readings]:
        """Once each control cycle: from the true readings to those of the sensors."""
        queue = jax.tree.map(lambda past, now: jnp.concatenate([past, now[None]]), state.past, readings)
        spread = self.encoder_noise, self.gyroscope_noise, self.accelerometer_noise, self.foot_contact_noise
        noise = _normal(spread, readings, key)
        row = 0 if state.late is None else self.jitter - state.late
        seen = jax.tree.map(lambda queue, bias, noise: queue[row] + bias + noise, queue, state.bias, noise)
        return state._replace(past=jax.tree.map(lambda x: x[1:], queue)), seen


def _normal(spread: tuple[FloatScalar, ...], like: Readings, key: Key[Array, ""]) -> Readings:
    ends = np.cumsum([len(part) for part in like])
    drawn = jnp.split(worlds_last(_drawn, tuple(map(len, like)))(key), ends[:-1])
    return Readings(*(size * part for size, part in zip(spread, drawn, strict=True)))


def _drawn(lengths: tuple[int, ...], keys: Key[Array, " worlds"]) -> Float[Array, "numbers worlds"]:
    """Normal numbers, side by side, so that their long arithmetic is compiled once. LLVM vectorises it over worlds in
    the last axis, and not over a short one. The barrier keeps XLA from computing them again in each fused reader: on
    two GPUs that made a kernel that spilled registers."""

    def draw(key: Key[Array, ""]) -> Float[Array, " numbers"]:
        parts = zip(jax.random.split(key, len(lengths)), lengths, strict=True)
        return jnp.concatenate([jax.random.uniform(part, (length,), minval=ABOVE_MINUS_1) for part, length in parts])

    normal = np.sqrt(2.0, dtype=np.float32) * jax.lax.erf_inv(jax.vmap(draw, out_axes=-1)(keys))
    return jax.lax.optimization_barrier(normal)
