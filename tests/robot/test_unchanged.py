# pyright: reportAttributeAccessIssue=false
"""A robot of a YAML moves as its MJCF does in native MuJoCo, or what differs is refused or named."""

import ast
from contextlib import nullcontext
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from tree_robots import FOUR_LEGS

import humanoid_mjx
from humanoid_mjx import InputError, make_task
from humanoid_mjx.commands import console
from humanoid_mjx.commands.info import show_info
from humanoid_mjx.evaluation.policy import find_policy
from humanoid_mjx.physics import make_physics
from humanoid_mjx.physics.native import _team
from humanoid_mjx.report.web import table
from humanoid_mjx.robot import make_robot
from humanoid_mjx.robot.differences import HEADINGS, differences_of
from humanoid_mjx.training import cost
from humanoid_mjx.training.plan import Group

FEET = "feet: [foot_0_0, foot_1_0, foot_0_1, foot_1_1]\n"
HOME = 'home: {"hip.*": 35, "knee.*": -70}\n'
SERVO = "servo: {stiffness: 80, damping: 2}\n"
YAML = f"model: base.xml\n{HOME}{FEET}{SERVO}torque: 20\n"


def replaced(text, *pairs):
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    return text


def feet(words):
    return '<geom name="foot"', f'<geom name="foot" {words}'


def floor(words):
    return '<geom name="floor"', f'<geom name="floor" {words}'


def world(element):
    return "</worldbody>", f"{element}</worldbody>"


def contact(element):
    names = [f"{i}_{j}" for i in "01" for j in "01"]
    return "</mujoco>", f"<contact>{''.join(element.replace('FOOT', name) for name in names)}</contact></mujoco>"


def motors(*elements):
    joints = [f"{kind}_{i}_{j}" for kind in ("hip", "knee") for i in "01" for j in "01"]
    return (
        "</mujoco>",
        f"<actuator>{''.join(e.replace('J', f'joint={j!r}') for j in joints for e in elements)}</actuator></mujoco>",
    )


def robot_of(folder, *pairs, yaml=YAML):
    (folder / "base.xml").write_text(replaced(FOUR_LEGS, *pairs))
    (folder / "robot.yaml").write_text(yaml)
    return make_robot(str(folder / "robot.yaml"))


def start(robot, model):
    """Trunk 1 mm above touching, moving at (0.8, 0.3, 0) m/s and turning at 1 rad/s."""
    data = mujoco.MjData(model)
    joints = [model.joint(name).id for name in robot.joints]
    data.qpos[:7] = 0, 0, 0.001 - robot.soles[:, 2].min(), 1, 0, 0, 0
    data.qpos[model.jnt_qposadr[joints]] = robot.posture
    data.qvel[:6] = 0.8, 0.3, 0, 0, 0, 1
    return data, model.jnt_qposadr[joints], model.jnt_dofadr[joints]


def slide(robot, model):
    """Where native MuJoCo brings the trunk in 0.6 s, the joints held by a servo of applied forces, m."""
    data, places, dofs = start(robot, model)
    for _ in range(300):
        data.qfrc_applied[dofs] = np.clip(80 * (robot.posture - data.qpos[places]) - 2 * data.qvel[dofs], -20, 20)
        mujoco.mj_step(model, data)
    return data.qpos[:3]


def apart(robot, folder):
    """How far the robot is from its unmodified file after the slide, m."""
    own = mujoco.MjModel.from_xml_path(str(folder / "base.xml"))
    return np.linalg.norm(slide(robot, own) - slide(robot, robot.model))


def named(robot):
    return {row.name.split(" ")[0] + " " + row.name.split(" ")[1]: row for row in robot.differences()}


SAME = {
    "base": [],
    "priority": [feet('priority="1" friction=".1"')],
    "soft plane": [floor('priority="1" solref=".1 1" solimp=".2 .5 .01"')],
    "visual plane": [
        feet('friction=".2"'),
        floor('friction=".2"'),
        world('<geom type="plane" size="5 5 .1" contype="0" conaffinity="0"/>'),
    ],
    "plane of another group": [
        feet('friction=".3"'),
        floor('friction=".3"'),
        world('<geom type="plane" size="5 5 .1" contype="2" conaffinity="2" friction="2"/>'),
    ],
    "masks that meet one way": [
        feet('contype="2" conaffinity="0" friction=".2"'),
        floor('conaffinity="3" friction=".3"'),
    ],
    "margin": [feet('margin=".02"'), floor('margin=".005"')],
    "gap": [feet('margin=".02" gap=".01"')],
    "solmix": [feet('solmix="3" solref=".05 1"'), floor('solimp=".5 .8 .01"')],
    "solmix of 0": [feet('solmix="0" solref=".05 1"')],
    "direct solref": [feet('solref="-8000 -90"')],
    "frictionless": [feet('condim="1"'), floor('condim="1"')],
    "default class": [("<default/>", '<default><geom friction=".15" solref=".03 1"/></default>')],
    "default class of pairs": [("<default/>", '<default><pair margin=".03" solref=".2 1" friction="3"/></default>')],
    "default classes": [
        (
            "<default/>",
            '<default><geom condim="1" gap="1"/><site euler="0 30 0" pos="1 1 1"/><general armature="1"/></default>',
        )
    ],
    "pair": [contact('<pair geom1="floor" geom2="foot_FOOT" friction=".2 .5" solref=".03 1"/>')],
    "pair of masked feet": [
        feet('contype="0" conaffinity="0"'),
        contact('<pair geom1="foot_FOOT" geom2="floor" friction=".2 .2"/>'),
    ],
    "wall out of reach": [world('<geom type="box" size="1 1 .05" contype="4" conaffinity="4"/>')],
    "impratio": [("<option", '<option impratio="5"')],
    "armature of motors": [motors('<motor J armature=".02" damping=".3" gear="2"/>')],
    "springdamper beside motors": [
        ("<default/>", '<default><joint springdamper=".1 1"/></default>'),
        motors('<motor J armature=".02" damping=".3" gear="2"/>'),
    ],
    "flag": [("<option ", '<option><flag eulerdamp="disable"/></option><option ')],
}


@pytest.mark.parametrize("case", SAME)
def test_feet_slide_as_in_the_unmodified_file(case, tmp_path):
    robot = robot_of(tmp_path, *SAME[case])
    assert apart(robot, tmp_path) < 1e-4
    # All that is named does not concern the slide: contacts of other parts, and the drive.
    assert {name.split()[0] for name in named(robot)} <= {"contact", "actuator"}


def test_a_motor_that_is_disabled_weighs_and_damps_on(tmp_path):
    """It drives its joint no longer, which then has no motor here."""
    elements, text = motors('<motor J ctrlrange="-20 20" armature=".2" damping=".5"/>')
    text = text.replace("joint='hip_0_0'", "joint='hip_0_0' name='lame' group='2'")
    robot = robot_of(tmp_path, (elements, text), ("<option", '<option actuatorgroupdisable="2"'))
    assert len(robot.joints) == 7 and apart(robot, tmp_path) < 1e-4
    assert named(robot)["actuator 'lame'"][1:] == ("drives a joint", "none")


NO_CONTACT = '<option><flag contact="disable"/></option>'
NO_PLANE = "no plane that it can touch", None
AS_OTHERS = "as other shapes of its body can"
HEEL = '<geom name="foot"', '<geom name="heel" type="sphere" size=".02" pos="0 0 -.2"/><geom name="foot"'


@pytest.mark.parametrize(
    ("pairs", "name", "values", "least"),
    [
        ([("<option", '<option cone="elliptic" impratio="100"')], "option cone", ("elliptic", "pyramidal"), 0.005),
        ([("<option", '<option integrator="RK4"')], "option integrator", ("rk4", "euler"), 0.001),
        ([("<option", '<option solver="PGS" iterations="1"')], "option solver", ("pgs", "newton"), 0),
        ([("<option", '<option iterations="1"')], "option iterations", ("1", "100"), 0),
        ([("<mujoco>", f"<mujoco>{NO_CONTACT}")], "option disableflags", ("contact", "none"), 0),
        (
            [("<mujoco>", f"<mujoco>{NO_CONTACT.replace('contact', 'constraint')}")],
            "option disableflags",
            ("constraint", "none"),
            0.1,
        ),
        (
            [feet('condim="6" friction=".6 .05 .01"'), floor('friction=".6"')],
            "condim of",
            ("6: resists twisting or rolling", "3: resists sliding"),
            5e-4,
        ),
        ([feet('contype="2" conaffinity="2"')], "ground of", NO_PLANE, 0.1),
        (
            [feet('contype="2" conaffinity="2" condim="4"')],
            "condim of",
            ("4: resists twisting or rolling", "3: resists sliding"),
            0.1,
        ),
        ([feet('contype="2" conaffinity="2"'), HEEL], "ground of", (f"{NO_PLANE[0]}, {AS_OTHERS}", None), 0),
        ([contact('<exclude body1="world" body2="calf_FOOT"/>')], "ground of", NO_PLANE, 0.1),
        ([feet('adhesion="5"')], "adhesion or", ("set", "none"), 0.005),
        ([floor('surfacevel="1 0 0 0 0 0"')], "adhesion or", ("set", "none"), 0.1),
        (
            [('type="sphere" size=".02" pos="0 0 -.2"', 'type="capsule" size=".02 .03" euler="0 90 0" pos="0 0 -.2"')],
            "shape of",
            ("capsule", "2 balls, in its ends"),
            1e-4,
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_kept_is_named(pairs, name, values, least, tmp_path):
    robot = robot_of(tmp_path, *pairs)
    row = named(robot)[name]
    assert row.in_file == values[0] and values[1] in (row.here, None)
    assert apart(robot, tmp_path) >= least
    assert ("and 3 more" in row.name) == (not name.startswith("option"))


@pytest.mark.parametrize(
    ("pairs", "words"),
    [
        ([floor('pos="0 0 -.1"')], "'foot_0_0' can touch 'floor', at z = -0.1 m; the ground is one level plane"),
        ([floor('euler="0 5 0"')], "tilted by 5 degrees"),
        ([floor('euler="180 0 0"')], "tilted by 180 degrees"),
        ([world('<geom name="step" type="box" size="1 1 1"/>')], "'step', a box in the world; .* write contype"),
        ([world('<geom name="two" type="plane" size="5 5 .1"/>')], "'two', the second ground that it can touch"),
    ],
)  # fmt: skip
def test_ground_that_is_no_level_plane_is_refused(pairs, words, tmp_path):
    with pytest.raises(InputError, match=f"robot.yaml: model: .*{words}"):
        robot_of(tmp_path, *pairs)


@pytest.mark.parametrize(
    ("pairs", "yaml", "words"),
    [
        ([world('<geom name="ground" type="box" size=".1 .1 .1" pos="0 0 9" contype="0" conaffinity="0"/>')], YAML,
         "robot.yaml: model: the package adds an element of the name 'ground'; rename that of the MJCF"),
        ([contact('<pair name="calf_FOOT_point0" geom1="trunk" geom2="foot_FOOT"/>')], f"{YAML}contacts: model",
         "the package adds an element of the name 'calf_0_0_point0'; rename"),
        ([("</worldbody>", '</worldbody><contact><pair geom1="floor" geom2="foot_0_0"/><pair geom1="foot_0_0" '
           'geom2="floor" friction="2 2 0 0 0"/></contact>')], YAML, "two <pair> are of 'floor' and 'foot_0_0'; keep"),
        ([('type="sphere" size=".02"', 'type="ellipsoid" size=".02 .02 .02"')], YAML, "calf_0_0 has an ellipsoid"),
        ([("<option", '<option gravity="0 0 0"')], YAML, "model: no gravity pulls down in base.xml; write <option gra"),
        ([("<mujoco>", f"<mujoco>{NO_CONTACT.replace('contact', 'gravity')}")], YAML, "no gravity pulls down in base"),
        ([], YAML.replace("base.xml", '"a\\0b"'), "model must be the path of an MJCF, got 'a.x00b'"),
        ([], YAML.replace("base.xml", "."), "model must be the path of an MJCF, got '.'"),
        ([], YAML.replace("]", ", foot_0_0]"), "feet: 'foot_0_0' stands there twice"),
        ([], YAML.replace("foot_1_1", "trunk"), "a box or mesh four; name geoms that give each foot as many"),
        ([], YAML + "mirror: {x: y}", "mirror: no body, joint or geom has 'x' in its name"),
        ([], YAML + "turns: [-1, 0.5, 0.2, 1]", "turns"),
        ([('name="hip" ', "")], YAML, "model: a joint that moves has no name; write name="),
        ([("</mujoco>", "<keyframe><key/></keyframe></mujoco>")], YAML.replace(HOME, "home: up\n"), "it has none"),
        ([('name="trunk" pos', 'name="tr\u00fcnk" pos')], YAML, "not UTF-8; save it as UTF-8"),
    ],
)  # fmt: skip
def test_what_the_two_files_cannot_mean_is_said(pairs, yaml, words, tmp_path):
    with pytest.raises(InputError, match=words):
        text = replaced(FOUR_LEGS, *pairs)
        (tmp_path / "base.xml").write_bytes(text.encode("latin-1"))
        (tmp_path / "robot.yaml").write_text(yaml)
        make_robot(str(tmp_path / "robot.yaml")).model  # noqa: B018


def test_a_gain_that_is_no_number_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"robot.yaml: model: the biasprm of motor 0 of joint 'hip_0_0' .8. must be a"):
        elements = motors('<position J kp="80" kv="nan" forcerange="-20 20"/>')
        robot_of(tmp_path, elements, yaml=f"model: base.xml\n{HOME}{FEET}")


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
def test_the_tree_slides_as_the_unmodified_file(cone, tmp_path):
    """Feet of four kinds: with priority, soft with a margin, without friction, and by an explicit pair."""
    pair = '<contact><pair geom1="floor" geom2="foot_1_1" friction=".2 .5" solref=".03 1"/></contact></mujoco>'
    option = f'<option cone="{cone}" impratio="10"'
    assert robot_of(tmp_path, ("</mujoco>", pair), ("<option", option), yaml=f"{YAML}cone: {cone}\n").cone == cone
    spec = mujoco.MjSpec.from_file(str(tmp_path / "base.xml"))
    for name, values in {
        "foot_0_0": {"priority": 1, "friction": (0.1, 0, 0)},
        "foot_1_0": {"margin": 0.004, "solmix": 3.0, "solref": (0.04, 1)},
        "foot_0_1": {"priority": 1, "condim": 1},
    }.items():
        for key, value in values.items():
            setattr(spec.geom(name), key, value)
    spec.compile()
    (tmp_path / "base.xml").write_text(spec.to_xml())
    robot = make_robot(str(tmp_path / "robot.yaml"))
    own = mujoco.MjModel.from_xml_path(str(tmp_path / "base.xml"))
    physics = make_physics("tree", robot=robot)
    posture = jnp.asarray(robot.posture)
    data, *_ = start(robot, robot.model)

    def law(stages):
        return 80 * (posture - stages.qpos) - 2 * stages.qvel

    world = jax.jit(lambda world: physics.run(world, law, cycles=300))(physics.start(data.qpos, data.qvel))
    np.testing.assert_allclose(world.qpos[:3], slide(robot, own), atol=1e-4)


ONE_LEG = """<mujoco><worldbody><geom name="floor" type="plane" size="5 5 .1"/>
  <body name="trunk" pos="0 0 .4"><freejoint/><geom size=".1" mass="1" contype="0" conaffinity="0"/>
    <body name="leg"><joint name="hip" axis="0 1 0"/>
      <geom name="foot" size=".02" pos="0 0 -.3" mass=".1"/></body>
  </body></worldbody></mujoco>"""


@pytest.mark.parametrize(("cone", "condim"), [("pyramidal", 1), ("elliptic", 3)])
def test_mjx_feels_a_foot(cone, condim, tmp_path):
    """Without friction its contact has one row, not the four of a pyramid; with a cone the first of three."""
    (tmp_path / "base.xml").write_text(ONE_LEG.replace("<geom", f'<geom condim="{condim}"'))
    (tmp_path / "robot.yaml").write_text(f"model: base.xml\nfeet: [foot]\ntorque: 5\ncone: {cone}\n")
    physics = make_physics("mjx-jax", robot=str(tmp_path / "robot.yaml"))
    data = mujoco.MjData(physics.model)
    data.qpos[2] = 0.319
    mujoco.mj_forward(physics.model, data)
    world = physics.start(data.qpos, data.qvel)
    forces = jax.jit(lambda world: physics.sense(world, jnp.zeros(1)).contacts.normal_force)(world)
    np.testing.assert_allclose(forces, data.sensor("leg_point0_contact").data, rtol=0.02)
    assert forces[0] > 1


@pytest.mark.parametrize(
    ("pair", "words"),
    [
        (('damping=".2"', 'damping=".2" stiffness="5 30"'), r"the stiffnesspoly of joint 'hip_0_0' .8.: take mujoco"),
        (("<option", '<option noslip_iterations="3"'), "does not compute noslip iterations: take mujoco"),
        (contact('<pair geom1="trunk" geom2="foot_FOOT" adhesion="3"/>'), "does not compute a gap, adhesion or"),
        (("<option", '<option><flag override="enable"/></option><option'), "MJX cannot represent the robot, mjtEna"),
    ],
)
def test_mjx_refuses_what_it_does_not_compute(pair, words, tmp_path):
    robot = robot_of(tmp_path, pair, yaml=f"{YAML}contacts: model\n")
    with pytest.raises(InputError, match=words):
        physics = make_physics("mjx-jax", robot=robot)
        physics.step(physics.start(physics.qpos0, jnp.zeros(robot.model.nv)), lambda _: jnp.zeros(8))


def test_an_elliptic_cone_keeps_the_softness_of_friction(tmp_path):
    """`solreffriction` of a pair, which acts in elliptic cones alone; the tree has none and says so."""
    pairs = [contact('<pair geom1="floor" geom2="foot_FOOT" friction=".3 .3" solreffriction=".2 1"/>')]
    option = "<option", '<option cone="elliptic"'
    robot = robot_of(tmp_path, *pairs, option, yaml=YAML + "cone: elliptic\n")
    assert apart(robot, tmp_path) < 1e-4
    with pytest.raises(InputError, match=r"the solreffriction of pair 'calf_0_0_point0' \(4\): take mujoco"):
        make_physics("tree", robot=robot)


def test_a_robot_that_the_tree_refuses_stands_in_native_mujoco(tmp_path):
    """With a tail on a ball joint, which has fewer velocities than coordinates."""
    tail = '<body><joint type="ball"/><geom size=".02" pos="0 0 .2" mass=".2" contype="0" conaffinity="0"/></body>'
    robot = robot_of(tmp_path, ("<freejoint/>", f"<freejoint/>{tail}"))
    task = find_policy(tmp_path / "robot.yaml").learner.task
    world = jax.jit(task.reset)(jax.random.key(0)).data.world
    assert task.physics == "mujoco" and world.qvel.shape == (robot.model.nv,)
    data = mujoco.MjData(robot.model)
    data.qpos, data.qvel = world.qpos, world.qvel
    mujoco.mj_step(robot.model, data)
    world = make_physics("mujoco", robot=robot).step(world, lambda _: jnp.zeros(8))[0]
    np.testing.assert_allclose(world.qvel, data.qvel, atol=1e-5)


def test_a_joint_without_a_motor_that_the_keyframe_moves_is_named(tmp_path):
    """Episodes begin with it as it is drawn."""
    neck = '<freejoint/><body><joint name="neck"/><geom name="head" size=".05" contype="0" conaffinity="0"/></body>'
    for angle in ("0.4", "0"):
        key = f'<keyframe><key name="up" qpos="0 0 .4 1 0 0 0 {angle}{" .6 -1.2" * 4}"/></keyframe></mujoco>'
        pairs = ("<freejoint/>", neck), motors('<motor J ctrlrange="-20 20"/>'), ("</mujoco>", key)
        robot = robot_of(tmp_path, *pairs, yaml=f"model: base.xml\n{FEET}home: up\n")
        assert ("home of" in named(robot)) == (angle != "0")


def test_bodies_keep_their_contacts_but_not_with_the_ground(tmp_path):
    """`contacts: model`, with pairs of the ground that goes."""
    pairs = [contact('<pair geom1="floor" geom2="foot_FOOT" friction=".2 .2"/>'), feet('margin=".001"')]
    robot = robot_of(tmp_path, *pairs, yaml=YAML + "contacts: model\n")
    own = mujoco.MjModel.from_xml_path(str(tmp_path / "base.xml"))
    assert np.linalg.norm(slide(robot, own) - slide(robot, robot.model)) < 1e-4
    (lost,) = [row for row in robot.differences() if row.name.startswith("contact")]
    assert lost.name == "contact of 'floor' and 'trunk'"


def test_what_would_touch_the_ground_of_the_judge_is_named(tmp_path):
    """The trunk of a file without a plane, which falls through the ground here."""
    robot = robot_of(tmp_path, ('<geom name="floor"', '<geom name="floor" contype="0" conaffinity="0"'))
    rest = []
    for model in (robot.in_file()[0].compile(), robot.model):
        data = mujoco.MjData(model)
        data.qpos[2], data.qpos[3:5] = 0.1, (0, 1)
        mujoco.mj_step(model, data, 200)
        rest.append(data.qpos[2])
    assert rest[0] > 0.04 > rest[1]
    (row,) = [row for row in robot.differences() if "--unmodified" in row.in_file]
    assert row.name == "contact of 'package_ground' and 'trunk'" and row.here == "none"


def test_masses_joints_and_options_are_those_of_the_file(tmp_path):
    robot = robot_of(tmp_path, ("<option", '<compiler settotalmass="12"/><option density="3" gravity="0 0 -5"'))
    own = mujoco.MjModel.from_xml_path(str(tmp_path / "base.xml"))
    for field in (
        name for name in dir(own) if name.startswith(("body_mass", "body_iner", "body_ipos", "jnt_", "dof_"))
    ):
        if isinstance(value := getattr(own, field), np.ndarray):
            np.testing.assert_allclose(getattr(robot.model, field), value, err_msg=field)
    assert robot.model.opt.density == 3 and robot.model.opt.gravity[2] == -5


def test_a_file_that_discards_looks_keeps_those_of_shapes_that_touch_nothing_here(tmp_path):
    pair = "<option", '<compiler discardvisual="true"/><option'
    assert robot_of(tmp_path, pair).model.ngeom == robot_of(tmp_path).model.ngeom


def test_every_element_that_the_package_adds_has_an_empty_default_class():
    """Elements of kinds that have default classes; models that the package writes itself have none."""
    found = 0
    for file in Path(humanoid_mjx.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if file.name != "legs.py" and isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                kind = node.func.attr.removeprefix("add_")
                if node.func.attr != kind and kind in ("actuator", "pair", "geom", "site", "joint", "camera", "light"):
                    assert ast.unparse(node.args[0]).endswith("PLAIN"), (file, node.lineno)
                    found += 1
    assert found >= 8


HOLD = '<position J kp="80" forcerange="-20 20"/>'


@pytest.mark.parametrize(
    ("elements", "torque", "stiffness", "damping", "words"),
    [
        (['<motor J ctrlrange="-1 1" gear="30" forcerange="-100 100"/>'], 30, 30, 0.9, None),
        (['<motor J ctrlrange="-100 100" gear="-2" forcerange="-10 10"/>'], 20, 20, 0.6, None),
        (['<motor J ctrlrange="-5 10"/>'], 10, 10, 0.3, "motor of -5 to 10 N m"),
        (['<motor J ctrlrange="-1 1" gear="10"/>'] * 2, 20, 20, 0.6, "motor of 10 N m + motor of 10 N m"),
        ([HOLD], 20, 80, 0, "position of 20 N m"),
        ([HOLD, '<velocity J kv="5" forcerange="-20 20"/>'], 20, 80, 5, "+ damper"),
        ([HOLD, '<damper J kv="5" ctrlrange="0 1"/>'], 20, 80, 5, "+ damper"),
        (
            ['<general J gear="2" gainprm="80" biastype="affine" biasprm="0 -80 -3" forcerange="-20 20"/>'],
            *(40, 320, 12, "position of 40 N m"),
        ),
        (['<position J kp="80" kv="2" timeconst=".05" forcerange="-20 20"/>'], 20, 80, 2, "filterexact of 0.05 s"),
        (['<motor J ctrlrange="-10 10" delay=".02" nsample="20"/>'], 10, 10, 0.3, "delay 0.02"),
    ],
)  # fmt: skip
def test_limits_and_gains_are_those_of_all_actuators_of_a_joint(elements, torque, stiffness, damping, words, tmp_path):
    robot = robot_of(tmp_path, motors(*elements), yaml=f"model: base.xml\n{HOME}{FEET}")
    np.testing.assert_allclose(robot.torque_limits, torque)
    np.testing.assert_allclose(robot.servo.stiffness, stiffness)
    np.testing.assert_allclose(robot.servo.damping, damping)
    rows = named(robot)
    assert words in rows["actuator of"].in_file if words else "actuator of" not in rows


@pytest.mark.parametrize(("group", "torque"), [(1, 10), (2, 20), (30, 30)])
def test_actuators_of_disabled_groups_do_not_count(group, torque, tmp_path):
    elements = motors('<position J kp="80" forcerange="-20 20" group="1"/>', '<motor J ctrlrange="-10 10" group="2"/>')
    option = "<option", f'<option actuatorgroupdisable="{group}"'
    robot = robot_of(tmp_path, elements, option, yaml=f"model: base.xml\n{HOME}{FEET}")
    np.testing.assert_allclose(robot.torque_limits, torque)
    np.testing.assert_allclose(robot.servo.stiffness, 80 if group > 1 else 10)
    assert named(robot)["actuator of"].in_file.count("disabled") == (group < 3)


@pytest.mark.parametrize(
    "elements",
    [
        ['<position J kp="80" kv="2" ctrlrange="-.3 .9"/>'],
        ['<position J kp="20" gear="-2" ctrlrange="-1 .4"/>'],
        ['<general J gainprm="40" biastype="affine" biasprm="3 -80 -2" ctrlrange="-.5 .5"/>'],
        ['<position J kp="80" inheritrange="1"/>', '<damper J kv="1" ctrlrange="0 2"/>'],
        ['<intvelocity J kp="80" ctrlrange="-1 1" actrange="-.3 .9"/>'],
        ['<motor J ctrlrange="-1 1" gear="20"/>'],
    ],
)
def test_set_points_end_where_those_of_the_files_actuators_end(elements, tmp_path):
    """Where native MuJoCo's actuators bring a joint to rest that is asked to go far."""
    text = motors(*elements)
    robot = robot_of(tmp_path, text, yaml=f'model: base.xml\nhome: {{".*": 5}}\n{FEET}{SERVO}torque: 20\n')
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "base.xml"))
    if "motor" in elements[0]:
        assert np.isinf(robot.setpoint_limits).all()
        return
    joint, data, rests = model.joint(robot.joints[0]), mujoco.MjData(model), []
    aims = np.flatnonzero(model.actuator_trnid[:, 0] == joint.id)[0]
    for side in -1, 1:
        data.ctrl[aims] = side * np.sign(model.actuator_gear[aims, 0]) * 50
        data.act[:] = side * 50
        mujoco.mj_step(model, data, min(model.na, 1))  # which brings activations within their limits
        mujoco.mj_forward(model, data)
        stiffness = -model.actuator_biasprm[aims, 1] * model.actuator_gear[aims, 0]
        rests.append(data.actuator_force[aims] / stiffness + data.qpos[joint.qposadr[0]])
    np.testing.assert_allclose(robot.setpoint_limits[:, 0], rests, rtol=1e-6)
    task = make_task("walk", robot=str(tmp_path / "robot.yaml"), physics="mujoco", symmetric=False, action_scale=90)
    for side in -1.0, 1.0:
        far = task.setpoint(jnp.full(len(robot.joints), side))
        expected = np.clip(side * np.pi / 2 + robot.posture[0], *rests)
        np.testing.assert_allclose(far[0], expected, rtol=1e-5)


def test_a_posture_that_no_set_point_reaches_is_refused(tmp_path):
    elements = motors('<position J kp="80" gear="-2" ctrlrange="-2 2"/>')
    with pytest.raises(InputError, match=r"knee_0_0 at -70 degrees is beyond set-points of its actuators, -57.2958 to"):
        robot_of(tmp_path, elements)


@pytest.mark.parametrize(
    ("default", "elements", "yaml", "torque"),
    [
        ('<motor gear="50" ctrlrange="-.4 .4"/>', ["<motor J/>"], SERVO, 20),
        ('<position forcerange="-5 5"/>', ['<position J kp="80" kv="2"/>'], "torque: 20\n", 20),
    ],
)
def test_the_packages_motors_inherit_no_default(default, elements, yaml, torque, tmp_path):
    pairs = [("<default/>", f"<default>{default}</default>"), motors(*elements)]
    robot = robot_of(tmp_path, *pairs, yaml=f"model: base.xml\n{HOME}{FEET}{yaml}")
    np.testing.assert_allclose(robot.torque_limits, torque)
    assert (robot.model.actuator_gear[:, 0] == 1).all() and not robot.model.actuator_forcelimited.any()


@pytest.mark.parametrize("torque", ["", "torque: 20\n"])
def test_a_limit_of_the_joint_counts(torque, tmp_path):
    """Also for the torque of the YAML; a factor on limits acts on it as in the file."""
    pair = ('damping=".2"', 'damping=".2" actuatorfrcrange="-3 7"'), motors('<motor J ctrlrange="-9 9"/>')
    robot = robot_of(tmp_path, *pair, yaml=f"model: base.xml\n{HOME}{FEET}{torque}")
    np.testing.assert_allclose(robot.torque_limits, 7)
    assert named(robot)["actuator of"].in_file == "motor of -3 to 7 N m"
    found = []
    for name in "mujoco", "unmodified":
        physics = make_physics(name, robot=robot, torque_limit=1.5)
        world, asked = physics.start(physics.qpos0, jnp.zeros(robot.model.nv)), jnp.full(8, 100.0)
        found.append((physics.sense(world, asked).torque, physics.step(world, lambda _, asked=asked: asked)[0].qvel))
    for here, own in zip(*found, strict=True):
        np.testing.assert_allclose(here, own, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(found[0][0], 10.5)


def test_controls_that_are_not_clamped_limit_nothing(tmp_path):
    pairs = motors('<motor J ctrlrange="-9 9"/>'), ("<option", '<option><flag clampctrl="disable"/></option><option')
    with pytest.raises(InputError, match="torque: the model has no limit for hip_0_0"):
        robot_of(tmp_path, *pairs, yaml=f"model: base.xml\n{HOME}{FEET}")
    robot = make_physics("mujoco", robot=robot_of(tmp_path, *pairs)).robot
    assert named(robot)["option disableflags"][1:] == ("clampctrl", "none")


@pytest.mark.parametrize("element", ["<motor J/>", "<muscle J/>", '<motor J ctrlrange="-1 1" gear="0"/>'])
def test_a_limit_that_the_file_lacks_is_asked_for(element, tmp_path):
    with pytest.raises(InputError, match=r'torque: the .*limit .*hip_0_0; write its N m as torque: ."hip_0_0": 20'):
        robot_of(tmp_path, motors(element), yaml=f"model: base.xml\n{HOME}{FEET}")


MOUNT = ('<body name="thigh" pos=".18 .12 0">', '<body name="mount" pos=".18 .12 0"><body name="thigh">')


def test_legs_end_at_a_joint_that_exists(tmp_path):
    """Below a body without a joint, and below a waist whose joint is higher."""
    plain = robot_of(tmp_path).leg_length
    assert plain == pytest.approx(0.348, abs=1e-3)
    end = ("        </body>\n      </replicate>", "        </body></body>\n      </replicate>")
    assert robot_of(tmp_path, MOUNT, end).leg_length == pytest.approx(plain, abs=1e-9)
    waist = (
        '<body name="pelvis"><joint name="waist" axis="0 0 1" pos="0 0 .3"/><geom size=".01" mass=".01" contype="0"/>'
    )
    legs = '<replicate count="2" sep="_" offset="-.36 0 0">'
    below = (legs, waist + legs), ("</replicate></replicate>", "</replicate></replicate></body>")
    assert robot_of(tmp_path, *below).leg_length == pytest.approx(plain, abs=1e-9)


def test_feet_above_the_hips_are_refused(tmp_path):
    words = r"home: the feet are above the hips: calf_0_0 is .* m above the ground, its hip 'hip_0_0' .* m"
    with pytest.raises(InputError, match=words):
        robot_of(tmp_path, ('range="-80 80"', 'range="-180 180"'), yaml=YAML.replace('"hip.*": 35', '"hip.*": 160'))


def turned(euler):
    """The same robot, with the frame of its trunk turned and all below turned back."""
    body = f'<body euler="{euler}"><geom size="1"/></body>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    back = " ".join(map(repr, (model.body_quat[1] * [1, -1, -1, -1]).tolist()))
    trunk = '<body name="trunk" pos="0 0 .4">'
    yield trunk, trunk.replace(">", f' euler="{euler}">')
    yield "<freejoint/>", f'<freejoint/><frame quat="{back}">'
    yield "    </body>\n  </worldbody>", "    </frame></body>\n  </worldbody>"


INERTIAL = (
    '<geom name="trunk"',
    '<inertial pos=".01 .02 .03" mass="6" fullinertia=".2 .25 .3 .01 .02 .03"/><geom name="trunk"',
)


@pytest.mark.parametrize("euler", ["90 0 0", "0 90 0", "180 0 0", "10 20 30", "90 30 0"])
def test_a_trunk_with_a_turned_frame_is_the_same_robot(euler, tmp_path):
    plain = robot_of(tmp_path)
    where = slide(plain, plain.model)
    robot = robot_of(tmp_path, *turned(euler))
    np.testing.assert_allclose(slide(robot, robot.model), where, atol=1e-12)
    np.testing.assert_allclose(robot.soles, plain.soles, atol=1e-12)
    assert (robot.leg_length, robot.start_height) == pytest.approx((plain.leg_length, plain.start_height))
    assert named(robot)["frame of"].here == "upright at home"


def test_an_inertia_turns_with_its_frame(tmp_path):
    """Given in the file for the turned trunk, against native MuJoCo on the file itself."""
    scaled = "<option", '<compiler settotalmass="12"/><option'
    inertial = "<freejoint/>", f"<freejoint/>{INERTIAL[1].split('<geom')[0]}"
    robot = robot_of(tmp_path, *turned("90 0 0"), inertial, scaled)
    own = mujoco.MjModel.from_xml_path(str(tmp_path / "base.xml"))
    one, two = mujoco.MjData(own), mujoco.MjData(robot.model)
    two.qpos[:3] = own.qpos0[:3]
    for model, data in ((own, one), (robot.model, two)):
        mujoco.mj_forward(model, data)
    np.testing.assert_allclose(two.subtree_com[1], one.subtree_com[1], atol=1e-9)
    np.testing.assert_allclose(two.xipos, one.xipos, atol=1e-9)
    moments = []
    for model, data in ((own, one), (robot.model, two)):
        axes = data.ximat.reshape(-1, 3, 3)
        moments.append(np.einsum("bij,bj,bkj->bik", axes, model.body_inertia, axes))
    np.testing.assert_allclose(*moments, atol=1e-9)


@pytest.mark.parametrize("held", [True, False])
def test_an_equality_that_holds_a_turned_trunk_by_its_frame_is_refused(held, tmp_path):
    """One of a joint that has the trunk's name does not."""
    joint = '<freejoint/><body><joint name="trunk"/><geom size=".05"/></body>'
    held_by = '<connect body1="trunk" anchor="0 0 0"/>' if held else '<joint joint1="trunk"/>'
    equality = "</mujoco>", f"<equality>{held_by}</equality></mujoco>"
    with pytest.raises(InputError, match="and an <equality> holds it by its frame") if held else nullcontext():
        robot_of(tmp_path, *turned("90 0 0"), equality, ("<freejoint/>", joint))


def test_a_turned_trunk_starts_on_its_feet_and_sees_the_same(tmp_path):
    states = []
    for pairs in ([], list(turned("90 0 0"))):
        task = make_task("stand", robot=robot_of(tmp_path, *pairs), physics="mujoco")
        states.append(jax.jit(task.reset)(jax.random.key(0)))
        data = mujoco.MjData(task.robot.model)
        data.qpos = states[-1].data.world.qpos
        mujoco.mj_kinematics(task.robot.model, data)
        heights = [data.geom(f"foot_{i}_{j}").xpos[2] - 0.02 for i in "01" for j in "01"]
        assert min(heights) > -0.01 and max(heights) < 0.03
    np.testing.assert_allclose(states[0].obs, states[1].obs, atol=1e-6)


def test_a_keyframe_that_leans_is_home_and_its_heading_is_not(tmp_path):
    """A lean that lowers the front: the soles are where the keyframe has them."""
    angles = " ".join(f"{angle}" for _ in range(4) for angle in np.radians([35, -70]))
    yaml = YAML.replace(HOME, "home: stand\n")
    soles = {}
    for quat in ("1 0 0 0", ".7071068 0 0 .7071068", ".998 0 .0632 0"):
        key = f'<keyframe><key name="stand" qpos="0 0 .3 {quat} {angles}"/></keyframe></mujoco>'
        robot = robot_of(tmp_path, ("</mujoco>", key), yaml=yaml)
        soles[quat] = robot.soles
        own = mujoco.MjModel.from_xml_path(str(tmp_path / "base.xml"))
        data = mujoco.MjData(own)
        data.qpos = own.key_qpos[0] * 1.0
        mujoco.mj_kinematics(own, data)
    level, headed, leant = soles.values()
    np.testing.assert_allclose(level, headed, atol=1e-6)
    expected = [data.geom(f"foot_{i}_{j}").xpos - data.xpos[1] - [0, 0, 0.02] for j in "01" for i in "01"]
    np.testing.assert_allclose(leant, expected, atol=1e-3)


def test_a_turn_about_the_vertical_alone_is_refused(tmp_path):
    with pytest.raises(InputError, match="'trunk' is turned about the vertical; write it without"):
        robot_of(tmp_path, ('<body name="trunk" pos="0 0 .4">', '<body name="trunk" pos="0 0 .4" euler="0 0 90">'))


def test_info_and_the_report_show_the_table_and_mujocos_warnings(tmp_path, monkeypatch):
    pairs = [("<option", '<compiler settotalmass="9"/><option cone="elliptic"')]
    robot_of(tmp_path, *pairs)
    name = str(tmp_path / "robot.yaml")
    with console.capture() as shown:
        show_info(name, (), False)
    for words in (
        "differs from the MJCF in the file here",
        "option cone elliptic pyramidal",
        "MuJoCo warns compiler attribute",
    ):
        assert words in " ".join(shown.get().split()), words
    for slow in ("training_bytes", "disk_bytes", "runs_at_once"):
        monkeypatch.setattr(cost, slow, lambda *_, **__: 1)
    monkeypatch.setattr(Group, "bytes", 1)
    with console.capture() as shown:
        show_info("stand_cpu", (f"task.robot={name}",), False)
    assert "option timestep 0.002 0.004" in " ".join(shown.get().split())
    task = make_task("stand", robot=name, physics="mujoco")
    assert "<td>option cone</td><td>elliptic</td><td>pyramidal</td>" in table(HEADINGS, differences_of(task))


def test_warnings_of_mujoco_are_not_raw_lines(tmp_path, recwarn):
    robot = robot_of(tmp_path, ("<option", '<compiler settotalmass="9"/><option'))
    _team(robot, None, jax.tree.structure(None))
    assert robot.mass == pytest.approx(9) and not recwarn.list
