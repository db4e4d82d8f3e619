"""Descriptions of robots: what follows from a model, and what is no robot is refused."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from humanoid_mjx import make_task
from humanoid_mjx.robot import ROBOTS, Robot, make_robot
from humanoid_mjx.robot.lower_body import JOINTS, LowerBody
from humanoid_mjx.spec import InputError

BODY = LowerBody(ranges="human")


def test_the_lower_body_is_one():
    assert BODY.joints == JOINTS and BODY.points == 4 and BODY.foot_pairs.tolist() == [[0, 1]]
    assert BODY.model is BODY.model and make_robot("lower_body", ranges="human") == BODY
    np.testing.assert_array_equal(BODY.torque_limits, np.full(10, 2.0))
    np.testing.assert_array_equal(BODY.phases, [0.0, 0.5])
    order, signs = BODY.joint_images
    assert order.tolist() == [5, 6, 7, 8, 9, 0, 1, 2, 3, 4] and (signs == 1).all()
    assert BODY.start_height == 0.21
    assert BODY.leg_length == pytest.approx(0.19 * np.cos(np.radians(15)) + 0.025, abs=1e-9)


@pytest.mark.parametrize("name", ROBOTS)
def test_sensors_are_those_of_the_model(name):
    robot = make_robot(name)
    encoders, gyroscope, accelerometer, feet, points = robot.sensors
    kinds = [mujoco.mjtSensor(robot.model.sensor(sensor).type[0]).name for sensor in (gyroscope, accelerometer)]
    assert kinds == ["mjSENS_GYRO", "mjSENS_ACCELEROMETER"]
    assert len({robot.model.sensor(sensor).id for sensor in (*encoders, *feet, *points)}) == robot.model.nsensor - 2


def test_it_is_written_as_it_was_chosen():
    assert BODY.model_dump(mode="json") == {"name": "lower_body", "ranges": "human"}


class Dog(Robot):
    """Four legs of one joint; the left hips turn the other way than the right ones."""

    feet: tuple[str, ...] = ("fr", "fl", "rr", "rl")
    turns: tuple[float, ...] = (0.0, 0.5, 0.5, 0.0)
    mirror: tuple[tuple[str, str], ...] = (("fr", "fl"), ("rr", "rl"))
    axis: str = "x"

    def spec(self, timestep=None):
        spec = mujoco.MjSpec()
        spec.worldbody.add_geom(name="ground", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(0, 0, 1))
        body = spec.worldbody.add_body(name="trunk", pos=(0, 0, 0.32))
        body.add_freejoint()
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.2, 0.1, 0.05), mass=10, contype=0, conaffinity=0)
        for foot in self.feet:
            leg = body.add_body(name=foot, pos=(0.2 if foot[0] == "f" else -0.2, 0.1 if foot[1] == "l" else -0.1, 0))
            leg.add_joint(name=foot, axis=(1, 0, 0) if self.axis == "x" else (1, 1, 0), armature=0.01, damping=0.2)
            leg.add_geom(name=f"{foot}_ball", size=(0.02, 0, 0), pos=(0, 0, -0.3), mass=0.5, contype=0)
            leg.add_site(name=f"{foot}_contact", size=(0.03, 0, 0), pos=(0, 0, -0.3))
            spec.add_pair(name=foot, geomname1="ground", geomname2=f"{foot}_ball")
        for foot in reversed(self.feet):
            spec.add_actuator(name=foot, target=foot, trntype=mujoco.mjtTrn.mjTRN_JOINT).set_to_motor()
        body.add_site(name="imu")
        kinds, site = mujoco.mjtSensor, mujoco.mjtObj.mjOBJ_SITE
        for name in self.feet:
            for end in ("contact", "ball_contact"):
                spec.add_sensor(name=f"{name}_{end}", type=kinds.mjSENS_TOUCH, objtype=site, objname=f"{name}_contact")
            joint = {"objtype": mujoco.mjtObj.mjOBJ_JOINT, "objname": name}
            spec.add_sensor(name=f"{name}_encoder", type=kinds.mjSENS_JOINTPOS, **joint)
        for name, kind in (("gyroscope", kinds.mjSENS_GYRO), ("accelerometer", kinds.mjSENS_ACCELEROMETER)):
            spec.add_sensor(name=name, type=kind, objtype=site, objname="imu")
        spec.option.timestep = timestep or 0.004
        return spec


def test_another_robot():
    dog = Dog()
    assert dog.joints == dog.feet[::-1] and dog.points == 1 and dog.foot_pairs.tolist() == [[0, 1], [2, 3]]
    order, signs = dog.joint_images
    assert order.tolist() == [1, 0, 3, 2] and (signs == -1).all()
    assert dog.leg_length == pytest.approx(0.32) and np.isinf(dog.torque_limits).all()


@pytest.mark.parametrize("physics", ["tree", "mujoco"])
def test_it_stands_in_the_tasks_on_legs(physics):
    """On legs whose motors come in another order than their joints, under a servo stiff enough for it."""
    control = {"name": "servo", "stiffness": 200.0, "damping": 4.0}
    task = make_task("walk", robot=Dog(), physics=physics, control=control, gait="clock", push={"impulse": 0.0})
    state, step = jax.jit(task.reset)(jax.random.key(0)), jax.jit(task.step_continuous)
    assert state.obs.shape == (task.observation_size,) == (4 + 4 + 9 + 4 + 4 + 5,)
    for k in range(50):
        state = step(state, jnp.zeros(4), jax.random.key(k))
    assert not state.terminated and np.isfinite(state.obs).all()
    data, weight = state.data, 12 * 9.81
    np.testing.assert_allclose(data.readings.encoders, data.world.qpos[jnp.array([10, 9, 8, 7])], atol=0.1)
    assert data.readings.foot_contact.sum() == pytest.approx(weight, rel=0.2)
    with pytest.raises(InputError, match="gait: table needs two legs of hip pitch"):
        make_task("walk", robot=Dog(), gait="table")


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"home": (1.0,)}, "home must hold 4 numbers, got 1"),
        ({"turns": (0.0, 0.5)}, "turns must hold 4 numbers, got 2"),
        ({"feet": ("fr", "rr", "fl", "rl"), "mirror": ()}, None),
        ({"mirror": (("fr", "rx"),)}, "mirror: fr has no image rx"),
        ({"axis": "skew"}, "mirror: the axis of"),
    ],
)
def test_what_does_not_fit_the_model_is_refused(values, words):
    if words is None:
        assert Dog(**values).feet == values["feet"]
        return
    with pytest.raises((InputError, ValueError), match=words):
        Dog(**values)


def test_an_unknown_robot_is_refused():
    with pytest.raises(InputError, match="unknown robot 'arm'; known are dog, humanoid, leg, legs, lower_body"):
        make_robot("arm")
