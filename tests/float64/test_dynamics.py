"""The dynamics in double precision: reference, fast version and MuJoCo agree; physics holds."""

from functools import partial

import jax
import jax.numpy as jnp
import lagrange_euler
import mujoco
import numpy as np
import pytest
from jax.test_util import check_grads
from opponents import make_mjspec

from humanoid_mjx import compute
from humanoid_mjx.mechanics import dynamics
from humanoid_mjx.robot.chain import Chain
from humanoid_mjx.robot.leg import ALONG_THE_LEG, AS_PRINTED, Leg

GRAVITIES = {"along_the_leg": ALONG_THE_LEG, "as_printed": AS_PRINTED}
SETS = {"thesis": Leg.thesis, "matlab_script": Leg.matlab_script}
CLOSE = partial(np.testing.assert_allclose, rtol=0, atol=1e-10)


def terms(module, leg, qpos, qvel, qacc):
    return {
        "mass_matrix": module.mass_matrix(leg, qpos),
        "coriolis": module.coriolis(leg, qpos, qvel),
        "gravity": module.gravity(leg, qpos),
        "torque": module.inverse_dynamics(leg, qpos, qvel, qacc),
    }


fast = jax.jit(jax.vmap(partial(terms, dynamics), in_axes=(None, 0, 0, 0)))
reference = jax.jit(jax.vmap(partial(terms, lagrange_euler), in_axes=(None, 0, 0, 0)))
velocity_coefficients = jax.jit(jax.vmap(lagrange_euler.velocity_coefficients, in_axes=(None, 0)))
forward = jax.jit(jax.vmap(dynamics.forward_dynamics, in_axes=(None, 0, 0, 0)))


def random_states(joints, number=100, seed=0):
    generator = np.random.default_rng(seed)
    qpos, qvel, qacc = generator.uniform(-1, 1, (3, number, joints))
    return jnp.array(qpos * np.pi), jnp.array(qvel * 5), jnp.array(qacc * 50)


def random_chain(seed=0):
    """Three joints with skew axes, every length and offset, and full inertias."""
    generator = np.random.default_rng(seed)
    points = generator.normal(size=(3, 8, 4))
    points[..., 3] = 1
    return Chain.build(
        theta_offset=(0.3, -1.1, 2.0),
        d=(0.1, -0.2, 0.15),
        a=(0.3, 0.2, -0.25),
        alpha=(0.7, -1.9, 0.4),
        pseudo_inertia=np.einsum("lpi,lpj->lij", points, points) / 10,
        gravity=(1.0, -2.0, -9.0),
    )


def from_mujoco(leg, qpos, qvel):
    """The mass matrix and the bias of MuJoCo."""
    model = make_mjspec(leg).compile()
    data = mujoco.MjData(model)
    matrices, biases = [], []
    for data.qpos[:], data.qvel[:] in zip(np.asarray(qpos), np.asarray(qvel), strict=True):
        mujoco.mj_forward(model, data)
        matrix = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, matrix)
        matrices.append(matrix)
        biases.append(data.qfrc_bias.copy())
    return np.array(matrices), np.array(biases)


@pytest.mark.parametrize("gravity", GRAVITIES)
@pytest.mark.parametrize("parameters", [*SETS, "random_chain"])
def test_reference_fast_version_and_mujoco_agree(parameters, gravity):
    leg = random_chain() if parameters == "random_chain" else SETS[parameters](GRAVITIES[gravity])
    states = random_states(leg.num_joints)
    ours, slow = fast(leg, *states), reference(leg, *states)
    for name, value in ours.items():
        CLOSE(value, slow[name], err_msg=name)
    matrix, bias = from_mujoco(leg, *states[:2])
    CLOSE(ours["mass_matrix"], matrix)
    CLOSE(ours["coriolis"] + ours["gravity"], bias)


@pytest.mark.parametrize("parameters", SETS)
def test_structure_of_the_equations(parameters):
    leg = SETS[parameters]()
    qpos, qvel, qacc = random_states(5, seed=1)
    ours = fast(leg, qpos, qvel, qacc)
    matrix = np.asarray(ours["mass_matrix"])
    CLOSE(matrix, matrix.swapaxes(1, 2), atol=1e-15)
    assert np.linalg.eigvalsh(matrix).min() > 0
    coefficients = velocity_coefficients(leg, qpos)
    CLOSE(coefficients, coefficients.swapaxes(2, 3))
    rate = jax.vmap(lambda q, v: jax.jvp(partial(dynamics.mass_matrix, leg), (q,), (v,))[1])(qpos, qvel)
    CLOSE(jnp.einsum("si,si->s", qvel, ours["coriolis"]), jnp.einsum("si,sij,sj->s", qvel, rate, qvel) / 2)
    CLOSE(dynamics.bias(leg, qpos[0], qvel[0]), ours["coriolis"][0] + ours["gravity"][0])
    both = dynamics.mass_matrix_and_bias(leg, qpos[0], qvel[0])
    CLOSE(both[0], matrix[0])
    CLOSE(both[1], ours["coriolis"][0] + ours["gravity"][0])


@pytest.mark.parametrize("make", [*SETS.values(), Leg.physical, random_chain])
def test_forward_undoes_inverse(make):
    leg = make()
    qpos, qvel, qacc = random_states(leg.num_joints, seed=2)
    torque = fast(leg, qpos, qvel, qacc)["torque"]
    np.testing.assert_allclose(forward(leg, qpos, qvel, torque), qacc, rtol=1e-9, atol=1e-9)


def test_gradients_match_finite_differences():
    leg = Leg.thesis()
    qpos, qvel, qacc = (x[0] for x in random_states(5, seed=4))
    forward_from = jax.jit(partial(dynamics.forward_dynamics, leg))
    check_grads(forward_from, (qpos, qvel, qacc / 100), 1, rtol=1e-5)
    check_grads(jax.jit(lambda s: dynamics.inverse_dynamics(leg.scaled(s), qpos, qvel, qacc)), (1.1,), 1, rtol=1e-5)


def energy_errors(integrator):
    """What 100 steps of 2 ms, and 200 of 1 ms, add to the energy, J."""
    leg, start = Leg.physical(), (jnp.array([0.3, 0.2, -0.4, 0.5, 0.6]), jnp.array([1.0, -0.5, 0.8, 0.3, -1.0]))

    def energies(dt):
        states = dynamics.rollout(leg, *start, no_torque, dt, 200, integrator)[1]
        return jax.vmap(partial(dynamics.energy, leg))(*states) - dynamics.energy(leg, *start)

    coarse, fine = np.abs(jax.jit(jax.vmap(energies))(jnp.array([2e-3, 1e-3])))
    return coarse[99], fine[199]


def no_torque(time, qpos, qvel):
    return jnp.zeros_like(qpos)


@pytest.mark.parametrize(
    ("integrator", "order"), [(dynamics.semi_implicit_euler, 1), (dynamics.midpoint, 2), (dynamics.runge_kutta, 4)]
)
def test_energy_is_conserved_to_the_integrators_order(integrator, order):
    coarse, fine = energy_errors(integrator)
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.35)
    assert fine < {1: 1e-3, 2: 1e-5, 4: 1e-7}[order]


def test_a_rollout_is_mujocos():
    leg, generator = Leg.thesis(), np.random.default_rng(5)
    torques = jnp.array(generator.uniform(-1e-2, 1e-2, (100, 5)))
    start = jnp.array([0.3, 0.2, -0.4, 0.5, 0.6]), jnp.zeros(5)

    def controller(time, qpos, qvel):
        return torques[jnp.round(time / 0.002).astype(int)]

    simulate = partial(dynamics.rollout, leg, controller=controller, dt=0.002, steps=100)
    final, states = jax.jit(simulate, compiler_options=compute.compiler_options("scalars"))(*start)
    model = make_mjspec(leg, 0.002).compile()
    data = mujoco.MjData(model)
    data.qpos[:] = start[0]
    for torque in np.asarray(torques):
        data.qfrc_applied[:] = torque
        mujoco.mj_step(model, data)
    CLOSE(final.qpos, data.qpos)
    CLOSE(final.qvel, data.qvel, atol=1e-8)
    CLOSE(states.qpos[-1], final.qpos)
