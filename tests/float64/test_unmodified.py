"""`physics: unmodified` moves a robot as a plain loop over MuJoCo does on the unchanged file."""

import jax
import mujoco
import numpy as np
import pytest
from tree_robots import FOUR_LEGS

from humanoid_mjx import InputError, make_task
from humanoid_mjx.control import at_rest
from humanoid_mjx.control.laws import RobotServoLaw
from humanoid_mjx.physics import make_physics
from humanoid_mjx.robot import make_robot

FILE = FOUR_LEGS.replace(
    '<geom name="foot" type="sphere" size=".02" pos="0 0 -.2"',
    '<geom name="foot" type="box" size=".03 .02 .01" pos="0 0 -.2" euler="0 35 0"',
).replace("</worldbody>", "</worldbody>ACTUATORS")
YAML = """
model: file.xml
home: {"hip.*": 35, "knee.*": -70}
feet: [foot_0_0, foot_1_0, foot_0_1, foot_1_1]
servo: {stiffness: 80, damping: 2}
torque: 20
"""
JOINTS = [f"{kind}_{i}_{j}" for kind in ("hip", "knee") for i in "01" for j in "01"]
POSITION = '<position J kp="80" kv="2" forcerange="-20 20"/>'


def torque(aim, q, v):
    return np.clip(80 * (aim - q) - 2 * v, -20, 20)


def motors(*elements):
    return "<actuator>" + "".join(e.replace("J", f"joint={j!r}") for j in JOINTS for e in elements) + "</actuator>"


def aimed(aim, q, v):
    return [aim]


# The actuators of a joint, and the control of each from the set-point, the angle and the velocity of the joint.
DRIVES = {
    "position": ((POSITION,), aimed),
    "gear": (('<position J kp="20" kv=".5" gear="2" ctrlrange="-9 9"/>',), lambda aim, q, v: [2 * aim]),
    "affine": (
        ('<general J gainprm="40" biastype="affine" biasprm="3 -80 -2"/>',),
        lambda aim, q, v: [(80 * aim - 3) / 40],
    ),
    "filter": (('<position J kp="80" kv="2" timeconst=".02"/>',), aimed),
    "delay": (('<position J kp="80" kv="2" delay=".006" nsample="4"/>',), aimed),
    "position and velocity": (('<position J kp="80"/>', '<velocity J kv="2"/>'), lambda aim, q, v: [aim, 0]),
    "position and damper": (
        ('<position J kp="80"/>', '<damper J kv="1" ctrlrange="0 2"/>', '<motor J gear="3"/>'),
        lambda aim, q, v: [aim, 2, 0],
    ),
    "motor": (('<motor J gear="10" ctrlrange="-1.5 1.5"/>',), lambda aim, q, v: [torque(aim, q, v) / 10]),
    "two motors": (
        (
            '<motor J gear="-4" ctrlrange="-1 1"/>',
            '<motor J ctrlrange="-12 12"/>',
            '<damper J kv="1" ctrlrange="0 2"/>',
        ),
        lambda aim, q, v: [torque(aim, q, v) / 4 / -4, torque(aim, q, v) * 3 / 4, 0],
    ),
    "motor and velocity": (
        ("<motor J/>", '<velocity J kv="5"/>'),
        lambda aim, q, v: [torque(aim, q, v), v],
    ),
    "velocity": (('<velocity J kv="5" gear="2"/>',), lambda aim, q, v: [torque(aim, q, v) / 2 / 5 + 2 * v]),
    "none": ((), None),
    "disabled": (
        ('<position J kp="80" group="3"/>', "<motor J/>"),
        lambda aim, q, v: [0, torque(aim, q, v)],
    ),
    "all disabled": ((POSITION.replace("J", 'J group="3"'),), None),
}
OPTIONS = {
    "elliptic": '<option cone="elliptic" impratio="100"/>',
    "RK4": '<option integrator="RK4"/>',
    "implicitfast": '<option integrator="implicitfast" solver="CG"/>',
    "one iteration": '<option iterations="1" ls_iterations="3" integrator="implicitfast"/>',
    "3 ms": '<option timestep="0.003"/>',
    "sensors off": '<option><flag sensor="disable"/></option>',
}


def made(folder, drive, *pairs, yaml=YAML):
    text = FILE.replace("ACTUATORS", motors(*DRIVES[drive][0]) if DRIVES[drive][0] else "")
    text = text.replace("<option ", '<option actuatorgroupdisable="3" ', "disabled" in drive)
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new, 1)
    (folder / "file.xml").write_text(text)
    (folder / "robot.yaml").write_text(yaml)
    return make_robot(str(folder / "robot.yaml"))


def compare(robot, folder, drive, turn=(1.0, 0.0, 0.0, 0.0), others=()):
    """Play random set-points both ways: the trunk slides, its feet touch down."""
    physics, rng = make_physics("unmodified", robot=robot), np.random.default_rng(0)
    steps, law = physics.substeps(0.02), RobotServoLaw().of(robot)
    start = np.array([0, 0, robot.start_height, 1, 0, 0, 0, *robot.posture])
    speed = np.array([0.5, 0.2, 0, 0.1, 0, 0.8, *np.zeros(8)])
    decide = jax.jit(
        lambda world, aim: physics.replace(setpoint=aim).run_sensed(world, law.follow(at_rest(aim)), steps)
    )
    world = physics.start(physics.qpos0.copy(), speed)
    world = world._replace(qpos=world.qpos.at[:7].set(start[:7]).at[physics.joint_qpos].set(robot.posture))

    model = mujoco.MjModel.from_xml_path(str(folder / "file.xml"))
    data, inverse = mujoco.MjData(model), np.array(turn) * [1, -1, -1, -1]
    joints = [model.joint(name).id for name in robot.joints]
    places, dofs = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    data.qpos[:7], data.qpos[places] = [0, 0, robot.start_height, *turn], robot.posture
    data.qvel[:] = speed
    mujoco.mju_rotVecQuat(data.qvel[3:6], speed[3:6], inverse)
    if model.na:
        data.act[:] = robot.posture
    touched, before = 0, mujoco.MjData(model)
    for _ in range(12):
        aim = robot.posture + 0.1 * rng.normal(size=len(joints))
        world, seen = decide(world, aim)
        for _ in range(steps):
            q, v = data.qpos[places], data.qvel[dofs]
            if DRIVES[drive][1] is None:
                data.qfrc_applied[dofs] = torque(aim, q, v)
            else:
                each = zip(aim, q, v, strict=True)
                data.ctrl[:] = [*others, *(control for row in each for control in DRIVES[drive][1](*row))]
            mujoco.mj_copyData(before, model, data)
            mujoco.mj_step(model, data)
        mujoco.mj_forward(model, before)
        touched = max(touched, data.ncon)
        qpos, qvel = np.array(world.qpos), np.array(world.qvel)
        mujoco.mju_mulQuat(qpos[3:7], qpos[3:7].copy(), np.array(turn))
        mujoco.mju_rotVecQuat(qvel[3:6], qvel[3:6].copy(), inverse)
        np.testing.assert_allclose(qpos, data.qpos, atol=1e-9)
        np.testing.assert_allclose(qvel, data.qvel, atol=1e-7)
        acting = before.qfrc_actuator[dofs] + before.qfrc_applied[dofs]
        np.testing.assert_allclose(seen.torque, acting, atol=1e-7)
        np.testing.assert_allclose(seen.readings.encoders, before.qpos[places], atol=1e-9)
        pressing = np.zeros(4)
        for number, contact in enumerate(before.contact):
            force, foot = np.zeros(6), model.body(model.geom_bodyid[contact.geom[1]]).name
            mujoco.mj_contactForce(model, before, number, force)
            pressing[robot.feet.index(foot)] += force[0]
        np.testing.assert_allclose(seen.readings.foot_contact, pressing, atol=1e-5)
    assert touched > 1
    return seen


@pytest.mark.parametrize("drive", DRIVES)
def test_actuators_move_as_in_a_plain_loop(drive, tmp_path):
    compare(made(tmp_path, drive), tmp_path, drive)


@pytest.mark.parametrize("option", OPTIONS)
def test_options_of_the_file_stay(option, tmp_path):
    robot = made(tmp_path, "position", ('<option timestep="0.002"/>', OPTIONS[option]))
    compare(robot, tmp_path, "position")


def test_a_turned_trunk_moves_in_its_own_frame(tmp_path):
    turn = np.array([np.cos(0.4), 0.0, np.sin(0.4), 0.0])
    back = "".join(f" {part}" for part in turn * [1, -1, -1, -1])
    pairs = (
        ("<freejoint/>", f"<freejoint/><frame quat='{back}'>"),
        ("</body>\n  </worldbody>", "</frame></body></worldbody>"),
    )
    quat = " ".join(map(str, turn))
    robot = made(tmp_path, "motor", ('pos="0 0 .4"', f'pos="0 0 .4" quat="{quat}"'), *pairs)
    compare(robot, tmp_path, "motor", turn)


def test_actuators_of_other_parts_keep_the_controls_of_the_keyframe(tmp_path):
    others = '<tendon><fixed name="t"><joint joint="hip_0_0" coef="1"/></fixed></tendon>'
    others += '<sensor><framepos name="gyroscope" objtype="body" objname="trunk"/></sensor>'
    others += '<keyframe><key name="home" qpos="0 0 .4 1 0 0 0'
    others += f'{" 0.6 -1.2" * 4}" ctrl="4{" 0" * 8}"/></keyframe>'
    tendon = ("<actuator>", f'{others}<actuator><motor tendon="t"/>')
    robot = made(tmp_path, "position", tendon, yaml=YAML.replace('{"hip.*": 35, "knee.*": -70}', "home"))
    compare(robot, tmp_path, "position", others=[4.0])


@pytest.mark.parametrize("condim", [1, 6])
def test_the_ground_of_a_file_without_one_leaves_all_but_that_they_rub_to_the_feet(condim, tmp_path):
    seen = '<geom type="plane" size="5 5 .1" contype="0" conaffinity="0"/>'
    bare = (
        ('<geom name="floor" type="plane" size="5 5 .1"/>', seen),
        ('name="foot"', f'name="foot" friction=".3" condim="{condim}"'),
    )
    robot = made(tmp_path, "position", *bare)
    assert make_physics("unmodified", robot=robot).words(0.02).endswith("a plane z = 0 in place of a ground")
    text = (tmp_path / "file.xml").read_text()
    plane = '<worldbody><geom type="plane" size="5 5 .1" friction="0" condim="1"/>'
    rubs = f'condim="{max(condim, 3)}" priority="1"'
    (tmp_path / "file.xml").write_text(text.replace("<worldbody>", plane, 1).replace(f'condim="{condim}"', rubs))
    compare(robot, tmp_path, "position")


@pytest.mark.parametrize(
    ("drive", "old", "new", "words"),
    [
        ("none", "</mujoco>", motors("<muscle J/>") + "</mujoco>", "motor 0 of joint 'hip_0_0'"),
        ("none", "</mujoco>", motors('<intvelocity J kp="80" actrange="-2 2"/>') + "</mujoco>", "motor 0"),
        ("none", '"0.002"', '"0.015"', "does not fit decisions of 0.02 s"),
    ],
)
def test_what_cannot_be_played_is_refused_in_a_sentence(drive, old, new, words, tmp_path):
    robot = made(tmp_path, drive, (old, new))
    with pytest.raises(InputError, match=words):
        make_task("walk", robot=robot.name, physics="unmodified")
