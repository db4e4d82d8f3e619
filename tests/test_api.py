"""The front door: training and policies as pure functions, and types without `Any`."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from finite_mdp import random_task

import humanoid_mjx
from humanoid_mjx import InputError, Policy, key, load_policy, make_learner, make_task, rollout, train
from humanoid_mjx.evaluation.policy import with_config
from humanoid_mjx.learners.rollout import greedy
from humanoid_mjx.learners.rollout import rollout as rollout_of_states
from humanoid_mjx.runs.tables import finished_runs
from humanoid_mjx.training.plan import build
from humanoid_mjx.training.program import run_key
from humanoid_mjx.training.state import to_arrays

ROOT = Path(__file__).parent.parent
TASK = make_task("joint_reach", joint=4, states=8, max_episode_steps=50)
TABLE = make_learner("tabular_q", TASK, episodes=60, record=10)
EXACT = make_learner("tabular_q", random_task(0, 8, 2, 8), episodes=60, record=10, learning_rate=1.0, discount=0.5)
"""Its values are binary fractions, which few programs round."""


@pytest.fixture(scope="module")
def grid():
    """Two values of epsilon by three keys."""
    epsilons, keys = jnp.array([0.125, 0.75]), jax.vmap(key)(jnp.arange(3))
    return jax.vmap(jax.vmap(lambda e, k: train(EXACT.replace(epsilon=e), k), (None, 0)), (0, None))(epsilons, keys)


def test_a_training_has_the_bits_of_the_sweep(tmp_path):
    """A run of a sweep takes its seed and its number for the key; on a CPU tables agree bit by bit."""
    task = {"name": "joint_reach", "joint": 5, "states": 5, "action": 15.0}
    values = {"name": "tabular_q", "epsilon_decay": 0.5, "learning_rate": 0.5, "discount": 0.5}  # exact in binary
    config = {"name": "small", "task": task, "learner": values, "seeds": 2, "episodes": 60, "record": 10}
    config["sweep"] = {"axes": {"learner.epsilon": [0.125, 0.75]}}
    run = humanoid_mjx.sweep(config, tmp_path / "run", quiet=True)
    runs = finished_runs(run.path, ("point", "seed", "policy", "curve.", "final."))
    more = {key: value for key, value in values.items() if key != "name"}
    learner = make_learner("tabular_q", make_task(task.pop("name"), **task), episodes=60, record=10, **more)
    for row, (point, seed) in enumerate(zip(runs["point"], runs["seed"], strict=True)):
        alone = train(learner.replace(epsilon=(0.125, 0.75)[point]), run_key(jnp.int32(0), jnp.int32(seed)))
        (stored,) = to_arrays(alone.policy.weights, "policy")
        np.testing.assert_array_equal(alone.policy.weights, runs[stored][row])
        np.testing.assert_array_equal(alone.curve["steps"], runs["curve.steps"][row])
        assert alone.scores["greedy_success"] == runs["final.greedy_success"][row]


def test_mapped_trainings_are_those_alone(grid):
    assert grid.curve["success"].shape == (2, 3, 10) and grid.policy.weights.shape == (2, 3, 8, 2)
    alone = train(EXACT.replace(epsilon=0.75), key(2))
    np.testing.assert_array_equal(alone.policy.weights, grid.policy.weights[1, 2])
    np.testing.assert_array_equal(alone.curve["steps"], grid.curve["steps"][1, 2])
    assert not np.array_equal(grid.curve["steps"][0, 0], grid.curve["steps"][1, 0])


def test_learners_side_by_side_train_to_their_own_ends():
    learners = [EXACT.replace(epsilon=0.125, episodes=20), EXACT.replace(epsilon=0.75, episodes=60)]
    stacked = jax.tree.map(lambda *x: jnp.stack([jnp.asarray(each) for each in x]), *learners)
    both = jax.vmap(train, (0, None))(stacked, key(2))
    assert both.carry.agents.episode.tolist() == [20, 60]
    for row, learner in enumerate(learners):
        np.testing.assert_array_equal(both.curve["steps"][row], train(learner, key(2)).curve["steps"])


def test_training_ends_where_progress_does(grid):
    learner = grid.policy.learner
    progress = jax.vmap(jax.vmap(type(EXACT).progress))(learner, grid.carry)
    np.testing.assert_array_equal(progress, 1.0)


def test_sharded_keys_train_on_their_devices():
    mesh = jax.sharding.Mesh(np.array(jax.devices()[:2]), ("runs",))
    keys = jax.vmap(key)(jnp.arange(4))
    sharded = jax.device_put(keys, jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec("runs")))
    one, two = (jax.jit(jax.vmap(train, (None, 0)))(EXACT, k) for k in (keys, sharded))
    assert len(two.policy.weights.sharding.device_set) == 2
    assert two.policy.weights.addressable_shards[0].data.shape[0] == 2
    np.testing.assert_array_equal(one.curve["steps"], two.curve["steps"])


def test_networks_train_as_functions():
    learner = make_learner("deep_q", TASK, envs=8, rollout=8, width=8, layers=1, total_steps=1000, evaluations=2)
    rates = jnp.array([learner.learning_rate, learner.learning_rate, jnp.inf], jnp.float32)
    each = jax.vmap(lambda rate, key: train(learner.replace(learning_rate=rate), key))
    trained = each(rates, jax.vmap(key)(jnp.arange(3)))
    assert trained.carry.update[:2].tolist() == [16, 16]  # 16 updates of 64 steps are the first to reach 1,000
    assert trained.scores["diverged"].tolist() == [False, False, True]
    assert np.isfinite(trained.curve["greedy_success"]).sum(axis=1)[:2].tolist() == [2, 2]


def test_a_policy_plays_as_its_learner_acts(grid):
    policies = jax.tree.map(lambda x: x[1], grid.policy)
    played = jax.vmap(rollout, (None, 0, None))(EXACT.task, policies, key(7))
    table = policies.weights[2]
    expected, _ = rollout_of_states(EXACT.env, greedy(EXACT, table), key(7))
    assert played.steps[2] == expected.steps and played.success[2] == expected.success
    state = EXACT.env.reset(key(1))
    policy = jax.tree.map(lambda x: x[2], policies)
    assert policy.observation(state) == EXACT.task.state_index(state.data[0])
    assert int(policy(policy.observation(state), key(0))[0]) == int(jnp.argmax(table[policy.observation(state)]))


def test_a_function_of_ones_own_plays():
    """One choice at every step until the limit, or until it reaches the goal."""
    seen = []

    def policy(obs, key):
        seen.append(obs.shape)
        return jnp.zeros(1, jnp.int32)

    episode = rollout(TASK, policy, key(0), discount=0.5)
    assert set(seen) == {(1,)} and 1 <= int(episode.steps) <= 50


def test_an_action_outside_its_range_has_no_return_where_values_are_not_known():
    """The first choice is right, so the fault lies within the episode."""

    def returns(wrong):
        episode = rollout(TASK, lambda obs, key: jnp.where(obs > 0, wrong, 1), key(0))
        return episode.episode_return, episode.discounted_return, episode.success

    total, discounted, success = jax.vmap(returns)(jnp.array([1, 2, -1]))
    np.testing.assert_array_equal(np.isnan([total, discounted]), [[False, True, True]] * 2)
    np.testing.assert_array_equal(success, [True, False, False])


def test_a_shipped_policy_is_a_function():
    policy = load_policy("stand")
    state = jax.jit(policy.task.reset)(key(0))
    action = policy(state.obs, key(1))
    assert action.shape == (10,) and set(np.unique(action)) <= {0, 1, 2}
    with pytest.raises(InputError, match="neither a run folder nor a policy"):
        load_policy("stnad")


CORRIDOR = """
from typing import ClassVar
import jax.numpy as jnp
from humanoid_mjx import FiniteTask, traced

class Corridor(FiniteTask):
    num_states: ClassVar[int] = 4
    num_actions: ClassVar[int] = 2
    bonus: float = traced(0.1)

    def reset(self, key):
        return jnp.int32(0)

    def step(self, state, action, key):
        state = jnp.clip(state + 2 * action - 1, 0, 3)
        return state, self.bonus * (state == 3), state == 3
"""


def test_a_policy_of_train_is_evaluated_saved_and_read_again(tmp_path, monkeypatch):
    """With a task of one's own, whose module is found again from its folder."""
    (tmp_path / "corridor_of_api.py").write_text(CORRIDOR)
    monkeypatch.syspath_prepend(tmp_path)
    task = make_task("corridor_of_api:Corridor", max_episode_steps=40)
    learner = make_learner("tabular_q", task, episodes=50, epsilon_decay=0.9).replace(epsilon=0.3)
    trained = train(learner, key(0))
    played = [humanoid_mjx.evaluate(each, episodes=4)["greedy"].steps for each in (trained, trained.policy)]
    assert played[0].value == played[1].value == 3
    trained.policy.save(tmp_path / "mine.npz")
    again = load_policy(tmp_path / "mine.npz")
    np.testing.assert_array_equal(again.weights, trained.policy.weights)
    same = jax.tree.map(np.array_equal, again.learner, jax.tree.map(jnp.asarray, learner))
    assert all(jax.tree.leaves(same)) and again.learner.episodes == 50
    assert humanoid_mjx.evaluate(tmp_path / "mine.npz", episodes=4)["greedy"].steps.value == 3


@pytest.mark.parametrize("name", ["leg_reach", "squat", "walk"])
def test_a_learner_has_a_config_that_makes_it_again(name):
    learner = make_learner("deep_q", make_task(name), total_steps=1000).replace(learning_rate=np.float32(0.1))
    again = build(with_config(learner, None).config, {})
    assert jax.tree.structure(again) == jax.tree.structure(learner) and again.record == learner.record
    np.testing.assert_array_equal(*(np.float32(jax.tree.leaves(each)) for each in (again, learner)))


def test_a_short_training_records_as_much_as_it_has():
    def known(name, **values):
        learner = make_learner(name, TASK, **values)
        curve = train(learner, key(0)).curve
        return learner.record, int(np.isfinite(curve["steps"]).sum())

    assert known("tabular_q", episodes=50) == (50, 50)
    assert known("tabular_q", episodes=50, record=10) == (10, 10)
    # 20 updates of 512 steps; in the first few no episode ends.
    record, entries = known("deep_q", total_steps=10_000, envs=32, width=8, layers=1, evaluations=1)
    assert record == 20 and entries >= 15
    assert make_learner("tabular_q", TASK).record == 100


def test_entries_of_a_curve_have_places(grid):
    assert grid.places.shape == (2, 3, 10) and grid.places[0, 0].tolist() == list(range(6, 61, 6))


def test_one_loop_plays_finite_and_continuous_tasks():
    linear = make_learner("linear_q", make_task("leg_reach", physics="mujoco"))
    weights = jax.eval_shape(lambda: linear.policy(linear.init(key(0))))
    blank = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), weights)
    for policy in (train(TABLE, key(0)).policy, Policy(linear, blank)):
        reset, step = jax.jit(policy.task.reset), jax.jit(policy.task.step)
        state = reset(key(0))
        for number in range(2):
            action = policy(policy.observation(state), key(number))
            state = step(state, action, key(number))
        assert action.shape == (len(policy.task.action_bins),) and state.obs.shape == (policy.task.observation_size,)


WRONG = {
    "key(0.5)": "key: the seed must be an integer from -2**31 to 2**32 - 1, got 0.5.",
    "key(2**40)": "got 1099511627776.",
    "train(table, 3)": "train: the last argument must be a key of jax.random, got 3; pass key(3).",
    "policy(0, 0)": "policy(obs, key): the last argument must be a key of jax.random, got 0; pass key(0).",
    "rollout(task, policy, 0)": "rollout: the last argument must be a key of jax.random",
    "train(table, jax.random.split(key(0), 3))": "train: there must be one key, got keys of shape (3,); map over them",
    "train(task, key(0))": "train: write train(learner, key(0)); JointReach is no learner of make_learner.",
    "train(key(0), table)": "train: write train(learner, key(0)); PRNGKeyArray is no learner of make_learner.",
    "rollout(task, policy, key(0), discount='a')": "rollout: discount must be a number, got 'a'.",
    "rollout(task, policy, key(0), jnp.ones(2))": "rollout: discount must be a number, got ",
    "rollout(policy, task, key(0))": "the first two are Policy and JointReach.",
    "rollout(task, lambda obs, key: jnp.int32(7), key(0))": "below [2], of shape (1,); got int32[].",
    "rollout(task, lambda obs, key: None, key(0))": "below [2], of shape (1,); got None.",
    "rollout(task, lambda obs, key: {'action': 1}, key(0))": "of shape (1,); got {'action': 1}.",
    "rollout(task, lambda obs, key: jnp.zeros(2, int), key(0))": "below [2], of shape (1,); got int32[2].",
    "rollout(task, lambda obs, key: jnp.zeros(1), key(0))": "below [2], of shape (1,); got float32[1].",
    "rollout(reach, lambda obs, key: jnp.zeros(2), key(0))": "or numbers from -1 to 1, of shape (5,); got float32[2].",
    "rollout(task, lambda obs, key: jnp.full(1, 7), key(0))": "integers at least 0 and below [2]; it returned [7].",
    "rollout(task, lambda obs, key: jnp.where(obs > 0, -1, 1), key(0))": "below [2]; it returned [-1].",
    "rollout(reach, lambda obs, key: jnp.full(5, 1.5), key(0))": "or numbers from -1 to 1; it returned [1.5, 1.5,",
    "policy(policy.task.reset(key(0)), key(0))": "write policy(policy.observation(state), key).",
    "policy(-1, key(0))": "policy: an observation is the row of a table, an integer from 0 to 7, got -1; map over many",
    "policy(jnp.int32(8), key(0))": "an integer from 0 to 7, got Array(8, dtype=int32",
    "policy(np.float32(3), key(0))": "an integer from 0 to 7, got np.float32(3.0)",
    "policy(jnp.array([3]), key(0))": "an integer from 0 to 7, got int32[1]; map over many by jax.vmap",
    "policy(True, key(0))": "an integer from 0 to 7, got True",
    "policy(None, key(0))": "an integer from 0 to 7, got None",
    "load_policy('stand')(jnp.zeros(40), key(0))": "policy: an observation is numbers of shape (41,), got float32[40]",
    "load_policy('stand')([0.0] * 41, key(0))": "policy: an observation is numbers of shape (41,), got [0.0, 0.0,",
    "train(table.replace(epsilon=jnp.array([0.1, 0.2])), key(0))": "train: epsilon must be one number, got Array",
    "train(table.replace(task=task.replace(bonus='5')), key(0))": "train: task.bonus must be one number, got '5'; map",
    "policy.observation(task.reset(key(0)))": "policy.observation: take a state of policy.task.reset or .step, got",
    "make_learner('tabular_q', 'joint_reach')": "got 'joint_reach'; pass make_task('joint_reach').",
    "make_learner('tabular_q', type(task))": "pass JointReach(...).",
    "make_task(type(task))": '; write "humanoid_mjx.tasks.joint_reach:JointReach", or JointReach(...).',
    "make_learner('deep_q', humanoid_mjx.Task())": "Task is not; derive it from FiniteTask or ContinuousTask.",
    "make_learner('tabular_q', task, total_steps=9)": "total_steps: tabular_q counts episodes; write episodes in its",
    "make_learner('deep_q', task, episodes=9)": "episodes: deep_q counts control steps of all environments; write",
    "make_learner('tabular_q', task, episodes=50, record=60)": "record (60) must be at most episodes (50).",
    "jax.vmap(lambda e: make_learner('tabular_q', task, epsilon=e).epsilon)(jnp.ones(2))": "learner.epsilon must be a "
    "number, got VmapTracer(aval=float32[], batched=float32[2]); build with a number, then .replace(epsilon=...) takes",
    "table.replace(epsilom=0.1)": "TabularQ.replace: epsilom: unknown field; did you mean 'epsilon'?",
    "jax.vmap(lambda n: table.replace(agents=n).epsilon)(jnp.arange(2))": "TabularQ.replace: agents is static: it",
    "table.replace(method='sarssa')": "TabularQ.replace: method must be one of q_learning, sarsa, expected_sarsa",
    "load_policy(None)": "a policy is named by a run folder, a policy file or a shipped name, got None.",
    "humanoid_mjx.evaluate('stand', episodes=0)": "evaluate: episodes must be an integer of at least 1, got 0.",
    "humanoid_mjx.evaluate('stand', episodes=2.5)": "evaluate: episodes must be an integer of at least 1, got 2.5.",
    "humanoid_mjx.evaluate('stand', episodes=True)": "evaluate: episodes must be an integer of at least 1, got True.",
    "humanoid_mjx.evaluate('stand', point='2')": "point must be an integer of at least 0, got '2'.",
    "load_policy('stand', point=-1)": "point must be an integer of at least 0, got -1.",
    "humanoid_mjx.play('stand', episode=-1)": "play: episode must be an integer of at least 0, got -1.",
    "humanoid_mjx.play('stand', episode=1.5)": "play: episode must be an integer of at least 0, got 1.5.",
    "humanoid_mjx.plot()": "plot: name a run folder.",
    "humanoid_mjx.plot('runs/none', y=None)": "plot: a column is named by text such as 'steps', got None.",
    "humanoid_mjx.plot('runs/none', by='')": "plot: a column is named by text such as 'steps', got ''.",
    "policy.save('x.onnx')": "x.onnx: a policy file must end in .npz; humanoid-mjx export writes .onnx and .c from it.",
    "humanoid_mjx.plot('runs/none', out='x.jpg')": "--out x.jpg: the file must end in .png.",
    "humanoid_mjx.evaluate(None)": "a policy is named by a run folder, a policy file or a shipped name, got None.",
    "humanoid_mjx.sweep(None)": "sweep: config must be a config, its name or path, or a mapping of its keys, got None.",
    "humanoid_mjx.sweep('joint1', reporter=type)": "sweep: reporter must be a Reporter, got <class 'type'>.",
    "humanoid_mjx.sweep({3: 4})": "config: a key must be a string, got 3.",
    "humanoid_mjx.sweep('maze', out=3)": "sweep: out must be the path of a run folder, got 3.",
    "humanoid_mjx.sweep('maze', out='a\\0')": "sweep: out must be the path of a run folder, got 'a\\x00'.",
    "humanoid_mjx.sweep('maze', pool_size='2')": "sweep: pool_size must be an integer of at least 1, got '2'.",
    "humanoid_mjx.sweep('maze', trackers='wandb')": 'sweep: trackers must be a list such as ["tensorboard"], got',
    "humanoid_mjx.sweep('maze', overrides='seeds=2')": 'overrides must be a list such as ["learner.epsilon=0.1"], got',
    "humanoid_mjx.evaluate('walk', overrides=[3])": 'an override must be a string such as "learner.epsilon=0.1", got',
    "humanoid_mjx.play(policy)": "moves no robot",
    "make_physics('tree', 3)": "name the values, as in make_physics('tree', robot=...); got 3.",
    "TaskVectorEnv(task, 0)": "TaskVectorEnv: num_envs must be an integer of at least 1, got 0.",
    "TaskVectorEnv(task, 2, 'choice')": "actions must be choices or numbers, got 'choice'.",
}
PROGRAM = """
import json, sys
import jax, jax.numpy as jnp, numpy as np
import humanoid_mjx
from humanoid_mjx import InputError, Policy, key, load_policy, make_learner, make_task, rollout, train
from humanoid_mjx.physics import make_physics
from humanoid_mjx.tasks.gym_env import TaskVectorEnv

task, reach = make_task("joint_reach", joint=4, states=8, max_episode_steps=50), make_task("leg_reach")
table = make_learner("tabular_q", task, episodes=5)
policy = train(table, key(0)).policy
for call in json.load(sys.stdin):
    try:
        print(json.dumps(repr(eval(call))))
    except InputError as error:
        print(json.dumps("InputError: " + str(error)))
"""


def test_a_wrong_argument_gets_one_sentence():
    """In a program without the checks of types that the tests have."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    words = {"input": json.dumps(list(WRONG)), "capture_output": True, "text": True, "env": environment}
    done = subprocess.run([sys.executable, "-c", PROGRAM], check=False, **words)
    assert done.returncode == 0, done.stderr
    for (call, says), said in zip(WRONG.items(), map(json.loads, done.stdout.splitlines()), strict=True):
        assert said.startswith("InputError: ") and says in said and "\n" not in said and said[-1] == ".", (call, said)


def test_a_figure_named_by_a_string_is_of_its_kind(tmp_path):
    run = humanoid_mjx.sweep("joint4", tmp_path / "run", overrides=["sweep=null", "seeds=1", "episodes=5"], quiet=True)
    picture = humanoid_mjx.plot(run, out=str(tmp_path / "x.png"))
    assert picture.path == tmp_path / "x.png" and picture.path.read_bytes().startswith(b"\x89PNG")


def test_policies_side_by_side_are_not_one(grid):
    chosen = jax.tree.map(lambda x: x[1], grid.policy)
    for call in (
        lambda: rollout(EXACT.task, chosen, key(0)),
        lambda: chosen(jnp.int32(0), key(0)),
        lambda: humanoid_mjx.evaluate(chosen),
    ):
        with pytest.raises(
            InputError, match=r"of shape \(3,\); choose one by jax.tree.map\(lambda x: x\[0\], policy\)"
        ):
            call()
    assert repr(grid) == (
        "Trained(Policy(2 x 3 x TabularQ on TableTask); curve: return, steps, success; "
        "scores: diverged, greedy_return, greedy_steps, greedy_success)"
    )


def test_the_face_names_what_it_has():
    for name in dir(humanoid_mjx):
        value = getattr(humanoid_mjx, name)
        assert name.startswith("__") or callable(value) or name in ("control", "dynamics", "kinematics")
    with pytest.raises(AttributeError, match="no attribute 'swep'"):
        _ = humanoid_mjx.swep


def test_importing_the_face_loads_nothing():
    code = "import sys, humanoid_mjx; print(*sorted({'jax', 'numpy', 'mujoco', 'pydantic'} & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert done.stdout.strip() == ""


def test_a_users_file_and_the_front_door_pass_pyright(tmp_path):
    """In `standard` mode; every name of the front door is used, and no result is an `Any`."""
    user = ROOT / "tests" / "data" / "user_of_all.py"
    assert set(dir(humanoid_mjx)) - {"__version__"} <= set(re.findall(r"\w+", user.read_text()))
    shutil.copy(user, tmp_path / "user.py")
    include = ["user.py", os.path.relpath(ROOT / "humanoid_mjx" / "api.py", tmp_path)]
    settings = {"typeCheckingMode": "standard", "include": include, "extraPaths": [str(ROOT)], "pythonVersion": "3.11"}
    (tmp_path / "pyrightconfig.json").write_text(json.dumps(settings))
    command = [sys.executable, "-m", "pyright", "-p", str(tmp_path), "--pythonpath", sys.executable, "--outputjson"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    said = json.loads(done.stdout)["generalDiagnostics"]
    assert [each for each in said if each["severity"] != "information"] == []
    types = [re.search(r'is "(.+)"$', each["message"])[1] for each in said]
    assert len(types) == user.read_text().count("reveal_type(")
    assert [kind for kind in types if re.search(r"\bAny\b|Unknown", kind)] == []
