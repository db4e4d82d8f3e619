# pyright: reportAttributeAccessIssue=false
"""Robots of a YAML beside an MJCF: what follows from the model, what is refused, where the files are found."""

import os
import re
import shutil
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
import yaml

from humanoid_mjx import InputError, make_task
from humanoid_mjx.commands import console
from humanoid_mjx.commands.info import show_info, show_keys, show_model
from humanoid_mjx.config import load
from humanoid_mjx.evaluation.policy import at_rest, find_policy, in_world, save_policy
from humanoid_mjx.files import folder
from humanoid_mjx.robot import make_robot
from humanoid_mjx.robot.declared import Declaration
from humanoid_mjx.robot.mirror import image
from humanoid_mjx.robot.mjcf import content_of, files_of
from humanoid_mjx.robot.reaching import REGION, _leg, _miss, _solve, monomials, reach_of
from humanoid_mjx.spec import modules_in
from humanoid_mjx.training.plan import make_plan, resolved

CHANGED = """<freejoint/><body name="ball"><joint name="ball" type="ball"/><geom size="0.1"/></body>"""

SHIPPED = ["dog", "humanoid"]


def files(path, edit=None, **keys):
    """The dog's files in a folder, its model edited, with other keys; None takes one out."""
    shutil.copy(folder("robots") / "dog.xml", path / "dog.xml")
    text = (path / "dog.xml").read_text()
    (path / "dog.xml").write_text(edit(text) if edit else text)
    data = yaml.safe_load((folder("robots") / "dog.yaml").read_text()) | keys
    data = {key: value for key, value in data.items() if value is not None}
    (path / "pet.yaml").write_text(yaml.safe_dump(data, sort_keys=False))
    return str(path / "pet.yaml")


@pytest.mark.parametrize("name", SHIPPED)
def test_robots_that_ship_are_their_own_mirror_image(name):
    robot = make_robot(name)
    order, signs = robot.joint_images
    np.testing.assert_allclose(robot.posture[order] * signs, robot.posture, atol=1e-12)
    for values in (robot.servo.stiffness, robot.servo.damping, robot.torque_limits):
        np.testing.assert_array_equal(values[order], values)


def motors_reversed(text):
    """A model whose motors come in another order than its joints."""
    head, motors, tail = re.split(r"</?actuator>", text)
    return f"{head}<actuator>{''.join(reversed(motors.splitlines()))}</actuator>{tail}"


@pytest.mark.parametrize("name", [*SHIPPED, "motors reversed"])
def test_who_does_nothing_stands_in_the_task(name, tmp_path):
    """As long as nothing pushes: with the task's spread at the start, errors of sensors, and the servo at each step."""
    robot = files(tmp_path, edit=motors_reversed) if name == "motors reversed" else name
    task = make_task("stand", robot=robot, physics="mujoco", push={"impulse": 0.0})
    state = jax.jit(jax.vmap(task.reset))(jax.random.split(jax.random.key(0), 4))
    step, still = jax.jit(jax.vmap(task.step_continuous)), jnp.zeros((4, len(task.robot.joints)))
    for second in range(50):
        state = step(state, still, jax.random.split(jax.random.key(second), 4))
        assert not state.terminated.any()
    assert (state.reward > 0.9).all()
    # All of its weight is on its feet, of which none hangs in the air.
    touch = state.data.readings.foot_contact
    np.testing.assert_allclose(touch.sum(axis=1), task.robot.mass * 9.81, rtol=0.1)
    assert touch.min() > 0.0
    model = task.robot.model
    by_motor = state.data.world.qpos[:, model.jnt_qposadr[model.actuator_trnid[:, 0]]]
    np.testing.assert_allclose(state.data.readings.encoders, by_motor, atol=0.1)
    assert name != "motors reversed" or task.robot.joints[0] == "RL_calf"


@pytest.mark.parametrize("name", SHIPPED)
def test_feet_go_where_the_polynomials_of_the_legs_bring_them(name):
    """Against the leg's kinematics, at places of every size; the solved joints are the limit of what a fit can do."""
    robot = make_robot(name)
    leg, rows = _leg(robot, 0), slice(0, None)
    region = 0.6 * (REGION if leg.flat else REGION[:3])
    wanted = np.random.default_rng(1).uniform(region[:, 0], region[:, 1], (100, len(region)))
    terms = np.stack(monomials(wanted.T), axis=1)
    rows = slice(0, terms.shape[1])
    miss = _miss(robot, leg, terms @ reach_of(robot)[1][rows][:, leg.joints], wanted)
    best = _miss(robot, leg, _solve(robot, leg, wanted), wanted)
    assert np.quantile(np.abs(best[:, :3]), 0.9) < 0.01 and np.quantile(np.abs(miss[:, :3]), 0.9) < 0.02


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"feets": ["FR_foot"]}, r"pet.yaml: feets: unknown key; did you mean 'feet'"),
        ({"feet": None}, r"pet.yaml: feet: this key is required"),
        ({"feet": ["FR_fot"]}, r"pet.yaml: feet: the model has no geom or body 'FR_fot'; did you mean 'FR_foot'"),
        ({"feet": ["trunk"]}, r"pet.yaml: feet: trunk has no geom that touches"),
        ({"model": "cat.xml"}, r"pet.yaml: .*cat.xml cannot be read: No such file"),
        ({"home": "sit"}, r"pet.yaml: home: the model has no keyframe 'sit'; it has none"),
        ({"home": {".*_knee": 3}}, r"pet.yaml: home: '.\*_knee' fits no joint"),
        ({"home": {"(": 3}}, r"pet.yaml: home: '\(' is no regular expression"),
        ({"home": {".*_calf": 900}}, r"pet.yaml: home: FR_calf at 900 degrees is beyond its range"),
        ({"home": None}, r"pet.yaml: home: FR_calf at 0 degrees is beyond its range, .*; without this key"),
        ({"home": {".*_calf": float("nan")}}, r"pet.yaml: home: a number, or numbers by patterns"),
        ({"servo": 80}, r"pet.yaml: servo must be a mapping of keys, got 80; known are damping, stiffness"),
        ({"servo": {"stiffness": 1e300}}, r"pet.yaml: servo.stiffness: a number must be 0 or from 1"),
        (
            {"torque": {".*": 1e-300}},
            r"torque: a number must be 0 or from 1e-06 to 1e.06 in size, got 1e-300",
        ),
        ({"servo": {"damping": -1}}, r"pet.yaml: servo.damping: must be at least 0, got -1"),
        ({"servo": {"stiffness": "stiff"}}, r"pet.yaml: servo.stiffness: a number, or numbers by patterns"),
        ({"servo": {"stifness": 3}}, r"pet.yaml: servo.stifness: unknown key; did you mean 'stiffness'"),
        ({"shares": {"FR_hip": 2}}, r"pet.yaml: shares: FL_hip and its mirror image must have the same"),
        ({"mirror": {"FR": "XX"}}, r"pet.yaml: mirror: FR_hip has no image XX_hip"),
        ({"turns": [0.0, 0.5]}, r"pet.yaml: turns must hold 4 numbers, got 2"),
    ],
)
def test_what_does_not_fit_is_said_with_file_and_key(keys, words, tmp_path):
    with pytest.raises(InputError, match=words):
        make_robot(files(tmp_path, **keys))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("<freejoint/>", "", "a robot is one body with a free joint"),
        ("</worldbody>", '<body name="box"/></worldbody>', "the bodies are: trunk, box"),
        ("</mujoco>", '<option timestep="nan"/></mujoco>', "<option timestep> is nan; it must be from 1e-06 to 1 s"),
        ("</mujoco>", '<option timestep="-1"/></mujoco>', "<option timestep> is -1; it must be"),
        ("<option", '<option gravity="0 0 inf"', "the option gravity must be a number of at most 1e.10"),
        (
            'damping="',
            'frictionloss="inf" damping="',
            "the frictionloss of joint 'FR_hip' .12. must be a number of at most",
        ),
        ('mass="5.2"', 'mass="nan"', "dog.xml holds a NaN; write a number in its place"),
        (
            'damping="',
            'stiffness="1e300" damping="',
            "the stiffness of joint 'FR_hip' .12. must be a number of at most",
        ),
        ("<motor ctrlrange=", "<motor user=", "torque: the model has no limit for FR_hip"),
        ('type="sphere"', 'type="cylinder"', "feet: FR_calf has a cylinder"),
        ("</mujoco>", "", "no MJCF that MuJoCo takes: XML"),
    ],
)
def test_models_that_are_no_robots_are_refused(old, new, words, tmp_path, monkeypatch):
    def changed(text):
        text = text.replace(old, new)
        return text.replace('size="0.022"', 'size="0.022 0.022"') if "cylinder" in new else text

    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=f"pet.yaml: .*{words}"):
        make_robot(files(tmp_path, edit=changed))
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("stiffness", [1.0], "stiffness: must hold 12 numbers, got 1"),
        ("torque", [1.0] * 13, "torque: must hold 12 numbers, got 13"),
        ("damping", [-1.0] * 12, r"damping.0 must be at least 0.0, got -1.0"),
        ("torque", [0.0] * 12, r"torque.0 must be greater than 0.0, got 0.0"),
        ("feet", ["nose"], "feet: the model has no body 'nose'"),
    ],
)
def test_what_a_config_changes_of_a_robot_fits_its_model(key, value, words):
    with pytest.raises(InputError, match=words):
        make_robot("dog", **{key: value})


def test_patterns_the_models_own_values_and_defaults(tmp_path):
    robot = make_robot(files(tmp_path, servo={"stiffness": {".*calf": 7, ".*": 5}}, torque={".*_hip": 3}, shares=None))
    np.testing.assert_array_equal(robot.servo.stiffness[:3], [5, 5, 7])
    np.testing.assert_allclose(robot.servo.damping, 0.03 * robot.servo.stiffness)
    np.testing.assert_array_equal(robot.torque_limits[:3], [3, 23.7, 35.5])
    assert len(set(robot.shares)) == 1 and robot.shares[0] > 1  # for a servo as soft as this
    plain = make_robot(files(tmp_path, servo=None))
    np.testing.assert_array_equal(plain.servo.stiffness, plain.torque_limits)

    def position_actuators(text):
        return text.replace("<motor joint", '<position kp="9" kv="0.4" joint').replace("<motor ctrl", "<position force")

    own = make_robot(files(tmp_path, edit=position_actuators, servo=None))
    np.testing.assert_array_equal(own.servo.stiffness, [9.0] * 12)
    np.testing.assert_array_equal(own.servo.damping, [0.4] * 12)
    np.testing.assert_array_equal(own.torque_limits[:3], [23.7, 23.7, 35.5])


def test_motors_of_tendons_are_not_those_of_joints(tmp_path):
    """Though the number of the tendon is that of a joint."""

    def with_tendons(text):
        first = re.search(r'<joint name="(\w+)"', text)[1]
        tendons = "".join(f'<fixed name="t{i}"><joint joint="{first}" coef="1"/></fixed>' for i in range(6))
        motors = "".join(f'<motor tendon="t{i}" ctrlrange="-0.1 0.1"/>' for i in range(6))
        return text.replace("<actuator>", f"<tendon>{tendons}</tendon><actuator>{motors}")

    plain, other = make_robot(files(tmp_path)), make_robot(files(tmp_path, edit=with_tendons))
    np.testing.assert_array_equal(other.torque_limits, plain.torque_limits)


@pytest.mark.parametrize("turns", [[0.1, 0.6, 0.7, 0.2], []])
def test_feet_may_be_named_in_any_order(turns, tmp_path):
    """Each keeps its turn, or without any its share of the period by the order of the names."""
    feet = ["RL_foot", "FR_foot", "RR_foot", "FL_foot"]
    robot = make_robot(files(tmp_path, feet=feet, turns=turns))
    found = {foot.replace("calf", "foot"): turn for foot, turn in zip(robot.feet, robot.phases, strict=True)}
    assert found == dict(zip(feet, turns or [0.0, 0.25, 0.5, 0.75], strict=True))


@pytest.mark.parametrize(
    ("shape", "points"),
    [('type="capsule" size="0.02 0.05" euler="0 2.3038 0"', 2), ('type="box" size=".06 .03 .02" euler="0 0.733 0"', 4)],
)
def test_capsules_and_boxes_stand_on_balls(shape, points, tmp_path):
    """Of the feet of a body that stands on them, the lowest points are those of the shape itself."""
    ball = 'type="sphere" pos="0 0 -0.213" size="0.022"'
    robot = make_robot(files(tmp_path, edit=lambda text: text.replace(ball, f'pos="0 0 -0.213" {shape}')))
    assert robot.points == points
    data = mujoco.MjData(robot.model)
    data.qpos[robot.model.jnt_qposadr[robot.model.actuator_trnid[:, 0]]] = robot.posture
    mujoco.mj_forward(robot.model, data)
    balls = [robot.model.geom(f"FR_calf_point{k}") for k in range(points)]
    heights = [data.geom_xpos[ball.id, 2] - ball.size[0] for ball in balls]
    hip, length = data.body("FR_thigh").xpos[2], 0.213 * (np.cos(np.radians(48)) + np.cos(np.radians(42)))
    # The box lies level at home, and so does the capsule; a ball's radius or the box's half height is below the centre.
    np.testing.assert_allclose(heights, hip - length - 0.02, atol=2e-4)


def test_a_run_finds_its_robot_again_and_takes_no_other(tmp_path, monkeypatch):
    """From the config's folder, from elsewhere, and after both files were moved to where the config is now."""
    home = tmp_path / "home"
    home.mkdir()
    files(home)
    task = {"name": "stand", "robot": "pet.yaml", "physics": "mujoco"}
    learner = {"name": "deep_q", "envs": 16}
    (home / "c.yaml").write_text(yaml.safe_dump({"name": "c", "task": task, "learner": learner, "total_steps": 1000}))
    config = load(home / "c.yaml")
    written = resolved(config)
    robot = written["task"]["robot"]
    assert robot.keys() == {"name", "content"} and robot["name"] == str(home / "pet.yaml")
    monkeypatch.chdir(tmp_path)
    with modules_in(config.modules):
        assert make_robot("pet.yaml").content == robot["content"]
    with pytest.raises(InputError, match=r"there is no file pet\.yaml, and none"):
        make_robot("pet.yaml")
    assert make_plan(config).learners[0].task.robot.content == robot["content"]
    moved = home.rename(tmp_path / "moved")
    with modules_in(str(moved)):
        assert make_robot(robot["name"], content=robot["content"]).feet[0] == "FR_calf"
        (moved / "dog.xml").write_text("<!-- a comment -->" + (moved / "dog.xml").read_text())
        assert make_robot(robot["name"]).content == robot["content"]
        (moved / "dog.xml").write_text((moved / "dog.xml").read_text().replace('mass="5.2"', 'mass="5.3"'))
        with pytest.raises(InputError, match="has changed since this run"):
            make_robot(robot["name"], content=robot["content"])
        assert make_robot(robot["name"]).mass == pytest.approx(12.82)


def test_a_policy_is_played_on_its_robot_as_it_is_now_where_that_is_asked_for(tmp_path, monkeypatch):
    """By what the error says to type, or by the robot's place seen from here."""
    name = files(tmp_path)
    file = tmp_path / "rest.npz"
    save_policy(at_rest(name), file)
    (tmp_path / "dog.xml").write_text((tmp_path / "dog.xml").read_text().replace('mass="5.2"', 'mass="5.3"'))
    with pytest.raises(InputError, match="has changed since this run, its YAML or a file of its model") as error:
        find_policy(file)
    asked = re.search(r"--set (task\.robot=.*)\.$", str(error.value))[1]
    with pytest.raises(InputError, match="has changed"):
        find_policy(file, overrides=["task.friction=0.5"])
    monkeypatch.chdir(tmp_path)
    for now in asked, f"task.robot={Path(name).name}":
        found = in_world(find_policy(file, overrides=[now]), None, [now])
        assert found.learner.task.robot.mass == pytest.approx(12.82)


def test_a_robot_is_all_files_that_its_model_reads(tmp_path):
    """Included files, a mesh in `meshdir` and a height field count; a texture and layout do not."""
    (tmp_path / "parts").mkdir()
    (tmp_path / "meshes").mkdir()
    cube = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1)) + "f 1 2 3\nf 5 7 6\n"
    written = {
        "parts/head.xml": '<mujoco><worldbody><include file="parts/mass.xml"/></worldbody></mujoco>',
        "parts/mass.xml": '<mujocoinclude><geom type="sphere" size="1"/></mujocoinclude>',
        "meshes/box.obj": cube,
        "meshes/hills.txt": "1",
        "sky.png": "x",
    }
    for name, text in written.items():
        (tmp_path / name).write_text(text)
    model = """<mujoco><compiler meshdir="meshes"/><include file="parts/head.xml"/><asset><mesh file="box.obj"/>
    <hfield file="hills.txt"/><texture file="sky.png"/></asset></mujoco>"""
    (tmp_path / "dog.xml").write_text(model)

    def digest():
        return content_of({}, tmp_path / "dog.xml")

    assert len(files_of(tmp_path / "dog.xml")) == 5
    before = digest()
    for name, text in written.items():
        (tmp_path / name).write_text(text.replace("1", "3").replace("x", "y"))
        assert (digest() == before) == (name == "sky.png"), name
        (tmp_path / name).write_text(text)
        os.utime(tmp_path / name, ns=(1, 1))
        assert digest() == before
    (tmp_path / "parts" / "mass.xml").write_text("<!-- heavy -->" + written["parts/mass.xml"])
    assert digest() == before


def test_a_changed_include_is_another_robot(tmp_path):
    def included(text):
        head, body = text.split("<body name=", 1)
        body, tail = body.rsplit("</worldbody>", 1)
        (tmp_path / "body.xml").write_text(f"<mujocoinclude><body name={body}</mujocoinclude>")
        return f'{head}<include file="body.xml"/></worldbody>{tail}'

    name = files(tmp_path, edit=included)
    robot = make_robot(name)
    assert make_robot(name, content=robot.content).mass == robot.mass == pytest.approx(make_robot("dog").mass)
    body = tmp_path / "body.xml"
    body.write_text(body.read_text().replace('mass="5.2"', 'mass="9.2"'))
    with pytest.raises(InputError, match="has changed since this run"):
        make_robot(name, content=robot.content)
    assert make_robot(name).mass == pytest.approx(robot.mass + 4)


@pytest.mark.parametrize(
    ("name", "mirror", "other"),
    [
        ("r_knee", {"r_": "l_"}, "l_knee"),
        ("l_knee", {"r_": "l_"}, "r_knee"),
        ("roll_link", {"r_": "l_"}, "roll_link"),
        ("upright", {"right": "left"}, "upright"),
        ("hip_10_0_2", {"_0_": "_1_"}, "hip_10_1_2"),
        ("hip_10", {"0": "1"}, "hip_10"),
        ("LShoulderRoll", {"R": "L"}, "RShoulderRoll"),
        ("RShoulderRoll", {"R": "L"}, "LShoulderRoll"),
        ("kneeRight2", {"Right": "Left"}, "kneeLeft2"),
        ("FRhip", {"FR": "FL"}, "FLhip"),
        ("lr_link", {"LR_": "LL_", "lr_": "ll_", "r_": "l_"}, "ll_link"),
        ("right_arm_right", {"right": "left"}, "left_arm_left"),
        ("waist", {"r": "l"}, "waist"),
    ],
)
def test_whole_parts_of_names_change_sides(name, mirror, other):
    names = {name, other, "LShoulderLoll"}
    assert image(name, tuple(mirror.items()), names) == other
    assert image(other, tuple(mirror.items()), names) == name


@pytest.mark.parametrize(
    ("mirror", "words"),
    [
        ({"FR": "FL", "RR": "RX"}, r"mirror: RR_hip has no image RX_hip among the joints; did you mean 'RR_hip'\?"),
        ({"FR": "FL", "FL": "RL"}, "mirror: the image of RL_hip is FL_hip, but that of FL_hip is FR_hip"),
        ({"hip": "thigh"}, "mirror: the axis of FR_hip is no image of that of FR_thigh"),
    ],
)
def test_a_mirror_that_does_not_fit_names_the_joint(mirror, words, tmp_path):
    with pytest.raises(InputError, match=words):
        make_robot(files(tmp_path, mirror=mirror, shares=None))


def test_a_foot_without_an_image_is_named(tmp_path):
    """Its joints have images, the name of its body has none."""
    with pytest.raises(InputError, match="mirror: FR_foot has no image FL_foot among the feet"):
        make_robot(files(tmp_path, edit=lambda text: text.replace('body name="FR_calf"', 'body name="FR_foot"')))


@pytest.mark.parametrize(
    ("model", "keys", "facts"),
    [
        (
            "humanoid.xml",
            {"feet": ["right_foot", "left_foot"], "mirror": {"right": "left"}, "home": {".*_knee": -2}},
            (17, 1, [40, 40, 40]),
        ),
        (
            "ant.xml",
            {"feet": ["left_ankle_geom", "right_ankle_geom"], "home": {"ankle_[14]": 45, "ankle_[23]": -45}},
            (8, 2, [150, 150, 150]),
        ),
    ],
)
def test_models_of_gymnasium_are_taken_as_they_are(model, keys, facts, tmp_path):
    """Bodies without names, gears, motors in another order than joints, a foot that is a ball or a capsule."""
    gymnasium = pytest.importorskip("gymnasium")
    file = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets" / model
    (tmp_path / "other.yaml").write_text(yaml.safe_dump({"model": str(file)} | keys))
    robot = make_robot(str(tmp_path / "other.yaml"))
    assert (len(robot.joints), robot.points, robot.torque_limits[:3].tolist()) == facts
    assert robot.model.npair == len(robot.feet) * robot.points
    if robot.mirror:
        order, signs = robot.joint_images
        shoulder = robot.joints.index("right_shoulder1")
        assert robot.joints[order[shoulder]] == "left_shoulder1" and signs[shoulder] == -1
        np.testing.assert_allclose(robot.ranges_rad[order][shoulder], -robot.ranges_rad[shoulder][::-1])


@pytest.mark.parametrize(
    "wrong", ["modle: dog.xml\nfeets: [FR_foot]\nhome: home", "task: walk\nmodel: dog.xml\nfeet: []"]
)
def test_a_misspelt_robot_is_told_the_keys_of_robots(wrong, tmp_path):
    (tmp_path / "pet.yaml").write_text(wrong)
    for show in (show_keys, lambda name: show_info(name, (), False)):
        with console.capture() as shown:
            try:
                show(str(tmp_path / "pet.yaml"))
            except InputError as error:
                console.print(error)
        assert "turns" in shown.get() and "learner" not in shown.get()


def test_info_shows_a_robot_and_its_keys(tmp_path):
    with console.capture() as shown:
        show_info(files(tmp_path), (), False)
    for words in ("12 joints", "FR_hip -49 to 49 0 23.7", "-FL_hip", "4 with the ground", "tree takes it"):
        assert words in " ".join(shown.get().split()), words
    with console.capture() as shown:
        show_keys("robot")
    for name in Declaration.model_fields:
        assert f"\n{name} " in shown.get(), name
    with console.capture() as shown:
        show_model(str(tmp_path / "dog.xml"))
    assert "FR_calf, FL_calf, RR_calf, RL_calf: ends of limbs\n" in shown.get()  # it has no floor
    (tmp_path / "dog.xml").write_text((tmp_path / "dog.xml").read_text().replace("<freejoint/>", CHANGED))
    with console.capture() as shown:
        show_info(str(tmp_path / "pet.yaml"), (), False)
    assert "tree refuses" in shown.get() and "take mujoco, or try mjx-jax" in " ".join(shown.get().split())
