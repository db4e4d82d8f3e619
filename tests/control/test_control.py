"""Chapter 5: responses, motors that conserve power, gains; rollouts under controllers are in tests/float64."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from humanoid_mjx import InputError, Leg
from humanoid_mjx.control.gains import critical_kd, damping_ratio, max_kp, poles, step_response
from humanoid_mjx.thesis import leg as thesis


@pytest.mark.parametrize("ratio", [0.0, 0.3, 0.999, 1.0, 1.001, 1.985, 6.0])
def test_step_response_in_float32_starts_at_rest_and_obeys_its_equation(ratio):
    omega = 8.0
    y = lambda t: step_response(t, omega, ratio)  # noqa: E731
    times = jnp.linspace(0.0, 2.0, 41)
    first, second = jax.vmap(jax.grad(y))(times), jax.vmap(jax.grad(jax.grad(y)))(times)
    residual = second + 2 * ratio * omega * first + omega**2 * (jax.vmap(y)(times) - 1)
    assert float(y(times[0])) == 0.0 and float(first[0]) == pytest.approx(0.0, abs=1e-4)
    # Terms of size omega^2 = 64, each with a few float32 roundings; the quotient near 1 loses three more digits.
    assert float(jnp.abs(residual).max()) < 0.2


def test_gains_of_table_5_1_are_twice_overdamped():
    kp, kd = jnp.array(thesis.KP), jnp.array(thesis.KD)
    np.testing.assert_allclose(damping_ratio(kp, kd), [1.985, 1.819, 2.003, 2.357, 2.032], atol=5e-4)
    np.testing.assert_allclose(critical_kd(kp), [16.12, 16.49, 16.97, 16.12, 16.73], atol=5e-3)
    slow, fast = poles(kp, kd)
    np.testing.assert_allclose(slow, [-2.18, -2.47, -2.27, -1.80, -2.20], atol=5e-3)
    np.testing.assert_allclose(slow * fast, kp, rtol=1e-5)
    np.testing.assert_allclose(slow + fast, -kd, rtol=1e-5)


def test_a_chain_without_a_last_mass_carries_nothing():
    rods = np.array(Leg.physical().pseudo_inertia)
    rods[-1] = 0.0
    with pytest.raises(InputError, match="must have a mass"):
        Leg.from_links(thesis.LINK_LENGTHS, rods).carrying(0.1)


def test_a_quarter_of_the_squared_resonance_at_the_largest_inertia():
    assert float(max_kp(10.0, 2.0, 8.0)) == pytest.approx(0.25 * 10.0**2 * 2.0 / 8.0)
