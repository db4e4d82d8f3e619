"""The study `experiments/feasibility.py`, against simulation and closed forms, with fewer starts than it has."""

import math

import feasibility
import feasibility_figures
import feasible_postures
import feasible_ranges
import mujoco
import numpy as np
import pytest
from feasible_torques import carried
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from humanoid_mjx.mechanics import balance
from humanoid_mjx.physics import make_physics
from humanoid_mjx.physics.balance import foot_corners, link_motion
from humanoid_mjx.robot import lower_body as robot
from humanoid_mjx.thesis import leg as thesis


@pytest.fixture(scope="module")
def explored(tmp_path_factory):
    """Both columns, the record of the study, and the folder of its figures."""
    out = tmp_path_factory.mktemp("feasibility")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(feasible_postures, "STARTS", 20)
        for module in (feasible_ranges, feasibility, feasibility_figures):
            patch.setattr(module, "LEANS", (1.0, 45.0))
        return *feasibility.study(out), out


@pytest.mark.parametrize("name", ("proposed", "human"))
def test_a_balanced_body_stands_on_one_foot_in_mujoco_with_the_torques_that_are_told(explored, name):
    """On hard ground: on MuJoCo's own a sole gives way so far that a mass 6 mm beside its middle tips the body."""
    column = explored[0][name]
    stands, model = (
        feasible_postures.Body(name).standing(column.balanced),
        robot.lower_body_model(ranges=name, timestep=0.0002),
    )
    model.pair_solref[:, 0] = 0.002
    data = mujoco.MjData(model)
    data.qpos[:] = stands
    for _ in range(7500):
        data.ctrl[:] = column.torque + 20.0 * (stands[7:] - data.qpos[7:]) - 0.4 * data.qvel[6:]
        mujoco.mj_step(model, data)
    corners = foot_corners(make_physics("mujoco", robot={"ranges": name}), data.qpos[None])[0]
    assert (corners[:4, 2] < 1e-4).all() and corners[4:, 2].min() > 0.8 * feasible_ranges.CLEAR
    np.testing.assert_allclose(data.qpos[7:], stands[7:], atol=1e-3)
    np.testing.assert_allclose(data.actuator_force, column.torque, atol=0.02)


def test_the_ground_carries_what_moves_with_the_wrench_of_balance():
    random, body = np.random.default_rng(2), feasible_postures.Body("human")
    qpos, (qvel, qacc) = body.standing(random.uniform(-0.4, 0.4, 10)), random.normal(size=(2, 16))
    load, links = carried(body, qpos, qvel, qacc), link_motion(body.model, qpos[None], qvel[None], qacc[None])
    force, moment = (np.asarray(x, np.float64)[0] for x in balance.ground_wrench(links))
    np.testing.assert_allclose(load.force, force, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(load.point, balance.zero_moment_point(force, moment), atol=1e-5)


def test_headings_are_those_of_the_hips_three_angles(explored):
    """A thigh bent forward by 15 degrees below the foot's heading, as pitch, yaw and roll: Euler's angles."""

    def angles(heading):
        return -(Rotation.from_euler("z", heading) * Rotation.from_euler("y", -math.radians(15))).as_euler("YZX")

    for name, column in explored[0].items():
        low, high = np.radians(thesis.JOINT_RANGES[name][1])
        assert column.toes_out == pytest.approx(brentq(lambda x, high=high: angles(-x)[1] - high, 0.0, 1.2), abs=1e-5)
        inwards = brentq(lambda x, low=low: angles(x)[1] - low, 0.0, 1.2)
        assert column.toes_in == pytest.approx(inwards if name == "human" else 0.0, abs=1e-5)


def test_the_walking_default_is_the_column_that_serves(explored):
    columns, record, out = explored
    needs = feasibility.needed(feasible_postures.Body("human"), feasibility.WAY)
    lacks = feasibility.lacking(columns, needs)
    assert [name for name, words in lacks.items() if not words] == [feasibility.TASK.robot.ranges]
    assert "a hip that rolls inwards" in lacks["proposed"] and record["lacks"] == lacks
    assert "toes" in feasibility.lacking({"x": columns["human"]._replace(toes_in=0.1)}, needs)["x"]
    assert all((out / f"feasibility{which}.png").stat().st_size > 10_000 for which in ("", "-stances"))
