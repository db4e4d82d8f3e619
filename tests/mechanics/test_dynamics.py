"""The dynamics in single precision, the controller, the MJCF model and the benchmark; the rest is in tests/float64."""

import jax
import jax.numpy as jnp
import lagrange_euler
import numpy as np
import pytest

from humanoid_mjx import InputError, Leg, control, dynamics
from humanoid_mjx.bench import physics
from humanoid_mjx.robot.mjcf import make_mjspec

STATE = jnp.array([[0.3, -0.2, 0.4, 1.1, -0.5], [1.0, 2.0, -1.0, 0.5, 3.0]])


@pytest.mark.parametrize("make", [Leg.physical, Leg.thesis, Leg.matlab_script, Leg.figure_7_5])
def test_fast_version_equals_reference(make):
    leg = make()
    matrix, bias = dynamics.mass_matrix_and_bias(leg, *STATE)
    slow = lagrange_euler.coriolis(leg, *STATE) + lagrange_euler.gravity(leg, STATE[0])
    np.testing.assert_allclose(matrix, lagrange_euler.mass_matrix(leg, STATE[0]), rtol=1e-4, atol=1e-8)
    np.testing.assert_allclose(bias, slow, rtol=1e-4, atol=1e-5)
    assert matrix.dtype == bias.dtype == jnp.float32


def test_computed_torque_with_the_true_model_gives_the_second_order_response():
    leg = Leg.physical()
    goal = control.Reference(jnp.full(5, 0.5), jnp.full(5, 0.1), jnp.full(5, -0.2))
    torque = dynamics.inverse_dynamics(leg, *STATE, control.servo(70.0, 32.0, goal, *STATE))
    wanted = goal.qacc + 32.0 * (goal.qvel - STATE[1]) + 70.0 * (goal.qpos - STATE[0])
    np.testing.assert_allclose(dynamics.forward_dynamics(leg, *STATE, torque), wanted, rtol=2e-3)


def test_zeros_of_the_structure_stay_out_of_the_program():
    def operations(leg):
        return len(jax.make_jaxpr(lambda q: dynamics.mass_matrix(leg, q))(STATE[0]).eqns)

    assert operations(Leg.physical()) < operations(Leg.thesis())


def test_mujoco_refuses_what_it_cannot_simulate():
    leg = Leg.physical()
    with pytest.raises(InputError, match="mass"):
        make_mjspec(leg.scaled(jnp.array([1.0, 1.0, 0.0, 1.0, 1.0])))
    with pytest.raises(InputError, match="one chain"):
        make_mjspec(jax.vmap(leg.scaled)(jnp.ones(2)))


def test_benchmark_runs():
    lines = []
    records = physics.legs(lines.append, physics.Setting((1,), 2, 2, 2))  # one leg is on one device
    assert {(r.subject, r.unit) for r in records} == {
        ("chain", "physics steps/s"),
        ("chain", "control+physics steps/s"),
        ("mjx-jax", "physics steps/s"),
        ("mjx-jax", "control+physics steps/s"),
        ("mjx-jax plain", "control+physics steps/s"),
        ("mujoco", "physics steps/s"),
    }
    assert all(r.value > 0 for r in records)
    assert "mjx-jax plain" in lines[-1]
