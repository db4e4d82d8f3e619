"""Squatting on the ground: down and up again is learnt by decisions alone, and a fall begins anew."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from humanoid_mjx import make_task
from humanoid_mjx.compute import rng

DOWN, KNEE_ALONE, UP = 26, 6, 0
"""All three joints a place on; the knee alone; all a place back."""


@pytest.fixture(scope="module")
def bodies():
    """Two bodies in native MuJoCo, the physics that is ready first, and the step of both."""
    task, keys = make_task("squat", physics="mujoco"), jax.random.split(rng.key(0), 2)
    step = jax.jit(jax.vmap(task.step))
    return task, jax.jit(jax.vmap(task.reset))(keys), lambda state, *actions: step(state, jnp.array(actions), keys)


def test_down_and_up_again_is_done_in_six_decisions_and_a_body_that_falls_stands_up_anew(bodies):
    task, state, step = bodies
    start, fallen = state, 0
    for decision in range(6):
        state, reward, done = step(state, DOWN if decision < 3 else UP, KNEE_ALONE)
        assert done.tolist() == [decision == 5, False]
        assert state.rising.tolist() == [decision >= 2, False]
        assert reward.tolist() == [99.0 if decision == 5 else -1.0, -3.0 if state.diverged[1] > fallen else -1.0]
        if state.diverged[1] > fallen:
            np.testing.assert_array_equal(state.world.qpos[1], start.world.qpos[1])
        fallen = int(state.diverged[1])
        if decision == 2:
            joints = np.degrees(state.world.qpos[0, task.simulator.joint_qpos]).reshape(2, 5)
            np.testing.assert_allclose(joints, np.tile([20, 0, 0, 40, -20], (2, 1)), atol=task.tolerance)
            assert 0.005 < start.world.qpos[0, 2] - state.world.qpos[0, 2] < 0.02, "the hips come down"
    assert fallen >= 1 and state.diverged[0] == 0


def test_rows_and_observations_tell_the_way_up_from_the_way_down(bodies):
    task, state, _ = bodies
    one = jax.tree.map(lambda x: x[0], state)
    rising = one._replace(rising=jnp.bool_(True))
    assert int(task.state_index(rising)) - int(task.state_index(one)) == task.num_states // 2 == 27
    assert np.asarray(task.observe(rising) - task.observe(one)).tolist() == [0, 0, 0, 1]
