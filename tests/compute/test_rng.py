"""The cheap generator: that of jax, with keys that are independent across agents."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from humanoid_mjx.compute import rng
from humanoid_mjx.training.program import run_key

AGENTS, STEPS = 512, 2048


@pytest.fixture(scope="module")
def draws():
    """(AGENTS, STEPS, 3) The numbers that agents of one seed draw, as the tabular learner draws them."""
    keys = jax.vmap(lambda n: run_key(jnp.uint32(0), n))(jnp.arange(AGENTS, dtype=jnp.uint32))
    return np.asarray(jax.vmap(lambda key: jax.random.uniform(key, (3 * STEPS,)).reshape(STEPS, 3))(keys))


def test_a_uniform_number_is_that_of_jax_random_at_its_place():
    key = rng.key(7)
    together = jax.random.uniform(key, (30,))
    assert np.array_equal([rng.uniform(key, jnp.uint32(i)) for i in range(30)], together)


def test_agents_are_independent_of_each_other(draws):
    centred = draws.reshape(AGENTS, -1) - 0.5
    correlation = np.corrcoef(centred)[np.triu_indices(AGENTS, 1)]
    # 130,000 pairs of samples of length 6144, each with standard deviation 1/78: the largest is near 4.5 of them.
    assert np.abs(correlation).max() < 5.5 / np.sqrt(centred.shape[1])
    assert abs(correlation.std() * np.sqrt(centred.shape[1]) - 1) < 0.02


def test_a_million_agents_have_keys_of_their_own():
    keys = jax.jit(jax.vmap(lambda n: run_key(jnp.uint32(0), n)))(jnp.arange(1 << 20, dtype=jnp.uint32))
    words = np.asarray(jax.random.key_data(keys)).astype(np.uint64)
    assert len(np.unique(words[:, 0] << np.uint64(32) | words[:, 1])) == 1 << 20
