"""Drives of robot tasks: what a geared motor leaves of a torque, at rest, at speed, where voltage or current end."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from compiling import counting_compiles

from humanoid_mjx import InputError, make_task
from humanoid_mjx.control.drives import DcMotor, Ideal

SPEEDS = jnp.linspace(-12.0, 12.0, 41)
GEAR, VOLTAGE = 120.0, 9.0
MOTOR = DcMotor(gear=GEAR, voltage=VOLTAGE)


def test_stall_and_no_load():
    stall = GEAR * 0.0136 * VOLTAGE / 7.0
    # Without friction of the rotor the back-emf of the no-load speed is the voltage.
    fastest = VOLTAGE / (GEAR * (0.0136 + 1e-6 * 7.0 / 0.0136))
    most = MOTOR(jnp.full(41, 1e3), SPEEDS)
    np.testing.assert_allclose(most, stall * (1.0 - SPEEDS / fastest), rtol=1e-4, atol=1e-5)
    assert MOTOR(jnp.array([1e3]), jnp.zeros(1)) == pytest.approx(stall, rel=1e-6)
    np.testing.assert_allclose(MOTOR(jnp.array([1e3, -1e3]), jnp.array([fastest, -fastest])), 0.0, atol=1e-5)
    weak = MOTOR.replace(current=0.5)(jnp.array([1e3, -1e3]), jnp.zeros(2))
    np.testing.assert_allclose(weak, np.array([1, -1]) * GEAR * 0.0136 * 0.5, rtol=1e-5)


def test_no_torque_takes_more_than_the_largest_voltage():
    """Back-emf and resistance at the current that moves the joint and its rotor."""
    asked = jnp.asarray(np.random.default_rng(0).uniform(-3.0, 3.0, 41), float)
    current = (MOTOR(asked, SPEEDS) / GEAR + 1e-6 * GEAR * SPEEDS) / 0.0136
    voltage = np.abs(0.0136 * GEAR * SPEEDS + 7.0 * current)
    assert (voltage <= VOLTAGE * (1 + 1e-6)).all() and voltage.max() == pytest.approx(VOLTAGE)


def test_a_motor_without_limits_is_ideal():
    asked = jnp.linspace(-3.0, 3.0, 41)
    free = DcMotor(voltage=1e6, current=1e6, friction=0.0)
    np.testing.assert_allclose(free(asked, SPEEDS), asked, rtol=1e-4, atol=1e-4)
    assert Ideal()(asked, SPEEDS) is asked
    slow = jnp.full(41, 0.1)
    np.testing.assert_allclose(DcMotor()(asked / 2, slow), asked / 2, rtol=1e-4, atol=1e-6)


def test_it_drives_the_joints_of_a_task_and_is_data_of_its_program():
    keys = jax.random.split(jax.random.key(0), 2)
    tasks = [make_task("stand", physics="mujoco", push={"impulse": 0.0}, actuator=a) for a in ("ideal", "dc_motor")]
    weak = make_task("stand", physics="mujoco", push={"impulse": 0.0}, actuator={"name": "dc_motor", "voltage": 1.5})
    assert jax.tree.structure(tasks[1]) == jax.tree.structure(weak)
    step = jax.jit(lambda task, state: jax.vmap(task.step_continuous)(state, jnp.ones((2, 10)), keys))
    state = jax.jit(jax.vmap(tasks[0].reset))(keys)
    ideal, driven = (step(jax.tree.map(jnp.asarray, task), state).data.world.qvel for task in tasks)
    with counting_compiles() as programs:
        feeble = step(jax.tree.map(jnp.asarray, weak), state).data.world.qvel
    assert not programs
    still = step(jax.tree.map(jnp.asarray, weak.replace(actuator=weak.actuator.replace(voltage=1e-6))), state)
    # A start from rest: all of them agree while slow, and less voltage moves the joints less.
    sizes = [float(jnp.abs(x[:, 6:]).mean()) for x in (ideal, driven, feeble, still.data.world.qvel)]
    assert sizes[0] >= sizes[1] > sizes[2] > sizes[3]


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"name": "servo"}, "actuator.name: unknown actuator 'servo'; known are dc_motor, ideal"),
        ({"name": "dc_motor", "gear": "fast"}, r"actuator\.gear must be a valid number, got 'fast'"),
        ({"name": "dc_motor", "gear": [1.0, None]}, r"actuator\.gear must be a number, .* write sweep\.\S+\.gear\.$"),
        ({"name": "dc_motor", "gear": 0.0}, "actuator.gear must be positive, one number or 10, got 0.0"),
        ({"name": "dc_motor", "gear": [1.0, 2.0]}, "actuator.gear must be positive, one number or 10"),
        # At 135 the speed would fall by twice itself in a step: 135^2 (0.0136^2 / 7 + 1e-6) 0.004 s = 2 x 0.001 kg m^2.
        ({"name": "dc_motor", "gear": 136.0}, "too fast for an armature of 0.001"),
        ({"name": "dc_motor", "voltage": -1.0}, "actuator.voltage must be greater than 0"),
    ],
)
def test_what_is_no_motor_is_refused(values, words):
    with pytest.raises(InputError, match=words):
        make_task("stand", actuator=values)
    make_task("stand", actuator={"name": "dc_motor", "gear": 134.0})
