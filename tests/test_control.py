"""Chapter 5: responses, motors that conserve power, gains; rollouts under controllers are in tests/float64."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from humanoid_mjx import InputError, Leg
from humanoid_mjx.control.actuator import Motor
from humanoid_mjx.control.gains import critical_kd, damping_ratio, max_kp, poles
from humanoid_mjx.control.response import step_response
from humanoid_mjx.thesis import leg as thesis

MOTOR = Motor(0.02, 1.5, gear_ratio=100.0, rotor_inertia=1e-7, friction=1e-6, max_voltage=12.0)


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


def test_motor_conserves_power():
    rng = np.random.default_rng(0)
    qvel, voltage = jnp.array(rng.normal(size=100)), jnp.array(rng.uniform(-12, 12, 100))
    state = MOTOR.drive(voltage, qvel)
    electric = state.voltage * state.current
    heat = MOTOR.resistance * state.current**2 + MOTOR.reflected_friction * qvel**2
    scale = jnp.abs(electric) + heat + jnp.abs(state.torque * qvel)
    np.testing.assert_allclose((electric - heat - state.torque * qvel) / scale, 0.0, atol=1e-6)


def test_gear_conserves_power():
    geared, bare = MOTOR, Motor(0.02, 1.5, friction=1e-6, max_voltage=12.0)
    joint = geared.drive(jnp.array(5.0), jnp.array(0.3))
    shaft = bare.drive(jnp.array(5.0), jnp.array(0.3) * geared.gear_ratio)
    np.testing.assert_allclose(joint.torque * 0.3, shaft.torque * 0.3 * geared.gear_ratio, rtol=1e-5)
    np.testing.assert_allclose(joint.current, shaft.current, rtol=1e-5)


def test_torque_speed_line_runs_from_stall_to_no_load():
    stall, free = MOTOR.stall_torque(), jnp.asarray(MOTOR.no_load_speed())
    np.testing.assert_allclose(stall, 100.0 * 0.02 * 12.0 / 1.5, rtol=1e-6)
    assert MOTOR.drive(jnp.array(12.0), free).torque == pytest.approx(0.0, abs=1e-4 * float(stall))
    half = MOTOR.actuate(jnp.array(1e3), free / 2)
    np.testing.assert_allclose(half.torque, stall / 2, rtol=1e-4)
    assert float(half.voltage) == 12.0
    asked = MOTOR.actuate(jnp.array(0.5), jnp.array(1.0))
    np.testing.assert_allclose(asked.torque, 0.5, rtol=1e-4)


def test_gains_of_table_5_1_are_twice_overdamped():
    kp, kd = jnp.array(thesis.KP), jnp.array(thesis.KD)
    np.testing.assert_allclose(damping_ratio(kp, kd), [1.985, 1.819, 2.003, 2.357, 2.032], atol=5e-4)
    np.testing.assert_allclose(critical_kd(kp), [16.12, 16.49, 16.97, 16.12, 16.73], atol=5e-3)
    slow, fast = poles(kp, kd)
    np.testing.assert_allclose(slow, [-2.18, -2.47, -2.27, -1.80, -2.20], atol=5e-3)
    np.testing.assert_allclose(slow * fast, kp, rtol=1e-5)
    np.testing.assert_allclose(slow + fast, -kd, rtol=1e-5)


def test_resonance_limits_the_gain():
    np.testing.assert_allclose(max_kp(40.0, 2.0, 8.0), (0.5 * 20.0) ** 2)


def test_motors_give_what_they_can():
    asked = jnp.array([0.5, 1e3, -1e3, 0.0, -0.5])
    torque, most = MOTOR.actuate(asked, jnp.zeros(5)).torque, MOTOR.stall_torque()
    np.testing.assert_allclose(torque, [0.5, most, -most, 0.0, -0.5], rtol=1e-5)


def test_a_chain_without_a_last_mass_carries_nothing():
    rods = np.array(Leg.physical().pseudo_inertia)
    rods[-1] = 0.0
    with pytest.raises(InputError, match="must have a mass"):
        Leg.from_links(thesis.LINK_LENGTHS, rods).carrying(0.1)


def test_bad_values_get_a_sentence():
    with pytest.raises(InputError, match="structural_frequency must be finite and greater than 0"):
        max_kp(0.0, 1.0, 1.0)
