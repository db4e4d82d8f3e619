# pyright: reportAttributeAccessIssue=false
"""Terrain against native MuJoCo, against its own derivative, and against the laws of friction."""

from functools import cache

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from tree_robots import BALLS, BLOCK, converged, native, qacc_of

from humanoid_mjx.mechanics.terrain import Terrain
from humanoid_mjx.mechanics.tree.reading import read_tree
from humanoid_mjx.mechanics.tree.step import Values
from humanoid_mjx.physics import make_physics
from humanoid_mjx.physics.terrain import add_terrain
from humanoid_mjx.physics.tree import on_stairs
from humanoid_mjx.spec import InputError


def balls(turn=(1.0, 0.0, 0.0, 0.0)):
    spec = mujoco.MjSpec.from_string(BALLS)
    spec.geom("ground").quat = turn
    return spec


def somewhere(terrain, count, seed=0):
    """States whose first ball is near the ground: in it, on it, above it."""
    rng = np.random.default_rng(seed)
    qpos = np.concatenate([rng.uniform(-1, 1, (count, 3)), rng.normal(size=(count, 4))], axis=1)
    qpos[:, 3:] = [1, 0, 0, 0] + 0.3 * qpos[:, 3:]
    qpos[:, 3:] /= np.linalg.norm(qpos[:, 3:], axis=1, keepdims=True)
    qpos[:, 2] = terrain.height(qpos[:, 0], qpos[:, 1], np) + 0.03 + rng.uniform(-0.04, 0.003, count)
    return qpos, rng.normal(size=(count, 6)), np.zeros((count, 0))


def test_stairs_are_boxes_of_native_mujoco():
    """Treads, risers, edges, both boxes at once, middles of balls inside of boxes."""
    terrain = Terrain(stairs=0.05, width=0.12, direction=25.0)
    spec = balls()
    add_terrain(spec, terrain)
    at = somewhere(terrain, 2000)
    expected = native(converged(spec.compile()), *at)
    found, settled = qacc_of(on_stairs(read_tree(balls().compile())))(Values(terrain=terrain), *at)
    assert settled.all() and (np.abs(expected[:, :2]) > 1.0).any(axis=1).sum() > 500
    assert (np.linalg.norm(found - expected, axis=1) / np.linalg.norm(expected, axis=1)).max() < 1e-9


def test_a_slope_is_a_turned_plane_of_native_mujoco():
    """The world turned by the slope, and everything in it, moves in the same way."""
    physics = make_physics("tree", terrain={"slope": 12.0})
    half = np.radians(12.0) / 2
    turn = np.array([np.cos(half), 0.0, -np.sin(half), 0.0])
    model = converged(balls(turn).compile())
    qpos, qvel, ctrl = somewhere(Terrain(), 500)
    turned, moved, rotation = qpos.copy(), qvel.copy(), np.empty(9)
    mujoco.mju_quat2Mat(rotation, turn)
    rotation = rotation.reshape(3, 3)
    turned[:, :3], moved[:, :3] = qpos[:, :3] @ rotation.T, qvel[:, :3] @ rotation.T
    for row, old in zip(turned, qpos, strict=True):
        mujoco.mju_mulQuat(row[3:], turn, old[3:])
    expected = native(model, turned, moved, ctrl)
    expected[:, :3] = expected[:, :3] @ rotation
    found, settled = qacc_of(read_tree(balls().compile()))(Values(gravity=physics.gravity), qpos, qvel, ctrl)
    assert settled.all()
    assert (np.linalg.norm(found - expected, axis=1) / np.linalg.norm(expected, axis=1)).max() < 1e-9


def test_rough_ground_is_its_tangent_plane():
    """The nearest point of the ground, by descent, is as far away to first order in the distance."""
    terrain = Terrain(rough=0.05, wavelength=0.4)
    x, y = np.random.default_rng(0).uniform(-3, 3, (2, 200))
    height, slopes = terrain.height(x, y, np), jax.vmap(jax.grad(terrain.height, argnums=(0, 1)))(x, y)
    normal = np.array([-slopes[0], -slopes[1], np.ones(200)])
    normal /= np.linalg.norm(normal, axis=0)
    assert np.abs(height).max() <= 0.05 and np.degrees(np.arccos(normal[2])).max() > 20
    wrong = []
    for far in (0.002, 0.001):
        place = np.array([x, y, height]) + far * normal
        distance, found = terrain.nearest(jnp.asarray(place[:, None]), upper=False)
        wrong.append((np.abs(distance - far).max(), np.abs(found[:, 0] - normal).max()))
    # Halving the distance leaves a fourth of the error of a distance, and half of that of a normal.
    (first, turned), (second, less) = wrong
    assert 3.5 < first / second < 4.5 and second < 0.001 * 0.05
    assert 1.7 < turned / less < 2.3


@cache
def sliding():
    """The block's motion over 0.4 s, compiled once for all slopes."""
    return qacc_of(read_tree(mujoco.MjModel.from_xml_string(BLOCK)), 400)


@pytest.mark.parametrize(("degrees", "slides"), [(24.0, False), (26.0, False), (27.2, True), (35.0, True)])
def test_a_block_slides_on_a_slope_steeper_than_friction_bears(degrees, slides):
    """Coulomb's law with one coefficient: held below arctan(0.5) = 26.6 degrees, beyond it g (sin - mu cos).

    MuJoCo's contacts are soft: a block that is held creeps by millimetres a second, and one that slides shakes, whereby
    it feels up to 4% less friction.
    """
    gravity = make_physics("tree", terrain={"slope": degrees}).gravity
    at = np.array([[0.0, 0.0, 0.0199, 1.0, 0.0, 0.0, 0.0]]), np.zeros((1, 6)), np.zeros((1, 0))
    half = sliding()(Values(gravity=gravity), *at)
    whole = sliding()(Values(gravity=gravity), *half[:2], at[2])
    acceleration, slope = (half[1][0, 0] - whole[1][0, 0]) / 0.4, np.radians(degrees)
    friction = (9.81 * np.sin(slope) - acceleration) / (9.81 * np.cos(slope))
    if slides:
        assert 0.96 < friction / 0.5 <= 1.0
    else:
        assert friction == pytest.approx(np.tan(slope), abs=0.002) and np.abs(whole[1][0, :2]).max() < 0.006


@pytest.mark.parametrize("shape", [{"stairs": 0.004, "width": 0.1}, {"rough": 0.004}])
def test_a_body_on_a_slope_with_stairs_or_waves_feels_what_it_does_in_native_mujoco(shape):
    """Each foot partly over a riser or a wave; forces on its corners, and gravity that leans."""
    rng, angle = np.random.default_rng(1), np.linspace(0.0, 2 * np.pi, 32)
    qpos = np.zeros((32, 17))
    qpos[:, :2], qpos[:, 3], qpos[:, 6] = rng.uniform(-0.3, 0.3, (32, 2)), np.cos(angle / 2), np.sin(angle / 2)
    sensed = []
    for name in ("tree", "mujoco"):
        physics = make_physics(name, terrain={"slope": 8.0, "direction": 40.0} | shape)
        qpos[:, 2] = physics.qpos0[2] + physics.terrain.height(*qpos[:, :2].T, np) - 0.001
        worlds = jax.vmap(lambda q, physics=physics: physics.start(q, jnp.zeros(16)))(jnp.asarray(qpos))
        sensed.append(jax.jit(jax.vmap(lambda world, physics=physics: physics.sense(world, jnp.zeros(10))))(worlds))
    found, expected = sensed
    assert 60 < (np.asarray(expected.contacts.normal_force) > 0.1).sum() < 250
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-8)


def test_shapes_that_a_physics_lacks_are_refused():
    with pytest.raises(InputError, match="physics takes slope with rough or slope with stairs, got rough with"):
        make_physics("mujoco", terrain={"rough": 0.01, "stairs": 0.01})
    with pytest.raises(InputError, match="terrain: this physics takes slope, got rough"):
        make_physics("mjx-jax", terrain={"rough": 0.01})
