"""MJX against native MuJoCo in double precision: what is left is the solver's and rounding's."""

import jax
import numpy as np
import pytest

from humanoid_mjx.physics import make_physics


def pair(torso):
    """Two physics, each with a step of many worlds."""
    both = [make_physics(name, robot={"torso": torso, "ranges": "human"}) for name in ("mjx-jax", "mujoco")]
    steps = [jax.jit(jax.vmap(lambda world, target, p=p: p.step(world, servo(target)))) for p in both]
    return both[0], *steps


def start(mjx, qpos, qvel):
    return jax.vmap(lambda q, v: mjx.start(q, v))(qpos, qvel)


def servo(target):
    return lambda stages: 6.0 * (target - stages.qpos) - 0.2 * stages.qvel


@pytest.fixture(scope="module")
def fixed():
    return pair("fixed")


@pytest.fixture(scope="module")
def free():
    return pair("free")


def test_accelerations_of_the_fixed_body_agree(fixed):
    """Random states: fast, at their joint limits, legs touching."""
    mjx, step, native_step = fixed
    rng = np.random.default_rng(0)
    qpos, qvel = rng.uniform(*mjx.joint_ranges.T, (32, 10)), 3.0 * rng.normal(size=(32, 10))
    target = qpos + rng.uniform(-0.3, 0.3, (32, 10))
    world = start(mjx, qpos, qvel)
    (moved, torque), (expected, expected_torque) = step(world, target), native_step(world, target)
    acceleration, native_acceleration = ((new.qvel - qvel) / mjx.step_s for new in (moved, expected))
    np.testing.assert_allclose(torque, expected_torque, atol=1e-12)
    assert np.abs(native_acceleration).max() > 100.0
    np.testing.assert_allclose(acceleration, native_acceleration, rtol=1e-8, atol=1e-8)


def test_trajectories_of_the_fixed_body_agree(fixed):
    """Half a second: rounding of 1e-16 that grows as errors of the state do."""
    mjx, step, native_step = fixed
    target = np.random.default_rng(1).uniform(0.0, 0.5, (32, 10))
    world = other = start(mjx, np.zeros((32, 10)), np.zeros((32, 10)))
    for _ in range(250):
        world, _ = step(world, target)
        other, _ = native_step(other, target)
    assert np.abs(other.qpos).max() > 0.3
    np.testing.assert_allclose(world.qpos, other.qpos, atol=1e-10)


def test_a_squat_on_the_ground_agrees(free):
    """Half a second: the few iterations of the solver here converge, too."""
    mjx, step, native_step = free
    target = np.tile([0.25, 0.0, 0.0, 0.5, -0.25], (4, 2)) * np.array([[0.25], [0.5], [0.75], [1.0]])
    qpos = np.tile(mjx.qpos0, (4, 1))
    world = other = start(mjx, qpos, np.zeros((4, 16)))
    for _ in range(125):
        world, _ = step(world, target)
        other, _ = native_step(other, target)
    assert other.qpos[3, 2] < 0.214
    np.testing.assert_allclose(world.qpos, other.qpos, atol=1e-9)
