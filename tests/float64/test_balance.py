"""Zero-moment point and support polygon: against MuJoCo's contact forces, and against slow geometry."""

import mujoco
import numpy as np
import pytest
from scipy.spatial import ConvexHull

from humanoid_mjx.reproduction import ground
from humanoid_mjx.robot.lower_body import LowerBody


def swaying(seconds=2.0):
    """A body that squats and sways on its feet, by MuJoCo: states, accelerations, contact forces (8, 3), places."""
    model = LowerBody(ranges="human").spec().compile()
    data = mujoco.MjData(model)
    rows = []
    for step in range(round(seconds / model.opt.timestep)):
        phase = 2 * np.pi * step * model.opt.timestep
        squat, sway = 0.25 * (1 - np.cos(phase)) / 2, 0.02 * np.sin(2 * phase)
        target = np.tile([squat, 0.0, 0.0, 2 * squat, -squat + sway], 2)
        data.ctrl = 6.0 * (target - data.qpos[7:]) - 0.2 * data.qvel[6:]
        before = data.qpos.copy(), data.qvel.copy()
        mujoco.mj_step(model, data)
        forces, places = np.zeros((8, 3)), np.zeros((8, 3))
        for i in range(data.ncon):
            wrench, frame = np.zeros(6), data.contact.frame[i].reshape(3, 3)
            mujoco.mj_contactForce(model, data, i, wrench)
            forces[i], places[i] = frame.T @ wrench[:3], data.contact.pos[i]
        rows.append((*before, data.qacc.copy(), forces, places, data.ncon))
    return model, [np.array(x) for x in zip(*rows, strict=True)]


@pytest.fixture(scope="module")
def motion():
    return swaying()


def test_the_zero_moment_point_is_the_center_of_pressure(motion):
    """Within 1 mm while the feet are flat: the balls touch a half of their depth below z = 0, 0.1 mm, with friction."""
    model, (qpos, qvel, qacc, forces, places, touching) = motion
    flat = touching == 8
    assert flat.sum() > 400
    force, moment = ground.ground_wrench(model, qpos, qvel, qacc)
    np.testing.assert_allclose(force[flat], forces[flat].sum(axis=1), rtol=1e-6, atol=1e-6)
    zmp = ground.zero_moment_point(force, moment)
    pressure = forces[..., 2:] * places[..., :2]
    pressure = pressure[flat].sum(axis=1) / forces[flat, :, 2:].sum(axis=1)
    np.testing.assert_allclose(zmp[flat], pressure, atol=1e-3)
    still = ground.zero_moment_point(*ground.ground_wrench(model, qpos, qvel, 0 * qacc))
    # The accelerations are real: without them, the point would be elsewhere.
    assert np.abs(still - zmp)[flat].max() > 5e-3
    assert np.ptp(force[flat, 2]) > 3.0


def test_there_is_no_point_in_flight():
    assert np.isnan(ground.zero_moment_point(np.array([[1.0, 0.0, 0.0]]), np.ones((1, 3)))).all()


def test_inside_the_support_is_inside_the_convex_hull():
    rng = np.random.default_rng(0)
    corners, touching = rng.uniform(-1, 1, (200, 8, 2)), rng.random((200, 8)) < 0.7
    touching[:, :3] = True
    points = rng.uniform(-1.2, 1.2, (200, 2))
    hulls = [ConvexHull(some[there]).equations for some, there in zip(corners, touching, strict=True)]
    expected = [(hull[:, :2] @ point + hull[:, 2] < 0).all() for hull, point in zip(hulls, points, strict=True)]
    assert ground.inside_support(points, corners, touching).tolist() == expected
    assert 0.2 < np.mean(expected) < 0.8


@pytest.mark.parametrize(
    ("touching", "inside"),
    [("0000", False), ("1000", False), ("1100", False), ("1001", False), ("1110", False), ("1111", True)],
)
def test_the_middle_of_a_square(touching, inside):
    """No corner, one, an edge, a diagonal (which has no inside), half of it (whose edge is no inside), all."""
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    touches = np.array([[c == "1" for c in touching]])
    assert ground.inside_support(np.array([[0.5, 0.5]]), corners[None], touches).tolist() == [inside]


def test_a_flight_has_no_inside():
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    assert not ground.inside_support(np.array([[np.nan, np.nan]]), corners[None], np.ones((1, 4), bool)).any()
