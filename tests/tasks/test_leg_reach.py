"""leg_reach: set-points move a leg whose controller believes in other masses."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from stepping import arrays, reset, step

from humanoid_mjx import make_task
from humanoid_mjx.compute import rng

LEGS = 64


@jax.jit
@partial(jax.vmap, in_axes=(None, 0))
def go(task, state):
    """A leg after 30 decisions that send its set-points to its goal."""

    def decide(state, _):
        to_goal = (state.data.goal - state.data.setpoint) / jnp.radians(task.increment)
        return task.step_continuous(state, to_goal, rng.key(0)), None

    return jax.lax.scan(decide, state, length=30)[0]


def begin(task):
    """A state of each leg, what steps them, and what sends their set-points to their goals."""
    keys, values = jax.random.split(rng.key(1), LEGS), arrays(task)
    return reset(values, keys), lambda state, action: step(values, state, action, keys), partial(go, values)


def test_set_points_at_the_goal_reach_it_where_the_model_is_right_and_only_there():
    state, _, go = begin(make_task("leg_reach"))
    right = state._replace(data=state.data._replace(mass=jnp.ones_like(state.data.mass)))
    arrived, missed = go(right), go(state)
    assert arrived.success.all() and arrived.truncated.all() and not arrived.terminated.any()
    # At rest at its goal every joint earns both halves in full.
    np.testing.assert_allclose(arrived.reward, 1.0, atol=0.02)
    assert missed.success.mean() < 0.1


def test_starts_goals_and_masses_are_drawn_from_their_ranges():
    task = make_task("leg_reach")
    state, _, _ = begin(task)
    low, high = task.simulator.robot.ranges_rad.T
    for drawn in (state.data.world.qpos, state.data.goal):
        assert (drawn >= low - 1e-6).all() and (drawn <= high + 1e-6).all()
        assert (np.ptp(drawn, axis=0) > 0.8 * (high - low)).all()
        assert len(np.unique(drawn[:, 0])) == LEGS
    assert 0.8 <= state.data.mass.min() < 0.85 and 1.15 < state.data.mass.max() <= 1.2
    assert state.obs.shape == (LEGS, task.observation_size) and (np.abs(state.obs) <= 1).all()


def test_choices_are_parts_of_the_increment():
    task = make_task("leg_reach", bins=5, increment=10.0)
    state, step, _ = begin(task)
    action = jnp.tile(jnp.array([0, 1, 2, 3, 4]), (LEGS, 1))
    moved = step(state, action).data.setpoint - state.data.setpoint
    np.testing.assert_allclose(np.degrees(moved), np.tile([-10.0, -5.0, 0.0, 5.0, 10.0], (LEGS, 1)), atol=1e-3)


def test_a_set_point_leads_its_joint_by_20_degrees_at_most():
    state, step, _ = begin(make_task("leg_reach", increment=90.0))
    after = step(state, jnp.full((LEGS, 5), 8))
    np.testing.assert_allclose(np.degrees(after.data.setpoint - state.data.world.qpos), 20.0, atol=1e-3)


def test_a_leg_that_breaks_ends_its_episode_alone():
    state, step, _ = begin(make_task("leg_reach"))
    action = jnp.full((LEGS, 5), 4)
    sound = step(state, action)
    world = state.data.world._replace(qvel=state.data.world.qvel.at[3, 1].set(jnp.nan))
    broken = step(state._replace(data=state.data._replace(world=world)), action)
    assert broken.terminated.tolist() == [leg == 3 for leg in range(LEGS)] and broken.reward[3] == -1.0
    np.testing.assert_array_equal(np.delete(broken.obs, 3, axis=0), np.delete(sound.obs, 3, axis=0))


def test_another_physics_does_the_same():
    """The plant's links weigh as drawn and the controller's as believed."""
    state, _, go = begin(make_task("leg_reach"))
    there = go(state)
    start, _, elsewhere = begin(make_task("leg_reach", physics="mujoco"))
    # 600 steps of first order in float32; where set-points jump, velocities are large for a moment.
    np.testing.assert_allclose(elsewhere(start).data.world.qpos, there.data.world.qpos, atol=2e-3)
