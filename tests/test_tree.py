"""The tree in single precision: against native MuJoCo, world by world, and what it refuses."""

from functools import cache

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from tree_robots import HOPPER, converged, native, qacc_of, states

from humanoid_mjx import runtime
from humanoid_mjx.mechanics.tree.folding import fold
from humanoid_mjx.mechanics.tree.reading import read_tree
from humanoid_mjx.mechanics.tree.solver import BLOCK
from humanoid_mjx.mechanics.tree.step import Values
from humanoid_mjx.physics import make_physics
from humanoid_mjx.robot.lower_body import lower_body_model
from humanoid_mjx.spec import InputError

TREE, NATIVE = (make_physics(name, ranges="human") for name in ("tree", "mujoco"))


def test_accelerations_agree_with_native():
    """Rounding to 6e-8, times what stiff contacts of light feet make of it."""
    model = converged(lower_body_model("free", "human"))
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

    options = runtime.SHARED_KERNELS if physics is TREE else None
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
    return jax.jit(each, compiler_options=runtime.SHARED_KERNELS)


@pytest.fixture(scope="module")
def worlds():
    qpos = np.tile(TREE.qpos0, (4, 1))
    qpos[:, 7:] += np.random.default_rng(0).uniform(0, 0.1, (4, 10))
    return jax.vmap(lambda qpos: TREE.start(qpos, np.zeros(16)))(qpos)


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


def test_an_unsettled_world_is_flagged_and_stays(monkeypatch, worlds):
    """A single step of the search does not get from standing in the air to falling on both feet and beyond."""
    from humanoid_mjx.mechanics.tree import batching, solver

    monkeypatch.setattr(solver, "MOST_STEPS", 1)
    batching.worlds_last.cache_clear()
    qpos = worlds.qpos.at[1, 2].add(1.0)
    start = worlds._replace(qpos=qpos, warmstart=worlds.warmstart.at[:, 2].set(1e3))
    try:
        after = jax.jit(jax.vmap(lambda world: TREE.step(world, lambda stages: jnp.zeros(10))[0]))(start)
    finally:
        batching.worlds_last.cache_clear()
    np.testing.assert_array_equal(after.diverged, [True, False, True, True])
    np.testing.assert_array_equal(after.qpos[0], start.qpos[0])
    assert (after.qpos[1] != start.qpos[1]).any()


REFUSED = {
    "slide joints, as 'j'": '<joint name="j" type="slide"/>',
    "ball joints, as 'j'": '<joint name="j" type="ball"/>',
    "dry friction of joints": '<joint name="j" frictionloss="1"/>',
}


@pytest.mark.parametrize("words", REFUSED)
def test_joints_that_are_refused(words):
    body = f'<body>{REFUSED[words]}<geom type="sphere" size="0.1"/></body>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    with pytest.raises(InputError) as error:
        read_tree(model)
    assert str(error.value) == f"physics: the tree cannot represent {words}."


BOX = 'size=".1 .1 .1"'
DAMPER = '<damper joint="ankle" kv="1" ctrlrange="0 1"/>'
CYLINDER = 'type="cylinder" size="0.1 0.1" pos'


@pytest.mark.parametrize(
    ("words", "old", "new"),
    [
        ("contacts of a plane and a box, as those of 'ground-shank'.", 'fromto="0 0 0 0 0 -0.2" size="0.015"', BOX),
        ("contacts that resist twisting or rolling, as 'ground-shank'.", 'condim="1"', 'condim="6"'),
        ("elliptic friction cones.", 'impratio="2"', 'cone="elliptic"'),
        ("an integrator other than Euler.", 'impratio="2"', 'integrator="implicit"'),
        ("a fluid.", 'impratio="2"', 'density="1.2"'),
        ("equality constraints.", "<actuator>", '<equality><joint joint1="hip" joint2="knee"/></equality><actuator>'),
        ("tendons.", "<actuator>", '<tendon><fixed name="t"><joint joint="hip" coef="1"/></fixed></tendon><actuator>'),
        ("actuators whose gain is not fixed.", '<motor joint="ankle"/>', DAMPER),
        ("a touch sensor that is no box or ball, as 'sole'.", 'type="sphere" size="0.1" pos', CYLINDER),
    ],
)  # fmt: skip
def test_models_that_are_refused(words, old, new):
    """The hopper with one change."""
    assert old in HOPPER
    changed = HOPPER.replace(old, new)
    if new == BOX:
        changed = changed.replace('type="capsule" ' + BOX, 'type="box" ' + BOX)
    with pytest.raises(InputError) as error:
        read_tree(mujoco.MjModel.from_xml_string(changed))
    assert str(error.value) == f"physics: the tree cannot represent {words}"


def test_a_cycle_of_several_steps_holds_its_torque(worlds):
    """As in native MuJoCo, where the controller uses all that it is given."""

    def balance(stages):
        pull = jnp.einsum("pxv,px->v", stages.contacts().jacobian, stages.contacts().drift)[6:]
        weight = stages.mass_matrix[-10:, -10:] @ stages.qvel + stages.bias[-10:]
        return -6.0 * stages.qpos - 0.2 * stages.qvel + 0.1 * weight + 1e-3 * pull

    def cycles(physics):
        return jax.jit(jax.vmap(lambda world: physics.step(world, balance, substeps=3)))

    (world, torque), (expected, expected_torque) = cycles(TREE)(worlds), cycles(NATIVE)(worlds)
    np.testing.assert_allclose(torque, expected_torque, atol=1e-6)
    np.testing.assert_allclose(world.qvel, expected.qvel, atol=1e-3)
    np.testing.assert_allclose(world.qpos, expected.qpos, atol=1e-5)


def test_torque_for_another_mass_is_the_models(worlds):
    """The torques that native MuJoCo's inverse dynamics gives with each link's own factor."""
    factors, qacc = jnp.linspace(0.5, 1.5, 10), jnp.ones(10)

    def torques(physics):
        noted = []

        def note(stages):
            noted.append((stages.torque_for(qacc, factors), stages.contacts(), stages.mass_matrix, stages.bias))
            return jnp.zeros(10)

        def ask(world):
            physics.step(world, note)
            return noted[-1]

        return jax.jit(jax.vmap(ask))(worlds._replace(qvel=worlds.qvel + 0.3))

    for one, two in zip(jax.tree.leaves(torques(TREE)), jax.tree.leaves(torques(NATIVE)), strict=True):
        np.testing.assert_allclose(one, two, atol=1e-5)
