"""Physics in batches: worlds that do not touch each other, a body that rests on its feet, one compilation."""

import importlib.util
import warnings
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco.rollout import rollout

from humanoid_mjx.physics import make_physics, native
from humanoid_mjx.physics.base import MAX_SPEED, Stages
from humanoid_mjx.runtime import counting_compiles
from humanoid_mjx.spec import InputError

WORLDS = 4
MJX = make_physics("mjx-jax")
NATIVE = make_physics("mujoco")


def hold(stages: Stages):
    """A plain joint servo about the standing posture."""
    return -6.0 * stages.qpos - 0.2 * stages.qvel


def bits(tree):
    return [np.asarray(x).tobytes() for x in jax.tree.leaves(tree)]


@pytest.fixture(scope="module")
def step():
    """One time step of many worlds."""
    return jax.jit(jax.vmap(lambda physics, world: physics.step(world, hold), in_axes=(None, 0)))


@pytest.fixture(scope="module")
def native_step():
    """The same in native MuJoCo, each world with its own values."""
    return jax.jit(jax.vmap(lambda physics, world: physics.step(world, hold)))


def same(physics):
    """The physics with its values once for each world."""
    return jax.tree.map(lambda value: jnp.full(WORLDS, value), physics)


@pytest.fixture(scope="module")
def mjx():
    return jax.tree.map(jnp.float32, MJX)


@pytest.fixture(scope="module")
def worlds():
    """Standing bodies, each joint up to 0.1 rad away from zero."""
    qpos = np.tile(MJX.qpos0, (WORLDS, 1))
    qpos[:, 7:] += np.random.default_rng(0).uniform(0, 0.1, (WORLDS, 10))
    return jax.vmap(lambda qpos: MJX.start(qpos, np.zeros(16)))(qpos)


@pytest.fixture(scope="module")
def rested(step, mjx, worlds):
    """After three seconds of standing: worlds and torques."""
    for _ in range(750):
        worlds, torque = step(mjx, worlds)
    return worlds, torque


def test_a_standing_body_rests_on_its_weight(rested):
    worlds, torque = rested
    assert not worlds.diverged.any()
    assert np.abs(worlds.qvel).max() < 0.01
    readings = jax.jit(jax.vmap(lambda world, torque: MJX.sense(world, torque).readings))(worlds, torque)
    weight = MJX.model.body_mass.sum() * 9.81
    np.testing.assert_allclose(readings.foot_contact.sum(-1), weight, rtol=0.01)
    np.testing.assert_allclose(np.linalg.norm(readings.accelerometer, axis=-1), 9.81, rtol=0.01)
    np.testing.assert_array_equal(readings.encoders, worlds.qpos[:, 7:])
    np.testing.assert_allclose(readings.gyroscope, worlds.qvel[:, 3:6], atol=1e-6)


def test_native_rests_in_the_same_posture_on_the_same_weight(worlds, rested):
    """In a scan; the forces of a body that stands still change by less than its servo lets it sway."""
    rest = jax.jit(jax.vmap(lambda world: NATIVE.run(world, hold, 375, substeps=2)))
    resting = rest(worlds)
    np.testing.assert_allclose(resting.qpos, rested[0].qpos, atol=5e-3)
    np.testing.assert_allclose(resting.warmstart, 0.0, atol=0.5)
    sense = jax.jit(jax.vmap(lambda world: NATIVE.sense(world, -6.0 * world.qpos[7:]).readings))
    weight = MJX.model.body_mass.sum() * 9.81
    np.testing.assert_allclose(sense(resting).foot_contact.sum(-1), weight, rtol=0.01)


def test_native_worlds_may_differ_in_their_values(native_step, worlds, monkeypatch):
    """As in a batch of worlds that do not differ, also where the models are too many to be kept."""
    monkeypatch.setattr("humanoid_mjx.physics.native.MODELS_BYTES", 0)
    native._team.cache_clear()
    heavy = same(NATIVE).replace(mass=1.0 + 0.2 * jnp.arange(WORLDS), damping=jnp.array([0.01, 0.01, 0.1, 0.01]))
    moved = worlds
    for _ in range(3):
        moved, _ = native_step(heavy, moved)
    for i in range(WORLDS):
        alone, own = jax.tree.map(lambda x, i=i: jnp.repeat(x[i : i + 1], WORLDS, axis=0), (worlds, heavy))
        for _ in range(3):
            alone, _ = native_step(own, alone)
        assert bits(alone.qvel[0]) == bits(moved.qvel[i])
    assert len({bytes(row) for row in bits(list(moved.qvel))}) == WORLDS


def test_native_on_two_devices_at_once(native_step, worlds):
    """Two threads that step in native MuJoCo wait for each other, and not forever; neither changes the other's bits."""

    def run(device):
        world = jax.device_put(worlds, device)
        for _ in range(30):
            world, _ = native_step(same(NATIVE), world)
        return bits(world)

    with ThreadPoolExecutor(2) as threads:
        one, other = threads.map(run, jax.local_devices()[:2])
    assert one == other


def test_many_worlds_are_as_one_at_a_time(step, mjx, worlds):
    one_step = jax.jit(lambda physics, world: physics.step(world, hold))
    together, alone = worlds, [jax.tree.map(lambda x, i=i: x[i], worlds) for i in range(WORLDS)]
    for _ in range(25):
        together, _ = step(mjx, together)
        alone = [one_step(mjx, world)[0] for world in alone]
    for i, world in enumerate(alone):
        np.testing.assert_allclose(together.qpos[i], world.qpos, atol=1e-5)
        np.testing.assert_allclose(together.qvel[i], world.qvel, atol=1e-2)


@pytest.mark.parametrize("fault", [np.nan, np.inf, 1e6])
def test_a_diverging_world_is_flagged_and_changes_no_bit_of_another(step, mjx, worlds, fault):
    broken = worlds._replace(qvel=worlds.qvel.at[1, 8].set(fault))
    others = np.array([0, 2, 3])
    good, bad = worlds, broken
    for _ in range(5):
        (good, _), (bad, _) = step(mjx, good), step(mjx, bad)
    np.testing.assert_array_equal(bad.diverged, [False, True, False, False])
    np.testing.assert_array_equal(bad.qpos[1], broken.qpos[1])
    assert bits(jax.tree.map(lambda x: x[others], good)) == bits(jax.tree.map(lambda x: x[others], bad))


def test_reset_is_masked(step, mjx, worlds):
    bad, _ = step(mjx, worlds._replace(qpos=worlds.qpos.at[1].set(np.nan)))
    qpos, qvel = jnp.asarray(MJX.qpos0), jnp.zeros(16)
    reset = jax.vmap(lambda world, mask: MJX.reset(world, mask, qpos, qvel))(bad, bad.diverged)
    assert bits(reset.qpos[1]) == bits(jnp.asarray(MJX.qpos0, jnp.float32)) and not reset.diverged.any()
    assert bits(reset.qpos[2:]) == bits(bad.qpos[2:])
    fine, _ = step(mjx, reset)
    assert not fine.diverged.any()


def test_a_second_call_compiles_nothing(step, mjx, rested):
    worlds, _ = rested
    slippery = mjx.replace(friction=jnp.float32(0.1))
    with counting_compiles() as compiles:
        step(slippery, worlds)
    assert compiles.programs == 0


def test_torque_is_held_over_a_cycle_and_kept_within_its_limit():
    """Against native MuJoCo, with the fixed torso; the controller is asked once, and uses mass matrix and bias."""
    both = [make_physics(name, torso="fixed", torque_limit=0.3) for name in ("mjx-jax", "mujoco")]

    def track(stages: Stages):
        return stages.mass_matrix @ (2000.0 * (0.5 - stages.qpos) - 60.0 * stages.qvel) + stages.bias

    world, other = (physics.start(physics.qpos0 + 0.2, np.zeros(10)) for physics in both)
    cycle, native_cycle = (
        jax.jit(lambda world, physics=physics: physics.step(world, track, substeps=4)) for physics in both
    )
    torques = []
    for _ in range(10):
        world, torque = cycle(world)
        other, expected = native_cycle(other)
        np.testing.assert_allclose(torque, expected, atol=1e-3)
        np.testing.assert_allclose(world.qpos, other.qpos, atol=1e-5)
        torques.append(expected)
    assert np.abs(torques).max() == 0.3


def test_one_step_on_the_ground_agrees_with_native(step, native_step, mjx, worlds):
    """Tilted feet that strike the ground, in single precision: 1 mm/s in velocities of several m/s and rad/s."""
    kicked = worlds._replace(qvel=0.3 * jax.random.normal(jax.random.key(0), worlds.qvel.shape))
    for _ in range(5):
        kicked, _ = step(mjx, kicked)
    expected, _ = native_step(same(NATIVE), kicked)
    np.testing.assert_allclose(step(mjx, kicked)[0].qvel, expected.qvel, atol=1e-3)


def test_warp_agrees_with_native(worlds):
    """On the ground, with a controller that uses mass matrix and bias."""
    pytest.importorskip("warp")
    warp = make_physics("mjx-warp", worlds=WORLDS)

    def balance(stages: Stages):
        weight = stages.mass_matrix[-10:, -10:] @ stages.qvel + stages.bias[-10:]
        return hold(stages) + 0.1 * weight

    world, native = (
        jax.jit(jax.vmap(lambda world, p=physics: p.step(world, balance, substeps=2)[0]))(worlds)
        for physics in (warp, NATIVE)
    )
    np.testing.assert_allclose(world.qvel, native.qvel, atol=1e-3)


def test_warp_counts_worlds_that_lose_contacts_as_diverged(worlds):
    """Room for one standing body is too little for four; nobody can tell which of them lose."""
    pytest.importorskip("warp")
    for room, expected in ((1, True), (WORLDS, False)):
        warp = make_physics("mjx-warp", worlds=room)
        step = jax.jit(jax.vmap(lambda world, p=warp: p.step(world, hold)[0]))
        moved = worlds
        for _ in range(50):
            moved = step(moved)
        np.testing.assert_array_equal(moved.diverged, expected)


def test_native_worlds_diverge_alone_and_silently(native_step, worlds, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    with warnings.catch_warnings(action="error"):
        for fault in (np.nan, 1e9):
            broken = worlds._replace(qvel=worlds.qvel.at[1, 8].set(fault))
            for _ in range(3):
                broken, _ = native_step(same(NATIVE), broken)
            np.testing.assert_array_equal(broken.diverged, [False, True, False, False])
            np.testing.assert_array_equal(broken.qpos[1], worlds.qpos[1])
            assert np.isfinite(broken.qpos).all()
    assert not list(tmp_path.iterdir()) and capfd.readouterr() == ("", "")


def test_steps_are_those_of_mujocos_own_rollout(native_step, worlds):
    """In float64: what is left is the rounding of the states to float32 between steps."""
    moved, torques = worlds, []
    for _ in range(5):
        moved, torque = native_step(same(NATIVE), moved)
        torques.append(torque)
    model = NATIVE.model
    start = np.concatenate([np.zeros((WORLDS, 1)), worlds.qpos, worlds.qvel], axis=1)
    states, _ = rollout(model, mujoco.MjData(model), start, np.stack(torques, axis=1))
    np.testing.assert_allclose(states[:, -1, 1 : 1 + model.nq], moved.qpos, atol=1e-5)
    np.testing.assert_allclose(states[:, -1, 1 + model.nq :], moved.qvel, atol=1e-3)


def test_poses_of_both(worlds):
    poses = jax.jit(lambda world: MJX.poses(world))(jax.tree.map(lambda x: x[0], worlds))
    expected = jax.jit(jax.vmap(lambda world: NATIVE.poses(world)))(worlds)
    np.testing.assert_allclose(poses.position, expected.position[0], atol=1e-6)
    np.testing.assert_allclose(poses.rotation, expected.rotation[0], atol=1e-6)
    assert len(MJX.body_names) == len(poses.position) and MJX.body_names[1] == "torso"


def test_nothing_a_body_can_do_counts_as_diverged():
    assert MJX.torque_limit / MJX.damping < MAX_SPEED / 2


@pytest.mark.parametrize("physics", [MJX, NATIVE], ids=["mjx", "native"])
def test_a_push_on_the_torso_gives_its_impulse(physics):
    """In the air, the momenta after a step with the push and without differ by force times time, in x, y and z only."""
    qpos = physics.qpos0 + np.eye(17)[2]
    qvel = np.random.default_rng(0).normal(size=16)
    force = np.array([3.0, -2.0, 1.0])

    @jax.jit
    def after(push):
        pushed = physics.replace(push=tuple(push))
        matrices = []
        note = lambda stages: matrices.append(stages.mass_matrix) or jnp.zeros(10)  # noqa: E731
        world, _ = pushed.step(physics.start(qpos, qvel), note)
        return world.qvel, matrices[0]

    (pushed, matrix), (left_alone, _) = after(jnp.asarray(force, float)), after(jnp.zeros(3))
    gained = np.asarray(matrix) @ np.asarray(pushed - left_alone)
    # float32: velocities of order 3 carry 1e-7 each, times masses of 1.7.
    np.testing.assert_allclose(gained, np.concatenate([force * physics.step_s, np.zeros(13)]), atol=5e-6)


@pytest.mark.parametrize(
    ("name", "options", "sentence"),
    [
        ("mjx", {}, "physics.name: unknown physics 'mjx'; did you mean 'mjx-jax'? known are chain, mjx-jax, "),
        ("mujoco", {"robot": "arm"}, "physics.robot must be one of 'lower_body', 'legs' or 'leg', got 'arm'."),
        ("mujoco", {"ranges": "wide"}, "physics.ranges must be one of 'proposed' or 'human', got 'wide'."),
        ("mjx-jax", {"timestep": 0.0}, "physics.timestep must be greater than 0.0, got 0.0."),
        ("mjx-jax", {"step": 0.1}, "physics.step: unknown key; did you mean 'timestep'? known are damping, friction, "),
        ("mjx-warp", {}, "physics: mjx-warp needs the package warp-lang, which is not installed."),
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


@jax.jit
def torques_for(plant, qpos, qvel, qacc, believed):
    """What a controller asks for that believes in links of this mass: one factor, then one for each link."""
    asked = []

    def note(stages: Stages):
        asked.extend(stages.torque_for(qacc, mass) for mass in (believed, jnp.full(10, believed)))
        return jnp.zeros(10)

    plant.step(plant.start(qpos, qvel), note)
    return jnp.concatenate(asked)


@pytest.mark.parametrize("physics", [MJX, NATIVE], ids=["mjx", "native"])
@pytest.mark.parametrize("believed", [0.5, 1.0, 3.0])
def test_a_model_s_torque_is_that_of_a_body_of_its_mass(physics, believed):
    """Armature and damping belong to the joints: they do not grow with the links. One factor or one for each link."""
    random = np.random.default_rng(0)
    qpos = physics.qpos0 + np.concatenate([np.zeros(7), random.uniform(-0.5, 0.5, 10)])
    qvel, qacc = random.normal(size=16), 10 * random.normal(size=10)
    expected = held_torso_torque(believed, 0.02, qpos, qvel, qacc)
    plant = physics.replace(mass=2.0, damping=0.02)
    found = torques_for(jax.tree.map(jnp.float32, plant), *map(jnp.float32, (qpos, qvel, qacc, believed)))
    assert np.ptp(expected) > 0.1
    # float32 through ten joints: torques of up to 1 N m carry a few 1e-6.
    np.testing.assert_allclose(found, np.tile(expected, 2), atol=1e-5)


def test_a_cycle_is_a_multiple_of_the_time_step():
    assert MJX.substeps(0.02) == 5
    for period in (0.01, 0.0, float("nan")):
        with pytest.raises(InputError, match=f"a control cycle of {period} s must be a multiple of the time step of"):
            MJX.substeps(period)


def test_readings_on_the_way_are_those_of_the_last_step(worlds):
    start = jax.tree.map(lambda x: x[0], worlds)
    world, sensed = jax.jit(lambda world: MJX.run_sensed(world, hold, 3))(start)
    plain = jax.jit(lambda world: MJX.run(world, hold, 3))(start)
    np.testing.assert_allclose(world.qpos, plain.qpos, atol=1e-6)
    native, expected = jax.jit(lambda world: NATIVE.run_sensed(world, hold, 3))(start)
    before = jax.jit(lambda world: NATIVE.run(world, hold, 2))(start)
    np.testing.assert_allclose(native.qvel, world.qvel, atol=1e-3)
    np.testing.assert_allclose(expected.readings.encoders, before.qpos[7:], atol=1e-6)
    for name, atol in (("encoders", 1e-5), ("gyroscope", 1e-3), ("accelerometer", 0.3), ("foot_contact", 0.1)):
        found, right = (getattr(x.readings, name) for x in (sensed, expected))
        np.testing.assert_allclose(found, right, atol=atol, err_msg=name)
    np.testing.assert_allclose(sensed.torque, hold(Joints(before.qpos[7:], before.qvel[6:])), atol=1e-3)


class Joints(NamedTuple):
    qpos: np.ndarray
    qvel: np.ndarray


def test_bodies_and_contacts_of_both(worlds):
    """On a body that leans and moves, a few steps after a kick, so that corners differ in what they carry."""
    start = jax.tree.map(lambda x: x[0], worlds)
    start = start._replace(qvel=start.qvel.at[:6].set(jnp.array([0.3, 0.2, 0.0, 0.4, -0.3, 0.5])))
    world = jax.jit(lambda world: NATIVE.run(world, hold, 10))(start)
    torque = hold(Joints(world.qpos[7:], world.qvel[6:]))
    sensed, expected = (jax.jit(p.sense)(world, torque) for p in (MJX, NATIVE))
    for part in ("poses", "velocities", "contacts"):
        for name, found in getattr(sensed, part)._asdict().items():
            # Float32 from one state; the forces of four iterations of the solver, of a weight of 17 N.
            atol = 0.1 if name == "normal_force" else 1e-5
            np.testing.assert_allclose(found, getattr(getattr(expected, part), name), atol=atol, err_msg=name)
    contacts, readings = expected.contacts, expected.readings
    assert contacts.position.shape == (8, 3) and np.ptp(contacts.normal_force) > 1.0
    np.testing.assert_allclose(contacts.normal_force.reshape(2, 4).sum(1), readings.foot_contact, rtol=1e-4)
    assert (np.asarray(contacts.normal_force)[np.asarray(contacts.position)[:, 2] > 1e-3] == 0).all()


@pytest.mark.parametrize(
    "physics", [NATIVE, make_physics("chain"), make_physics("mujoco", torso="fixed", robot="legs")]
)
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
    poses, change = physics.poses(world), physics.poses(after)
    np.testing.assert_array_equal(poses.position, sensed.poses.position)
    # Positions of up to 0.3 m carry 3e-8 in float32, a quotient by h 1000 times as much; the rest is of order h.
    np.testing.assert_allclose((change.position - poses.position) / h, sensed.velocities.linear, atol=5e-3)
    spin = np.einsum("bij,bkj->bik", (change.rotation - poses.rotation) / h, poses.rotation)
    angular = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=-1)
    np.testing.assert_allclose(angular, sensed.velocities.angular, atol=3e-2)
