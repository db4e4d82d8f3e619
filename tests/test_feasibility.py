"""What the lower body can do with each column of Table 3.2, against simulation, closed forms and other code."""

import math

import mujoco
import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from humanoid_mjx.mechanics import balance
from humanoid_mjx.physics import make_physics
from humanoid_mjx.physics.balance import foot_corners, link_motion
from humanoid_mjx.reproduction import feasibility, feasibility_figures, feasible_postures, feasible_ranges, reproduce
from humanoid_mjx.reproduction import feasible_torques as torques
from humanoid_mjx.reproduction.feasible_postures import Body, level_travel
from humanoid_mjx.robot import lower_body as robot
from humanoid_mjx.tasks.legged.body import POSTURE
from humanoid_mjx.tasks.legged.walk import Walk
from humanoid_mjx.thesis import leg as thesis

BENT = math.radians(15.0)
HEIGHT = 0.19 * math.cos(BENT)
RIGHT = slice(0, 4)


@pytest.fixture(scope="module")
def explored(tmp_path_factory):
    """The experiment with fewer starts and leans: the columns, what it found and where its figures are."""
    out, columns, explore = tmp_path_factory.mktemp("feasibility"), {}, feasible_ranges.explore

    def kept(name, *rest):
        columns[name] = explore(name, *rest)
        return columns[name]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(feasible_postures, "STARTS", 20)
        for module in (feasible_ranges, feasibility, feasibility_figures):
            patch.setattr(module, "LEANS", (1.0, 45.0))
        patch.setattr(feasibility, "explore", kept)
        findings = reproduce([feasibility.NAME], out)
    return columns, findings, out


@pytest.fixture(scope="module")
def body():
    return Body("human")


def settled(ranges, qpos, torque, seconds):
    """The body in MuJoCo, on hard ground, under these torques and a servo that holds the joints of `qpos`.

    On ground as soft as MuJoCo's own a sole gives way so far that a mass 6 mm beside its middle tips the body.
    """
    model = robot.lower_body_model(ranges=ranges, timestep=0.0002)
    model.pair_solref[:, 0] = 0.002
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    for _ in range(round(seconds / model.opt.timestep)):
        data.ctrl[:] = torque + 20.0 * (qpos[7:] - data.qpos[7:]) - 0.4 * data.qvel[6:]
        mujoco.mj_step(model, data)
    return data


@pytest.mark.parametrize("name", feasibility.COLUMNS)
def test_a_balanced_body_stands_on_one_foot_in_mujoco_with_the_torques_that_are_told(explored, name):
    column = explored[0][name]
    stands = Body(name).standing(column.balanced)
    data = settled(name, stands, column.torque, 1.5)
    corners = foot_corners(make_physics("mujoco", ranges=name), data.qpos[None])[0]
    assert (corners[RIGHT, 2] < 1e-4).all(), "flat"
    assert corners[4:, 2].min() > 0.8 * feasible_ranges.CLEAR
    # Wrong torques of 0.02 N m would turn a joint by 0.001 rad.
    np.testing.assert_allclose(data.qpos[7:], stands[7:], atol=1e-3)
    np.testing.assert_allclose(data.actuator_force, column.torque, atol=0.02)


def test_the_best_upright_posture_of_the_proposed_ranges_falls(explored):
    (upright,) = feasible_ranges.furthest_inside(Body("proposed"), feasible_ranges._lifted, leans=(1.0,))
    body = Body("proposed")
    assert feasible_ranges.margin(body, upright) < -0.004
    stands = body.standing(upright)
    data = settled("proposed", stands, torques.carried(body, stands).torque, 1.5)
    assert foot_corners(make_physics("mujoco"), data.qpos[None])[0, 4:, 2].min() < 1e-4, "on the other foot, or lower"


def test_the_margin_is_that_of_the_support_polygon(body):
    random, physics = np.random.default_rng(1), make_physics("mujoco", ranges="human")
    right = np.arange(8) < 4
    for _ in range(5):
        joints = random.uniform(*(0.5 * body.limits).T)
        qpos = body.standing(joints)
        links = link_motion(physics.model, qpos[None], np.zeros((1, 16)), np.zeros((1, 16)))
        center = np.asarray(balance.center_of_mass(links.mass, links.position))[0]
        corners = foot_corners(physics, qpos[None])[0]
        np.testing.assert_allclose(corners[RIGHT, 2], 0.0, atol=1e-9)
        np.testing.assert_allclose(body.see(joints).center, center, atol=1e-6)
        np.testing.assert_allclose(body.see(joints).corners, corners[4:], atol=1e-9)
        margin = float(balance.support_margin(center[:2].astype(np.float32), corners[:, :2].astype(np.float32), right))
        # The balls in the corners are half a millimetre inside the box's edges; outside at a corner it is further.
        if margin > 0:
            assert margin == pytest.approx(body.see(joints).margin.min() - robot.CORNER_RADIUS, abs=1e-6)
        else:
            assert body.see(joints).margin.min() < robot.CORNER_RADIUS + 1e-6


def test_torques_and_the_ground_bring_about_the_motion(body):
    """In MuJoCo's forward dynamics; the ground's wrench is that of `mechanics.balance`."""
    random, model = np.random.default_rng(2), body.model
    qpos = body.standing(random.uniform(-0.4, 0.4, 10))
    qvel, qacc = random.normal(size=(2, 16)) * np.where(np.arange(16) < 6, 0.3, 2.0)
    load = torques.carried(body, qpos, qvel, qacc)
    links = link_motion(model, qpos[None], qvel[None], qacc[None])
    force, moment = (np.asarray(x, np.float64)[0] for x in balance.ground_wrench(links))
    np.testing.assert_allclose(load.force, force, rtol=1e-5, atol=1e-5)
    point = balance.zero_moment_point(force, moment)
    np.testing.assert_allclose(load.point, point, atol=1e-6)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    model = robot.lower_body_model()
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    mujoco.mj_kinematics(model, data)
    data.qfrc_applied[6:] = load.torque
    data.xfrc_applied[body.right] = [*force, *(moment - np.cross(data.xipos[body.right], force))]
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.qacc, qacc, rtol=1e-3, atol=1e-2)


def test_holding_level_hips_on_one_leg_takes_the_weight_of_all_else_at_its_arm(body):
    load = torques.carried(body, body.standing(np.zeros(10)))
    leg = sum(thesis.LINK_MASSES)
    arm = robot.TORSO_MASS * robot.HIP_OFFSET + leg * 2 * robot.HIP_OFFSET
    assert load.torque[2] == pytest.approx(thesis.GRAVITY * arm, rel=1e-6)
    assert load.point[1] == pytest.approx(robot.HIP_OFFSET)


def test_a_stiff_body_rocks_in_mujoco_as_long_as_is_told(body):
    model = robot.lower_body_model(ranges="human", timestep=0.0002)
    model.pair_solref[:, 0] = 0.002
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.jnt_stiffness[1:], model.dof_damping[6:], model.qpos_spring[7:] = 2e3, 20.0, POSTURE
    data, stance, period = mujoco.MjData(model), 0.6, 0.8
    way = torques.rocking(body, POSTURE, period, stance)
    qpos = body.standing(POSTURE)
    turn = Rotation.from_euler("x", way.tilt)
    edge = np.array([0.0, -robot.FOOT_WIDTH / 2, 0.0])
    data.qpos[:] = qpos
    data.qpos[:3] = edge + turn.apply(qpos[:3] - edge)
    data.qpos[3:7] = np.roll(turn.as_quat(), 1)
    mujoco.mj_kinematics(model, data)
    corners, seconds = [model.geom(f"left_corner{i}").id for i in range(4)], 0.0
    while data.geom_xpos[corners, 2].min() > robot.CORNER_RADIUS and seconds < 1.0:
        mujoco.mj_step(model, data)
        seconds += model.opt.timestep
    # Half the time in the air is the way down. On ground as hard as this a tilt of 5 degrees leaves 1 %.
    assert seconds == pytest.approx((1 - stance) * period / 2, rel=0.02)


def test_headings_are_those_of_the_hips_three_angles(explored):
    """A thigh bent forward by 15 degrees below the foot's heading, as pitch, yaw and roll: Euler's angles."""

    def angles(heading):
        thigh = Rotation.from_euler("z", heading) * Rotation.from_euler("y", -BENT)
        return -thigh.as_euler("YZX")

    for name, column in explored[0].items():
        low, high = np.radians(thesis.JOINT_RANGES[name][1])
        outwards = brentq(lambda x, high=high: angles(-x)[1] - high, 0.0, 1.2)
        assert column.toes_out == pytest.approx(outwards, abs=1e-5) and angles(-outwards)[2] > 0
        inwards = brentq(lambda x, low=low: angles(x)[1] - low, 0.0, 1.2)
        assert angles(inwards)[2] < 0, "the hip rolls inwards"
        assert column.toes_in == pytest.approx(inwards if name == "human" else 0.0, abs=1e-5)


def test_ankles_end_what_flat_feet_do(explored):
    for name, column in explored[0].items():
        assert column.level == pytest.approx(0.19 * (math.cos(BENT) - math.cos(math.radians(20.0))), abs=1e-6)
        limits = np.radians(thesis.JOINT_RANGES[name])
        ahead, behind = level_travel(limits, HEIGHT)
        assert ahead == pytest.approx(0.19 * math.sin(BENT), abs=1e-4), "a straight leg"
        shank = math.atan2(behind, HEIGHT) + math.acos(math.hypot(behind, HEIGHT) / 0.19)
        assert math.degrees(shank) == pytest.approx(20.0, abs=0.05)
        assert column.longest[0] > column.travel == pytest.approx(ahead + behind)


def test_wider_ranges_allow_as_much_and_further_leans_too(explored):
    proposed, human = (explored[0][name] for name in feasibility.COLUMNS)
    slack = 1e-5
    for column in (proposed, human):
        assert column.lifted[0] <= column.lifted[1] + slack and column.planted[0] <= column.planted[1] + slack
        assert column.beside == pytest.approx(-torques.INNER, abs=1e-5), "no sway at all"
    assert human.lifted[0] > 0 > proposed.lifted[0] and human.lifted[1] >= proposed.lifted[1] - slack
    assert human.lean < proposed.lean and human.rolling >= proposed.rolling - slack
    assert human.toes_in > proposed.toes_in and human.toes_out > proposed.toes_out
    assert max(np.abs(c.torque).max() for c in (proposed, human)) < 0.5 * 2.0


def test_the_gait_keeps_to_the_ground_and_to_the_ranges(body):
    height, stance = 0.1843, 0.6
    qpos, qvel, qacc = torques.gait(0.25, height, 0.5, stance, 0.015)
    corners = foot_corners(make_physics("mujoco", ranges="human"), qpos)
    stands = np.arange(len(qpos)) < stance * len(qpos)
    np.testing.assert_allclose(corners[stands][:, RIGHT, 2], 0.0, atol=1e-5)
    assert np.ptp(corners[stands][:, RIGHT, 0], axis=0).max() < 1e-5
    # The toes skim: the body's rocking, of which this gait has nothing, lifts them by more.
    assert corners[..., 2].min() > -0.002 and corners[:, RIGHT, 2].max() > 0.01
    low, high = body.limits.T
    assert (qpos[:, 7:] > low - math.radians(0.5)).all() and (qpos[:, 7:] < high).all()
    times = 0.5 / len(qpos)
    # Accelerations are linear in between, so that these sums are exact.
    np.testing.assert_allclose(np.diff(qvel, axis=0), times * (qacc[1:] + qacc[:-1]) / 2, atol=1e-9)
    moved = times * (qvel[1:] + qvel[:-1]) / 2 - times**2 / 12 * np.diff(qacc, axis=0)
    np.testing.assert_allclose(np.diff(qpos[:, 7:], axis=0), moved[:, 6:], atol=1e-12)


def test_the_walking_default_is_the_column_that_serves(explored):
    _, findings, out = explored
    assert {finding.verdict for finding in findings} == {"finding"}
    assert findings[-1].reproduced == [Walk.model_fields["ranges"].default] == ["human"]
    assert "proposed lacks a hip that rolls inwards" in findings[-1].why
    for file in (".png", "-stances.png"):
        assert (out / f"{feasibility.NAME}{file}").stat().st_size > 10_000
    assert (out / f"{feasibility.NAME}.md").read_text().count("\n") > 20


def test_the_experiment_is_of_the_walking_task():
    gait, posture = Walk().gait, feasibility.posture(feasibility.CONFIG)[0]
    assert {"period": gait.period, "stance": gait.stance} == feasibility.CONFIG["gait"]
    np.testing.assert_allclose(posture, Walk.posture)
    command = Walk().command
    walk = feasibility.CONFIG["walk"]
    assert command.turn == (-walk["turn"], walk["turn"]) and command.sideways == (-walk["sideways"], walk["sideways"])


def test_the_conclusion_turns_with_the_ranges(explored, body, monkeypatch):
    columns, needs = explored[0], feasibility.needed(body, feasibility.CONFIG)
    human = columns["human"]
    assert feasibility.conclude(columns | {"proposed": human}, needs).reproduced == ["proposed", "human"]
    stiff = human._replace(roll=(0.0, human.roll[1]))
    assert feasibility.conclude(columns | {"human": stiff}, needs).reproduced == []
    assert "toes" in feasibility.conclude({"x": human._replace(toes_in=0.1)}, needs).why
    rolls = (*thesis.JOINT_RANGES["proposed"][:2], (-30.0, 45.0), *thesis.JOINT_RANGES["proposed"][3:])
    monkeypatch.setitem(thesis.JOINT_RANGES, "proposed", rolls)
    monkeypatch.setattr(feasible_postures, "STARTS", 20)
    inwards = feasible_ranges._leg(
        Body("proposed"), lambda r: r.heading, lambda r: [*feasible_ranges._below(r), 100 * (r.ankle[2] + HEIGHT)]
    )
    assert inwards.heading == pytest.approx(human.toes_in, abs=1e-5), "both yaws end at 45 degrees"
