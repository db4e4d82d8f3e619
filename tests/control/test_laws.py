"""Control laws that tasks choose: their formulas, plant and model apart, what a config may write."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from compiling import counting_compiles

from humanoid_mjx import InputError, Leg, control, dynamics, make_task
from humanoid_mjx.control import make_law
from humanoid_mjx.physics import make_physics
from humanoid_mjx.robot import make_robot

LEG = make_physics("chain", robot="leg", torque_limit=1e6)
QPOS, QVEL = np.array([0.3, -0.2, 0.4, 1.1, -0.5]), np.array([1.0, 2.0, -1.0, 0.5, 3.0])
GOAL = control.Reference(jnp.full(5, 0.5), jnp.full(5, 0.1), jnp.full(5, -0.2))
KP, KD = 36.0, 18.0
"""Of natural_frequency 6 rad/s and damping_ratio 1.5."""


@jax.jit
def torque(physics, world, controller):
    """What the controller asks for; limits are out of reach."""
    return physics.step(world, controller)[1]


def on_leg(law, mass=1.0):
    physics = LEG.replace(mass=mass)
    return torque(physics, physics.start(QPOS, QVEL), law.follow(GOAL))


def test_each_law_is_its_formula():
    leg = Leg.physical()
    error, rate = 0.5 - QPOS, 0.1 - QVEL
    wanted, matrix = -0.2 + KP * error + KD * rate, dynamics.mass_matrix(leg, jnp.array(QPOS))
    gains = {"natural_frequency": 6.0, "damping_ratio": 1.5}
    springs = {"stiffness": 3.0, "damping": 0.1}
    expected = {
        "servo": 3.0 * error - 0.1 * QVEL,
        "pd": 3.0 * error + 0.1 * rate,
        "partitioned_pd": jnp.diag(matrix) * wanted,
        "computed_torque": matrix @ wanted + dynamics.bias(leg, jnp.array(QPOS), jnp.array(QVEL)),
    }
    for name, right in expected.items():
        law = make_law(name, **(springs if name in ("servo", "pd") else gains))
        np.testing.assert_allclose(on_leg(law), right, rtol=1e-4, atol=1e-6, err_msg=name)


def test_a_robot_without_a_servo_takes_no_robot_servo():
    with pytest.raises(InputError, match="this task's robot has no servo of its own; take servo, and its gains"):
        on_leg(make_law("robot_servo"))


def test_in_the_air_without_a_servo_the_grounded_law_is_computed_torque():
    exact = on_leg(make_law("grounded", natural_frequency=6.0, share=0.0))
    np.testing.assert_allclose(exact, on_leg(make_law("computed_torque", natural_frequency=6.0)), rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("name", ["partitioned_pd", "computed_torque", "grounded"])
def test_the_model_may_weigh_other_than_the_plant(name):
    right = on_leg(make_law(name), mass=1.0)
    np.testing.assert_allclose(on_leg(make_law(name), mass=1.5), right, rtol=1e-4, atol=1e-6)
    # Nothing of the chain resists its motion but its links, so that a model half as heavy asks for half.
    light = on_leg(make_law(name, mass=0.5, **({"share": 0.0} if name == "grounded" else {})))
    whole = on_leg(make_law(name, **({"share": 0.0} if name == "grounded" else {})))
    # Torques of up to 0.1 N m, of which the grounded law's elimination in float32 keeps three to four places.
    np.testing.assert_allclose(light, 0.5 * whole, rtol=1e-3, atol=5e-5)


def test_gains_are_data_of_one_program():
    world = LEG.start(QPOS, QVEL)
    torque(LEG, world, make_law("servo").follow(GOAL))
    with counting_compiles() as programs:
        stiff, soft = (torque(LEG, world, make_law("servo", stiffness=x).follow(GOAL)) for x in (40.0, 4.0))
    assert not programs
    assert not np.allclose(stiff, soft)


def test_a_task_takes_a_law_by_name_with_gains_or_from_a_users_file():
    task = partial(make_task, "leg_reach")
    assert task().control == make_law("computed_torque", natural_frequency=12.0)
    assert task(control="servo").control == make_law("servo")
    assert task(control={"natural_frequency": 9.0}).control == make_law("computed_torque", natural_frequency=9.0)
    assert task(control={"name": "pd", "damping": 0.5}).control == make_law("pd", damping=0.5)
    own = task(control={"name": "spring:Spring", "stiffness": 4.0})
    assert own.control.stiffness == 4.0
    for chosen in (task(), task(control="grounded"), own):
        dumped = chosen.model_dump(mode="json")["control"]
        assert task(control=dumped) == chosen
    paths = [jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_leaves_with_path(task())]
    assert ".control.natural_frequency" in paths and ".control.mass" in paths


@pytest.mark.parametrize("law", ["servo", "pd", "partitioned_pd", "computed_torque", "grounded", "spring:Spring"])
def test_every_law_can_be_traced_in_a_task(law):
    task = make_task("leg_reach", control=law)
    key = jax.random.key(0)
    state = jax.eval_shape(lambda task: task.reset(key), task)
    after = jax.eval_shape(lambda task, state: task.step(state, jnp.zeros(5, jnp.int32), key), task, state)
    assert after.obs.shape == (25,)


@pytest.mark.parametrize(
    ("written", "sentence"),
    [
        ("servoo", r"^task.control.name: unknown control 'servoo'; did you mean 'servo'\? known are"),
        ({"name": "servo", "stifness": 3.0}, r"^task.control.stifness: unknown key; did you mean 'stiffness'\?"),
        ({"name": "servo", "stiffness": -1.0}, r"^task.control.stiffness must be greater than 0.0, got -1.0"),
        ({"name": "pd", "natural_frequency": 3.0}, r"^task.control.natural_frequency: unknown key"),
        ({"name": "grounded", "share": 2.0}, r"^task.control.share must be at most 1.0, got 2.0"),
        ({"damping_ratio": 0.0}, r"^task.control.damping_ratio must be greater than 0"),
        (3.0, r"^task.control must be a name, or a mapping of keys"),
        ("spring:Sprung", r"^task.control.name: 'spring:Sprung' cannot be imported"),
        (":Sprung", r"^task.control.name: ':Sprung' cannot be imported: Empty module name"),
        ("spring:traced", r"^task.control.name: .spring:traced. must be a class derived from .*control.laws.Law"),
    ],
)
def test_what_cannot_be_gets_one_sentence(written, sentence):
    with pytest.raises(InputError, match=sentence) as caught:
        make_task("leg_reach", control=written)
    assert "\n" not in str(caught.value) and str(caught.value).endswith(".") and ".." not in str(caught.value)


def test_the_servo_of_a_robot_is_a_multiple_of_its_own():
    dog = make_robot("dog")
    twice = make_law("robot_servo", stiffness=2.0, damping=3.0).of(dog)
    np.testing.assert_allclose(twice.stiffness, 2.0 * np.asarray(dog.servo[0]), rtol=1e-6)
    np.testing.assert_allclose(twice.damping, 3.0 * np.asarray(dog.servo[1]), rtol=1e-6)
