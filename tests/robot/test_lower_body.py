"""The lower body: its numbers, its mirror symmetry, what positive angles mean."""

import mujoco
import numpy as np
import pytest

from humanoid_mjx.robot import lower_body as body
from humanoid_mjx.robot import make_robot
from humanoid_mjx.robot.legs import TORQUE_LIMIT
from humanoid_mjx.robot.reaching import reach_of
from humanoid_mjx.spec import InputError
from humanoid_mjx.thesis import leg as thesis


@pytest.fixture(scope="module", params=["free", "fixed"])
def model(request):
    return body.LowerBody(torso=request.param, ranges="human").model


@pytest.fixture(scope="module")
def standing():
    model = body.LowerBody().model
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def test_joints_and_motors_come_in_one_order(model):
    names = [model.joint(joint).name for joint in range(model.njnt)][-10:]
    assert names[:5] == [f"right_{name}" for name in ("hip_pitch", "hip_yaw", "hip_roll", "knee_pitch", "ankle_pitch")]
    assert names[5:] == [name.replace("right", "left") for name in names[:5]] and tuple(names) == body.JOINTS
    assert [model.joint(motor.trnid[0]).name for motor in map(model.actuator, names)] == names
    np.testing.assert_array_equal(model.actuator_ctrlrange, np.tile([-TORQUE_LIMIT, TORQUE_LIMIT], (10, 1)))


def test_ranges_are_those_of_table_3_2():
    for name, degrees in thesis.JOINT_RANGES.items():
        model = body.LowerBody(ranges=name).model
        np.testing.assert_allclose(np.degrees(model.jnt_range[1:]), np.tile(degrees, (2, 1)), atol=1e-12)


def test_masses_and_heights(standing):
    model, data = standing
    assert model.body_mass.sum() == pytest.approx(1.02 + 2 * (0.142 + 0.04319 + 0.026 + 0.06733 + 0.066))
    assert model.geom("torso").size * 2 == pytest.approx([0.0375, 0.0825, 0.06])
    assert model.geom("left_foot").size * 2 == pytest.approx([0.06, 0.0225, 0.025])
    assert data.body("torso").xpos == pytest.approx([0, 0, 0.095 + 0.095 + 0.025])
    for side, y in (("right", -0.04125), ("left", 0.04125)):
        heights = {"pitch_link": 0.215, "yaw_link": 0.215, "thigh": 0.215, "shank": 0.120, "foot": 0.025}
        for link, z in heights.items():
            assert data.body(f"{side}_{link}").xpos == pytest.approx([0, y, z])
    assert model.geom("right_thigh").size[0] == pytest.approx(0.480 / 4 / np.pi / 2)


def test_feet_stand_flat_and_nothing_else_touches(standing):
    _, data = standing
    assert data.ncon == 8
    np.testing.assert_allclose(data.contact.dist, 0.0, atol=1e-12)
    np.testing.assert_allclose(data.contact.pos[:, 2], 0.0, atol=1e-12)
    below_the_mass = data.contact.pos[:, 0].min() < data.subtree_com[1][0] < data.contact.pos[:, 0].max()
    assert below_the_mass


@pytest.mark.parametrize(
    ("joint", "axis", "sign"),
    [("hip_pitch", 0, 1), ("hip_roll", 1, 0), ("knee_pitch", 0, -1), ("ankle_pitch", 2, -1), ("hip_yaw", 1, 0)],
)
@pytest.mark.parametrize("side", body.SIDES)
def test_positive_angles(side, joint, axis, sign):
    """Flexion forwards, shank back, toes down; to the side it is always outwards. Seen at the toe."""
    model = body.LowerBody(torso="fixed").model
    data = mujoco.MjData(model)
    toe = np.array([0.04, 0.0, -0.025])
    moves = []
    for angle in (0.0, 0.1):
        data.joint(f"{side}_{joint}").qpos = angle
        mujoco.mj_kinematics(model, data)
        moves.append(data.body(f"{side}_foot").xpos + data.body(f"{side}_foot").xmat.reshape(3, 3) @ toe)
    outwards = -1 if side == "right" else 1
    assert np.sign(moves[1] - moves[0])[axis] == (sign or outwards)


def mirrored(vector):
    """Swap the legs; of a free torso, mirror what comes before: velocities, or a position and a quaternion."""
    joints = np.concatenate([vector[-5:], vector[-10:-5]])
    signs = {0: [], 6: [1, -1, 1, -1, 1, -1], 7: [1, -1, 1, 1, -1, 1, -1]}[len(vector) - 10]
    return np.concatenate([vector[:-10] * signs, joints])


@pytest.mark.parametrize("seed", range(4))
def test_mirrored_states_and_torques_give_mirrored_accelerations(model, seed):
    rng = np.random.default_rng(seed)
    data = mujoco.MjData(model)
    qpos = model.qpos0.copy()
    qpos[-10:] = rng.uniform(*model.jnt_range[-10:].T)
    if model.nq > 10:
        qpos[:3] = rng.uniform([-0.05, -0.05, 0.07], [0.05, 0.05, 0.17])
        qpos[3:7] = np.array([1, 0, 0, 0]) + 0.2 * rng.normal(size=4)
        qpos[3:7] /= np.linalg.norm(qpos[3:7])
    qvel, torque = rng.normal(size=model.nv), rng.uniform(-1, 1, 10)
    accelerations = []
    for q, v, u in ((qpos, qvel, torque), (mirrored(qpos), mirrored(qvel), mirrored(torque))):
        data.qpos, data.qvel, data.ctrl, data.qacc_warmstart = q, v, u, 0.0
        mujoco.mj_forward(model, data)
        accelerations.append(data.qacc.copy())
    np.testing.assert_allclose(accelerations[1], mirrored(accelerations[0]), rtol=1e-6, atol=1e-6)


def test_it_is_a_robot_that_is_written_as_it_was_chosen():
    robot = body.LowerBody(ranges="human")
    assert robot.joints == body.JOINTS and robot.points == 4 and robot.foot_pairs.tolist() == [[0, 1]]
    assert robot.model is robot.model and make_robot("lower_body", ranges="human") == robot
    np.testing.assert_array_equal(robot.torque_limits, np.full(10, 2.0))
    np.testing.assert_array_equal(robot.phases, [0.0, 0.5])
    order, signs = robot.joint_images
    assert order.tolist() == [5, 6, 7, 8, 9, 0, 1, 2, 3, 4] and (signs == 1).all()
    assert robot.start_height == 0.21
    assert robot.leg_length == pytest.approx(0.19 * np.cos(np.radians(15)) + 0.025, abs=1e-9)
    assert robot.model_dump(mode="json") == {"name": "lower_body", "ranges": "human"}


@pytest.mark.parametrize("name", ["leg", "legs"])
def test_robots_that_hang_have_no_feet_on_the_ground(name):
    robot = make_robot(name)
    assert robot.foot_pairs.shape == (0, 2)
    with pytest.raises(InputError, match=f"robot: {name} hangs from its base; name one that stands"):
        reach_of(robot)
