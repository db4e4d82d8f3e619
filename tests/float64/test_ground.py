"""Contacts of the feet against MuJoCo's own, and inverse dynamics within them against slow projections."""

from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from humanoid_mjx.control import at_rest, grounded_torque, make_law
from humanoid_mjx.control.ground import constrained_dynamics, eliminate
from humanoid_mjx.control.stages import Stages
from humanoid_mjx.physics import make_physics
from humanoid_mjx.robot.description import ground_points

FREE = make_physics("mjx-jax", robot={"ranges": "human"})
NATIVE = make_physics("mujoco", robot={"ranges": "human"})


@partial(jax.jit, static_argnums=0)
def look(physics, qpos, qvel):
    """What a controller sees in a state."""
    seen = {}

    def controller(stages):
        matrix, bias = stages.dynamics()
        seen.update(matrix=matrix, bias=bias, contacts=stages.contacts())
        return jnp.zeros(10)

    physics.step(physics.start(qpos, qvel), controller)
    return seen


def random_state(seed):
    rng = np.random.default_rng(seed)
    qpos = FREE.qpos0 + np.r_[0.01 * rng.normal(size=3), 0.1 * rng.normal(size=4), rng.uniform(0.2, 0.6, 10)]
    qpos[3:7] /= np.linalg.norm(qpos[3:7])
    return qpos, rng.normal(size=16)


@pytest.mark.parametrize("seed", range(3))
def test_contacts_are_mujocos(seed):
    """Their places, which of them touch, their Jacobian and its rate."""
    qpos, qvel = random_state(seed)
    model, data = FREE.model, mujoco.MjData(FREE.model)
    balls, _ = ground_points(FREE.model)
    data.qpos, data.qvel = qpos, qvel
    mujoco.mj_kinematics(model, data)
    qpos[2] -= np.median(data.geom_xpos[balls, 2])
    data.qpos = qpos
    mujoco.mj_forward(model, data)
    contacts = look(FREE, qpos, qvel)["contacts"]
    assert [model.geom(ball).name for ball in balls] == [f"{s}_corner{i}" for s in ("right", "left") for i in range(4)]
    assert {int(g) for g in data.contact.geom[:, 1]} & set(balls.tolist()) == set(balls[contacts.touching].tolist())
    assert 0 < contacts.touching.sum() < 8
    for i, ball in enumerate(balls):
        jacobian, rate = np.zeros((2, 3, 16))
        lowest, body = data.geom_xpos[ball] - [0, 0, model.geom_size[ball, 0]], model.geom_bodyid[ball]
        mujoco.mj_jac(model, data, jacobian, None, lowest, body)
        mujoco.mj_jacDot(model, data, rate, None, lowest, body)
        np.testing.assert_allclose(contacts.position[i], lowest, atol=1e-12)
        np.testing.assert_allclose(contacts.jacobian[i], jacobian, atol=1e-12)
        np.testing.assert_allclose(contacts.drift[i], rate @ qvel, atol=1e-12)
    for ours, others in zip(contacts, look(NATIVE, qpos, qvel)["contacts"], strict=True):
        np.testing.assert_allclose(ours, others, atol=1e-12)


@pytest.mark.parametrize("name", ["chain", "mjx-jax"])
def test_there_is_no_ground_in_the_air(name):
    physics = make_physics(name) if name == "chain" else make_physics(name, robot={"torso": "fixed"})
    contacts = jax.eval_shape(partial(look, physics), np.zeros(10), np.zeros(10))["contacts"]
    assert contacts.jacobian.shape == (0, 3, 10) and contacts.touching.shape == (0,)


TAKEN = {"11111111": 12, "11110111": 12, "11110011": 11, "11110010": 9, "11110000": 6, "01000010": 6, "00000000": 0}


@pytest.mark.parametrize(("touching", "taken"), TAKEN.items())
def test_a_corner_takes_what_it_can(touching, taken):
    """Six degrees of freedom a flat foot, five an edge, three a corner: against the projection by a pseudo-inverse."""
    seen = look(FREE, *random_state(0))
    touch = np.array([int(c) for c in touching], bool)
    matrix, bias = np.asarray(seen["matrix"]), np.asarray(seen["bias"])
    mobility, drift = constrained_dynamics(
        seen["matrix"], seen["bias"], seen["contacts"]._replace(touching=jnp.array(touch))
    )
    rows = np.asarray(seen["contacts"].jacobian)[touch].reshape(-1, 16)
    rates = np.asarray(seen["contacts"].drift)[touch].reshape(-1)
    assert np.linalg.matrix_rank(rows, tol=1e-9) == taken
    force = np.random.default_rng(1).normal(size=16)
    free = np.linalg.solve(matrix, force - bias)
    inverse = np.linalg.inv(matrix)
    resistance = np.linalg.pinv(rows @ inverse @ rows.T, rcond=1e-10)
    expected = free - inverse @ rows.T @ resistance @ (rows @ free + rates)
    # The softness is 1e-4 / kg of the inverse inertia that the contacts see: a percent where it is least.
    np.testing.assert_allclose(mobility @ force + drift, expected, atol=1e-2 * np.abs(free).max())
    assert np.abs(rows @ (mobility @ force + drift) + rates).max(initial=0.0) < 1e-3 * np.abs(free).max()


def test_elimination_solves():
    rng = np.random.default_rng(0)
    root, right = rng.normal(size=(12, 12)), rng.normal(size=(12, 3))
    matrix = root @ root.T + 1e-3 * np.eye(12)
    np.testing.assert_allclose(
        eliminate(jnp.array(matrix), jnp.array(right)), np.linalg.solve(matrix, right), rtol=1e-8
    )


@pytest.mark.parametrize("touching", ["00000000", "11110000"])
def test_joints_accelerate_as_wanted_where_contacts_let_them(touching):
    """In flight and on one flat foot every acceleration of the joints is possible: without a share for the servo the
    torque brings about the one wanted."""
    seen = look(FREE, *random_state(0))
    contacts = seen["contacts"]._replace(touching=jnp.array([int(c) for c in touching], bool))
    held, wanted = jnp.array(np.random.default_rng(2).normal(size=(2, 10)))
    torque = grounded_torque(wanted, held, 0.0, seen["matrix"], seen["bias"], contacts, np.arange(6, 16))
    mobility, drift = constrained_dynamics(seen["matrix"], seen["bias"], contacts)
    np.testing.assert_allclose((mobility[:, 6:] @ torque + drift)[6:], wanted, atol=1e-6)


@pytest.mark.parametrize("touching", ["11110000", "11111111"])
def test_the_share_weighs_the_servo_against_the_accelerations(touching):
    """The torque is where a sum of squares is least: what remains of the accelerations wanted, in the metric of the
    inertia, and what is added to the servo's torque, in that of its inverse, times the share squared."""
    seen = look(FREE, *random_state(0))
    contacts = seen["contacts"]._replace(touching=jnp.array([int(c) for c in touching], bool))
    held, wanted = jnp.array(np.random.default_rng(2).normal(size=(2, 10)))
    mobility, drift = constrained_dynamics(seen["matrix"], seen["bias"], contacts)
    inertia = np.asarray(seen["matrix"])[6:, 6:]

    def cost(torque):
        remains, added = wanted - mobility[6:, 6:] @ torque - drift[6:], torque - held
        return remains @ inertia @ remains + 0.1**2 * added @ np.linalg.inv(inertia) @ added

    torque = grounded_torque(wanted, held, 0.1, seen["matrix"], seen["bias"], contacts, np.arange(6, 16))
    slope = jax.grad(cost)  # at the minimum rounding leaves less than 1e-6 of it
    assert np.abs(slope(torque)).max() < 1e-6 * np.abs(slope(held)).max()


def test_gains_are_data():
    """A batch of gains and shares gives what each gives alone."""
    seen = look(FREE, *random_state(0))
    scale = jnp.array([0.5, 1.0, 2.0])
    laws = jax.vmap(lambda x: jax.tree.map(lambda leaf: x * leaf, make_law("grounded")))(scale)
    dynamics = seen["matrix"], seen["bias"]
    state = Stages(
        jnp.full(10, 0.1), jnp.ones(10), lambda: dynamics, lambda: seen["contacts"], lambda mass: dynamics, slice(6, 16)
    )
    still = at_rest(jnp.zeros(10))
    together = jax.vmap(lambda law: law(still, state))(laws)
    for i in range(3):
        np.testing.assert_allclose(together[i], jax.tree.map(lambda x, i=i: x[i], laws)(still, state), rtol=1e-9)
    assert np.abs(together[2] - together[0]).min() > 1e-3
