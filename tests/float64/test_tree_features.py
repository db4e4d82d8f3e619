"""What trees may have, each on a robot as small as can be, against native MuJoCo with a converged solver."""

from collections import Counter

import mujoco
import numpy as np
import pytest
from tree_robots import PLANAR, QUADRUPED, SHAPES, converged, dropped, native, qacc_of, states

from humanoid_mjx.mechanics.tree.folding import fold
from humanoid_mjx.mechanics.tree.pairs import SLOTS
from humanoid_mjx.mechanics.tree.reading import read_tree
from humanoid_mjx.mechanics.tree.step import Values

HINGED = """<mujoco><option {option}/><worldbody>
    <geom type="plane" size="0 0 1" friction="0.6"/>
    <body pos="0 0 0.3"><freejoint/><geom type="capsule" size="0.03 0.1" mass="1"/>
    <body pos="0.15 0 0"><joint axis="0 1 0" range="-60 60" limited="true" damping="0.05" frictionloss="0.01"/>
    <geom size="0.05" mass="0.4"/></body></body></worldbody></mujoco>"""


def test_steps_are_mujocos():
    """Also of another length, by the integrator that derives forces by velocities; boxes and shapes move by Euler's."""
    agrees(PLANAR.replace("<option", '<option timestep="0.004" integrator="implicitfast"'))


def agrees(xml, count=300, seed=0):
    model = converged(mujoco.MjModel.from_xml_string(xml))
    agree(model, dropped(model, count, seed))


def agree(model, at):
    """Accelerations, and positions and velocities after a step."""
    tree = fold(read_tree(model))
    qpos, qvel, qacc, settled = qacc_of(tree, 1)(Values(), *at)
    assert settled.all()
    expected = native(model, *at)
    size = 1.0 + np.linalg.norm(expected, axis=1)
    assert (np.linalg.norm(qacc - expected, axis=1) / size).max() < 1e-9
    data = mujoco.MjData(model)
    for i, (data.qpos, data.qvel, data.ctrl) in enumerate(zip(*at, strict=True)):
        data.qacc_warmstart = 0.0
        mujoco.mj_step(model, data)
        # What rounding of the accelerations comes to in a step.
        atol = 1e-9 * size[i] * model.opt.timestep + 1e-12
        np.testing.assert_allclose(qvel[i], data.qvel, rtol=0.0, atol=atol)
        np.testing.assert_allclose(qpos[i], data.qpos, rtol=0.0, atol=atol)


def test_a_pair_of_one_body_moves_nothing():
    """Two balls that overlap, one of them on a body without a joint."""
    balls = '<geom name="one" size="0.05"/><body pos="0.02 0 0"><geom name="two" size="0.05"/></body>'
    xml = HINGED.format(option="").replace("<freejoint/>", f"<freejoint/>{balls}")
    agrees(xml.replace("</mujoco>", '<contact><pair geom1="one" geom2="two"/></contact></mujoco>'), count=20)


LEAVES, STICKS, SLIDES = (
    getattr(mujoco.mjtConstraintState, f"mjCNSTRSTATE_{name}") for name in ("SATISFIED", "QUADRATIC", "CONE")
)


def zones(model, at):
    """MuJoCo's states of the contacts with elliptic cones."""
    found, data = set(), mujoco.MjData(model)
    for data.qpos, data.qvel, data.ctrl in zip(*at, strict=True):
        mujoco.mj_forward(model, data)
        found.update(data.efc_state[data.efc_type == mujoco.mjtConstraint.mjCNSTR_CONTACT_ELLIPTIC].tolist())
    return found


@pytest.mark.parametrize(("xml", "impratio"), [(QUADRUPED, 10.0), (HINGED, 100.0)], ids=["quadruped", "hinged"])
def test_elliptic_cones_are_mujocos(xml, impratio):
    """With unequal friction and without, of bodies with each other, and beside the dry friction of a joint."""
    model = converged(mujoco.MjModel.from_xml_string(xml.format(option="")))
    model.opt.cone, model.opt.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, impratio
    at = states(model, 300) if xml is QUADRUPED else dropped(model, 100)
    agree(model, at)
    assert zones(model, at) >= {STICKS, SLIDES} | ({LEAVES} if xml is QUADRUPED else set())


@pytest.mark.parametrize("option", ['integrator="Euler"', 'cone="elliptic"', 'integrator="RK4"'])
@pytest.mark.parametrize("resists", ['damping="0.7"', 'armature="0.3"', 'frictionloss="0.8"', ""])
def test_what_resists_a_free_joint_is_mujocos(resists, option):
    """Each alone and all together: the joint of a class meant for hinges has them, too."""
    resists = resists or 'damping="0.7" armature="0.3" frictionloss="0.8"'
    xml = HINGED.replace("<freejoint/>", f'<joint type="free" {resists}/>').format(option=option)
    model = converged(mujoco.MjModel.from_xml_string(xml))
    assert model.dof_damping[:6].any() or model.dof_armature[:6].any() or model.dof_frictionloss[:6].any()
    agree(model, dropped(model, 100))


def test_shapes_on_a_plane_are_mujocos():
    """A box, cylinders that stand, lie and lean, an ellipsoid, on a slope."""
    agrees(SHAPES, count=500)


def test_a_cylinder_that_stands_is_mujocos():
    """On one point of a rim and on three, level and leaning, either end down."""
    xml = """<mujoco><worldbody><geom type="plane" size="0 0 1"/>
    <body><freejoint/><geom type="cylinder" size="0.05 0.03" mass="1"/></body></worldbody></mujoco>"""
    model, rng, counts = converged(mujoco.MjModel.from_xml_string(xml)), np.random.default_rng(0), Counter[int]()
    qpos, data = np.tile(model.qpos0, (100, 1)), mujoco.MjData(model)
    qpos[:, 2], qpos[::2, 3:5] = 0.028, (0.0, 1.0)
    qpos[:90, 3:7] += rng.choice([0.01, 0.1], (90, 1)) * rng.normal(size=(90, 4))
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    for data.qpos in qpos:
        mujoco.mj_forward(model, data)
        counts[data.ncon] += 1
    assert min(counts[1], counts[3]) > 30, counts
    agree(model, (qpos, rng.normal(size=(100, model.nv)), np.zeros((100, 0))))


def test_boxes_that_touch_each_other_are_mujocos():
    """Two boxes that fold onto each other and onto a fixed one: with friction, without."""
    xml = """<mujoco><worldbody><geom name="wall" type="box" size="0.05 0.1 0.02" margin="0.001"/>
    <body pos="0 0.07 0"><joint axis="1 0 0" range="-40 150" limited="true"/><joint axis="0 1 0"/>
    <geom type="box" size="0.06 0.03 0.08" pos="0 0 0.11" mass="0.5"/></body>
    <body pos="0 -0.07 0"><joint axis="1 0 0" range="-150 40" limited="true"/><joint axis="0 1 0.2"/>
    <geom name="box" type="box" size="0.04 0.02 0.09" pos="0 0 0.12" mass="0.4" friction="0.7" margin="0.001"/></body>
    </worldbody><contact><pair geom1="wall" geom2="box" condim="1"/></contact></mujoco>"""
    agrees(xml, count=200)


@pytest.mark.parametrize("pads", [1, 5], ids=["few", "many"])
def test_balls_and_capsules_that_touch_boxes_are_mujocos(pads):
    """Of the body before and of the world, with margins and friction of their own; many pairs are looked at in a loop,
    and two limbs of one build are one."""
    pad = '<geom type="box" size="0.05 0.02 0.04" pos="{} 0.02 0.1" euler="{} 20 0" mass="0.2" contype="2"/>'
    arm = """<body pos="{} -0.07 0"><joint axis="1 0 0" range="-70 30"/><joint axis="0 1 0.2" range="-30 30"/>
    <joint axis="0.1 0 1" range="-90 90"/><geom name="arm{}" type="capsule" size="0.02 0.05" pos="0 0 0.1"
      euler="0 40 0" mass="0.4" friction="0.7" margin="0.001" conaffinity="2"/>
    <geom name="tip{}" size="0.03" pos="0 0 0.15" mass="0.2" conaffinity="2"/></body>"""
    pair = """<pair geom1="wall" geom2="arm{}" condim="1"/><pair geom1="tip{}" geom2="wall" friction="0.3 0.5 1 1 1"
    solref="0.01 1.2" margin="0.002"/>"""
    xml = f"""<mujoco><default><geom conaffinity="0" contype="0"/><joint damping="0.01" limited="true"/></default>
    <worldbody><geom name="wall" type="box" size="0.15 0.1 0.02"/>
    <body pos="0 0.07 0"><joint axis="1 0 0" range="-30 70"/><joint axis="0 1 0" range="-60 60"/>
    {"".join(pad.format(0.03 * number, 10 * number) for number in range(pads))}</body>
    {"".join(arm.format(place, *(place,) * 2) for place in (0.04, -0.06))}</worldbody>
    <contact>{"".join(pair.format(place, place) for place in (0.04, -0.06))}</contact></mujoco>"""
    model = converged(mujoco.MjModel.from_xml_string(xml))
    at, data, touched, few = states(model, 300), mujoco.MjData(model), Counter[str](), []
    for data.qpos in at[0]:
        mujoco.mj_forward(model, data)
        few.append(data.ncon <= SLOTS)
        names = [sorted(model.geom(geom).name[:3] for geom in pair) for pair in data.contact.geom]
        touched.update(map("-".join, names))
    assert all(touched[pair] > 20 for pair in ("arm-wal", "tip-wal", "-arm", "-tip")), touched
    agree(model, [part[few] for part in at])


@pytest.mark.parametrize(
    ("foot", "plane"), [('margin="{}"', ""), ('contype="{}"', '<geom type="plane" size="0 0 1" pos="0 0 .02" {}/>')]
)
def test_limbs_of_one_build_differ_in_where_they_touch(foot, plane):
    """In their margins, and in the planes that they touch."""
    legs = "".join(
        f"""<body pos="0 {side} 0"><joint axis="0 1 0" range="-60 60" limited="true" damping=".05"/>
        <geom size=".05" pos="0 0 -.1" mass=".4" {foot.format(value)}/></body>"""
        for side, value in ((-0.1, 2 if plane else 0.01), (0.1, 4 if plane else 0.002))
    )
    floor = '<geom type="plane" size="0 0 1" contype="0" conaffinity="3"/>'
    agrees(f"""<mujoco><worldbody>{floor}{plane.format('contype="0" conaffinity="4"')}<body pos="0 0 0.2"><freejoint/>
      <geom type="capsule" size=".03 .1" mass="1" contype="1" conaffinity="0"/>{legs}</body></worldbody></mujoco>""")


def test_free_bodies_turn_by_runge_and_kuttas_method():
    agrees(HINGED.format(option='integrator="RK4" timestep="0.01"'), count=50, seed=1)


def test_upright_capsules_rub():
    """Where the axis of a capsule gives no tangent, as of legs at home."""
    xml = """<mujoco><worldbody><geom type="plane" size="0 0 1"/>
    <body pos="0 0 0.29"><freejoint/><geom type="capsule" size="0.1 0.2" mass="2"/></body></worldbody></mujoco>"""
    model = converged(mujoco.MjModel.from_xml_string(xml))
    at = model.qpos0[None], np.array([[1.0, 2.0, -0.1, 0.0, 0.0, 0.0]]), np.zeros((1, 0))
    expected = native(model, *at)
    assert (expected[0, :2] < -1.0).all()
    np.testing.assert_allclose(qacc_of(read_tree(model))(Values(), *at)[0], expected, atol=1e-9)
