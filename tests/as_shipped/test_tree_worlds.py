"""The tree with the kernels that users have: how near single precision comes, and worlds that do not touch each
other."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tree_robots import converged, native, near_upright, qacc_of, states

from humanoid_mjx import compute
from humanoid_mjx.mechanics.tree.folding import fold
from humanoid_mjx.mechanics.tree.reading import read_tree
from humanoid_mjx.mechanics.tree.search import BLOCK
from humanoid_mjx.mechanics.tree.step import Values
from humanoid_mjx.physics import make_physics
from humanoid_mjx.robot.lower_body import LowerBody

TREE, NATIVE = (make_physics(name, robot={"ranges": "human"}) for name in ("tree", "mujoco"))


def test_accelerations_agree_with_native():
    """Rounding to 6e-8, times what stiff contacts of light feet make of it."""
    model = converged(LowerBody(ranges="human").spec().compile())
    at = states(model, 4000, seed=7)
    qacc, settled = qacc_of(fold(read_tree(model)))(Values(), *at)
    # MuJoCo starts from the same states, rounded.
    expected = native(model, *(x.astype(np.float32).astype(float) for x in at))
    errors = np.linalg.norm(qacc - expected, axis=1) / np.linalg.norm(expected, axis=1)
    assert settled.all()
    assert np.quantile(errors, 0.999) < 1e-4


MOTIONS = {"standing": ((0.0, 0.0, 0.0), 0.0), "pushed": ((0.6, 0.3, 0.0), 0.0), "stepping": ((0.0, 0.0, 0.0), 0.3)}
"""The push, N, and how far the legs step, rad."""


@cache
def motion(physics, steps):
    """Worlds after so many steps under a servo, while pushed and stepping: one program for all of `MOTIONS`."""

    def run(push, lift, qpos, qvel):
        one = physics.replace(push=push)

        def cycle(world, index):
            time = index * physics.step_s
            lifted = lift * jnp.maximum(jnp.sin(2.0 * jnp.pi * time / 0.5 + jnp.array([0.0, jnp.pi])), 0.0)
            leg = jnp.array([1.0, 0.0, 0.0, 2.0, 1.0])
            target = jnp.array([0.15, 0.0, 0.0, 0.3, 0.15] * 2) + (lifted[:, None] * leg).reshape(10)
            world, _ = one.step(world, lambda s: 6.0 * (target - s.qpos) - 0.2 * s.qvel)
            return world, None

        world = one.start(qpos, qvel)
        return jax.lax.scan(cycle, world, jnp.arange(steps))[0]

    options = compute.compiler_options("tree") if physics is TREE else None
    return jax.jit(jax.vmap(run, in_axes=(None, None, 0, 0)), compiler_options=options)


@pytest.mark.parametrize("name", MOTIONS)
def test_a_second_of_motion_agrees_with_native(name):
    rng = np.random.default_rng(8)
    qpos = np.tile(TREE.qpos0, (8, 1))
    qpos[:, 7:] += np.array([0.15, 0.0, 0.0, 0.3, 0.15] * 2) + rng.uniform(-0.02, 0.02, (8, 10))
    qpos[:, 2] -= 0.004
    qvel = 0.05 * rng.normal(size=(8, 16))
    world, expected = (motion(physics, 250)(*MOTIONS[name], qpos, qvel) for physics in (TREE, NATIVE))
    assert not world.diverged.any()
    np.testing.assert_allclose(world.qpos, expected.qpos, atol=1e-3)


@pytest.fixture(scope="module")
def step():
    hold = lambda stages: -6.0 * stages.qpos - 0.2 * stages.qvel  # noqa: E731
    each = jax.vmap(lambda world: TREE.step(world, hold))
    return jax.jit(each, compiler_options=compute.compiler_options("tree"))


@pytest.fixture(scope="module")
def worlds():
    return near_upright(TREE)


def legs_crossed(worlds):
    """The second body with its legs in each other, far inside, and fast."""
    qpos = worlds.qpos.at[1, 7:].set(jnp.array([0.0, 0.0, -0.5, 0.1, 0.0] * 2))
    return worlds._replace(qpos=qpos, qvel=worlds.qvel.at[1, 6:].set(30.0))


FAULTS = {
    "nan": lambda w: w._replace(qvel=w.qvel.at[1, 8].set(jnp.nan)),
    "nan far away": lambda w: w._replace(qpos=w.qpos.at[1, 0].set(jnp.nan)),
    "fast": lambda w: w._replace(qvel=w.qvel.at[1, 8].set(1e6)),
    "legs crossed": legs_crossed,
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_world_changes_no_bit_of_another(step, worlds, fault):
    """Nor do contacts that only one world has, though they let all take another way through the program."""
    good, bad, others = worlds, FAULTS[fault](worlds), np.array([0, 2, 3])
    for _ in range(10):
        (good, torque), (bad, bad_torque) = step(good), step(bad)
        for one, two in zip(jax.tree.leaves((good, torque)), jax.tree.leaves((bad, bad_torque)), strict=True):
            np.testing.assert_array_equal(np.asarray(one)[others], np.asarray(two)[others])
    assert not bad.diverged[others].any()
    if fault != "legs crossed":
        assert bad.diverged[1]


def test_legs_in_each_other_in_more_worlds_than_a_block_holds(step, worlds):
    """They move as in a batch that is searched at once, and change no bit of the other worlds; nor do as many NaNs."""
    rows = np.r_[0, np.ones(BLOCK + 2, int), 2, 3]
    others, expected = rows != 1, step(legs_crossed(worlds))[0]
    apart, crossed, broken = (
        step(jax.tree.map(lambda x: x[rows], w))[0] for w in (worlds, legs_crossed(worlds), FAULTS["nan"](worlds))
    )
    for one, *found in zip(*map(jax.tree.leaves, (apart, crossed, broken)), strict=True):
        for two in found:
            np.testing.assert_array_equal(np.asarray(one)[others], np.asarray(two)[others])
    assert np.abs(crossed.qvel[1] - apart.qvel[1]).max() > 1.0
    # Rounding of stiff contacts: kernels may compute the last worlds of a batch by other instructions.
    np.testing.assert_allclose(crossed.qvel, expected.qvel[rows], rtol=1e-4, atol=1e-4)
