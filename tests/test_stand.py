"""stand: what falls, what is seen, what is pushed. In native MuJoCo, which compiles quickest."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from humanoid_mjx.learners.evaluation import evaluate

from humanoid_mjx import InputError, make_task
from humanoid_mjx.tasks.stand import OBSERVATIONS, PRIVILEGED

BODIES = 16
stand = partial(make_task, "stand", physics="mujoco")


@cache
def programs(structure):
    def still(obs, key):
        return jnp.full((len(obs), 10), (structure.choices - 1) // 2)

    def decide(params, state, key):
        step = jax.vmap(structure.step, in_axes=(None, 0, 0, 0))
        return step(params, state, still(state.obs, key), jax.random.split(key, BODIES))

    reset = jax.jit(jax.vmap(structure.reset, in_axes=(None, 0)))
    return reset, jax.jit(decide), jax.jit(lambda params, key: evaluate(structure, params, still, BODIES, key))


def values(task):
    return jax.tree.map(jnp.asarray, task.params)


def begin(task):
    reset, step, _ = programs(task.structure())
    params = values(task)
    return reset(params, jax.random.split(jax.random.key(1), BODIES)), partial(step, params)


def test_a_body_that_does_nothing_falls_unless_its_servo_is_stiff():
    task = stand()
    _, _, score = programs(task.structure())
    assert score(values(task), jax.random.key(0))["greedy_success"] == 0.0
    stiff = stand(stiffness=6.0, damping=0.2)
    assert score(values(stiff), jax.random.key(0))["greedy_success"] > 0.6


def test_resets_differ_and_stand_upright():
    state, _ = begin(stand())
    qpos = np.asarray(state.data.world.qpos)
    assert all(len(np.unique(qpos[:, place])) == BODIES for place in (3, 7, 16))
    np.testing.assert_allclose(np.linalg.norm(qpos[:, 3:7], axis=1), 1.0, atol=1e-6)
    down = state.obs[:, 26:29]
    # The lean is at most 0.03 rad about each of two axes.
    assert (down[:, 2] < -np.cos(0.045)).all()


def test_a_fall_terminates_with_no_reward_and_the_end_of_time_truncates():
    state, step = begin(stand(duration=0.1))
    for k in range(5):
        assert not state.truncated.any()
        state = step(state, jax.random.key(k))
    assert state.truncated.all() and state.success.all() and not state.terminated.any()
    world = state.data.world._replace(qpos=state.data.world.qpos.at[2, 2].set(0.05))
    after = step(state._replace(data=state.data._replace(world=world)), jax.random.key(9))
    assert after.terminated.tolist() == [body == 2 for body in range(BODIES)]
    assert after.reward[2] == 0.0 and not after.truncated[2] and not after.success[2]
    np.testing.assert_allclose(sum(after.metrics.values()), after.reward, atol=1e-6)


def test_pushes_come_when_they_are_due_and_change_nothing_before():
    pushed, push = begin(stand(stiffness=6.0, damping=0.2, push_every=0.1))
    calm, rest = begin(stand(stiffness=6.0, damping=0.2, push_every=0.1, push=0.0))
    first = np.ceil(np.asarray(pushed.data.first_push) / 0.02 - 1e-4)
    for k in range(6):
        pushed, calm = push(pushed, jax.random.key(k)), rest(calm, jax.random.key(k))
        differs = (np.asarray(pushed.data.world.qpos) != np.asarray(calm.data.world.qpos)).any(axis=1)
        np.testing.assert_array_equal(differs, k >= first)
    assert 0 < first.min() + 1 <= first.max() + 1 <= 6


def test_the_estimate_of_gravity_is_near_the_truth():
    task = stand(stiffness=6.0, damping=0.2, observe="privileged")
    state, step = begin(task)
    for k in range(100):
        state = step(state, jax.random.key(k))
    seen, true = state.obs[:, 26:29], state.obs[:, 41:44]
    # Pushed bodies accelerate by some tenths of gravity, of which the filter lets 2 % through at a time.
    assert np.degrees(np.arccos(np.clip((seen * true).sum(axis=1), -1, 1))).max() < 4.0
    weight = np.asarray(state.data.readings.foot_contact).sum(axis=1)
    assert np.median(weight) == pytest.approx(1.709 * 9.81, rel=0.05)


def test_observations_are_as_many_as_their_names_say():
    assert stand().observation_size == sum(OBSERVATIONS.values()) == 41
    privileged = stand(observe="privileged")
    assert privileged.observation_size == 41 + sum(PRIVILEGED.values())
    state, step = begin(privileged)
    assert step(state, jax.random.key(0)).obs.shape == (BODIES, 48)


def test_noisy_sensors_are_seen_and_do_not_move_the_body():
    clean, step = begin(stand())
    noisy, noisy_step = begin(stand(sensors={"encoder_noise": 0.01, "gyroscope_bias": 0.1}))
    clean, noisy = step(clean, jax.random.key(0)), noisy_step(noisy, jax.random.key(0))
    np.testing.assert_array_equal(clean.data.world.qpos, noisy.data.world.qpos)
    spread = np.asarray(noisy.obs - clean.obs)[:, :10].std()
    assert 0.007 < spread < 0.013


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"physics": "chain"}, "task.physics must be one of"),
        ({"period": 0.01}, "must be a multiple of the time step of 0.004 s"),
        ({"sensors": {"encoder_noise": -1.0}}, "task.sensors.encoder_noise must be at least 0"),
    ],
)
def test_bad_values_get_a_sentence(wrong, words):
    with pytest.raises(InputError, match=words):
        make_task("stand", **wrong)
