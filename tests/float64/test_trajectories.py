"""Trajectories, gaits and the pattern generator in double precision, against scipy and finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from leg_reference import GOLDEN
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from humanoid_mjx.mechanics import gaits, trajectories
from humanoid_mjx.mechanics import pattern_generator as cpg
from humanoid_mjx.thesis import leg as thesis

TIMES = np.array(thesis.GAIT_TIMES_S)
WALK, TURN = gaits.gait("straight_walk"), gaits.gait("sudden_turn")
SLOW = gaits.gait("sudden_turn", "linear")

quintic_at = jax.jit(jax.vmap(trajectories.Quintic.at, in_axes=(None, 0)))
rest_to_rest = jax.jit(trajectories.rest_to_rest)
gait_at = jax.jit(jax.vmap(gaits.Gait.at, in_axes=(None, 0)))
legs_at = jax.jit(jax.vmap(gaits.Gait.both_legs, in_axes=(None, 0)))


@jax.jit
def unequal_steps(params, state, dt):
    def step(state, dt):
        state = cpg.step(params, state, dt)
        return state, cpg.posture(params, state)

    return jax.lax.scan(step, state, dt)


angle = st.floats(-5, 5)


def test_thesis_quintics_have_the_printed_coefficients():
    planned = trajectories.thesis_quintics()
    printed = np.zeros((6, 5))
    printed[[0, 3, 4, 5]] = np.radians(thesis.QUINTIC_COEFFICIENTS).T
    np.testing.assert_allclose(planned.coefficients, printed, rtol=1e-12, atol=1e-16)
    for row in GOLDEN["trajectory"]:
        motion = planned.at(row["t"])
        np.testing.assert_allclose(motion.position, row["q"], atol=1e-12)
        np.testing.assert_allclose(motion.velocity, row["qd"], atol=1e-12)
        np.testing.assert_allclose(motion.acceleration, row["qdd"], atol=1e-12)


@settings(max_examples=50)
@given(start=angle, end=angle, duration=st.floats(0.1, 10))
def test_quintic_meets_its_boundaries_and_its_derivatives_are_derivatives(start, end, duration):
    path = rest_to_rest(jnp.array([start]), jnp.array([end]), duration)
    scale = 10 * max(1, duration**2, duration**-2)
    for t, boundary in ((0.0, start), (duration, end)):
        np.testing.assert_allclose(np.ravel(path.at(t)), [boundary, 0.0, 0.0], atol=1e-12 * scale)
    t, h = np.linspace(0.1, 0.9, 5) * duration, 1e-4 * duration
    ahead, now, behind = (quintic_at(path, t + shift) for shift in (h, 0, -h))
    rough = 1e-5 * scale * (abs(start) + abs(end) + 1) / duration**2 * max(1, duration) ** 2
    np.testing.assert_allclose((ahead.position - behind.position) / (2 * h), now.velocity, atol=rough)
    np.testing.assert_allclose((ahead.velocity - behind.velocity) / (2 * h), now.acceleration, atol=rough)


def test_quintic_rests_outside_its_time():
    path = trajectories.rest_to_rest(1.0, 4.0, 2.0)
    for t, position in ((-1.0, 1.0), (3.0, 4.0)):
        np.testing.assert_allclose(path.at(t), [position, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("name", gaits.TABLES)
def test_spline_gait_is_scipys(name):
    t = np.linspace(-1, 2, 500)
    motion = gait_at(gaits.gait(name), t)
    for i, joint in enumerate(thesis.JOINT_NAMES):
        column = gaits.TABLES[name].get(joint, np.zeros(7))
        reference = CubicSpline(TIMES, np.radians(column), bc_type="periodic")
        np.testing.assert_allclose(motion.position[:, i], reference(t % 0.8), atol=1e-12)
        np.testing.assert_allclose(motion.velocity[:, i], reference(t % 0.8, 1), atol=1e-10)
        np.testing.assert_allclose(motion.acceleration[:, i], reference(t % 0.8, 2), atol=1e-8)


def test_linear_gait_goes_straight_between_the_points():
    t = np.linspace(0, 0.8, 300)[:-1]
    motion = gait_at(SLOW, t)
    for joint, column in thesis.SUDDEN_TURN.items():
        i = thesis.JOINT_NAMES.index(joint)
        np.testing.assert_allclose(motion.position[:, i], np.interp(t, TIMES, np.radians(column)), atol=1e-14)
    assert not motion.acceleration.any()


def run(params, state, dt, n):
    return unequal_steps(params, state, jnp.full(n, dt))


def test_pattern_generator_settles_into_the_gait():
    params = cpg.Params(TURN, 1.25)
    for seed, lead in enumerate((0.3, -2.0, 3.0, 5.5)):
        start = cpg.init(params, phase=float(seed), lead=lead)
        state, _ = run(params, start, 0.01, 600)
        _, legs = run(params, state, 0.01, 80)
        t = float(state.phase[0]) / (2 * np.pi) * 0.8 + 0.01 * np.arange(1, 81)
        np.testing.assert_allclose(legs, legs_at(TURN, t).position, atol=1e-7)


def test_antiphase_is_stable_and_in_phase_is_not():
    params = cpg.Params(WALK, 1.25, coupling=3.0)
    for lead, shrinks in ((np.pi + 1e-3, True), (1e-3, False)):
        fixed = np.pi if shrinks else 0.0
        state, _ = run(params, cpg.init(params, lead=lead), 0.01, 50)
        off = (state.phase[1] - state.phase[0]) % (2 * np.pi) - fixed
        np.testing.assert_allclose(off, 1e-3 * np.exp((-6 if shrinks else 6) * 0.5), rtol=1e-3)


def test_pattern_generator_solves_its_equations():
    params = cpg.Params(TURN, 1.7, 0.6)
    start = cpg.init(params, phase=0.4, lead=1.0)._replace(frequency=cpg.Follower(jnp.array(1.0), jnp.array(0.5)))
    k, w = float(params.coupling), float(params.response)

    def rates(_, y):
        right, left, f, df, r, dr = y
        pull = k * np.sin(left - right - np.pi)
        speed = 2 * np.pi * f
        return [speed + pull, speed - pull, df, w * w * (1.7 - f) - 2 * w * df, dr, w * w * (0.6 - r) - 2 * w * dr]

    y0 = [*start.phase, 1.0, 0.5, 0.0, 0.0]
    end = solve_ivp(rates, (0, 1.3), y0, rtol=1e-11, atol=1e-12).y[:, -1]
    for steps in (1, 7):
        state, _ = run(params, start, 1.3 / steps, steps)
        got = np.concatenate([state.phase, *state.frequency[None:], *state.amplitude[None:]], axis=None)
        np.testing.assert_allclose(got, [*(end[:2] % (2 * np.pi)), *end[2:]], atol=1e-8)
