"""Policies on held-out episodes and as files: what is measured, what is refused."""

import json
import re

import jax
import jax.numpy as jnp
import numpy as np
import probes
import pytest
from command_line import told

from humanoid_mjx import make_task
from humanoid_mjx.commands.evaluate import words_on_returns
from humanoid_mjx.compute import rng
from humanoid_mjx.evaluation import evaluate
from humanoid_mjx.evaluation.episode import play
from humanoid_mjx.evaluation.evaluate import evaluate_all, held_out_keys, play_out
from humanoid_mjx.evaluation.policy import find_policy, in_world, policies_of_best, read_policy, save_policy
from humanoid_mjx.learners.rollout import AGENTS, agent, rollout
from humanoid_mjx.runs.ranking import ranked
from humanoid_mjx.runs.statistics import estimated
from humanoid_mjx.spec import InputError
from humanoid_mjx.training.program import run_key
from humanoid_mjx.training.sweep import Run, sweep

REACH = {"name": "joint_reach", "joint": 4, "states": 11, "max_episode_steps": 30}
LEG = {"name": "leg_reach", "bins": 3, "duration": 0.4}
TABLE = {"name": "tabular_q", "epsilon": 0.5, "learning_rate": 0.5}
LINEAR = {"name": "linear_q", "learning_rate": 0.1, "envs": 4, "rollout": 4, "evaluation_envs": 2}


def trained(path, task, learner, **options):
    budget = {"episodes" if learner["name"] == "tabular_q" else "total_steps": 40}
    plain = {"name": "tiny", "task": task, "learner": learner, "seeds": 2, "record": 4}
    return sweep(plain | budget | options, path).path


@pytest.fixture(scope="module")
def reach(tmp_path_factory):
    """Points that differ by far: one never learns."""
    axes = {"learner.learning_rate": [0.001, 0.5]}
    return trained(tmp_path_factory.mktemp("evaluate") / "reach", REACH, TABLE, sweep={"axes": axes}, episodes=200)


@pytest.fixture(scope="module")
def leg(tmp_path_factory):
    """Episodes of so few steps that none succeeds, and all are as long."""
    axes = {"learner.learning_rate": [0.0001, 0.3, 0.01]}
    return trained(tmp_path_factory.mktemp("evaluate") / "leg", LEG, LINEAR, sweep={"axes": axes}, total_steps=400)


def test_a_task_ends_its_episodes_itself(reach):
    """However long they are: the agent that does not move never reaches its goal."""
    long = in_world(find_policy(reach), None, ["task.max_episode_steps=150_000"])
    assert play_out(long, "zero", 1)["steps"].tolist() == [150_000]


def test_episodes_that_the_physics_gives_up_are_told_from_falls():
    """On ice the solver in single precision finds no forces; native MuJoCo does, and the robot stands."""
    ice, (tree, native) = ["task.friction=0.02"], ("tree", "mujoco")
    found = {physics: play_out(in_world(find_policy("stand"), physics, ice), "greedy", 8) for physics in (tree, native)}
    assert found[tree]["lost"].any() and not (found[tree]["lost"] & found[tree]["success"]).any()
    assert found[native]["success"].all() and not found[native]["lost"].any()
    assert estimated("stand", "greedy", found[tree]).as_json()["lost"] == found[tree]["lost"].mean()


def test_the_best_of_a_run_reaches_its_goal_on_the_shortest_way(reach):
    best = find_policy(reach)
    assert best.config.learner["learning_rate"] == 0.5 and best.config.sweep is None
    found = play_out(best, "greedy", 20)
    task = make_task("joint_reach", **{k: v for k, v in REACH.items() if k != "name"})
    assert found["success"].all() and (found["steps"] == np.ceil(abs(task.goal - task.start) / task.action)).all()


def test_another_point_than_the_best(reach):
    worse = find_policy(reach, 0)
    assert worse.point == 0 and worse.config.learner["learning_rate"] == 0.001 and find_policy(reach).point == 1
    assert {policy.point for policy in policies_of_best(reach, 0)} == {0}
    with pytest.raises(InputError, match=r"--point 2: .* holds no finished run of it; it has 2, from 0 on"):
        find_policy(reach, 2)


def test_points_of_other_sizes_have_what_sweeps_of_their_own_have(tmp_path):
    """One has more rows in its table than the other, and greedy scores along its curve."""
    then, axes = {"episodes": 20, "record": 4}, {"task.states": [11, 21], "learner.evaluations": [1, 4]}
    both = trained(tmp_path / "both", REACH, TABLE, then=then, sweep={"mode": "zip", "axes": axes})
    alone = trained(tmp_path / "alone", REACH | {"states": 21}, TABLE | {"evaluations": 4}, then=then)
    for mixed, own in ((both, alone), (both / "then", alone / "then")):
        results, wanted = Run(mixed).results, Run(own).results
        chosen = results["point"] == 1
        for name in {*wanted} - {"point", "learner.start_from"}:
            np.testing.assert_array_equal(results[name][chosen], wanted[name], err_msg=name)
        assert np.isnan(results["greedy_return"][~chosen]).all()
        for one, other in zip(policies_of_best(mixed, 1), policies_of_best(own), strict=True):
            np.testing.assert_array_equal(one.policy, other.policy)
        assert find_policy(mixed, 0).policy.shape[0] == 11
    with pytest.raises(InputError, match=r"both.*does not fit"):
        trained(tmp_path / "more", REACH, TABLE | {"start_from": str(both)}, sweep={"axes": {"task.bonus": [1, 2]}})


def test_the_best_of_a_run_is_the_first_of_its_table(leg):
    """What is left to tell them apart is the return."""
    run = Run(leg)
    first = ranked(["learner.learning_rate"], run.summary, quickest=False)[0]
    means = [run.summary["greedy_return"][run.summary["point"] == point].mean() for point in range(3)]
    assert first.point == find_policy(run.path).point == np.argmax(means)


def test_agents_that_do_not_learn(leg):
    """Of each joint the zero agent takes the middle choice: set-points stay. The other takes all choices alike."""
    best = find_policy(leg)
    state = jax.jit(best.learner.env.reset)(rng.key(0))

    @jax.jit
    def choices(number):
        choose = agent(best.learner, best.policy, number)
        return jax.vmap(choose, in_axes=(None, 0))(state, jax.random.split(rng.key(1), 3000))

    zero, random = (np.asarray(choices(jnp.int32(AGENTS.index(name)))) for name in ("zero", "random"))
    assert (zero == 1).all()
    shares = np.stack([(random == choice).mean(axis=0) for choice in range(3)])
    # 3,000 draws of a third: four standard deviations are 0.034.
    np.testing.assert_allclose(shares, 1 / 3, atol=0.035)


def test_episodes_are_the_same_for_all_and_however_they_are_cut(leg, monkeypatch):
    best = find_policy(leg)
    whole = play_out(best, "random", 7)
    monkeypatch.setattr(evaluate, "BLOCK", 4)
    parts = play_out(best, "random", 7)
    np.testing.assert_array_equal(whole["success"], parts["success"])
    np.testing.assert_allclose(whole["return"], parts["return"], rtol=1e-5)
    assert len(np.unique(whole["return"])) == 7


def test_a_reward_of_one_for_each_of_ten_steps_is_discounted():
    always = probes.make(1, [1, 1], 0, [0, 0], [[1, 1], [1, 1]], cap=10)
    play = jax.jit(lambda discount: rollout(always, lambda state, key: jnp.zeros(1, int), rng.key(0), discount)[0])
    for discount in (0.0, 0.9):
        found = play(discount)
        assert found.episode_return == 10
        assert found.discounted_return == pytest.approx((1 - discount**10) / (1 - discount))


def test_a_return_that_falls_while_success_grows_is_explained(reach):
    best = find_policy(reach)._replace(name="mine")
    row = {"success": np.ones(4), "return": np.full(4, 20.0), "steps": np.ones(4), "discounted_return": np.full(4, 9.0)}
    waits = row | {"return": np.full(4, 30.0), "discounted_return": np.full(4, 5.0)}
    other = estimated("joint_reach", "random", waits)
    (words,) = words_on_returns([best], [estimated("mine", "greedy", row), other])
    assert words.startswith("mine has a lower return than an agent that succeeds no more often") and words.endswith(
        "greedy 9, random 5."
    )
    assert words_on_returns([best], [estimated("mine", "greedy", row | {"return": np.full(4, 40.0)}), other]) == []


def test_no_training_has_a_key_of_evaluation():
    seeds, numbers = jnp.repeat(jnp.arange(2, dtype=jnp.uint32), 64), jnp.tile(jnp.arange(64, dtype=jnp.uint32), 2)
    runs = jax.vmap(run_key)(seeds, numbers)
    ends = jax.vmap(jax.random.fold_in, in_axes=(0, None))(runs, 1)
    held, *trained = (
        {tuple(key) for key in jax.random.key_data(keys).tolist()} for keys in (held_out_keys(64), runs, ends)
    )
    assert not held & set.union(*trained) and [*map(len, (held, *trained))] == [64, 128, 128]


def test_what_play_shows_is_an_episode_that_evaluation_counts(leg):
    best = find_policy(leg)
    counted, played = play_out(best, "greedy", 3), play(best, episode=2)
    assert len(played.actions) == counted["steps"][2] == 4 and played.success == counted["success"][2]
    assert played.episode_return == pytest.approx(float(counted["return"][2]), rel=1e-4)


def test_a_policy_comes_back_from_its_file(reach, leg, tmp_path):
    for path in (reach, leg):
        best, file = find_policy(path), tmp_path / f"{path.name}.npz"
        save_policy(best, file)
        again = read_policy(file)
        assert jax.tree.structure(again[:2]) == jax.tree.structure(best[:2]) and again.as_json() == best.as_json()
        for old, new in zip(jax.tree.leaves(best[:2]), jax.tree.leaves(again[:2]), strict=True):
            assert old.dtype == new.dtype and np.asarray(old).tobytes() == np.asarray(new).tobytes()
        assert again.origin["provenance"]["versions"]["jax"] and again.origin["scores"]["final.greedy_success"] >= 0
    assert evaluate_all([again], 3) == evaluate_all([best], 3)


def test_files_that_are_no_policies(reach, tmp_path):
    good = tmp_path / "good.npz"
    save_policy(find_policy(reach), good)
    whole = good.read_bytes()
    with np.load(good) as file:
        arrays = dict(file)
    header = json.loads(str(arrays["header"]))

    def write(name, **changes):
        np.savez(tmp_path / name, **(arrays | changes))
        return tmp_path / name

    (tmp_path / "truncated.npz").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "text.npz").write_text("a policy")
    packed = bytearray(whole)
    packed[8] ^= 1 << 6  # another way of compression, in the directory too
    packed[whole.index(b"PK\x01\x02") + 10] ^= 1 << 6
    (tmp_path / "packed.npz").write_bytes(bytes(packed))
    np.savez(tmp_path / "foreign.npz", x=np.zeros(3))
    np.savez(tmp_path / "pickled.npz", header=np.array({"format": 1}, object))
    short = {name: array[:3] for name, array in arrays.items() if name.startswith("policy")}
    damaged = "is no policy file, or a truncated or damaged one"
    for file, words in (
        *((f"{name}.npz", damaged) for name in ("truncated", "text", "packed", "foreign", "pickled")),
        ("missing.npz", "there is no such file"),
        (write("old.npz", header=np.array(json.dumps(header | {"format": "version 0"}))), "export it again"),
        (write("short.npz", **short), "does not fit"),
        (
            write("half.npz", header=np.array(json.dumps({"format": header["format"]}))),
            "header.name: this key is",
        ),
    ):
        with pytest.raises(InputError, match=words):
            read_policy(tmp_path / file)
    with pytest.raises(InputError, match="neither a run folder nor a policy; did you mean 'posture_switch'"):
        find_policy("posture_swich")


def test_shipped_policies_succeed():
    (found, *others) = evaluate_all([find_policy("posture_switch")], 8)
    assert found.success.value == 1.0 and all(other.success.value < 1.0 for other in others)


def test_commands(leg, tmp_path):
    file, found = tmp_path / "leg.npz", tmp_path / "found.json"
    world = "--physics", "mujoco", "--set", "task.duration=0.3"
    told("export", leg, file, "--point", 0)
    output = told("evaluate", file, *world, "--episodes", 5, "--json", found)
    for words in ("5 episodes that no training has seen, physics mujoco, task.duration=0.3", "greedy", "zero"):
        assert words in output
    result = json.loads(found.read_text())
    assert [e["agent"] for e in result["evaluations"]] == ["greedy", "zero", "random"]
    task = result["policies"][0]["config"]["task"]
    assert (task["physics"], task["duration"], result["set"]) == ("mujoco", 0.3, ["task.duration=0.3"])
    for e in result["evaluations"]:
        low, high = e["return_interval"]
        assert low <= e["return"] <= high and e["steps"] == 3.0


def test_a_return_that_is_no_number_is_null_in_json(leg, tmp_path, monkeypatch):
    results = {"success": 0.0, "return": np.nan, "steps": 1.0, "discounted_return": np.inf}
    episodes = {name: np.array([x]) for name, x in results.items()}
    monkeypatch.setattr(evaluate, "evaluate_all", lambda *_: [estimated("leg", "greedy", episodes)])
    told("evaluate", leg, "--json", tmp_path / "found.json")
    (found,) = json.loads((tmp_path / "found.json").read_text(), parse_constant=pytest.fail)["evaluations"]
    assert (found["return"], found["discounted_return"], found["steps"]) == (None, None, 1.0)


def test_a_policy_is_shown_in_the_file_of_its_robot_beside_its_own_world(tmp_path):
    found = tmp_path / "found.json"
    short = "--set", "task.duration=0.1", "--episodes", 2, "--json", found
    output = told("evaluate", "walk_dog", "--unmodified", *short)
    for words in (
        "2 episodes that no training has seen, physics mujoco",
        "walk_dog (greedy)",
        "success is to stay upright; evaluate --gait says whether a robot also goes as it is told",
        "walk_dog, unmodified (gre",
    ):
        assert words in output
    assert "walk_dog, unmodified: time steps of 0.004 s, euler, pyramidal cone; 12 joints take the servo's" in output
    worlds = [policy["config"]["task"]["physics"] for policy in json.loads(found.read_text())["policies"]]
    assert worlds == ["mujoco", "unmodified"]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["evaluate", "RUN", "--physics", "mujoco"], "the task joint_reach has no choice of physics"),
        (["evaluate", "posture_switch", "--physics", "bullet"], "physics.name: unknown physics"),
        (["evaluate", "nothing"], "neither a run folder nor a policy"),
        (["evaluate", "RUN", "--json", "none/x.json"], "there is no folder none"),
        (["evaluate", "RUN", "--json", "."], "--json .: this is a folder; name a file"),
        (["evaluate", "RUN", "--json", "-"], "--json -: this is the standard output; name a file"),
        (["evaluate", "posture_switch", "--point", "1"], "--point: posture_switch is no run folder"),
        (
            ["evaluate", "walk_dog", "--physics", "tree", "--unmodified"],
            "--physics tree: --unmodified plays in native MuJoCo",
        ),
        (
            ["play", "walk_dog", "--physics", "tree", "--unmodified"],
            "--physics tree: --unmodified plays in native MuJoCo",
        ),
        (
            ["evaluate", "posture_switch", "--unmodified"],
            "the robot legs has no foot on the ground; take physics mujoco",
        ),
        (["export", "leg", "x.xml", "--point", "1"], "--point: x.xml is of a robot"),
        (["export", "RUN", "x.pkl"], "must end in .xml, for a robot, or in .npz"),
        (["export", "RUN", "none/x.npz"], "there is no folder none"),
        (["play", "RUN"], "its task joint_reach moves no robot"),
    ],
)
def test_what_cannot_be_done_gets_a_sentence(reach, arguments, sentence):
    with pytest.raises(InputError, match=re.escape(sentence)):
        told(*(reach if argument == "RUN" else argument for argument in arguments))


def test_estimates_are_of_the_episodes():
    rng = np.random.default_rng(0)
    episodes = {"success": np.arange(8) < 2, "return": np.arange(8.0), "discounted_return": np.arange(8.0) / 2}
    found = estimated("p", "greedy", episodes | {"steps": rng.uniform(size=8)})
    assert found.as_json()["discounted_return"] == 1.75
    assert found.success.value == 0.25 and found.episode_return.value == 3.5 and found.mean_return == 3.5
    # Wilson's interval of 2 in 8 by his formula with z = 1.96, printed in many tables.
    np.testing.assert_allclose(found.success[1:], (0.0715, 0.5907), atol=1e-4)
