# pyright: reportAttributeAccessIssue=false
"""Models where people have them: robots of installed packages, scenes, meshes that are missing and feet of meshes."""

import importlib.util
import re
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
import yaml

from humanoid_mjx import InputError
from humanoid_mjx.evaluation.policy import find_policy
from humanoid_mjx.files import folder, names
from humanoid_mjx.report.scene import make_scene
from humanoid_mjx.robot import make_robot, mjcf
from humanoid_mjx.robot.holding import in_words, standing, tipping

TEXTS = {name: (folder("robots") / f"{name}.yaml").read_text() for name in names("robots", ".yaml")}
PUBLIC = {name: re.search(r"package:(\w+)", text)[1] for name, text in TEXTS.items() if "package:" in text}


@pytest.mark.parametrize("name", PUBLIC)
def test_public_robots_stand_in_native_mujoco(name):
    """For a second, and for two fifths of one where soft gains let them tip over without a policy."""
    assert len(TEXTS[name].splitlines()) <= 12
    if importlib.util.find_spec(PUBLIC[name]) is None:
        with pytest.raises(InputError, match=f"{name}.yaml: model: the package '{PUBLIC[name]}' .* pip install"):
            make_robot(name)
        return
    robot = make_robot(name)
    model, order, signs = robot.model, *robot.joint_images
    np.testing.assert_allclose(robot.posture[order] * signs, robot.posture, atol=0.02)
    data, joints = mujoco.MjData(model), robot.driven
    data.qpos[2], data.qpos[model.jnt_qposadr[joints]] = robot.start_height, robot.posture
    seconds = 0.4 if tipping(robot)[0] > 1 else 1.0
    for _ in range(round(seconds / model.opt.timestep)):
        angles, rates = data.qpos[model.jnt_qposadr[joints]], data.qvel[model.jnt_dofadr[joints]]
        torque = robot.servo.stiffness * (robot.posture - angles) - robot.servo.damping * rates
        data.ctrl = np.clip(torque, -robot.torque_limits, robot.torque_limits)
        mujoco.mj_step(model, data)
    assert data.xmat[1, 8] > 0.9 and data.qpos[2] > 0.85 * robot.start_height


def test_a_missing_package_is_named_with_what_brings_it(tmp_path):
    (tmp_path / "r.yaml").write_text("model: package:no_such_models/r.xml\nfeet: [foot]\n")
    words = r"r.yaml: model: the package 'no_such_models' is not installed; pip install no_such_models brings it"
    with pytest.raises(InputError, match=words):
        make_robot(str(tmp_path / "r.yaml"))


@pytest.mark.parametrize("name", ["walk_go1", "walk_g1"])
def test_policies_of_public_robots_ship_and_name_the_package_that_they_need(name):
    if importlib.util.find_spec("mujoco_playground") is None:
        with pytest.raises(InputError, match=r"the package 'mujoco_playground' .* pip install 'playground<1' brings"):
            find_policy(name)
        return
    assert find_policy(name).learner.task.robot.name == name.removeprefix("walk_")


BODY = """
<body name="trunk" pos="0 0 .4"><freejoint/><geom type="box" size=".2 .08 .05" mass="6"/>LOOKS
  <replicate count="2" sep="_" offset="-.36 0 0"><replicate count="2" sep="_" offset="0 -.24 0">
    <body name="thigh" pos=".18 .12 0">
      <joint name="hip" axis="0 1 0" range="-80 80"/><geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02" mass=".5"/>
      <body name="calf" pos="0 0 -.2">
        <joint name="knee" axis="0 1 0" range="-150 10"/>
        <geom type="capsule" fromto="0 0 0 0 0 -.2" size=".015" mass=".2"/>
        <geom name="foot" FOOT pos="0 0 -.2" euler="0 35 0" mass=".05" friction=".4"/>
      </body>
    </body>
  </replicate></replicate>
</body>"""
BOX = 'type="box" size=".03 .02 .01"'
CORNERS = " ".join(f"{x} {y} {z}" for x in (-0.03, 0.03) for y in (-0.02, 0.02) for z in (-0.01, 0.01))


def written(path, foot=BOX, looks="", assets="", scene="", **keys):
    """A robot's file, one that includes it where there is a scene, and its YAML."""
    body = BODY.replace("FOOT", foot).replace("LOOKS", looks)
    text = f"<mujoco><asset>{assets}</asset><worldbody>{body}</worldbody></mujoco>"
    (path / "robot.xml").write_text(text)
    (path / "scene.xml").write_text(f'<mujoco><include file="robot.xml"/><worldbody>{scene}</worldbody></mujoco>')
    feet = [f"foot_{i}_{j}" for i in "01" for j in "01"]
    data = {"model": "scene.xml" if scene else "robot.xml", "home": {"hip.*": 35, "knee.*": -70}, "feet": feet}
    (path / "robot.yaml").write_text(yaml.safe_dump(data | {"torque": 20, "servo": {"stiffness": 80}} | keys))
    return str(path / "robot.yaml")


def test_a_model_lies_in_a_package_whose_code_stays_idle(tmp_path, monkeypatch):
    (tmp_path / "my_models" / "dogs").mkdir(parents=True)
    (tmp_path / "my_models" / "__init__.py").write_text("raise RuntimeError")
    written(tmp_path / "my_models" / "dogs")
    monkeypatch.syspath_prepend(tmp_path)
    robot = make_robot(written(tmp_path, model="package:my_models/dogs/robot.xml"))
    np.testing.assert_array_equal(robot.soles, make_robot(written(tmp_path)).soles)
    with pytest.raises(InputError, match=r"robot.yaml: .*my_models/cats.xml cannot be read: No such file"):
        make_robot(written(tmp_path, model="package:my_models/cats.xml"))
    monkeypatch.setitem(mjcf.DISTRIBUTIONS, "my_models", "'my-models<1'")  # a later version has its models elsewhere
    with pytest.raises(InputError, match=r"'my_models' has no cats.xml; pip install 'my-models<1' brings the version"):
        make_robot(written(tmp_path, model="package:my_models/cats.xml"))


def test_the_plane_of_a_scene_is_the_ground(tmp_path):
    plane = '<geom type="plane" size="5 5 .1" friction=".7"/>'
    robots = [make_robot(written(tmp_path, scene=scene)) for scene in (plane, plane.replace(".7", ".3"))]
    assert [robot.model.pair_friction[0, 0] for robot in robots] == [0.7, 0.4]
    bare, added = make_robot(written(tmp_path)), "on the ground that --unmodified adds"
    rows = {row.in_file: row.name for row in bare.differences()}
    assert "ground of 'foot_0_0' and 3 more" in rows.values()
    model = bare.in_file()[0].compile()
    data = mujoco.MjData(model)
    data.qpos[2] = -5.0  # deep in the ground all touch it that can
    mujoco.mj_forward(model, data)
    touching = {max(pair) for pair in data.contact.geom.tolist() if 0 in model.geom_bodyid[pair]}
    assert rows[added] == "contact of 'package_ground' and 'trunk' and 8 more" and len(touching) == 4 + 9
    assert added not in [row.in_file for row in make_robot(written(tmp_path, scene=plane)).differences()]


def test_meshes_that_are_missing_matter_only_where_they_touch_or_weigh(tmp_path):
    assets = '<mesh name="shell" file="shell.stl"/>'
    shell = '<geom mesh="shell" type="mesh" contype="0" conaffinity="0" mass="0"/>'
    robot = make_robot(written(tmp_path, looks=shell, assets=assets))
    assert ("1 meshes", "for looks", "none: no such files") in robot.differences()
    assert robot.mass == make_robot(written(tmp_path)).mass
    bones = robot.model.ngeom - make_robot(written(tmp_path)).model.ngeom
    assert bones == 4, "one from the trunk to each thigh, in place of the shell"
    for change in (('contype="0" ', ""), ('mass="0"', "")):
        with pytest.raises(
            InputError, match=r"robot.yaml: model: the mesh shell.stl of trunk is missing, and it touches"
        ):
            make_robot(written(tmp_path, looks=shell.replace(*change), assets=assets))


def test_a_robot_is_seen_before_it_is_trained(tmp_path):
    """By its YAML, on its servo: every joint stays at the middle of its choices."""
    shapes = BODY.replace("<geom ", '<geom group="3" ')
    for_contacts_only = Path(written(tmp_path)).with_name("robot.xml")
    for_contacts_only.write_text(
        f"<mujoco><worldbody>{shapes}</worldbody></mujoco>".replace("FOOT", BOX).replace("LOOKS", "")
    )
    rest = find_policy(str(tmp_path / "robot.yaml"))
    counts = np.array(rest.learner.env.action_bins)
    choice = rest.learner.act(rest.policy, jnp.ones(rest.learner.env.observation_size), jax.random.key(0))
    np.testing.assert_array_equal(choice, (counts - 1) // 2)
    model = rest.learner.task.simulator.model
    shown = make_scene(model, model.qpos0[None]).shown
    assert len(shown) > 0, "shapes for contacts only, as none is for looks"
    model.geom_group[shown[-1]] = 0  # as that of a foot, while the meshes of the rest are not there
    assert make_scene(model, model.qpos0[None]).shown == shown
    with pytest.raises(InputError, match="leg: task: robot: this one hangs from its base; name one that stands"):
        find_policy("leg")


def test_a_foot_of_a_mesh_stands_on_the_corners_of_its_hull(tmp_path):
    box, plane = make_robot(written(tmp_path)), '<geom type="plane" size="5 5 .1"/>'
    mesh = written(tmp_path, 'type="mesh" mesh="sole"', assets=f'<mesh name="sole" vertex="{CORNERS}"/>', scene=plane)
    found = make_robot(mesh).soles.reshape(4, 4, 3)
    for foot, expected in zip(found, box.soles.reshape(4, 4, 3), strict=True):
        order = [np.lexsort(part.round(4).T) for part in (foot, expected)]
        np.testing.assert_allclose(foot[order[0]], expected[order[1]], atol=1e-6)


def test_what_a_servo_has_to_hold_is_the_slope_of_the_energy(tmp_path):
    """All knees of a robot on even legs bend by the same angle: the work of their torques lifts the trunk."""
    robot = make_robot(written(tmp_path, 'type="sphere" size=".02"'))
    model, energy = robot.model, []
    for bend in (-1e-5, 1e-5):
        data = mujoco.MjData(model)
        bent = robot.posture + bend * np.array(["knee" in joint for joint in robot.joints])
        data.qpos[model.jnt_qposadr[robot.driven]] = bent
        mujoco.mj_forward(model, data)
        feet = np.mean(
            [data.body(foot).xpos + data.body(foot).xmat.reshape(3, 3) @ [0, 0, -0.2] for foot in robot.feet], 0
        )
        energy.append(robot.mass * 9.81 * (data.subtree_com[0, 2] - feet[2]))
    torque = standing(robot)[0][["knee" in joint for joint in robot.joints]].sum()
    assert torque == pytest.approx(abs(energy[1] - energy[0]) / 2e-5, rel=0.02)


def test_gains_that_cannot_hold_a_robot_are_said_with_those_that_do(tmp_path):
    (fine,) = in_words(make_robot(written(tmp_path)))
    assert re.match(r"under its weight knee_\d_\d gives way by \S+ degrees, knee_\d_\d takes \d+% of", fine)
    soft = in_words(make_robot(written(tmp_path, servo={"stiffness": 8, "damping": 0.01})))[1]
    assert "e+" not in soft
    (better,) = in_words(make_robot(written(tmp_path, servo=yaml.safe_load(soft.split("take servo: ")[1]))))
    assert float(re.search(r"by (\S+) degrees", better)[1]) <= 5 and float(re.search(r"ratio (\S+),", better)[1]) >= 0.5
    weak = in_words(make_robot(written(tmp_path, torque=0.5)))
    assert weak[1].startswith("no gains hold it")


def test_gains_that_are_said_name_joints_of_any_name(tmp_path):
    """What is a sign of regular expressions or of YAML in a name stands for itself."""

    def robot(servo):
        path = Path(written(tmp_path, servo=servo, home={"hip.*": 35, ".*ee.*": -70}))
        text = (tmp_path / "robot.xml").read_text()
        (tmp_path / "robot.xml").write_text(text.replace("knee", "k[(n]ee: +"))
        return make_robot(str(path))

    soft = in_words(robot({"stiffness": 8, "damping": 0.01}))[1]
    assert robot(yaml.safe_load(soft.split("take servo: ")[1])).stiffness[1] > 8
