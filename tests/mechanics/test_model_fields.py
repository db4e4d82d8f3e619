"""No field of a MuJoCo model is lost: the tree reads it, or refuses it by name, or it moves nothing."""

import mujoco
import numpy as np
import pytest
from model_fields import (
    APART,
    CHOICES,
    COMPUTED,
    DERIVED,
    IDLE,
    IMU,
    REFUSED,
    REFUSED_ELSEWHERE,
    SOLVER,
    STRUCTURE,
    changed,
    get,
    make,
    moved,
    names_of,
    put,
)

from humanoid_mjx.mechanics.tree.reading import read_tree
from humanoid_mjx.mechanics.tree.refusing import faults, robot_faults

MOTION, TREE = moved(make()), read_tree(make(), IMU)


def words_of(model):
    return [fault.what for fault in faults(model, IMU) + robot_faults(model)]


def test_every_field_is_listed_once():
    """One that MuJoCo adds is in no list: find out what it does, and read it or refuse it."""
    model = make()
    lists = COMPUTED, CHOICES, STRUCTURE, tuple(REFUSED), REFUSED_ELSEWHERE, IDLE, SOLVER, DERIVED
    listed, apart = [name for names in lists for name in names], {prefix for of in APART.values() for prefix in of}
    assert len(listed) == len(set(listed))
    every = {*names_of(model), *names_of(model.opt, "opt_"), *names_of(model.stat, "stat_")} - {"opt", "stat"}
    sizes = {name for name in every if name.startswith("n") and isinstance(getattr(model, name, None), int)}
    others = {name for name in every - sizes if not name.endswith(("_user", "_matid"))}
    assert {name for name in others if name.partition("_")[0] not in apart} - set(listed) == set()


@pytest.mark.parametrize("field", COMPUTED)
def test_a_number_that_moves_a_model_is_read(field):
    """The float64 test says that it is read rightly."""
    model = make()
    put(model, field, changed(model, field, np.random.default_rng(0)))
    assert np.abs(moved(model) - MOTION).max() > 1e-6
    assert not words_of(model) and (field.startswith(("actuator", "jnt_actfrc")) or read_tree(model, IMU) != TREE)


@pytest.mark.parametrize("field", IDLE)
def test_what_is_ignored_moves_nothing(field):
    model = make()
    put(model, field, changed(model, field, np.random.default_rng(0)))
    np.testing.assert_array_equal(moved(model), MOTION)
    assert not words_of(model) and read_tree(model, IMU) == TREE


@pytest.mark.parametrize("field", REFUSED)
def test_what_is_not_computed_is_refused_by_its_name(field):
    """With the element, or for a motor without a name its number and joint."""
    kind, _, name = field.partition("_")
    word = {"jnt": "joint", "dof": "joint", "actuator": "motor"}.get(kind, kind)
    rows = len(get(make(), field))
    for row in (0, rows - 1):
        model, kind = make(), kind if kind != "dof" else "jnt"
        values = np.zeros_like(get(model, field))
        values[row] = REFUSED[field]
        put(model, field, values)
        element = repr(getattr(model, kind)(row).name)
        if kind == "actuator" and row:
            element = "2" if name == "trntype" else "2 of joint 'way'"
        assert f"the {name} of {word} {element}" in words_of(model)


FLAGS = mujoco.mjtDisableBit.__members__
SAME = {
    "SPRING": ("jnt_stiffness",),
    "DAMPER": ("dof_damping",),
    "GRAVITY": ("opt_gravity",),
    "LIMIT": ("jnt_limited",),
    "FRICTIONLOSS": ("dof_frictionloss",),
    **dict.fromkeys(("WARMSTART", "MIDPHASE", "AUTORESET", "NATIVECCD", "ISLAND", "MULTICCD", "EQUALITY"), ()),
}
"""Flags that are the same as these fields at 0."""


@pytest.mark.parametrize("flag", SAME)
def test_a_flag_is_the_same_as_nothing_to_disable(flag):
    one, other = make(), make()
    one.opt.disableflags |= int(FLAGS[f"mjDSBL_{flag}"])
    for field in SAME[flag]:
        put(other, field, 0)
    np.testing.assert_allclose(moved(one), moved(other), rtol=1e-11, atol=1e-11)
    assert not words_of(one) and read_tree(one, IMU) == read_tree(other, IMU)


def test_no_other_flag_is_let_through():
    """Those of contacts leave none; four are in the float64 test; the rest are refused."""
    refused = {
        "ACTUATION": "disabled motors",
        "SENSOR": "disabled sensors",
        "CLAMPCTRL": "the ctrllimited of motor 'hip'",
    }
    for flag in FLAGS.keys() - {"mjNDISABLE"}:
        name, model = flag.removeprefix("mjDSBL_"), make()
        model.opt.disableflags |= int(FLAGS[flag])
        if name in ("CONTACT", "CONSTRAINT"):
            tree = read_tree(model, IMU)
            assert (
                not tree.ground and not tree.pairs and any(joint.limit for joint in tree.joints) == (name == "CONTACT")
            )
        elif name not in (*SAME, "REFSAFE", "EULERDAMP", "FILTERPARENT"):
            assert words_of(model) == [refused[name]], name
    for flag, bit in mujoco.mjtEnableBit.__members__.items():
        name, model = flag.removeprefix("mjENBL_").lower(), make()
        model.opt.enableflags |= int(bit) if flag != "mjNENABLE" else 0
        quiet = name in ("energy", "fwdinv", "invdiscrete", "mjnenable")
        assert words_of(model) == ([] if quiet else [f"the flag {name}"])
        assert not quiet or (moved(model) == MOTION).all()


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        *((field, 0.1, "a gap, adhesion or surface velocity of contacts, as those of 'floor' and")
          for field in ("geom_gap", "geom_adhesion", "geom_surfacevel", "pair_gap", "pair_adhesion")),
        ("opt_density", 1.2, "a fluid"),
        ("opt_viscosity", 1.2, "a fluid"),
        ("opt_noslip_iterations", 1, "noslip iterations"),
        ("opt_integrator", 2, "the implicit integrator"),
        ("opt_integrator", 4, "the discrete integrator"),
        ("opt_disableactuator", 1, "disabled motors"),
        ("geom_condim", 4, "contacts that resist twisting or rolling, as those of 'floor' and 'foot' (3)"),
        ("pair_dim", 6, "contacts that resist twisting or rolling, as those of 'floor' and 'lower'"),
        ("jnt_solref", (0.02, -1.0), "the solref of joint 'hip' (2)"),
        ("dof_solref", (-100.0, 1.0), "the solref of joint 'hip'"),
        ("geom_solref", (-100.0, 1.0), "a solref of which one value is positive, as those of 'floor' and 'foot' (3)"),
        ("jnt_range", (0.0, 0.0), "the range of joint 'hip' (2)"),
        ("geom_size", np.inf, "the size of geom 'floor' (5)"),
        ("body_mass", np.nan, "the mass of body 'world' (4)"),
        ("actuator_gear", 0.0, "the gear of motor 'hip' (3)"),
        ("actuator_gainprm", 0.0, "the gainprm of motor 'hip' (3)"),
        ("actuator_ctrlrange", (-1.0, 2.0), "the ctrlrange of motor 'hip'"),
        ("actuator_forcerange", (-1.0, 2.0), "the forcerange of motor 1 of joint 'knee'"),
    ],
)  # fmt: skip
def test_other_refusals_name_the_element(field, value, words):
    model = make()
    put(model, field, value)
    assert any(said.startswith(words) for said in words_of(model)), words_of(model)


def test_friction_of_its_own_softness_is_refused_where_it_acts():
    """In elliptic cones alone: a pyramid has one softness."""
    model = make()
    model.opt.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    before = moved(model)
    assert not words_of(model)
    model.pair_solreffriction[0] = -400.0, -30.0
    assert np.abs(moved(model) - before).max() > 1e-6
    assert words_of(model) == ["the solreffriction of pair 'toe'"]


SHAPES = {
    "plane": 'type="plane" size="1 1 1"',
    "height field": 'type="hfield" hfield="h"',
    "sphere": 'size=".1"',
    "capsule": 'type="capsule" size=".08 .1"',
    "ellipsoid": 'type="ellipsoid" size=".1 .12 .08"',
    "cylinder": 'type="cylinder" size=".09 .1"',
    "box": 'type="box" size=".1 .09 .08"',
    "mesh": 'type="mesh" mesh="m"',
}
PAIR = """<mujoco><asset><hfield name="h" nrow="2" ncol="2" elevation="1 1 1 1" size=".3 .3 .1 .1"/>
<mesh name="m" vertex="-.1 -.1 -.1 .1 -.1 -.1 0 .1 -.1 0 0 .1"/></asset><worldbody><geom name="a" {}/>
<body pos="0 0 .05"><joint axis="1 .1 0" pos="1 0 0"/><geom name="b" {}/></body></worldbody></mujoco>"""


@pytest.mark.parametrize("one", SHAPES)
def test_no_two_shapes_pass_through_each_other(one):
    """Where MuJoCo has a contact the tree has one, or refuses the two by name."""
    for two in SHAPES.keys() - {"plane", "height field"}:
        model = mujoco.MjModel.from_xml_string(PAIR.format(SHAPES[one], SHAPES[two]))
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        assert data.ncon, two
        if found := [fault.what for fault in faults(model)]:
            assert one in found[0] and two in found[0] and "'a'" in found[0] and "'b'" in found[0]
        else:
            tree = read_tree(model)
            assert tree.ground or tree.pairs


@pytest.mark.parametrize(
    ("joint", "taken"),
    [
        ('type="slide" axis="0 0 1"', False),
        ('axis="0 1 0"', False),
        ('axis="1 0 0"', True),
        ('axis="0 1 0.001"', True),
    ],
)
def test_capsules_that_stay_parallel_are_refused(joint, taken):
    """MuJoCo makes two contacts of them, the tree one."""
    model = mujoco.MjModel.from_xml_string(f"""<mujoco><worldbody>
    <geom name="a" type="capsule" size=".1 .1" euler="90 0 0"/>
    <body pos="0 0 .19"><joint {joint}/><geom name="b" type="capsule" size=".1 .2" euler="90 0 0"/></body>
    </worldbody></mujoco>""")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.ncon == 2
    words = [] if taken else ["two contacts of capsules that stay parallel, as those of 'a' and 'b'"]
    assert [fault.what for fault in faults(model)] == words


@pytest.mark.parametrize(
    ("turned", "joint", "taken"),
    [
        ("0 0 0", 'type="slide"', False),
        ("0 0 0", 'axis="0 0 1"', False),
        ("30 0 0", 'axis="1 0 0"', False),
        ("30 0 0", 'axis="1 0.001 0"', True),
        ("30 0 0", 'axis="0 0 1"', True),
        ("30 20 0", 'axis="1 0 0"', True),
    ],
)
def test_capsules_that_stay_parallel_to_a_face_are_refused(turned, joint, taken):
    """Their second contact hangs on the sign of what is zero but for rounding."""
    model = mujoco.MjModel.from_xml_string(f"""<mujoco><worldbody><geom name="a" type="box" size=".1 .1 .1"/>
    <body pos="0 0 .1"><joint {joint}/><geom name="b" type="capsule" size=".1 .2" euler="{turned}"/></body>
    </worldbody></mujoco>""")
    words = [] if taken else ["contacts of a capsule that stays parallel to a face of a box, as those of 'b' and 'a'"]
    assert [fault.what for fault in faults(model)] == words
