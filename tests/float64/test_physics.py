"""MJX and the tree against native MuJoCo in double precision: what is left is the solver's and rounding's."""

import jax
import mujoco
import numpy as np
import pytest
from tree_robots import UNEQUAL, converged

from humanoid_mjx.physics import make_physics
from humanoid_mjx.robot import Robot
from humanoid_mjx.spec import InputError


@pytest.fixture(scope="module")
def both():
    """MJX, a step of many worlds in it, and one in native MuJoCo; no factor is 1."""
    values = {"mass": 1.2, "friction": 0.7, "damping": 0.8, "torque_limit": 0.9}
    pair = [make_physics(name, robot={"ranges": "human"}, **values) for name in ("mjx-jax", "mujoco")]
    return pair[0], *(jax.jit(jax.vmap(lambda world, target, p=p: p.step(world, servo(target)))) for p in pair)


def start(mjx, qpos, qvel):
    return jax.vmap(lambda q, v: mjx.start(q, v))(qpos, qvel)


def servo(target):
    return lambda stages: 6.0 * (target - stages.qpos) - 0.2 * stages.qvel


def test_accelerations_in_the_air_agree(both):
    """Random states: fast, at their joint limits, legs touching."""
    mjx, step, native_step = both
    rng = np.random.default_rng(0)
    qpos, qvel = np.tile(mjx.qpos0, (32, 1)), 3.0 * rng.normal(size=(32, 16))
    qpos[:, 2], qpos[:, 7:] = 1.0, rng.uniform(*mjx.robot.ranges_rad.T, (32, 10))
    target = qpos[:, 7:] + rng.uniform(-0.3, 0.3, (32, 10))
    world = start(mjx, qpos, qvel)
    (moved, torque), (expected, expected_torque) = step(world, target), native_step(world, target)
    acceleration, native_acceleration = ((new.qvel - qvel) / mjx.step_s for new in (moved, expected))
    np.testing.assert_allclose(torque, expected_torque, atol=1e-12)
    assert np.abs(native_acceleration).max() > 100.0
    np.testing.assert_allclose(acceleration, native_acceleration, rtol=1e-8, atol=1e-8)


def test_a_squat_on_the_ground_agrees(both):
    """Half a second: the few iterations of the solver here converge, too."""
    mjx, step, native_step = both
    target = np.tile([0.25, 0.0, 0.0, 0.5, -0.25], (4, 2)) * np.array([[0.25], [0.5], [0.75], [1.0]])
    qpos = np.tile(mjx.qpos0, (4, 1))
    world = other = start(mjx, qpos, np.zeros((4, 16)))
    for _ in range(125):
        world, _ = step(world, target)
        other, _ = native_step(other, target)
    assert other.qpos[3, 2] < 0.214
    np.testing.assert_allclose(world.qpos, other.qpos, atol=1e-9)


class Unequal(Robot):
    motors: str = ""
    integrator: int = 0

    def spec(self, timestep=None):
        spec = mujoco.MjSpec.from_string(UNEQUAL.replace("</actuator>", self.motors + "</actuator>"))
        spec.option.timestep = timestep or spec.option.timestep
        spec.option.integrator = self.integrator
        return spec


@pytest.mark.parametrize(("integrator", "name"), [(1, "rk4"), (2, "implicit"), (3, "implicitfast")])
def test_mjx_refuses_what_its_euler_does_not_integrate(integrator, name):
    """As the model takes damping at the beginning of a step, which implicitfast does not."""
    with pytest.raises(InputError, match=f"MJX in jax does not compute the {name} integrator: take mujoco"):
        make_physics("mjx-jax", robot=Unequal(integrator=integrator))


@pytest.mark.parametrize("name", ["tree", "mjx-jax", "mujoco"])
def test_nothing_of_a_model_is_left_out_without_a_word(name):
    """A servo of two joints, all traced values in it, against native MuJoCo with a changed model."""
    factors = {"friction": 1.5, "damping": 0.5, "torque_limit": 0.3}
    physics = make_physics(name, robot=Unequal(), **factors)
    assert physics.joint_names == ("back", "front")
    goal, qvel = np.array([-0.3, 0.3]), np.array([0.3, 0.2, 0, 0, 0, 0, 1.0, -2.0, 1.0])
    run = jax.jit(lambda world: physics.run_sensed(world, lambda s: 5.0 * (goal - s.qpos) - 0.2 * s.qvel, 60))
    start = physics.qpos0 + np.array([0, 0, 0, 0, 0, 0, 0, 0.1, 0.1, -0.1])
    world, sensed = run(physics.start(start, qvel))
    own, model = mujoco.MjModel.from_xml_string(UNEQUAL), converged(mujoco.MjModel.from_xml_string(UNEQUAL))
    for name_of_array in ("actuator_gear", "actuator_ctrllimited", "actuator_forcelimited"):
        getattr(model, name_of_array)[:] = getattr(own, name_of_array)
    model.geom_friction[:, 0] *= 1.5
    model.dof_damping *= 0.5
    model.actuator_ctrlrange *= 0.3
    model.actuator_forcerange *= 0.3
    data, at, largest, torques = mujoco.MjData(model), np.array([9, 7]), np.array([0.24, 0.6]), []
    data.qpos, data.qvel = start, qvel
    for _ in range(60):
        torque = np.clip(5.0 * (goal - data.qpos[at]) - 0.2 * data.qvel[at - 1], -largest, largest)
        data.ctrl = torque / [4.0, -2.0]
        mujoco.mj_step(model, data)
        torques.append(torque)
    assert not world.diverged and np.abs(np.abs(torques).max(axis=0) - largest).max() < 1e-12
    if name == "mjx-jax":  # whose solver has four iterations for legs 4 cm in the ground
        np.testing.assert_allclose(world.qpos, data.qpos, atol=5e-3)
        return
    np.testing.assert_allclose(world.qpos, data.qpos, atol=1e-8)
    np.testing.assert_allclose(sensed.torque, torques[-1], atol=1e-7)
    np.testing.assert_allclose(sensed.readings.gyroscope, data.sensor("gyroscope").data, atol=1e-6)
    np.testing.assert_allclose(sensed.readings.accelerometer, data.sensor("accelerometer").data, atol=1e-5)


ODD = (
    '<position name="odd" joint="toe" kp="5"/>',
    '<motor name="odd" joint="toe" gear="0"/>',
    '<motor name="odd" site="imu"/>',
    '<general name="odd" joint="toe" gainprm="0"/>',
    '<general name="odd" joint="toe" gaintype="affine"/>',
    '<general name="odd" joint="toe" dyntype="filter" dynprm="0.1"/>',
    '<motor name="odd" joint="toe" ctrlrange="-1 2" ctrllimited="true"/>',
    '<motor name="odd" joint="toe" forcerange="-1 2" forcelimited="true"/>',
)


@pytest.mark.parametrize("odd", ODD)
def test_a_motor_that_is_no_motor_of_a_joint_is_refused(odd):
    with pytest.raises(InputError, match=r"no physics takes the \w+ of motor 'odd' \(take"):
        make_physics("mujoco", robot=Unequal(motors=odd))


class Pair(Robot):
    """A joint with two motors and an uneven limit, and one with a motor whose own limit is above the joint's."""

    def spec(self, timestep=None):
        return mujoco.MjSpec.from_string("""<mujoco><worldbody><body>
          <joint name="two" axis="0 1 0" actuatorfrcrange="-2.6 2"/><geom size=".1" pos="0 0 -.3" mass="1"/>
          <body pos="0 0 -.4"><joint name="one" axis="0 1 0" actuatorfrcrange="-4 5"/>
          <geom size=".1" pos="0 0 -.3" mass="1"/></body></body></worldbody>
          <actuator><motor joint="two" ctrlrange="-6 6"/><motor joint="one"/>
          <motor joint="two" gear="-2" forcerange="-2 2"/></actuator></mujoco>""")


@pytest.mark.parametrize("factor", [0.5, 2.0])
@pytest.mark.parametrize("name", ["tree", "mjx-jax", "mujoco"])
def test_the_motors_of_a_joint_give_together_what_it_takes(name, factor):
    """The motors of one joint against each other and together; what is reported is what acts."""
    physics, model = make_physics(name, robot=Pair(), torque_limit=factor), Pair().spec().compile()
    for limit in (model.actuator_ctrlrange, model.actuator_forcerange, model.jnt_actfrcrange):
        limit *= factor
    data, step = mujoco.MjData(model), jax.jit(lambda world, asked: physics.step(world, lambda _: asked))
    for asked in ([1.0, 9.0, -1.5], [7.0, -9.0, -1.0], [-20.0, 0.5, 20.0], [-9.0, 3.0, -8.0], [1.0, 0.0, -1.0]):
        mujoco.mj_resetData(model, data)
        data.ctrl = np.array(asked) / [1.0, 1.0, -2.0]
        mujoco.mj_step(model, data)
        world, torque = step(physics.start(physics.qpos0, np.zeros(2)), np.array(asked))
        np.testing.assert_allclose(world.qvel, data.qvel, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose([torque[0] + torque[2], torque[1]], data.qfrc_actuator, rtol=1e-12, atol=1e-12)
