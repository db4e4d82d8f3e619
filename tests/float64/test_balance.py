"""Zero-moment point and support polygon: against MuJoCo's contact forces, and against slow geometry."""

import mujoco
import numpy as np
import pytest
from scipy.spatial import ConvexHull

from humanoid_mjx.reproduction import balance
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
    force, moment = balance.ground_wrench(model, qpos, qvel, qacc)
    np.testing.assert_allclose(force[flat], forces[flat].sum(axis=1), rtol=1e-6, atol=1e-6)
    zmp = balance.zero_moment_point(force, moment)
    pressure = forces[..., 2:] * places[..., :2]
    pressure = pressure[flat].sum(axis=1) / forces[flat, :, 2:].sum(axis=1)
    np.testing.assert_allclose(zmp[flat], pressure, atol=1e-3)
    still = balance.zero_moment_point(*balance.ground_wrench(model, qpos, qvel, 0 * qacc))
    # The accelerations are real: without them, the point would be elsewhere.
    assert np.abs(still - zmp)[flat].max() > 5e-3
    assert np.ptp(force[flat, 2]) > 3.0


def test_there_is_no_point_in_flight():
    assert np.isnan(balance.zero_moment_point(np.array([[1.0, 0.0, 0.0]]), np.ones((1, 3)))).all()


def slow_margin(point, corners):
    """By every edge of scipy's hull."""
    hull = ConvexHull(corners)
    inside = -(hull.equations[:, :2] @ point + hull.equations[:, 2]).max()
    if inside >= 0:
        return inside
    ends = corners[hull.simplices]
    along = ends[:, 1] - ends[:, 0]
    place = np.clip(((point - ends[:, 0]) * along).sum(axis=1) / (along**2).sum(axis=1), 0, 1)
    return -np.linalg.norm(point - ends[:, 0] - place[:, None] * along, axis=1).min()


def test_the_margin_is_that_of_the_convex_hull():
    rng = np.random.default_rng(0)
    signs = []
    for _ in range(200):
        corners, touching = rng.uniform(-1, 1, (8, 2)), rng.random(8) < 0.7
        touching[:3] = True
        point = rng.uniform(-1.2, 1.2, 2)
        expected = slow_margin(point, corners[touching])
        assert float(balance.support_margin(point, corners, touching)) == pytest.approx(expected, abs=1e-9)
        signs.append(expected > 0)
    assert 0.2 < np.mean(signs) < 0.8


@pytest.mark.parametrize(
    ("touching", "margin"),
    [("0000", -np.inf), ("1000", -np.sqrt(0.5)), ("1100", -0.5), ("1001", 0.0), ("1110", 0.0), ("1111", 0.5)],
)
def test_margins_of_a_square(touching, margin):
    """Its middle: no corner, one, an edge, a diagonal (which has no inside), half of it, all."""
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    found = balance.support_margin(np.array([0.5, 0.5]), corners, np.array([c == "1" for c in touching]))
    assert float(found) == pytest.approx(margin, abs=1e-12)
