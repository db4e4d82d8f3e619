"""The leg's kinematics in single precision, what learning and simulation use; the size of the dynamics' program."""

import jax
import jax.numpy as jnp
import numpy as np
from leg_reference import numeric_jacobian, toe, turned, uniform

from humanoid_mjx import dynamics, kinematics
from humanoid_mjx.robot.leg import Leg
from humanoid_mjx.thesis import leg as thesis

LEG = Leg.physical()
LENGTHS = thesis.LINK_LENGTHS
RANGES = thesis.JOINT_RANGES["proposed"]

forward = jax.jit(jax.vmap(kinematics.forward, in_axes=(None, 0)))


def single(x):
    return jnp.asarray(x, jnp.float32)


def test_frames_are_the_joints_one_after_the_other():
    frames = np.array(kinematics.frames(LEG, jnp.zeros(5)))
    l1, l2, l3, l4, l5 = LENGTHS
    depth = np.cumsum([0, 0, l2, l3, l4, l5])
    np.testing.assert_allclose(frames[1:, :3, 3], np.stack([0 * depth, -depth, 0 * depth + l1], axis=1)[1:], atol=1e-7)
    assert (frames[0] == np.eye(4)).all()
    axes = [[0, 0, 1], [0, -1, 0], [-1, 0, 0], [0, 0, -1], [0, 0, -1]]
    np.testing.assert_array_equal(frames[:-1, :3, 2], axes)


def test_zeros_of_the_structure_stay_out_of_the_program():
    def operations(leg):
        return len(jax.make_jaxpr(lambda q: dynamics.mass_matrix(leg, q))(jnp.zeros(5)).eqns)

    assert operations(Leg.physical()) < operations(Leg.thesis())


def test_randomised_lengths_need_no_new_leg():
    scaled = jax.vmap(lambda s: kinematics.forward(jax.tree.map(lambda x: s * x, LEG), jnp.full(5, 0.3)))
    reached = scaled(jnp.array([1.0, 2.0]))[:, :3, 3]
    np.testing.assert_allclose(reached[1], 2 * reached[0], rtol=1e-6)


def test_static_torque_does_the_virtual_work():
    q, wrench = uniform(RANGES, 1, seed=2)[0], np.array([1.0, -2.0, 3.0, 0.1, 0.2, -0.3])
    torque = kinematics.static_torque(LEG, single(q), single(wrench))
    np.testing.assert_allclose(torque, wrench @ numeric_jacobian(LENGTHS, q), atol=1e-6)


def test_inverse_finds_the_joints():
    q = uniform(RANGES, 2000, seed=4)
    pose = forward(LEG, single(q))
    solutions, valid = map(np.array, jax.jit(jax.vmap(kinematics.inverse, in_axes=(None, 0)))(LEG, pose))
    away = np.where(valid, np.abs(turned(solutions, q[:, None])).max(axis=-1), np.inf).min(axis=1)
    assert away.max() < 1e-3
    assert np.median(away) < 2e-6
    assert solutions.dtype == np.float32


def test_workspace_holds_what_the_ranges_allow():
    ranges = np.radians(RANGES)
    points = np.array(kinematics.workspace(LEG, ranges, jax.random.key(0), 4000)).astype(float)
    hip = np.array([0, 0, LENGTHS[0]])
    distance = np.linalg.norm(points - hip, axis=1)
    assert points.shape == (4000, 3)
    assert distance.max() < sum(LENGTHS[1:]) + 1e-6
    grid = np.stack(np.meshgrid(*[np.linspace(low, high, 5) for low, high in np.radians(RANGES)]), -1).reshape(-1, 5)
    reached = np.array(forward(LEG, single(grid)))[:, :3, 3]
    assert (points.min(axis=0) > reached.min(axis=0) - 0.01).all() and (points.max(0) < reached.max(0) + 0.01).all()
    assert (np.ptp(points, axis=0) > 0.8 * np.ptp(reached, axis=0)).all(), "the sample fills the reach"
    still = jnp.tile(jnp.array([[0.3]]), (5, 2))
    expected = np.tile(toe(LENGTHS, np.full(5, 0.3))[:3, 3], (3, 1))
    np.testing.assert_allclose(kinematics.workspace(LEG, still, jax.random.key(1), 3), expected, atol=1e-6)
