"""Errors of the sensors: none by default, of the size asked for, late by the delay asked for."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from humanoid_mjx.physics.base import Readings
from humanoid_mjx.physics.sensors import Sensors

KEY = jax.random.key(0)
KEYS = jax.random.split(KEY, 16)
"""All three delays of a jitter of 2 are among them, by a chance of all but 0.005 for any seed."""


def readings(value):
    return Readings(*(jnp.full(n, value) for n in (10, 3, 3, 2)))


def run(sensors, values, key=KEY):
    """What is read of true readings that are `values`, one after the other."""
    state = sensors.start(readings(values[0]), key)
    seen = []
    for i, value in enumerate(values):
        state, now = sensors.read(state, readings(value), jax.random.fold_in(key, i))
        seen.append(now)
    return jax.tree.map(lambda *x: np.stack(x), *seen)


def test_perfect_sensors_tell_the_truth():
    for part in run(Sensors(), [1.0, 2.0, 3.0]):
        np.testing.assert_array_equal(part[:, 0], [1.0, 2.0, 3.0])


def test_delay_in_control_cycles():
    for part in run(Sensors(delay=2), [1.0, 2.0, 3.0, 4.0]):
        np.testing.assert_array_equal(part[:, 1], [1.0, 1.0, 1.0, 2.0])


def test_jitter_draws_a_longer_delay_for_each_episode():
    late = np.array([run(Sensors(delay=1, jitter=2), np.arange(9.0), key=key)[0][-1, 0] for key in KEYS])
    assert set(8.0 - late) == {1.0, 2.0, 3.0}
    one = run(Sensors(delay=1, jitter=2), np.arange(9.0))[0][:, 0]
    np.testing.assert_array_equal(np.diff(one[4:]), 1.0)  # of one episode it stays the same


def test_noise_and_bias_have_the_size_asked_for():
    sensors = Sensors(encoder_noise=0.1, gyroscope_bias=0.2, accelerometer_noise=0.3, accelerometer_bias=0.4)
    sense = jax.jit(jax.vmap(lambda key: jnp.stack([x[:2] for x in one_and_two(sensors, key)])))
    seen = np.asarray(sense(jax.random.split(KEY, 4000)))
    first, second = seen[:, :4], seen[:, 4:]
    size = np.asarray(first.std(axis=(0, 2)))
    assert size == pytest.approx([0.1, 0.2, 0.5, 0.0], rel=0.05)
    change = np.asarray((second - first).std(axis=(0, 2)))
    assert change == pytest.approx([0.1 * 2**0.5, 0.0, 0.3 * 2**0.5, 0.0], rel=0.05, abs=1e-6)


def one_and_two(sensors, key):
    """Two readings in one episode, one after the other: their eight arrays."""
    state = sensors.start(readings(0.0), key)
    state, one = sensors.read(state, readings(0.0), jax.random.fold_in(key, 1))
    state, two = sensors.read(state, readings(0.0), jax.random.fold_in(key, 2))
    return [*one, *two]
