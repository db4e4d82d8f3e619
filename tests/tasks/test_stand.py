"""stand: what falls, what is seen, what is pushed. In native MuJoCo, which compiles quickest."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from stepping import arrays, reset, step

from humanoid_mjx import InputError, make_task
from humanoid_mjx.compute import rng
from humanoid_mjx.tasks.legged.events import Push

BODIES = 16
STIFF = {"stiffness": 6.0, "damping": 0.2}
stand = partial(make_task, "stand", physics="mujoco")


def begin(task):
    """States of all bodies, and what carries out one still decision of each."""
    middle, task = jnp.full((BODIES, 10), (task.bins - 1) // 2), arrays(task)
    start = reset(task, jax.random.split(rng.key(1), BODIES))
    return start, lambda state, key: step(task, state, middle, jax.random.split(key, BODIES))


def test_a_body_that_does_nothing_falls_unless_its_servo_is_stiff():
    for task, stays in ((stand(), (0.0, 0.0)), (stand(control=STIFF), (0.6, 1.0))):
        state, step = begin(task)

        @jax.jit
        def fall(state, keys, step=step):
            return jax.lax.scan(lambda state, key: (after := step(state, key), after.terminated), state, keys)[1]

        fell = np.asarray(fall(state, jax.random.split(rng.key(0), 250))).any(axis=0)
        assert stays[0] <= 1.0 - fell.mean() <= stays[1]


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
        state = step(state, rng.key(k))
    assert state.truncated.all() and state.success.all() and not state.terminated.any()
    world = state.data.world._replace(qpos=state.data.world.qpos.at[2, 2].set(0.05))
    after = step(state._replace(data=state.data._replace(world=world)), rng.key(9))
    assert after.terminated.tolist() == [body == 2 for body in range(BODIES)]
    assert after.reward[2] == 0.0 and not after.truncated[2] and not after.success[2]
    np.testing.assert_allclose(sum(after.metrics.values()), after.reward, atol=1e-6)


def test_what_counts_as_a_fall_is_declared():
    state, step = begin(stand(fall={"tilt": 1.0}))
    after = step(state, rng.key(0))
    _, x, y, _ = np.asarray(after.data.world.qpos[:, 3:7]).T
    leaning = np.degrees(np.arccos(1 - 2 * (x**2 + y**2))) > 1.0
    assert 0 < leaning.sum() < BODIES
    np.testing.assert_array_equal(after.terminated, leaning)
    state, step = begin(stand(fall={"height": 1.4}))
    assert step(state, rng.key(0)).terminated.all()


def test_pushes_come_when_they_are_due_and_change_nothing_before():
    pushed, push = begin(stand(control=STIFF, push={"every": 0.1}))
    calm, rest = begin(stand(control=STIFF, push={"every": 0.1, "impulse": 0.0}))
    first = np.ceil(np.asarray(pushed.data.first_push) / 0.02 - 1e-4)
    for k in range(6):
        pushed, calm = push(pushed, rng.key(k)), rest(calm, rng.key(k))
        differs = (np.asarray(pushed.data.world.qpos) != np.asarray(calm.data.world.qpos)).any(axis=1)
        np.testing.assert_array_equal(differs, k >= first)
    assert 0 < first.min() + 1 <= first.max() + 1 <= 6


def test_impulses_are_drawn_from_the_least_to_the_largest_in_any_direction():
    push, period = Push(impulse=0.8, least=0.25, every=2.0), 0.02
    force = jax.jit(jax.vmap(lambda key: push.force(jnp.float32(4.01), period, key)))
    forces = np.asarray(force(jax.random.split(rng.key(3), 2000)))
    sizes = period * np.linalg.norm(forces, axis=1)
    assert 0.2 - 1e-6 <= sizes.min() < 0.21 and 0.79 < sizes.max() <= 0.8 + 1e-6
    # The mean of 2,000 uniform numbers is off by 4 sigma = 0.016 in one of 16,000 samples.
    assert sizes.mean() == pytest.approx(0.5, abs=0.016)
    assert np.unique(np.sign(forces[:, :2]), axis=0).shape == (4, 2) and not forces[:, 2].any()


def test_the_estimate_of_gravity_is_near_the_truth():
    state, step = begin(stand(control=STIFF, observe="privileged"))
    for k in range(100):
        state = step(state, rng.key(k))
    seen, true = state.obs[:, 26:29], state.obs[:, 41:44]
    # Pushed bodies accelerate by some tenths of gravity, of which the filter lets 2 % through at a time.
    assert np.degrees(np.arccos(np.clip((seen * true).sum(axis=1), -1, 1))).max() < 4.0
    weight = np.asarray(state.data.readings.foot_contact).sum(axis=1)
    assert np.median(weight) == pytest.approx(1.709 * 9.81, rel=0.05)


def test_noisy_sensors_are_seen_and_do_not_move_the_body():
    clean, step = begin(stand())
    noisy, noisy_step = begin(stand(sensors={"encoder_noise": 0.01, "gyroscope_bias": 0.1}))
    clean, noisy = step(clean, rng.key(0)), noisy_step(noisy, rng.key(0))
    np.testing.assert_array_equal(clean.data.world.qpos, noisy.data.world.qpos)
    spread = np.asarray(noisy.obs - clean.obs)[:, :10].std()
    assert 0.007 < spread < 0.013


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"physics": "chain"}, "physics.name: 'chain' must be a class derived from"),
        ({"period": 0.01}, "must be a multiple of the time step of 0.004 s"),
        ({"sensors": {"encoder_noise": -1.0}}, "task.sensors.encoder_noise must be at least 0"),
        ({"stiffness": 3.0}, "task.stiffness: unknown key"),
        ({"push": 0.2}, "task.push must be a mapping of keys, got 0.2; known are every, impulse, least"),
        ({"rewards": {"uprihgt": 1.0}}, "task.rewards.uprihgt: unknown key; did you mean 'upright'"),
        ({"randomise": {"mass": 1.5}}, "task.randomise.mass must be less than 1"),
    ],
)
def test_bad_values_get_a_sentence(wrong, words):
    with pytest.raises(InputError, match=words):
        make_task("stand", **wrong)


def test_a_physics_of_ones_own_moves_the_body():
    """Half a newton along x for 0.1 s: the bodies in the wind are ahead of those without, and no other way."""
    ends = []
    for physics in ("mujoco", "wind:Windy"):
        task = stand(physics=physics)
        state, step = begin(task)
        for k in range(5):
            state = step(state, rng.key(k))
        ends.append(state.data.world.qvel)
    assert task.simulator.batch == 16 and task.arithmetic == "arrays"
    gained = np.asarray(ends[1] - ends[0])
    assert 0.01 < gained[:, 0].mean() < 0.1 and abs(gained[:, 1].mean()) < 0.005
