"""Physics in batches, with the kernels that users have: worlds that do not touch each other."""

import warnings
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco.rollout import rollout
from standing import NATIVE, VALUES, WORLDS, hold, standing, step

from humanoid_mjx.physics import make_physics, native
from humanoid_mjx.physics.base import Stages


def bits(tree):
    return [np.asarray(x).tobytes() for x in jax.tree.leaves(tree)]


@pytest.fixture(scope="module")
def native_step():
    """One time step of many worlds in native MuJoCo, each world with its own values."""
    return jax.jit(jax.vmap(lambda physics, world: physics.step(world, hold)))


def same(physics):
    """The physics with its values once for each world."""
    return jax.tree.map(lambda value: jnp.full(WORLDS, value), physics)


@pytest.fixture(scope="module")
def worlds():
    return standing()


def test_native_worlds_may_differ_in_their_values(native_step, worlds, monkeypatch):
    """As in a batch of worlds that do not differ, also where the models are too many to be kept."""
    monkeypatch.setattr("humanoid_mjx.physics.native.MODELS_BYTES", 0)
    native._team.cache_clear()
    heavy = same(NATIVE).replace(mass=1.0 + 0.2 * jnp.arange(WORLDS), damping=jnp.array([0.5, 0.5, 5.0, 0.5]))
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


@pytest.mark.parametrize("fault", [np.nan, np.inf, 1e6])
def test_a_diverging_world_is_flagged_and_changes_no_bit_of_another(worlds, fault):
    broken = worlds._replace(qvel=worlds.qvel.at[1, 8].set(fault))
    others = np.array([0, 2, 3])
    good, bad = worlds, broken
    for _ in range(5):
        (good, _), (bad, _) = step(VALUES, good), step(VALUES, bad)
    np.testing.assert_array_equal(bad.diverged, [False, True, False, False])
    np.testing.assert_array_equal(bad.qpos[1], broken.qpos[1])
    assert bits(jax.tree.map(lambda x: x[others], good)) == bits(jax.tree.map(lambda x: x[others], bad))


def test_one_step_on_the_ground_agrees_with_native(native_step, worlds):
    """Tilted feet that strike the ground, in single precision: 1 mm/s in velocities of several m/s and rad/s."""
    kicked = worlds._replace(qvel=0.3 * jax.random.normal(jax.random.key(0), worlds.qvel.shape))
    for _ in range(5):
        kicked, _ = step(VALUES, kicked)
    expected, _ = native_step(same(NATIVE), kicked)
    np.testing.assert_allclose(step(VALUES, kicked)[0].qvel, expected.qvel, atol=1e-3)


def test_warp_agrees_with_native(worlds):
    """On the ground, with a controller that uses mass matrix and bias."""
    pytest.importorskip("warp")
    warp = make_physics("mjx-warp", worlds=WORLDS)

    def balance(stages: Stages):
        matrix, bias = stages.dynamics()
        weight = matrix[-10:, -10:] @ stages.qvel + bias[-10:]
        return hold(stages) + 0.1 * weight

    world, native = (
        jax.jit(jax.vmap(lambda world, p=physics: p.run(world, balance, 2)))(worlds) for physics in (warp, NATIVE)
    )
    np.testing.assert_allclose(world.qvel, native.qvel, atol=1e-3)


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
