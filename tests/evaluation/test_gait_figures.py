"""Figures of gaits: running sums against whole motions, a walk whose figures are known, how near legs are."""

from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from gait_reference import reference

from humanoid_mjx.evaluation.gait.figures import FIGURES, figures
from humanoid_mjx.evaluation.gait.tally import Asked, Sample, add, begin, legs_apart, window_samples
from humanoid_mjx.physics.base import Poses
from humanoid_mjx.robot import make_robot
from humanoid_mjx.robot.lower_body import LowerBody

INTERVAL, BODY = 0.004, LowerBody()
MASS = BODY.mass
WINDOW = int(window_samples(0.36, INTERVAL))


@partial(jax.jit, static_argnames=("turns", "robot"))
def figures_of(first, samples, asked, command, turns=False, robot=BODY):
    """The figures of one episode without a fall."""

    def one(tally, step):
        return add(tally, *step, jnp.int32(WINDOW), INTERVAL, robot), None

    tally, _ = jax.lax.scan(one, begin(first, robot), (samples, asked))
    return figures(tally, command, jnp.bool_(turns), jnp.bool_(False), robot, jnp.float32(1.0), INTERVAL)


def measured(motion, commands, turn=None, robot=BODY):
    """The figures of a motion: arrays over the samples, with `place_0` and the like for what was before."""
    cast = lambda x: jnp.asarray(x, bool if np.asarray(x).dtype == bool else jnp.float32)  # noqa: E731
    samples = Sample(**{name: cast(motion[name]) for name in Sample._fields})
    before = {name: cast(motion[f"{name}_0"]) for name in ("place", "heading", "angles")}
    first = jax.tree.map(lambda part: part[0], samples)._replace(**before)
    count = len(commands)
    goal, since = turn if turn else (np.zeros(count), np.full(count, -1.0))
    asked = Asked(cast(commands), cast(goal), cast(since))
    found = figures_of(first, samples, asked, cast(commands[0]), turn is not None, robot)
    assert found.keys() == FIGURES.keys()
    return {name: float(value) for name, value in found.items()}


def wandering(seconds=8.0, seed=0):
    """A motion in which everything happens: feet that chatter, legs that touch, slow and fast slips, half a turn."""
    rng, count = np.random.default_rng(seed), round(seconds / INTERVAL)
    smooth = lambda *shape: np.cumsum(rng.normal(size=(count, *shape)), axis=0)  # noqa: E731
    force = smooth(2)
    force = np.where(rng.uniform(size=force.shape) < 0.02, 5.0, force - np.median(force, axis=0))
    heading = 3.0 + 0.02 * smooth()
    return {
        "place": 0.002 * smooth(2) + 0.0008 * np.arange(count)[:, None], "angles": 0.01 * smooth(10),
        "heading": np.mod(heading + np.pi, 2 * np.pi) - np.pi, "torque": rng.normal(size=(count, 10)),
        "gap": (np.array([0.0, 0.06]) + 0.002 * smooth(2))[:, None], "height": np.abs(0.001 * smooth(2)),
        "load": np.maximum(force, 0.0), "speed": rng.lognormal(-3.0, 1.0, (count, 2, 4)),
        "touching": rng.uniform(size=(count, 2, 4)) < 0.4, "legs_apart": 0.01 * rng.normal(size=count) + 0.01,
        "place_0": np.array([0.01, 0.0]), "heading_0": 3.0, "angles_0": np.zeros(10),
    }  # fmt: skip


@pytest.mark.parametrize("seed", range(3))
def test_running_sums_are_those_of_the_whole_motion(seed):
    motion = wandering(seed=seed)
    rng, count = np.random.default_rng(seed + 10), len(motion["heading"])
    commands = np.repeat(rng.uniform(-0.5, 0.5, (count // 250, 3)), 250, axis=0)
    found, expected = measured(motion, commands), reference(motion, commands, INTERVAL, WINDOW, MASS)
    for name, value in expected.items():
        # Float32 sums over 2,000 samples, of ways whose ends are metres from the origin.
        assert found[name] == pytest.approx(value, rel=2e-3, abs=1e-5), name


def known_walk(count, period=0.4, duty=0.7, length=0.06, speed=0.3, slip=0.03, heading=2.5):
    """Feet in turn, each on the ground for a share of the period, a step's length ahead where it comes down."""
    time = np.arange(count) * INTERVAL
    turns = np.stack([np.mod(time / period, 1.0), np.mod(time / period + 0.5, 1.0)], axis=1) + 1e-9
    loaded = turns < duty
    swing = np.clip((turns - duty) / (1 - duty), 0.0, 1.0)
    # The foot comes down `length` ahead of the other and stays while the body walks on.
    ahead, zero = np.where(turns[:, 0] < 0.5, -length, length), np.zeros((count, 10))
    place = np.outer(speed * (time + INTERVAL), [np.cos(heading), np.sin(heading)])
    return {
        "place": place, "heading": np.full(count, heading), "angles": zero + 0.2 * (time[:, None] + INTERVAL),
        "torque": zero + 0.5, "gap": np.stack([ahead, np.full(count, 0.07)], axis=1)[:, None],
        "height": 0.02 * np.sin(np.pi * swing), "load": 8.0 * loaded,
        "speed": np.where(loaded, slip, 0.8)[..., None] + np.zeros(4),
        "touching": loaded[..., None] & np.ones(4, bool), "legs_apart": np.full(count, 0.02),
        "place_0": np.zeros(2), "heading_0": heading, "angles_0": np.zeros(10),
    }  # fmt: skip


def test_a_walk_whose_figures_are_known():
    count = round(12.0 / INTERVAL)
    found = measured(known_walk(count), np.tile([0.25, 0.0, 0.0], (count, 1)))
    known = {
        "seconds": 12.0, "forward": 0.3, "left": 0.0, "turn": 0.0, "speed_error": 0.05, "turn_error": 0.0, "drift": 0.0,
        "heading_error": 0.0, "slip": 0.03, "duty": 0.7, "flight": 0.0, "step_length": 0.06, "step_frequency": 5.0,
        "clearance": 0.02, "duty_asymmetry": 0.0, "crossing": 0.0, "leg_contact": 0.0, "peak_torque": 0.5,
        "cost_of_transport": 10 * 0.5 * 0.2 / (MASS * 9.81 * 0.3), "success": 1.0,
    }  # fmt: skip
    for name, value in known.items():
        assert found[name] == pytest.approx(value, rel=0.01, abs=2e-3), name
    assert np.isnan(found["turn_success"])
    # A duty factor below one half is a run: nothing is loaded for 0.2 of the time, twice in a period.
    run = measured(known_walk(count, duty=0.3), np.tile([0.3, 0.0, 0.0], (count, 1)))
    assert run["flight"] == pytest.approx(0.4, abs=0.01)


def test_feet_of_a_dog_are_measured_by_pairs():
    """A trot: its fore and its hind legs do what a biped's do, the hind ones half a period later."""
    count, dog = round(8.0 / INTERVAL), make_robot("dog")
    commands = np.tile([0.3, 0.0, 0.0], (count, 1))
    fore, hind = known_walk(count), known_walk(count)
    for name in ("height", "load", "speed", "touching"):
        joined = np.concatenate([fore[name], hind[name][:, ::-1]], axis=1)
        fore[name] = joined[..., :1] if joined.ndim == 3 else joined
    fore["load"] *= 10.0
    fore["gap"] = np.concatenate([fore["gap"], np.array([-1.0, 1.0]) * hind["gap"]], axis=1)
    found = measured(fore, commands, robot=dog)
    known = {"duty": 0.7, "duty_asymmetry": 0.0, "flight": 0.0, "step_length": 0.06, "crossing": 1.0, "slip": 0.03}
    known |= {"step_frequency": 10.0, "clearance": 0.02}
    for name, value in known.items():
        assert found[name] == pytest.approx(value, rel=0.01, abs=2e-3), name
    limping = fore | {"load": np.where(np.arange(4) == 2, 0.0, fore["load"])}
    found = measured(limping, commands, robot=dog)
    assert found["duty_asymmetry"] == pytest.approx(0.35 / 0.525, abs=1e-3)


def test_a_body_that_stands_takes_no_steps():
    count = round(4.0 / INTERVAL)
    motion = known_walk(count, duty=1.1, speed=0.0, slip=0.0)
    found = measured(motion, np.zeros((count, 3)))
    assert found["duty"] == 1.0 and found["step_frequency"] == 0.0 and found["slip"] == 0.0
    assert found["drift"] == 0.0
    for name in ("step_length", "clearance", "cost_of_transport", "turn_seconds"):
        assert np.isnan(found[name]), name


@pytest.mark.parametrize(("rate", "seconds", "success"), [(1.0, 0.698, 1.0), (0.5, 1.396, 1.0), (0.4, 1.745, 0.0)])
def test_a_sudden_turn_is_timed(rate, seconds, success):
    """A turn of 45 degrees at a steady rate is within 5 degrees of its goal after 40 of them."""
    count = round(9.0 / INTERVAL)
    motion, since = known_walk(count), np.arange(count) * INTERVAL - 3.0
    goal = np.radians(45.0)
    motion["heading"] = 2.5 + np.clip(rate * since, 0.0, goal)
    found = measured(motion, np.tile([0.3, 0.0, 0.0], (count, 1)), (np.full(count, goal), since))
    assert found["turn_seconds"] == pytest.approx(seconds, abs=0.005)
    assert found["turn_success"] == success and np.isnan(found["heading_error"])
    motion["heading"][-500:] -= 0.1  # 2 s before the end, 4 s after the command
    late = measured(motion, np.tile([0.3, 0.0, 0.0], (count, 1)), (np.full(count, goal), since))
    assert late["turn_success"] == 0.0


def test_legs_are_as_near_as_mujoco_finds_them():
    model = LowerBody(ranges="human").model
    data, rng, touching = mujoco.MjData(model), np.random.default_rng(0), 0
    near = jax.jit(lambda poses: legs_apart(poses, LowerBody()))
    for _ in range(60):
        data.qpos[:7] = 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0
        low, high = model.jnt_range[1:].T.copy()
        high[[2, 7]] = 0.0  # hips that roll inwards only
        data.qpos[7:] = rng.uniform(low, high)
        mujoco.mj_kinematics(model, data)
        pairs = zip(model.pair_geom1, model.pair_geom2, strict=True)
        legs = [pair for pair in pairs if model.geom_type[pair[0]] == mujoco.mjtGeom.mjGEOM_CAPSULE]
        expected = min(mujoco.mj_geomDistance(model, data, *map(int, pair), 1.0, None) for pair in legs)
        poses = Poses(jnp.asarray(data.xpos, float), jnp.asarray(data.xmat.reshape(-1, 3, 3), float))
        touching += expected < 0
        if expected > 0:
            np.testing.assert_allclose(near(poses), expected, atol=2e-6)
        else:
            # MuJoCo searches for the depth of capsules that overlap in another way; the sign is what counts.
            assert near(poses) <= 1e-6
    assert 3 < touching < 57
