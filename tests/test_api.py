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
from humanoid_mjx import InputError, key, load_policy, make_learner, make_task, rollout, train
from humanoid_mjx.learners.rollout import greedy
from humanoid_mjx.learners.rollout import rollout as rollout_of_states
from humanoid_mjx.runs.tables import finished_runs
from humanoid_mjx.tasks.finite import Rules
from humanoid_mjx.training.program import run_key
from humanoid_mjx.training.state import to_arrays

ROOT = Path(__file__).parent.parent
TASK = make_task("joint_reach", joint=4, states=8, max_episode_steps=50)
TABLE = make_learner("tabular_q", TASK, episodes=60, record=10)
EXACT = make_learner(
    "tabular_q", random_task(0, 8, 2, 8, Rules()), episodes=60, record=10, learning_rate=1.0, discount=0.5
)
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
    both = jax.vmap(train, (None, 0))(learner, jax.vmap(key)(jnp.arange(2)))
    assert both.carry.update.tolist() == [16, 16]  # 16 updates of 64 steps are the first to reach 1,000
    assert not both.scores["diverged"].any()
    assert np.isfinite(both.curve["greedy_success"]).sum(axis=1).tolist() == [2, 2]
    diverged = train(learner.replace(learning_rate=jnp.float32(np.inf)), key(0))
    assert diverged.scores["diverged"]


def test_a_policy_plays_as_its_learner_acts(grid):
    policies = jax.tree.map(lambda x: x[1], grid.policy)
    played = jax.vmap(rollout, (None, 0, None))(EXACT.task, policies, key(7))
    table = policies.weights[2]
    expected = rollout_of_states(EXACT.env, greedy(EXACT, table), key(7))
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


def test_a_shipped_policy_is_a_function():
    policy = load_policy("stand")
    state = jax.jit(policy.task.reset)(key(0))
    action = policy(state.obs, key(1))
    assert action.shape == (10,) and set(np.unique(action)) <= {0, 1, 2}
    with pytest.raises(InputError, match="neither a run folder nor a policy"):
        load_policy("stnad")


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
