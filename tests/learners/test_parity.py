"""The textbook tasks of `experiments/parity.py`, by their equations."""

import jax.numpy as jnp
import numpy as np
import parity
import pytest

from humanoid_mjx.compute import rng

KEY = rng.key(0)


def test_the_cliffs_greedy_path_takes_13_steps():
    assert parity.expected_on_the_cliff(0.0) == pytest.approx(-13.0)
    state, reward, over = parity.CliffWalking().step(jnp.int32(parity.START), jnp.int32(1), KEY)
    assert (int(state), float(reward), bool(over)) == (parity.START, -100.0, False)


def test_the_cart_pole_moves_by_its_equations_of_motion():
    """Forces on the cart and moments about the pole's hinge (R. Florian, 2007, without friction)."""
    task, gravity, cart, pole, half = parity.CartPole(), 9.8, 1.0, 0.1, 0.5
    for choice, obs in enumerate(np.random.default_rng(0).uniform(-0.15, 0.15, (2, 4)).astype(np.float32)):
        state = task.reset(KEY)._replace(data=(jnp.asarray(obs), jnp.int32(0)))
        _, speed, angle, spin = obs.astype(float)
        inertia = [[cart + pole, pole * half * np.cos(angle)], [pole * half * np.cos(angle), 4 / 3 * pole * half**2]]
        force = [20 * choice - 10 + pole * half * spin**2 * np.sin(angle), pole * gravity * half * np.sin(angle)]
        driven, turning = np.linalg.solve(inertia, force)
        expected = obs + 0.02 * np.array([speed, driven, spin, turning])
        found = task.step(state, jnp.array([choice]), KEY)
        np.testing.assert_allclose(found.obs, expected, atol=1e-5)
