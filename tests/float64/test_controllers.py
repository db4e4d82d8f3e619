"""Controllers on the simulated leg: the error equation, its order of convergence, cycles, payloads, stiff servos."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from humanoid_mjx import control, dynamics
from humanoid_mjx.mechanics.trajectories import thesis_quintics
from humanoid_mjx.robot.leg import Leg
from humanoid_mjx.thesis import leg as thesis

KP, KD = np.array(thesis.KP), np.array(thesis.KD)
POLES = -KD / 2 + np.array([[1.0], [-1.0]]) * np.sqrt(KD**2 / 4 - KP)
START, GOAL = np.array([0.6, -0.3, 0.2, 0.9, -0.4]), np.array([-0.3, 0.4, 0.5, 0.2, 0.3])


def computed_torque(model, kp, kd, goal, qpos, qvel):
    return dynamics.inverse_dynamics(model, qpos, qvel, control.servo(kp, kd, goal, qpos, qvel))


def resting(goal=GOAL):
    return control.at_rest(jnp.array(goal))


def in_steps_of(lengths, seconds, simulate):
    """What `simulate(dt, steps)` returns by step, for each length of a step: one program, whose fine steps go on for
    the time asked for and whose coarse ones for longer, which is cut off."""
    together = jax.jit(jax.vmap(partial(simulate, steps=round(seconds / min(lengths)))))(jnp.array(lengths))
    places = ((i, slice(round(seconds / dt))) for i, dt in enumerate(lengths))
    return [jax.tree.map(lambda x, place=place: np.asarray(x[place]), together) for place in places]


@cache
def regulate():
    """(steps, 5) Errors of exact computed torque on its way to rest, by steps of 0.4 and of 0.2 ms."""
    leg = Leg.physical()

    def controller(time, qpos, qvel):
        return computed_torque(leg, KP, KD, resting(), qpos, qvel)

    def errors(dt, steps):
        return GOAL - dynamics.rollout(leg, jnp.array(START), jnp.zeros(5), controller, dt, steps)[1].qpos

    return in_steps_of((4e-4, 2e-4), 1.0, errors)


@cache
def follow():
    """(steps, 5) Errors of exact computed torque along the thesis's trajectories, by steps of 0.4 and of 0.2 ms."""
    leg, planned = Leg.thesis(), thesis_quintics()

    def controller(time, qpos, qvel):
        return computed_torque(leg, KP, KD, control.Reference(*planned.at(time)), qpos, qvel)

    def errors(dt, steps):
        states = dynamics.rollout(leg, jnp.zeros(5), jnp.zeros(5), controller, dt, steps)[1]
        return jax.vmap(planned.at)(dt * jnp.arange(1, steps + 1)).position - states.qpos

    return in_steps_of((4e-4, 2e-4), thesis.QUINTIC_S, errors)


def measured_poles(errors, dt, stride):
    """(2, 5) The slow and the fast pole of the recursion e_k = a e_(k-1) + b e_(k-2) that fits the errors, 1/s."""
    sampled = np.asarray(errors)[::stride]
    found = []
    for e in sampled.T:
        a, b = np.linalg.lstsq(np.stack([e[1:-1], e[:-2]], axis=1), e[2:])[0]
        found.append(np.sort(np.log(np.roots([1.0, -a, -b]).real) / (stride * dt))[::-1])
    return np.array(found).T


def test_the_error_has_the_poles_of_the_gains():
    found = measured_poles(regulate()[1], 2e-4, 100)
    np.testing.assert_allclose(found, POLES, rtol=0.01)


def test_the_poles_converge_at_first_order():
    found = (measured_poles(e, dt, round(0.02 / dt)) for e, dt in zip(regulate(), (4e-4, 2e-4), strict=True))
    off = [np.abs(poles / POLES - 1).max() for poles in found]
    assert np.log2(off[0] / off[1]) == pytest.approx(1.0, abs=0.15)


def closed_form(times):
    """(n, 5) The error that starts with the planned motion's place and stands still, from its two poles."""
    slow, fast = POLES
    start = np.radians(thesis.QUINTIC_RANGES)[:, 0]
    t = np.asarray(times)[:, None]
    return start * (fast * np.exp(slow * t) - slow * np.exp(fast * t)) / (fast - slow)


def test_the_error_along_the_trajectories_is_that_of_its_equation():
    off = []
    for errors, dt in zip(follow(), (4e-4, 2e-4), strict=True):
        off.append(np.abs(errors - closed_form(dt * np.arange(1, len(errors) + 1))).max())
    assert np.log2(off[0] / off[1]) == pytest.approx(1.0, abs=0.15)
    assert off[1] < 1e-3 and np.abs(errors[-1]).max() < 4e-5


@cache
def by_hand():
    """A controller and a step, each a program of its own."""

    def controller(time, qpos, qvel):
        goal = control.Reference(jnp.array(GOAL) * time, jnp.array(GOAL), jnp.zeros(5))
        return computed_torque(Leg.physical(), KP, KD, goal, qpos, qvel)

    return jax.jit(controller), jax.jit(dynamics.semi_implicit_euler)


@pytest.mark.parametrize("cycle", [1, 3, jnp.array(3)])
def test_a_torque_is_held_over_its_cycle(cycle):
    leg, dt, steps = Leg.physical(), 1e-3, 20
    controller, step = by_hand()
    final, _ = jax.jit(partial(dynamics.rollout, leg, controller=controller, dt=dt, steps=steps, cycle=cycle))(
        jnp.array(START), jnp.zeros(5)
    )
    state = dynamics.State(jnp.array(START), jnp.zeros(5))
    torque = jnp.zeros(5)
    for index in range(steps):
        if index % int(cycle) == 0:
            torque = controller(index * dt, *state)
        state = step(leg, state, torque, dt)
    np.testing.assert_allclose(final.qpos, state.qpos, rtol=1e-12)
    np.testing.assert_allclose(final.qvel, state.qvel, rtol=1e-10)


def test_a_payload_pulls_with_its_weight():
    leg, mass = Leg.physical(), 0.2
    qpos = jnp.array([0.1, 0.0, 0.0, 0.3, -0.2])
    pull = jax.jit(dynamics.gravity)
    more = pull(leg.carrying(mass), qpos) - pull(leg, qpos)
    _, l2, l3, l4, l5 = thesis.LINK_LENGTHS
    hip = mass * thesis.GRAVITY * ((l2 + l3) * np.sin(0.1) + l4 * np.sin(0.1 - 0.3) + l5 * np.sin(0.1 - 0.3 + 0.2))
    assert float(more[0]) == pytest.approx(hip, rel=1e-9)


def test_a_stiff_servo_acts_through_the_step():
    """It converges to the motion of fine steps, and goes on where a held torque is lost."""
    leg, gains = Leg.matlab_script(), (0.02 * KP, 0.02 * KD)

    def controller(time, qpos, qvel):
        return control.pd(*gains, resting(), qpos, qvel)

    def final(integrator, *lengths):
        """(len(lengths), 5) Where it is after 0.1 s."""

        def simulate(dt, steps):
            return dynamics.rollout(leg, jnp.array(START), jnp.zeros(5), controller, dt, steps, integrator)[1].qpos

        return np.array([qpos[-1] for qpos in in_steps_of(lengths, 0.1, simulate)])

    (fine,) = final(dynamics.runge_kutta, 2e-5)
    coarse, half, rough = np.abs(final(control.implicit_euler(*gains), 8e-4, 4e-4, 1e-2) - fine).max(axis=1)
    assert np.log2(coarse / half) == pytest.approx(1.0, abs=0.2)
    assert rough < 0.1
    assert not (np.abs(final(dynamics.semi_implicit_euler, 1e-2)) < 10).all()


def test_a_stiff_servo_pulls_from_where_the_step_ends():
    """The torque of the step, with the place and the velocity at its end, moves the leg and its rotors as they move."""
    leg, gains, dt, force = Leg.matlab_script(), (0.02 * KP, 0.02 * KD), 1e-2, jnp.linspace(-1.0, 1.0, 5)
    start = dynamics.State(jnp.array(START), jnp.linspace(2.0, -1.0, 5))
    rotor = 1e-3
    end = control.implicit_euler(*gains, armature=rotor)(leg, start, force, dt)
    changed = -gains[0] * (end.qpos - start.qpos) - gains[1] * (end.qvel - start.qvel)
    qacc = (end.qvel - start.qvel) / dt
    needed = dynamics.inverse_dynamics(leg, start.qpos, start.qvel, qacc) + rotor * qacc
    np.testing.assert_allclose(needed, force + changed, rtol=1e-9, atol=1e-9)


def test_an_analog_controller_acts_in_every_stage():
    """Of the Runge-Kutta method, whose fourth order a torque held over the step would spoil."""
    leg = Leg.matlab_script()

    def controller(time, qpos, qvel):
        return control.pd(0.02, 0.002, resting(), qpos, qvel) + 0.01 * jnp.sin(5.0 * time)

    def final(*lengths, cycle=None):
        """(len(lengths), 5) Where it is after 0.2 s."""

        def simulate(dt, steps):
            start = jnp.array(START), jnp.zeros(5)
            return dynamics.rollout(leg, *start, controller, dt, steps, dynamics.runge_kutta, cycle=cycle)[1].qpos

        return np.array([qpos[-1] for qpos in in_steps_of(lengths, 0.2, simulate)])

    coarse, half, fine = final(4e-3, 2e-3, 2e-4)
    coarse, half, held = (np.abs(x - fine).max() for x in (coarse, half, final(2e-3, cycle=1)[0]))
    assert np.log2(coarse / half) == pytest.approx(4.0, abs=0.4)
    assert held > 100 * half
