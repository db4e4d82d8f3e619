"""The legs as chains and in native MuJoCo: the same accelerations in double precision."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from humanoid_mjx.physics import make_physics

CHAIN, NATIVE = make_physics("chain"), make_physics("mujoco", robot="legs")
rng = np.random.default_rng(0)
QPOS, QVEL = rng.uniform(-3, 3, (2, 20, 10))
TORQUE = rng.uniform(-1, 1, (20, 10))


def cycle(physics):
    """A step of many robots from where they are, under these torques."""

    def one(qpos, qvel, torque):
        return physics.step(physics.start(qpos, qvel), lambda stages: torque)[0]

    return jax.jit(jax.vmap(one))


def test_accelerations():
    chain, native = (cycle(physics)(QPOS, QVEL, TORQUE) for physics in (CHAIN, NATIVE))
    np.testing.assert_allclose((chain.qvel - native.qvel) / CHAIN.timestep, 0.0, atol=1e-8)


def test_places_of_the_links():
    ours, native = (
        jax.vmap(lambda q, physics=physics: physics.sense(physics.start(q, q), 0 * q).poses)(QPOS)
        for physics in (CHAIN, NATIVE)
    )
    rows = [NATIVE.body_names.index(name) for name in CHAIN.body_names]
    np.testing.assert_allclose(ours.position, native.position[:, rows], atol=1e-12)
    np.testing.assert_allclose(ours.rotation[:, 1:], native.rotation[:, rows[1:]], atol=1e-12)


@pytest.mark.parametrize("physics", [CHAIN, NATIVE], ids=lambda physics: type(physics).__name__)
def test_what_a_model_asks_for_is_what_moves_it(physics):
    """One mass factor for the robot, or one for each link."""

    def step(qpos, wanted, mass):
        plant = physics.replace(mass=mass, torque_limit=1e6)
        world = plant.start(qpos, 0 * qpos)
        return plant.step(world, lambda stages: stages.torque_for(wanted, mass))[0].qvel

    for mass in (jnp.float64(1.7), jnp.linspace(0.7, 1.7, 10)):
        qvel = jax.jit(jax.vmap(step, in_axes=(0, 0, None)))(QPOS, jnp.array(TORQUE), mass)
        np.testing.assert_allclose(qvel, TORQUE * CHAIN.timestep, atol=1e-10)
