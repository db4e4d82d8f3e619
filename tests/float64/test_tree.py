"""The tree against native MuJoCo with a converged solver, in double precision."""

import re
from functools import cache

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from other_robots import touches
from tree_robots import HOPPER, QUADRUPED, SWING, converged, native, qacc_of, states

from humanoid_mjx.mechanics.tree import pairs
from humanoid_mjx.mechanics.tree.folding import fold
from humanoid_mjx.mechanics.tree.reading import read_tree
from humanoid_mjx.mechanics.tree.step import Values
from humanoid_mjx.physics import make_physics
from humanoid_mjx.physics.base import Readings
from humanoid_mjx.physics.tree import TreePhysics
from humanoid_mjx.robot.description import IMU, sensing_spec
from humanoid_mjx.robot.lower_body import LowerBody


def jointed():
    """The quadruped with its front feet on one ground, thick legs, and a joint between those in front and behind."""
    pair = re.search('<pair geom1="fl_foot".*?/>', QUADRUPED).group()
    thick = QUADRUPED.replace(pair, pair + pair.replace("fl", "fr")).replace('size="0.02"', 'size="0.06"')
    front, rear = thick.split('<body name="rl_thigh"')
    joint = '<body><joint name="spine" axis="0.1 0.2 1" range="-30 30"/><inertial pos="-0.1 0 0" mass="1"'
    xml = f'{front}{joint} diaginertia="0.003 0.002 0.004"/><body name="rl_thigh"{rear}'
    return mujoco.MjModel.from_xml_string(xml.replace("</worldbody>", "</body></worldbody>"))


ROBOTS = {
    "free": lambda: LowerBody(ranges="human").spec().compile(),
    "fixed": lambda: LowerBody(torso="fixed", ranges="human").spec().compile(),
    "hopper": lambda: mujoco.MjModel.from_xml_string(HOPPER),
    "quadruped": lambda: mujoco.MjModel.from_xml_string(QUADRUPED),
    "jointed": jointed,
}


def errors(found, expected):
    """Relative, by state."""
    return np.linalg.norm(found - expected, axis=1) / np.linalg.norm(expected, axis=1)


@cache
def solver(name):
    return qacc_of(fold(read_tree(ROBOTS[name]())))


def contacts_of_bodies(model, positions):
    data, found = mujoco.MjData(model), []
    for data.qpos in positions:
        mujoco.mj_forward(model, data)
        found.append(touches(model, data)[1])
    return np.array(found)


@pytest.mark.parametrize(
    ("name", "count", "slots"), [("free", 4000, pairs.SLOTS), ("hopper", 500, 8), ("jointed", 500, 2)]
)
def test_accelerations_agree_with_native(monkeypatch, name, count, slots):
    """What is left is rounding, and what stiff contacts of light feet make of it: 1e-13 as a rule. Worlds with more
    contacts of bodies than slots do not settle. Bodies of the jointed robot touch in more worlds than a block holds."""
    monkeypatch.setattr(pairs, "SLOTS", slots)
    model = converged(ROBOTS[name]())
    at = states(model, count)
    qacc, settled = solver(name)(Values(), *at)
    crowded = contacts_of_bodies(model, at[0]) > slots
    np.testing.assert_array_equal(settled, ~crowded)
    assert crowded.sum() > 20 if name == "jointed" else crowded.mean() < 0.01
    assert errors(qacc, native(model, *at))[settled].max() < 1e-9


def test_traced_values_are_those_of_a_model_with_them():
    """Each link's mass, friction, damping, gravity, a push: all at once."""
    model = converged(ROBOTS["free"]())
    rng = np.random.default_rng(1)
    at = states(model, 500, seed=1)
    mass, push, gravity = rng.uniform(0.5, 2.0, model.nbody), np.array([2.0, -1.0, 3.0]), np.array([0.5, -0.3, -8.0])
    values = Values(mass, 0.4, 1.7, gravity, push)
    qacc, settled = solver("free")(values, *at)
    # MuJoCo computes what contacts and limits feel of the inertia once, when it compiles a model.
    model.body_mass *= mass
    model.body_inertia *= mass[:, None]
    model.dof_damping *= 1.7
    model.pair_friction[:, :2] *= 0.4
    model.opt.gravity = gravity
    expected = native(model, *at, force=np.concatenate([push, np.zeros(13)]))
    assert settled.all()
    assert errors(qacc, expected).max() < 1e-9


def test_limbs_of_one_build_are_lanes():
    """The quadruped's fourth leg stands on other ground than the three; two bodies of the jointed one have legs."""
    trees = {name: fold(read_tree(make())) for name, make in ROBOTS.items()}
    lanes = {"free": 2, "fixed": 2, "hopper": 1, "quadruped": 3, "jointed": 2}
    assert {name: tree.lanes for name, tree in trees.items()} == lanes
    assert [len(trees["jointed"].dofs), sum(map(len, trees["jointed"].dofs))] == [13, 19]


def start(physics, qpos, qvel):
    return jax.vmap(lambda q, v: physics.start(q, v))(jnp.asarray(qpos), jnp.asarray(qvel))


def test_sensors_and_forces_are_mujocos():
    """Readings, forces of each contact, and velocities of bodies."""
    physics = make_physics("tree", robot={"ranges": "human"})
    model = converged(sensing_spec(physics.robot, None).compile())
    qpos, qvel, ctrl = states(model, 300, seed=3)
    ctrl = np.clip(ctrl, -2.0, 2.0)
    world = start(physics, qpos, qvel)
    readings, _, velocities, contacts, _ = jax.jit(jax.vmap(physics.sense))(world, ctrl)
    assert (np.asarray(contacts.normal_force) >= 0.0).all()
    data, wrench, rate = mujoco.MjData(model), np.zeros(6), np.zeros(6)
    for i in range(len(qpos)):
        data.qpos, data.qvel, data.ctrl = qpos[i], qvel[i], ctrl[i]
        mujoco.mj_forward(model, data)
        forces = [data.sensor(name).data[0] for name in physics.robot.point_sensors]
        np.testing.assert_allclose(contacts.normal_force[i], forces, rtol=1e-9, atol=1e-9)
        imu = [data.sensor(name).data for name in IMU]
        expected = Readings(qpos[i, 7:], *imu, np.reshape(forces, (2, 4)).sum(axis=1))
        for name, reading in readings._asdict().items():
            np.testing.assert_allclose(reading[i], getattr(expected, name), rtol=1e-9, atol=1e-9, err_msg=name)
        total = np.zeros(3)
        for number, contact in enumerate(data.contact):
            mujoco.mj_contactForce(model, data, number, wrench)
            if model.geom_bodyid[contact.geom[0]] == 0:
                total += contact.frame.reshape(3, 3).T @ wrench[:3]
        np.testing.assert_allclose(contacts.normal_force[i].sum(), total[2], rtol=1e-9, atol=1e-9)
        for body in range(1, model.nbody):
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, rate, 0)
            np.testing.assert_allclose(velocities.angular[i, body], rate[:3], atol=1e-10)
            np.testing.assert_allclose(velocities.linear[i, body], rate[3:], atol=1e-10)


class Smaller(TreePhysics):
    """Of less to compile than the lower body is."""

    xml: str

    @property
    def model(self):
        return compiled(self.xml)


compiled = cache(mujoco.MjModel.from_xml_string)


def test_a_batch_of_batches_is_one_batch():
    """Four worlds, each with robots of three masses: a world is shared by its robots, and the masses by all worlds, so
    that neither has both axes by itself."""
    robot, (qpos, qvel, _) = Smaller(xml=SWING), states(compiled(SWING), 4, seed=7)
    worlds, masses = start(robot, qpos, qvel), jnp.array([0.7, 1.0, 1.6])

    def move(world, mass):
        return robot.replace(mass=mass).step(world, lambda stages: 0.1 * stages.dynamics()[1][-1:] - stages.qpos)

    nested = jax.jit(jax.vmap(jax.vmap(move, in_axes=(None, 0)), in_axes=(0, None)))(worlds, masses)
    copies = jax.tree.map(lambda x: jnp.repeat(x, len(masses), axis=0), worlds)
    flat = jax.jit(jax.vmap(move))(copies, jnp.tile(masses, len(qpos)))
    assert not flat[0].diverged.any() and np.ptp(nested[0].qvel, axis=1).max() > 1e-2, "masses matter"
    for batch, one in zip(jax.tree.leaves(nested), jax.tree.leaves(flat), strict=True):
        # Rounding, and what stiff contacts make of it.
        np.testing.assert_allclose(batch.reshape(one.shape), one, rtol=1e-9, atol=1e-9)
