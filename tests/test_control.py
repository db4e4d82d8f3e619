"""Chapter 5: responses, motors that conserve power, gains, controllers; rollouts with them are in tests/float64."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from humanoid_mjx import InputError, Leg, control, dynamics
from humanoid_mjx.control.actuator import Motor, through_motors
from humanoid_mjx.control.gains import check_gains, critical_kd, damping_ratio, max_kp, poles
from humanoid_mjx.control.response import step_response
from humanoid_mjx.thesis import leg as thesis

MOTOR = Motor.build(0.02, 1.5, gear_ratio=100.0, rotor_inertia=1e-7, friction=1e-6, max_voltage=12.0)


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
    geared, bare = MOTOR, Motor.build(0.02, 1.5, friction=1e-6, max_voltage=12.0)
    joint = geared.drive(jnp.array(5.0), jnp.array(0.3))
    shaft = bare.drive(jnp.array(5.0), jnp.array(0.3) * geared.gear_ratio)
    np.testing.assert_allclose(joint.torque * 0.3, shaft.torque * 0.3 * geared.gear_ratio, rtol=1e-5)
    np.testing.assert_allclose(joint.current, shaft.current, rtol=1e-5)


def test_torque_speed_line_runs_from_stall_to_no_load():
    stall, free = MOTOR.stall_torque(), MOTOR.no_load_speed()
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


GOAL = control.Reference(jnp.full(5, 0.5), jnp.full(5, 0.1), jnp.full(5, -0.2))
QPOS, QVEL = jnp.array([[0.3, -0.2, 0.4, 1.1, -0.5], [1.0, 2.0, -1.0, 0.5, 3.0]])


def test_controllers_are_their_equations():
    leg, kp, kd = Leg.thesis(), jnp.array(thesis.KP), jnp.array(thesis.KD)
    error, rate = GOAL.qpos - QPOS, GOAL.qvel - QVEL
    wanted, matrix = GOAL.qacc + kd * rate + kp * error, dynamics.mass_matrix(leg, QPOS)
    np.testing.assert_allclose(control.pd(control.PD.build(5, kp, kd), GOAL, QPOS, QVEL), kp * error + kd * rate)
    partitioned = control.partitioned_pd(control.PartitionedPD.build(leg, kp, kd), GOAL, QPOS, QVEL)
    np.testing.assert_allclose(partitioned, jnp.diag(matrix) * wanted, rtol=1e-5)
    torque = control.computed_torque(control.ComputedTorque.build(leg, kp, kd), GOAL, QPOS, QVEL)
    np.testing.assert_allclose(torque, matrix @ wanted + dynamics.bias(leg, QPOS, QVEL), rtol=1e-4)


def test_controllers_take_a_batch_of_parameters():
    models = jax.vmap(Leg.physical().scaled)(jnp.array([0.8, 1.2]))
    params = control.PartitionedPD(models, jnp.full((2, 5), 70.0), jnp.full((2, 5), 32.0))
    light, heavy = jax.vmap(control.partitioned_pd, in_axes=(0, None, None, None))(params, GOAL, QPOS, QVEL)
    np.testing.assert_allclose(heavy, 1.5 * light, rtol=1e-5)


def test_motors_around_a_controller_give_what_they_can():
    driven = through_motors(MOTOR, lambda time, qpos, qvel: jnp.array([0.5, 1e3, -1e3, 0.0, -0.5]))
    torque, most = driven(0.0, QPOS, jnp.zeros(5)), MOTOR.stall_torque()
    np.testing.assert_allclose(torque, [0.5, most, -most, 0.0, -0.5], rtol=1e-5)


def test_a_chain_without_a_last_mass_carries_nothing():
    rods = np.array(Leg.physical().pseudo_inertia)
    rods[-1] = 0.0
    with pytest.raises(InputError, match="must have a mass"):
        Leg.from_links(thesis.LINK_LENGTHS, rods).carrying(0.1)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: Motor.build(0.02, 0.0), "resistance must be finite and greater than 0, got 0.0"),
        (lambda: Motor.build(float("nan"), 1.0), "torque_constant must be finite"),
        (lambda: Motor.build(0.02, 1.0, friction=-1.0), "friction must be finite and at least 0"),
        (lambda: Motor.build([0.1, 0.2], [1.0, 1.0, 1.0]), "scalars or of one shape"),
        (lambda: max_kp(0.0, 1.0, 1.0), "structural_frequency must be finite and greater than 0, got 0.0"),
        (lambda: check_gains(5, kp=-1.0), "kp must be finite and at least 0"),
        (lambda: check_gains(5, kp=[1.0, 2.0]), r"kp must be a number or one for each of 5 joints, got shape \(2,\)"),
        (lambda: check_gains(5, kd=float("inf")), "kd must be finite"),
        (lambda: check_gains(5, kd="stiff"), "kd must be numbers, got 'stiff'"),
        (lambda: control.PD.build(5, kp=1.0, kd=-1.0), "kd must be finite and at least 0"),
        (lambda: control.PartitionedPD.build(Leg.physical(), [1.0] * 4, 1.0), "one for each of 5 joints"),
        (lambda: control.ComputedTorque.build(Leg.physical(), float("nan"), 1.0), "kp must be finite"),
    ],
)
def test_bad_values_get_a_sentence(call, words):
    with pytest.raises(InputError, match=words):
        call()
