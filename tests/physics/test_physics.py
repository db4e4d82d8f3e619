"""What physics says of a body, against native MuJoCo and the laws of mechanics: weight, torques, readings, motion."""

import importlib.util
from copy import copy
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from standing import MJX, NATIVE, hold, standing

from humanoid_mjx.physics import make_physics
from humanoid_mjx.physics.base import Stages
from humanoid_mjx.robot.description import below, ground_points
from humanoid_mjx.spec import InputError

sense = jax.jit(jax.vmap(MJX.sense))
"""All that is sensed in many worlds."""


@jax.jit
def noted(physics, world, qacc, believed, held):
    """A time step under a share of a servo's torques, and what its controller notes: the mass matrix, and the torques
    for `qacc` if links had this mass, by one factor and by one for each link. One program, which takes long to compile,
    for all tests of a step."""
    notes = []

    def controller(stages: Stages):
        masses = believed, jnp.full(10, believed)
        notes.append((stages.dynamics()[0], [stages.torque_for(qacc, mass) for mass in masses]))
        return held * hold(stages)

    world, _ = physics.step(world, controller)
    return world, *notes[0]


STILL = np.zeros(10)


def note(physics, world, qacc=STILL, believed=1.0, held=0.0):
    """`noted` with its numbers as data of the program."""
    return noted(jax.tree.map(jnp.float32, physics), world, *map(jnp.float32, (qacc, believed, held)))


@pytest.fixture(scope="module")
def worlds():
    return standing()


@pytest.mark.parametrize("robot", ["lower_body", "legs", "dog"])
def test_what_hangs_on_a_body_is_what_mujoco_says(robot):
    model = make_physics("mjx-jax", robot=robot).model
    np.testing.assert_allclose(below(model) @ model.body_mass, model.body_subtreemass, rtol=1e-6)


def test_legs_on_a_fixed_torso_feel_gravity_alone():
    physics = make_physics("chain")
    still = jnp.zeros(len(physics.joint_names))
    readings = jax.jit(lambda still: physics.sense(physics.start(still, still), still).readings)(still)
    np.testing.assert_allclose(readings.accelerometer, [0.0, 0.0, 9.81], rtol=1e-3)
    assert not readings.gyroscope.any()


def test_the_corners_of_the_feet_move_as_the_bodies_do(worlds):
    """As MuJoCo's Jacobian at each corner says."""
    qvel = np.random.default_rng(0).normal(size=worlds.qvel.shape).astype(np.float32)
    worlds = worlds._replace(qvel=jnp.asarray(qvel))
    contacts = sense(worlds, jnp.zeros((len(qvel), 10))).contacts
    model, links = MJX.model, MJX.model.geom_bodyid[ground_points(MJX.model)[0]]
    data, jacobian = mujoco.MjData(model), np.zeros((3, model.nv))
    for world in range(len(qvel)):
        data.qpos, data.qvel = worlds.qpos[world], qvel[world]
        mujoco.mj_forward(model, data)
        for corner, link in enumerate(links):
            mujoco.mj_jac(model, data, jacobian, None, np.asarray(contacts.position[world, corner], float), int(link))
            np.testing.assert_allclose(contacts.velocity[world, corner], jacobian @ qvel[world], atol=1e-4)


def test_a_standing_body_rests_on_its_weight(worlds):
    """After three seconds in native MuJoCo, with which trajectories of MJX agree."""
    worlds = jax.jit(jax.vmap(lambda world: NATIVE.run(world, hold, 750)))(worlds)
    torque = hold(Joints(worlds.qpos[:, 7:], worlds.qvel[:, 6:]))
    assert not worlds.diverged.any()
    assert np.abs(worlds.qvel).max() < 0.01
    readings = sense(worlds, torque).readings
    weight = MJX.model.body_mass.sum() * 9.81
    np.testing.assert_allclose(readings.foot_contact.sum(-1), weight, rtol=0.01)
    np.testing.assert_allclose(np.linalg.norm(readings.accelerometer, axis=-1), 9.81, rtol=0.01)
    np.testing.assert_array_equal(readings.encoders, worlds.qpos[:, 7:])
    np.testing.assert_allclose(readings.gyroscope, worlds.qvel[:, 3:6], atol=1e-6)


@pytest.mark.parametrize("physics", [MJX, NATIVE], ids=["mjx", "native"])
def test_a_push_on_the_torso_gives_its_impulse(physics):
    """In the air, the momenta after a step with the push and without differ by force times time, in x, y and z only."""
    qpos = physics.qpos0 + np.eye(17)[2]
    qvel = np.random.default_rng(0).normal(size=16)
    force = np.array([3.0, -2.0, 1.0])

    start = physics.start(qpos, qvel)
    (pushed, *_), (left_alone, matrix, _) = (
        note(physics.replace(push=tuple(push)), start) for push in (force, np.zeros(3))
    )
    gained = np.asarray(matrix) @ np.asarray(pushed.qvel - left_alone.qvel)
    # float32: velocities of order 3 carry 1e-7 each, times masses of 1.7.
    np.testing.assert_allclose(gained, np.concatenate([force * physics.step_s, np.zeros(13)]), atol=5e-6)


@pytest.mark.parametrize(
    ("name", "options", "sentence"),
    [
        ("mjx", {}, "physics.name: unknown physics 'mjx'; did you mean 'mjx-jax'? known are chain, mjx-jax, "),
        (
            "mujoco",
            {"robot": "arm"},
            "physics.robot.name: unknown robot 'arm'; known are a2, apollo, pegasus, berkeley_humanoid, aliengo",
        ),
        ("mujoco", {"robot": {"ranges": "wide"}}, "physics.robot.ranges must be one of 'proposed' or 'human', "),
        ("mjx-jax", {"timestep": 0.0}, "physics.timestep must be at least 1e-06, got 0.0."),
        ("mjx-jax", {"step": 0.1}, "physics.step: unknown key; did you mean 'timestep'? known are damping, friction, "),
        ("mjx-warp", {}, "physics: mjx-warp needs the package warp; pip install 'humanoid-mjx[cuda]' brings it."),
    ],
)
def test_bad_input_gets_a_sentence(name, options, sentence):
    if name == "mjx-warp" and importlib.util.find_spec("warp"):
        pytest.skip("warp is installed")
    with pytest.raises(InputError) as error:
        make_physics(name, **options)
    assert str(error.value).startswith(sentence)


def held_torso_torque(mass, damping, qpos, qvel, qacc):
    """What MuJoCo's own inverse dynamics asks for on a body `mass` times as heavy, its torso not accelerated."""
    model, joints = copy(NATIVE.model), NATIVE.model.nu
    model.body_mass[:] *= mass
    model.body_inertia[:] *= mass
    model.dof_damping[model.dof_damping > 0] = damping
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    data.qpos, data.qvel, data.qacc = qpos, qvel, np.concatenate([np.zeros(6), qacc])
    mujoco.mj_inverse(model, data)
    return data.qfrc_inverse[-joints:]


@pytest.mark.parametrize("physics", [make_physics("tree"), MJX, NATIVE], ids=["tree", "mjx", "native"])
def test_states_and_torques_of_a_wrong_size_are_refused_and_no_number_diverges(physics):
    """Native MuJoCo takes 0 for torques that are no numbers."""
    still = jnp.zeros(physics.model.nv)
    with pytest.raises(InputError, match=r"start: qpos and qvel .* \(\(17,\), \(16,\)\), got \(\(17,\), \(17,\)\)"):
        physics.start(physics.qpos0, physics.qpos0)
    world = physics.start(physics.qpos0, still)
    for torque in (jnp.zeros(9), 0.0):
        with pytest.raises(InputError, match="the controller must return a torque of each of 10 joints, got"):
            jax.eval_shape(lambda world, torque=torque: physics.step(world, lambda _: torque), world)
    step = jax.jit(lambda world, torque: physics.step(world, lambda _: torque)[0].diverged)
    assert step(world, jnp.zeros(10).at[3].set(jnp.nan)) and not step(world, jnp.zeros(10))


@pytest.mark.parametrize("name", ["chain", "tree", "mjx-jax", "mujoco"])
def test_what_a_branch_asks_for_first_is_there_behind_it_too(name):
    """It is made when asked for, and what a branch makes must not leave it: jax refuses to trace what leaks."""
    robot = {} if name == "chain" else {"robot": {"torso": "fixed"}}
    physics = make_physics(name, torque_limit=5.0, **robot)

    def branching(stages: Stages):
        now, qpos = stages.dynamics, stages.qpos
        return jax.lax.cond(qpos[0] > -1.0, lambda: now()[0] @ qpos, lambda: qpos) + now()[1]

    world = physics.start(physics.qpos0, np.zeros(len(physics.qpos0)))
    jax.eval_shape(lambda world: physics.step(world, branching), world)


@pytest.mark.parametrize("physics", [MJX, NATIVE], ids=["mjx", "native"])
@pytest.mark.parametrize("believed", [0.5, 1.0, 3.0])
def test_a_model_s_torque_is_that_of_a_body_of_its_mass(physics, believed):
    """Armature and damping belong to the joints: they do not grow with the links. One factor or one for each link."""
    random = np.random.default_rng(0)
    qpos = physics.qpos0 + np.concatenate([np.zeros(7), random.uniform(-0.5, 0.5, 10)])
    qvel, qacc = random.normal(size=16), 10 * random.normal(size=10)
    expected = held_torso_torque(believed, 0.02, qpos, qvel, qacc)
    plant = physics.replace(mass=2.0, damping=1.0)
    found = np.concatenate(note(plant, plant.start(qpos, qvel), qacc, believed)[2])
    assert np.ptp(expected) > 0.1
    # float32 through ten joints: torques of up to 1 N m carry a few 1e-6.
    np.testing.assert_allclose(found, np.tile(expected, 2), atol=1e-5)


def test_a_cycle_is_a_multiple_of_the_time_step():
    assert MJX.substeps(0.02) == 5
    for period in (0.01, 0.0, float("nan")):
        with pytest.raises(InputError, match=f"a control cycle of {period} s must be a multiple of the time step of"):
            MJX.substeps(period)


class Joints(NamedTuple):
    qpos: np.ndarray
    qvel: np.ndarray


def test_readings_on_the_way_are_those_of_the_last_step(worlds):
    start = plain = jax.tree.map(lambda x: x[0], worlds)
    world, sensed = jax.jit(lambda world: MJX.run_sensed(world, hold, 3))(start)
    for _ in range(3):
        plain, *_ = note(MJX, plain, held=1.0)
    np.testing.assert_allclose(world.qpos, plain.qpos, atol=1e-6)
    native, expected = jax.jit(lambda world: NATIVE.run_sensed(world, hold, 3))(start)
    before = jax.jit(lambda world: NATIVE.run(world, hold, 2))(start)
    np.testing.assert_allclose(native.qvel, world.qvel, atol=1e-3)
    np.testing.assert_allclose(expected.readings.encoders, before.qpos[7:], atol=1e-6)
    for name, atol in (("encoders", 1e-5), ("gyroscope", 1e-3), ("accelerometer", 0.3), ("foot_contact", 0.1)):
        found, right = (getattr(x.readings, name) for x in (sensed, expected))
        np.testing.assert_allclose(found, right, atol=atol, err_msg=name)
    np.testing.assert_allclose(sensed.torque, hold(Joints(before.qpos[7:], before.qvel[6:])), atol=1e-3)


def test_bodies_and_contacts_of_both(worlds):
    """On a body that leans and moves, a few steps after a kick, so that corners differ in what they carry."""
    start = worlds._replace(qvel=worlds.qvel.at[:, :6].set(jnp.array([0.3, 0.2, 0.0, 0.4, -0.3, 0.5])))
    world = jax.jit(jax.vmap(lambda world: NATIVE.run(world, hold, 10)))(start)
    torque = hold(Joints(world.qpos[:, 7:], world.qvel[:, 6:]))
    both = sense(world, torque), jax.jit(jax.vmap(NATIVE.sense))(world, torque)
    sensed, expected = (jax.tree.map(lambda x: x[0], seen) for seen in both)
    for part in ("poses", "velocities", "contacts"):
        for name, found in getattr(sensed, part)._asdict().items():
            # Float32 from one state; the forces of four iterations of the solver, of a weight of 17 N.
            atol = 0.1 if name == "normal_force" else 1e-5
            np.testing.assert_allclose(found, getattr(getattr(expected, part), name), atol=atol, err_msg=name)
    contacts, readings = expected.contacts, expected.readings
    assert contacts.position.shape == (8, 3) and np.ptp(contacts.normal_force) > 1.0
    np.testing.assert_allclose(contacts.normal_force.reshape(2, 4).sum(1), readings.foot_contact, rtol=1e-4)
    assert (np.asarray(contacts.normal_force)[np.asarray(contacts.position)[:, 2] > 1e-3] == 0).all()


@pytest.mark.parametrize("physics", [NATIVE, make_physics("chain"), make_physics("mujoco", robot="legs")])
def test_velocities_are_what_poses_change_by(physics):
    random = np.random.default_rng(0)
    joints = len(physics.joint_names)
    qpos = physics.qpos0 + np.concatenate([np.zeros(len(physics.qpos0) - joints), random.uniform(-0.5, 0.5, joints)])
    world = physics.start(qpos, random.normal(size=len(qpos) - (len(qpos) > joints)))
    sensed = physics.sense(world, jnp.zeros(joints))
    h = 1e-3
    moved = world.qpos[-joints:] + h * world.qvel[-joints:]
    after = world._replace(qpos=jnp.concatenate([world.qpos[: len(qpos) - joints], moved]))
    if len(qpos) > joints:
        after = physics.start(world.qpos, world.qvel)
        mj = np.array(world.qpos, float)
        mujoco.mj_integratePos(physics.model, mj, np.asarray(world.qvel, float), h)
        after = world._replace(qpos=jnp.asarray(mj, float))
    poses, change = (physics.sense(each, jnp.zeros(joints)).poses for each in (world, after))
    np.testing.assert_array_equal(poses.position, sensed.poses.position)
    # Positions of up to 0.3 m carry 3e-8 in float32, a quotient by h 1000 times as much; the rest is of order h.
    np.testing.assert_allclose((change.position - poses.position) / h, sensed.velocities.linear, atol=5e-3)
    spin = np.einsum("bij,bkj->bik", (change.rotation - poses.rotation) / h, poses.rotation)
    angular = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=-1)
    np.testing.assert_allclose(angular, sensed.velocities.angular, atol=3e-2)
