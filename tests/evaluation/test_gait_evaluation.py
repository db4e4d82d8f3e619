"""evaluate --gait: what bodies do under commands that stay, and what is asked on the command line. In native MuJoCo,
which compiles quickest, and once on the tree."""

import json
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from command_line import told

from humanoid_mjx.compute import rng
from humanoid_mjx.config import parse
from humanoid_mjx.evaluation.gait.figures import FIGURES
from humanoid_mjx.evaluation.gait.scenarios import Scenario, gaits_of, play_scenarios, scenarios_of, settings_of
from humanoid_mjx.evaluation.policy import find_policy, in_world, policies_of_best, save_policy
from humanoid_mjx.physics.native import Native
from humanoid_mjx.robot.lower_body import LowerBody
from humanoid_mjx.spec import InputError
from humanoid_mjx.training.plan import make_plan
from humanoid_mjx.training.sweep import sweep

TINY = {"name": "deep_q", "width": 8, "layers": 1, "envs": 4, "rollout": 4, "minibatches": 2, "evaluation_envs": 2}
TASK = {"name": "walk", "physics": "mujoco", "command": {"sideways": [-0.1, 0.1]}}
STEPPING = {
    "control": {"name": "servo", "stiffness": 20.0, "damping": 0.45},
    "gait": {"period": 0.32, "cadence": 0.0, "stance": 0.62, "lift": 9.0, "sway": -2.0, "stride": 0.0},
}
"""A servo and a gait with which the body steps on the spot without a learner."""
ASKED = (
    Scenario("stand", (0.0, 0.0, 0.0)),
    Scenario("ahead", (0.3, 0.0, 0.0)),
    Scenario("stay", (0.0, 0.0, 0.0), turn_at=0.5, turn_by=0.0),
    Scenario("turn", (0.0, 0.0, 0.0), turn_at=0.5, turn_by=0.8),
)


def config(**task):
    return {"name": "tiny", "task": TASK | task, "learner": TINY, "seeds": 2, "record": 4, "total_steps": 64}


def learner_of(**task):
    (group,) = make_plan(parse(config(**task))).groups
    return group.learner()


def calm(learner):
    """The learner with a task in which nothing pushes the body and all worlds are as declared."""
    task = learner.task
    return learner.replace(task=task.replace(push=task.push.replace(impulse=jnp.float32(0.0)), randomise=None))


first_policy = jax.jit(lambda learner, key: learner.policy(learner.init(key)))


def played(learner, agent="greedy", seconds=0.5, seed=5):
    """The figures of four episodes under each of `ASKED`, (4, 4): one program for all; weights are untrained."""
    policy = first_policy(learner, rng.key(seed))
    found = play_scenarios(learner, jax.tree.map(lambda x: x[None], policy), ASKED, 4, seconds, (agent,))[agent]
    assert list(found) == list(FIGURES)
    return {name: figure[0] for name, figure in found.items()}


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """The run folder of two training seeds, and one of its policies as a file."""
    folder = tmp_path_factory.mktemp("gaits")
    path = sweep(config(), folder / "tiny").path
    save_policy(find_policy(path), folder / "one.npz")
    return path, folder / "one.npz"


def test_a_body_that_does_nothing_stands_or_steps_by_the_clock():
    found = played(calm(learner_of(**STEPPING)), "zero", 6.0)
    stand, ahead, stay, turn = ({name: x[row] for name, x in found.items()} for row in range(len(ASKED)))
    np.testing.assert_allclose(stand["duty"], 1.0, atol=1e-6)
    assert (stand["success"] == 1).all() and (stand["step_frequency"] == 0).all() and (stand["slip"] < 1e-3).all()
    assert (stand["speed_error"] < 1e-3).all() and (stand["drift"] < 0.02).all() and (stand["flight"] == 0).all()
    up = ahead["success"] == 1
    assert up.sum() >= 2
    # Two steps in 0.32 s, on the spot, neither foot favoured and none in flight.
    np.testing.assert_allclose(ahead["step_frequency"][up], 2 / 0.32, rtol=0.05)
    np.testing.assert_allclose(ahead["speed_error"][up], 0.3, atol=0.03)
    assert (ahead["flight"][up] < 0.02).all() and (ahead["duty_asymmetry"][up] < 0.1).all()
    assert ((ahead["duty"] > 0.5) & (ahead["duty"] < 0.75))[up].all() and (ahead["clearance"][up] > 0.001).all()
    # It keeps its heading: a turn by nothing is over at once, one by 0.8 rad never.
    up = stay["success"] == 1
    assert up.sum() >= 2 and (stay["turn_success"] == up).all() and (stay["turn_seconds"][up] == 0).all()
    assert (turn["turn_success"] == 0).all() and np.isnan(turn["turn_seconds"]).all()
    assert np.isnan(stand["turn_success"]).all() and (turn["turn_error"][turn["success"] == 1] > 0.5).all()


def test_commands_stay_whatever_the_task_draws():
    one, other = (played(calm(learner_of(command={"every": every}))) for every in (1e9, 0.02))
    for name in ("seconds", "drift", "peak_torque"):
        np.testing.assert_array_equal(one[name], other[name])
    assert not np.array_equal(one["seconds"][0], one["seconds"][1]), "commands change nothing"
    assert not np.array_equal(one["seconds"], played(calm(learner_of()), seed=6)["seconds"])


def test_episodes_are_the_same_however_they_are_cut(monkeypatch):
    whole = played(calm(learner_of()))
    monkeypatch.setattr(Native, "batch", 3 * len(ASKED))
    parts = played(calm(learner_of()))
    np.testing.assert_array_equal(whole["success"], parts["success"])
    np.testing.assert_allclose(whole["seconds"], parts["seconds"], atol=0.021)  # a decision more or less


def test_a_watched_step_is_the_step():
    task = jax.tree.map(jnp.asarray, learner_of().task)
    state = jax.jit(task.reset)(rng.key(0))
    offsets, key = jnp.linspace(-1.0, 1.0, 10), rng.key(1)
    plain = jax.jit(lambda: task.step_continuous(state, offsets, key))()
    watched, view, sensed = jax.jit(lambda: task.step_watched(state, offsets, key))()
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, atol=1e-5), plain._replace(data=0), watched._replace(data=0)
    )
    np.testing.assert_allclose(plain.data.world.qpos, watched.data.world.qpos, atol=1e-6)
    assert sensed.torque.shape == (5, 10)
    np.testing.assert_array_equal(sensed.torque[-1], view.torque)
    np.testing.assert_array_equal(view.episode.world.qpos, watched.data.world.qpos)
    again = task.commanded(watched, view, watched.data.command)
    np.testing.assert_allclose(again.obs, watched.obs, atol=1e-6)
    other = task.commanded(watched, view, jnp.array([0.5, 0.25, 1.0]))
    changed = np.flatnonzero(np.asarray(other.obs) != np.asarray(again.obs))
    np.testing.assert_array_equal(other.obs[-5:-2], 1.0)
    assert set(changed) <= set(range(len(other.obs) - 5, len(other.obs)))


def test_what_pushes_the_body_is_asked_for():
    assert settings_of([]) == ["task.duration=20", "task.push.impulse=0", "task.randomise=null", "task.terrain=null"]
    pushed = ["task.push.impulse=0.2", "task.randomise.mass=0.1"]
    assert settings_of(pushed) == ["task.duration=20", "task.terrain=null", *pushed]
    learner = learner_of(push={"impulse": 3.0, "every": 0.1})
    still, shaken = played(calm(learner), "zero", 0.6), played(learner, "zero", 0.6)
    assert (still["success"][0] == 1).all() and (shaken["success"] == 0).all()
    assert (shaken["seconds"] < 0.6).all() and (still["seconds"][0] == np.float32(0.6)).all()


def test_the_command(runs, tmp_path):
    file, short = tmp_path / "gaits.json", ("--episodes", 2, "--set", "task.duration=2.2")
    output = told("evaluate", runs[0], "--gait", "--physics", "tree", *short, "--json", file)
    for words in ("2 training seeds", "physics tree", "task.push.impulse=0", "sudden turn", "The random agent"):
        assert words in output.replace("\n", " ")
    result = json.loads(file.read_text())
    assert result["set"] == ["task.push.impulse=0", "task.randomise=null", "task.terrain=null", "task.duration=2.2"]
    assert result["commit"] and result["figures"]["slip"]["unit"] == "m/s"
    (group,) = result["results"]
    assert group["beyond_training"] == ["sideways +0.15", "sideways -0.15"]
    assert [policy["config"]["task"]["physics"] for policy in group["policies"]] == ["tree"] * 2
    scenarios = scenarios_of(LowerBody())
    assert [gait["scenario"] for gait in group["gaits"]] == 3 * [each.name for each in scenarios]
    assert [each.command[0] for each in scenarios[1:5]] == [0.15, 0.3, 0.5, 0.8]
    assert [len(gait["figures"]["success"]["seeds"]) for gait in group["gaits"][:: len(scenarios)]] == [2, 1, 1]
    for name in ("success", "seconds"):
        found = group["gaits"][1]["figures"][name]
        assert found["worst"] == min(seed[0] for seed in found["seeds"])
    zero = group["gaits"][len(scenarios)]
    assert zero["agent"] == "zero" and zero["figures"]["success"]["median"] == 1.0
    assert zero["figures"]["duty"]["median"] == 1.0 and zero["figures"]["turn_success"]["median"] is None


def test_all_seeds_of_the_best_point(runs):
    found, best = policies_of_best(runs[0]), find_policy(runs[0])
    assert sorted(policy.seed for policy in found) == [0, 1] and found[0].seed == best.seed
    changed = in_world(best, None, ["task.friction=0.5", "task.randomise.mass=0.3"])
    assert float(changed.learner.task.friction) == 0.5 and float(changed.learner.task.randomise.mass) == np.float32(0.3)
    assert best.config.task["randomise"] is None and best.learner.task.randomise is None
    one = jax.tree.map(lambda x: x[None], best.policy)
    gaits = gaits_of(play_scenarios(calm(best.learner), one, ASKED, 4, 0.3), ASKED)
    assert [gait.scenario for gait in gaits] == [asked.name for asked in ASKED]
    assert len(gaits[0].figures["drift"].seeds) == 1


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["stand", "--gait"], "the task stand gives no commands to a body on legs"),
        (["RUN", "--gait", "--json", "none/x.json"], "there is no folder none"),
        (["RUN", "--set", "task.frictoin=1"], "task.frictoin: unknown key; did you mean 'friction'"),
        (["RUN", "--set", "learner.epsilon=0"], "a policy stays as it is; change its task, as task.friction=0.5 does"),
        (["RUN", "--set", "task.name=stand"], "a policy stays as it is"),
        (["RUN", "--set", "task.observe=privileged"], "this would change what the policy observes"),
        (["RUN", "--gait", "--set", "task.symmetric=true"], "this would change what the policy observes"),
        (["RUN", "--gait", "--set", "task.bins=3"], "this would change what the policy observes or chooses from"),
        (["posture_switch", "--set", "task.places=7"], "this would change what the policy observes or chooses from"),
    ],
)
def test_what_cannot_be_done_gets_a_sentence(runs, arguments, sentence):
    with pytest.raises(InputError, match=re.escape(sentence)):
        told("evaluate", *(runs[0] if word == "RUN" else word for word in arguments))
