"""The leg's kinematics in double precision: a reference in NumPy, and every true solution found."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from leg_reference import numeric_jacobian, toe, turned, uniform

from humanoid_mjx import kinematics
from humanoid_mjx.robot.leg import Leg
from humanoid_mjx.thesis import leg as thesis

LEGS = {"recovered": Leg.physical(), "script": Leg.matlab_script()}
LENGTHS = {"recovered": thesis.LINK_LENGTHS, "script": thesis.SCRIPT_LENGTHS}
ORDERS = {"table 3.2": thesis.JOINT_RANGES["proposed"], "trajectories": thesis.QUINTIC_RANGES}
CIRCLE = ((-180, 180),) * 5
NEARLY_SINGULAR = ((-45, 45), (-1e-3, 1e-3), (0, 45), (1, 120), (-20, 40))

forward = jax.jit(jax.vmap(kinematics.forward, in_axes=(None, 0)))
jacobian = jax.jit(jax.vmap(kinematics.jacobian, in_axes=(None, 0)))
inverse_of_500 = jax.jit(jax.vmap(kinematics.inverse, in_axes=(None, 0)))


def inverse(leg, poses):
    """`kinematics.inverse` of any number of poses, compiled once."""
    padded = np.resize(np.asarray(poses), (-(-len(poses) // 500), 500, 4, 4))
    parts = [inverse_of_500(leg, jnp.array(part)) for part in padded]
    return (np.concatenate([np.array(part[i]) for part in parts])[: len(poses)] for i in (0, 1))


def joint_error(solutions, valid, q):
    """For each posture, how far the nearest of the solutions is from it; infinity without any."""
    away = np.abs(turned(solutions, q[:, None])).max(axis=-1)
    return np.where(valid, away, np.inf).min(axis=1)


def solve(leg, q):
    return inverse(leg, forward(leg, jnp.array(q)))


@pytest.mark.parametrize("name", LEGS)
def test_pose_and_jacobian_equal_the_product_and_its_differences(name):
    q = uniform(CIRCLE, 40, seed=1)
    np.testing.assert_allclose(forward(LEGS[name], q), [toe(LENGTHS[name], x) for x in q], rtol=0, atol=1e-14)
    expected = [numeric_jacobian(LENGTHS[name], x) for x in q]
    np.testing.assert_allclose(jacobian(LEGS[name], q), expected, rtol=0, atol=1e-8)


@pytest.mark.parametrize("order", ORDERS)
def test_inverse_finds_the_joints_of_10000_postures(order):
    q = uniform(ORDERS[order], 10_000, seed=2)
    solutions, valid = solve(LEGS["recovered"], q)
    assert joint_error(solutions, valid, q).max() < 1e-9
    assert (np.abs(solutions) <= np.pi).all()
    assert np.bincount(valid.sum(axis=1))[1] > 9990, "off the singular surface there is exactly one solution"


@pytest.mark.parametrize(
    ("name", "ranges"), [("recovered", CIRCLE), ("script", CIRCLE), ("recovered", NEARLY_SINGULAR)]
)
def test_inverse_on_the_full_circle_and_near_the_singular_surface(name, ranges):
    q = uniform(ranges, 10_000, seed=3)
    assert joint_error(*solve(LEGS[name], q), q).max() < 1e-9


def test_every_valid_solution_leads_back_and_none_repeats():
    planar = uniform(((-45, 45), (0, 0), (0, 0), (5, 120), (-20, 40)), 200, seed=4)
    for leg in LEGS.values():
        pose = forward(leg, jnp.array(planar))
        solutions, valid = inverse(leg, pose)
        back = forward(leg, jnp.array(solutions.reshape(-1, 5))).reshape(200, -1, 4, 4)
        assert np.abs(back - pose[:, None])[valid].max() < 1e-10
        rows, first, second = np.nonzero(valid[:, :, None] & valid[:, None, :])
        apart = np.abs(turned(solutions[rows, first], solutions[rows, second])).max(axis=-1)
        assert apart[first != second].min() > 1e-3
        assert (np.sort(~valid, axis=1) == ~valid).all(), "valid solutions come first"


def test_both_elbows_of_the_straight_walk():
    q = uniform(((-45, 45), (0, 0), (0, 0), (1, 120), (-20, 40)), 500, seed=5)
    solutions, valid = solve(LEGS["recovered"], q)
    assert joint_error(solutions, valid, q).max() < 1e-9
    l4 = LENGTHS["recovered"][3]
    hip = LENGTHS["recovered"][1] + LENGTHS["recovered"][2]
    other = np.zeros_like(q)
    bend = np.arctan2(l4 * np.sin(q[:, 3]), hip + l4 * np.cos(q[:, 3]))
    other[:, 0], other[:, 3] = q[:, 0] - 2 * bend, -q[:, 3]
    other[:, 4] = q[:, 4] + 2 * q[:, 3] - 2 * bend
    assert joint_error(solutions, valid, other).max() < 1e-9, "the elbow mirrored at the line from hip to ankle"
    low, high = 3.0 * np.radians(thesis.JOINT_RANGES["proposed"]).T
    inside = ((solutions >= low - 1e-6) & (solutions <= high + 1e-6)).all(axis=-1)
    assert ((valid & inside).sum(axis=1) == 1).all()


def test_double_root_at_the_straight_knee():
    q = uniform(((-45, 45), (0, 0), (0, 45), (0, 0), (-20, 40)), 500, seed=6)
    q[:50, 2] = 0.0
    q[0] = 0.0
    solutions, valid = solve(LEGS["recovered"], q)
    assert joint_error(solutions, valid, q).max() < 1e-7
    first = np.abs(forward(LEGS["recovered"], jnp.array(solutions[:, 0])) - forward(LEGS["recovered"], jnp.array(q)))
    assert first.max() < 1e-12


def test_impossible_poses_have_no_solution():
    leg, q = LEGS["recovered"], uniform(CIRCLE, 200, seed=8)
    pose = np.array(forward(leg, q))
    far, nan, mirrored = pose.copy(), pose.copy(), pose.copy()
    far[:, :3, 3] *= 10
    nan[:, 0, 3] = np.nan
    mirrored[:, :3, 2] *= -1
    shifted, turn = pose.copy(), np.array([toe(LENGTHS["recovered"], x) for x in uniform(CIRCLE, 200, seed=9)])
    shifted[:, :3, 3] += 0.01
    turn[:, :3, 3] = pose[:, :3, 3]
    zero = np.zeros_like(pose)
    kinds = {"far": far, "nan": nan, "mirrored": mirrored, "shifted": shifted, "turn": turn, "zero": zero}
    found = {kind: int(list(inverse(leg, bad))[1].sum()) for kind, bad in kinds.items()}
    assert not any(found.values()), found


def singular_postures(name, n, seed):
    """(4, n, 5) Postures on each of the four parts of the singular set."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-np.pi, np.pi, (4, n, 5))
    straight, square = np.pi * rng.integers(-1, 2, (4, n, 2)), np.pi / 2 * rng.choice([-1, 1], (4, n, 2))
    folded = np.arccos(-LENGTHS[name][2] / LENGTHS[name][1])
    q[0, :, 1], q[0, :, 3] = straight[0].T
    q[1, :, 1], q[1, :, 2] = straight[1, :, 0], folded
    q[2, :, 2], q[2, :, 3] = square[2, :, 0], straight[2, :, 0]
    q[3, :, 1], q[3, :, 2] = square[3].T
    return q


@pytest.mark.parametrize("name", LEGS)
def test_the_jacobian_loses_rank_on_the_singular_set(name):
    for part in singular_postures(name, 50, seed=10):
        matrices = jax.vmap(kinematics.jacobian, in_axes=(None, 0))(LEGS[name], jnp.array(part))
        assert np.linalg.svd(matrices, compute_uv=False)[:, -1].max() < 1e-8
