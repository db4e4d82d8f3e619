"""The tree in single precision: against native MuJoCo, and what it refuses."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from tree_robots import HOPPER, near_upright

from humanoid_mjx.mechanics.tree.reading import read_tree
from humanoid_mjx.mechanics.tree.refusing import faults
from humanoid_mjx.physics import make_physics
from humanoid_mjx.spec import InputError

TREE, NATIVE = (make_physics(name, robot={"ranges": "human"}) for name in ("tree", "mujoco"))


@pytest.fixture(scope="module")
def worlds():
    return near_upright(TREE)


def test_an_unsettled_world_is_flagged_and_stays(monkeypatch, worlds):
    """A single step of the search does not get from standing in the air to falling on both feet and beyond."""
    from humanoid_mjx.kernels.worlds import one_kernel
    from humanoid_mjx.mechanics.tree import search

    monkeypatch.setattr(search, "MOST_STEPS", 1)
    one_kernel.cache_clear()
    qpos = worlds.qpos.at[1, 2].add(1.0)
    start = worlds._replace(qpos=qpos, warmstart=worlds.warmstart.at[:, 2].set(1e3))
    try:
        after = jax.jit(jax.vmap(lambda world: TREE.step(world, lambda stages: jnp.zeros(10))[0]))(start)
    finally:
        one_kernel.cache_clear()
    np.testing.assert_array_equal(after.diverged, [True, False, True, True])
    np.testing.assert_array_equal(after.qpos[0], start.qpos[0])
    assert (after.qpos[1] != start.qpos[1]).any()


REFUSED = {"ball joints, as 'j'": 'name="j" type="ball"', "a spring of a free joint": 'type="free" stiffness="1"'}


def test_a_free_joint_resists_alike_in_all_directions():
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint type="free" damping="1"/><geom size="0.1"/></body></worldbody></mujoco>'
    )
    assert read_tree(model).drag == (0.0, 1.0, ())
    model.dof_damping[2] = 0.5
    with pytest.raises(InputError, match="damping, armature or friction that differs along a free joint"):
        read_tree(model)


@pytest.mark.parametrize("words", REFUSED)
def test_joints_that_are_refused(words):
    body = f'<body><joint {REFUSED[words]}/><geom type="sphere" size="0.1"/></body>'
    xml = f"<mujoco>{{}}<worldbody>{body}</worldbody></mujoco>"
    with pytest.raises(InputError) as error:
        read_tree(mujoco.MjModel.from_xml_string(xml.format("")))
    assert str(error.value) == f"physics: the tree cannot represent {words}: take mujoco, or try mjx-jax."
    if "spring" in words:
        read_tree(mujoco.MjModel.from_xml_string(xml.format('<option><flag spring="disable"/></option>')))


def test_a_body_without_joints_is_refused_where_its_turns_are_implicit():
    """MuJoCo's `implicitfast` derives gyroscopic torques of a body that is free alone, and of no other."""
    xml = """<mujoco><option integrator="{}"/><worldbody><body><freejoint/><geom type="box" size=".1 .05 .02"/>
    <body>{}<geom size=".01"/></body></body></worldbody></mujoco>"""
    for joint, alone in (("", True), ("<joint/>", False)):
        turns = []
        for integrator in ("Euler", "implicitfast"):
            model = mujoco.MjModel.from_xml_string(xml.format(integrator, joint))
            data = mujoco.MjData(model)
            data.qvel[3:6] = 3, 2, 1
            mujoco.mj_step(model, data)
            turns.append(data.qvel)
        assert (np.abs(turns[0] - turns[1]).max() > 1e-5) == alone == bool(faults(model))


ROUND = 'size=".1 .1"'
CYLINDER = 'type="cylinder" size="0.1 0.1" pos'


@pytest.mark.parametrize(
    ("words", "old", "new"),
    [
        ("contacts of a capsule and a cylinder, as those of 'trunk' and 'shank'",
         'fromto="0 0 0 0 0 -0.2" size="0.015"', ROUND),
        ("contacts that resist twisting or rolling, as those of 'ground' and 'shank' (2)", 'condim="1"', 'condim="6"'),
        ("the implicit integrator", 'impratio="2"', 'integrator="implicit"'),
        ("a fluid", 'impratio="2"', 'density="1.2"'),
        ("equality constraints", "<actuator>", '<equality><joint joint1="hip" joint2="knee"/></equality><actuator>'),
    ],
)  # fmt: skip
def test_models_that_are_refused(words, old, new):
    """The hopper with one change."""
    assert old in HOPPER
    changed = HOPPER.replace(old, new)
    if new == ROUND:
        changed = changed.replace('type="capsule" ' + ROUND, 'type="cylinder" ' + ROUND)
    with pytest.raises(InputError) as error:
        read_tree(mujoco.MjModel.from_xml_string(changed))
    assert str(error.value) == f"physics: the tree cannot represent {words}: take mujoco, or try mjx-jax."


def test_all_that_is_refused_is_said_at_once():
    """And what nothing reads or uses is not refused: the hopper's sensor, a tendon that does nothing."""
    changed = HOPPER.replace('type="sphere" size="0.1" pos', CYLINDER).replace('condim="1"', 'condim="6"')
    tendon = '<tendon><fixed name="t"><joint joint="hip" coef="1"/></fixed></tendon><actuator>'
    changed = changed.replace("<actuator>", tendon).replace('impratio="2"', 'noslip_iterations="2" density="1.2"')
    words = "a fluid; noslip iterations; "
    words += "contacts that resist twisting or rolling, as those of 'ground' and 'shank' (2)"
    with pytest.raises(InputError) as error:
        read_tree(mujoco.MjModel.from_xml_string(changed))
    assert str(error.value) == f"physics: the tree cannot represent {words}: take mujoco, or try mjx-jax."


def test_a_controller_that_uses_all_that_it_is_given_moves_as_in_native_mujoco(worlds):

    def balance(stages):
        pull = jnp.einsum("pxv,px->v", stages.contacts().jacobian, stages.contacts().drift)[6:]
        matrix, bias = stages.dynamics()
        weight = matrix[-10:, -10:] @ stages.qvel + bias[-10:]
        return -6.0 * stages.qpos - 0.2 * stages.qvel + 0.1 * weight + 1e-3 * pull

    def steps(physics):
        return jax.jit(jax.vmap(lambda world: physics.step(physics.run(world, balance, 2), balance)))

    (world, torque), (expected, expected_torque) = steps(TREE)(worlds), steps(NATIVE)(worlds)
    np.testing.assert_allclose(torque, expected_torque, atol=1e-5)
    np.testing.assert_allclose(world.qvel, expected.qvel, atol=1e-3)
    np.testing.assert_allclose(world.qpos, expected.qpos, atol=1e-5)


def test_torque_for_another_mass_is_the_models(worlds):
    """The torques that native MuJoCo's inverse dynamics gives with each link's own factor."""
    factors, qacc = jnp.linspace(0.5, 1.5, 10), jnp.ones(10)

    def torques(physics):
        noted = []

        def note(stages):
            noted.append((stages.torque_for(qacc, factors), stages.contacts(), *stages.dynamics()))
            return jnp.zeros(10)

        def ask(world):
            physics.step(world, note)
            return noted[-1]

        return jax.jit(jax.vmap(ask))(worlds._replace(qvel=worlds.qvel + 0.3))

    for one, two in zip(jax.tree.leaves(torques(TREE)), jax.tree.leaves(torques(NATIVE)), strict=True):
        np.testing.assert_allclose(one, two, atol=1e-5)
