"""Switching postures: Q-learning decides, computed torque carries it out."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from stepping import arrays, reset, step

from humanoid_mjx import make_task
from humanoid_mjx.compute import rng

UP, DOWN = 26, 0
"""All three joints a place on, all a place back."""


def start(task, robots):
    keys, values = jax.random.split(rng.key(0), robots), arrays(task)
    return reset(values, keys), lambda state, action: step(values, state, jnp.asarray(action), keys)


def test_the_right_way_up_arrives_and_the_left_leg_takes_opposite_values():
    task = make_task("posture_switch")
    state, step = start(task, 4)
    for _ in range(20):
        state, reward, arrived = step(state, jnp.full(4, UP))
        if arrived.all():
            break
    assert arrived.all() and (reward == 99.0).all()
    qpos = np.degrees(state.world.qpos[0])
    np.testing.assert_allclose(qpos, [20, 0, 0, 15, 10, -20, 0, 0, -15, -10], atol=2.0)
    assert int(task.state_index(jax.tree.map(lambda x: x[0], state))) == task.num_states - 1


@pytest.mark.parametrize("moves", [(1, 1, 1), (2, 1, 0), (0, 2, 1), (1, 0, 2)])
def test_a_choice_of_each_joint_moves_its_own_joint(moves):
    task = make_task("posture_switch")
    assert np.prod(task.action_bins) == task.num_actions
    state = jax.jit(task.reset)(rng.key(0))
    state = state._replace(encoders=jnp.asarray(task.grid[:, 2]))
    place = task.grid[np.arange(3), 1 + np.array(moves)]
    wanted = task.controller(task.whole_body(jnp.asarray(place, jnp.float32)))
    for found, expected in zip(*map(jax.tree.leaves, (task.drive(state, jnp.array(moves))[1], wanted)), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-6)


def test_staying_and_going_back_never_arrive():
    state, step = start(make_task("posture_switch"), 4)
    for _ in range(5):
        state, reward, arrived = step(state, jnp.array([13, DOWN, 13, DOWN]))
        assert not arrived.any() and (reward == -1.0).all()
    np.testing.assert_allclose(np.degrees(state.world.qpos[:, 0]), -20.0, atol=0.5)


def test_a_robot_that_breaks_is_started_anew_and_changes_no_bit_of_the_others():
    state, step = start(make_task("posture_switch"), 4)
    sound, _, _ = step(state, jnp.full(4, UP))
    world = state.world._replace(qvel=state.world.qvel.at[2, 3].set(jnp.nan))
    broken, _, arrived = step(state._replace(world=world), jnp.full(4, UP))
    assert broken.diverged.tolist() == [0, 0, 1, 0] and not arrived[2]
    np.testing.assert_array_equal(broken.world.qpos[2], state.world.qpos[2])
    for other in (0, 1, 3):
        np.testing.assert_array_equal(broken.world.qpos[other], sound.world.qpos[other])


def test_another_physics_carries_out_the_same_decisions():
    states = []
    for physics in ("chain", "mujoco"):
        state, step = start(make_task("posture_switch", physics=physics), 4)
        for _ in range(3):
            state, _, _ = step(state, jnp.array([UP, 5, 13, 20]))
        states.append(state)
    chain, other = states
    # Float32 over 120 steps of both: 1e-4 rad is a hundredth of the tolerance of a posture.
    np.testing.assert_allclose(other.world.qpos, chain.world.qpos, atol=1e-4)
    np.testing.assert_allclose(other.encoders, chain.encoders, atol=1e-4)


@pytest.mark.parametrize("physics", ["chain", "mjx-jax", "mujoco"])
def test_a_decision_can_be_traced_in_every_physics(physics):
    task = make_task("posture_switch", physics=physics)
    key = jax.random.key(0)
    state = jax.eval_shape(task.reset, key)
    after, reward, terminated = jax.eval_shape(task.step, state, jnp.int32(0), key)
    assert jax.tree.map(lambda x: (x.shape, x.dtype), after) == jax.tree.map(lambda x: (x.shape, x.dtype), state)
    assert reward.shape == terminated.shape == ()
