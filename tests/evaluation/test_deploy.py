"""Policies as ONNX: the values of JAX in ONNX Runtime, and a robot that walks by the contract alone."""

import json
import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from docs_reader import blocks
from flax import linen as nn
from tree_robots import FOUR_LEGS

from humanoid_mjx import InputError, make_learner, make_task
from humanoid_mjx.commands.export import export
from humanoid_mjx.compute import rng
from humanoid_mjx.evaluation.deploy import contract_of, write_onnx
from humanoid_mjx.evaluation.onnx_graph import to_onnx
from humanoid_mjx.evaluation.policy import find_policy
from humanoid_mjx.learners.approximate import Weights
from humanoid_mjx.learners.deep import DeepQ
from humanoid_mjx.learners.normalisation import Moments

pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")
ROOT = Path(__file__).parent.parent.parent
HOLD = '<position joint="hip_0_0" kp="80" ctrlrange="-.3 .5"/>'


def trained_of(learner, key):
    """A policy of random weights and moments."""
    size = learner.env.observation_size
    seen = Moments(jnp.float32(9), jax.random.normal(rng.key(1), (size,)), jnp.linspace(0.5, 2.0, size))
    policy = Weights(learner.init_value(key)[0], seen)
    return find_policy("stand")._replace(learner=learner, policy=policy, name="own")


def test_ten_thousand_states_have_the_values_of_jax(tmp_path):
    export("walk", tmp_path / "policy.onnx")
    session = onnxruntime.InferenceSession(str(tmp_path / "policy.onnx"))
    trained = find_policy("walk")
    learner, policy = trained.learner, trained.policy
    draw = jax.random.normal(rng.key(0), (10_000, learner.env.observation_size))
    obs = np.asarray(policy.moments.mean + 2.0 * jnp.sqrt(policy.moments.variance) * draw, np.float32)
    q = np.asarray(jax.jit(lambda obs: learner.q_values(policy.value, learner.preprocess(policy, obs)))(obs))
    found, actions = map(np.stack, zip(*(session.run(None, {"observation": row}) for row in obs), strict=True))
    # Sums of up to 256 products in another order, through four layers, in single precision.
    tolerance = 2e-4 * q.std()
    np.testing.assert_allclose(found, q, atol=tolerance)
    np.testing.assert_array_equal(actions, found.argmax(axis=-1))
    first, second = np.sort(q, axis=-1)[..., :-3:-1].transpose(2, 0, 1)
    clear = first - second > 2 * tolerance
    assert clear.mean() > 0.99
    np.testing.assert_array_equal(actions[clear], q.argmax(axis=-1)[clear])


@pytest.mark.parametrize(
    "function",
    [
        *(jnp.arctan2, jnp.mod, jnp.hypot, jnp.not_equal, jnp.maximum, lambda x, y: x**3 / y, lambda x, y: x @ y),
        *(lambda x, y: jnp.log1p(x * x) + jnp.expm1(y), lambda x, y: jnp.clip(x, -0.5, y.max()), jnp.outer),
        *(lambda x, y: x.at[jnp.array([3, 1])].set(y[:2]), lambda x, y: jnp.stack([x, y])[:, ::-1].T, jnp.cross),
        *(
            lambda x, y: (x > y).any(),
            lambda x, y: jnp.argmax(x - y),
            lambda x, y: jax.lax.rsqrt(x * x) + jnp.tile(y, 1),
        ),
        *(lambda x, y: jnp.where(x > 0, jnp.round(x), -y), lambda x, y: jnp.split(x, 3)[1] * y[jnp.array([0, 1])]),
    ],
)
def test_an_operation_has_the_values_of_jax(function):
    """On numbers in all four quadrants, with their halves and zeros."""
    size = 3 if function is jnp.cross else 6
    x, y = jnp.array([1.5, -2.0, 0.25, -0.5, 3.0, -0.75])[:size], jnp.array([0.5, 1.0, -1.5, -2.0, 2.5, 0.0])[:size]
    y = y if function is jnp.arctan2 else jnp.where(y == 0, 0.125, y)
    given = {"x": jax.ShapeDtypeStruct(x.shape, x.dtype), "y": jax.ShapeDtypeStruct(y.shape, y.dtype)}
    model = to_onnx(lambda x, y: (jnp.asarray(function(x, y)),), given, ["out"], {})
    (found,) = onnxruntime.InferenceSession(model).run(None, {"x": np.asarray(x), "y": np.asarray(y)})
    expected = np.asarray(function(x, y))
    assert found.dtype == expected.dtype
    np.testing.assert_allclose(found, expected, rtol=2e-6, atol=1e-6)


def test_an_operation_without_a_translation_is_named():
    given = {"x": jax.ShapeDtypeStruct((3,), np.float32)}
    with pytest.raises(InputError, match="an ONNX file cannot hold the operation cumsum of this policy"):
        to_onnx(lambda x: (jnp.cumsum(x),), given, ["out"], {})


class Gated(nn.Module):
    """A network of other layers than the shipped ones."""

    joints: int
    bins: int

    @nn.compact
    def __call__(self, obs):
        x = nn.gelu(nn.Dense(12)(obs)) * nn.sigmoid(nn.Dense(12)(obs))
        x = nn.softplus(nn.RMSNorm()(x)) + nn.tanh(x).sum(axis=-1, keepdims=True)
        return nn.Dense(self.joints * self.bins)(x).reshape(*x.shape[:-1], self.joints, self.bins)


class OwnNetwork(DeepQ):
    def network(self):
        return Gated(len(self.env.action_bins), self.bins)


def test_a_network_of_ones_own_has_the_values_of_jax(tmp_path):
    learner = OwnNetwork(task=make_task("leg_reach"))
    trained = trained_of(learner, rng.key(3))
    network, contract = write_onnx(trained, tmp_path / "own.onnx")  # no controller: the task is no legged one
    session = onnxruntime.InferenceSession(str(network))
    for obs in jax.random.normal(rng.key(4), (50, learner.env.observation_size)):
        q = learner.q_values(trained.policy.value, learner.preprocess(trained.policy, obs))
        np.testing.assert_allclose(session.run(["q"], {"observation": np.asarray(obs)})[0], q, rtol=1e-4, atol=1e-5)
    assert json.loads(contract.read_text())["observation"]["size"] == learner.env.observation_size


def test_ppo_has_the_commands_of_jax(tmp_path):
    learner = make_learner("brax_ppo", make_task("leg_reach"), num_envs=8, batch_size=8, num_minibatches=1)
    policy = jax.tree.map(jnp.asarray, learner.policy(learner.init(rng.key(0))))
    trained = find_policy("stand")._replace(learner=learner, policy=policy, name="ppo")
    network, _ = write_onnx(trained, tmp_path / "ppo.onnx")
    session = onnxruntime.InferenceSession(str(network))
    for obs in jax.random.normal(rng.key(4), (20, learner.env.observation_size)):
        found = session.run(["action"], {"observation": np.asarray(obs)})[0]
        np.testing.assert_allclose(found, learner.act(policy, obs, rng.key(0)), atol=1e-5)


@pytest.mark.parametrize(
    "values",
    [
        {"symmetric": True, "gait": {"name": "steps"}, "smoothing": 0.3},
        {"history": 3, "gait": "clock"},
        {"symmetric": True, "robot": "dog"},
    ],
)
def test_a_controller_decides_as_the_task_does(values, tmp_path):
    """The controller gets the readings of an episode of the task, and gives its observations and set-points."""
    task = make_task("walk", physics="mujoco", command={"sudden": 0.0, "every": 0.1, "heading_gain": 2.0}, **values)
    learner = make_learner("deep_q", task, width=16, layers=1)
    trained = trained_of(learner, rng.key(5))
    _, controller, _ = write_onnx(trained, tmp_path / "own.onnx")
    session = onnxruntime.InferenceSession(str(controller))
    memory = np.zeros(session.get_inputs()[-1].shape, np.float32)

    @jax.jit
    def begin(key):
        state = task.reset(key)
        data = state.data._replace(clock=task.gait.start(jnp.float32(0), task.robot))
        view = task.view(data, None, data.offsets)
        if task.history > 1:
            row = task.observed(view)
            view = view._replace(episode=data._replace(past=jnp.tile(row, (task.history, 1))))
        return state._replace(data=view.episode, obs=task.seen(view))

    @jax.jit
    def decide(state, key):
        action = learner.act(trained.policy, state.obs, key)
        offsets = task.offsets(state.data, task.as_numbers(action))
        return task.setpoint(offsets, task.reference(state.data)), task.step(state, action, key)

    state, moved = begin(rng.key(6)), 0
    for number in range(25):
        data = state.data
        given = {name: np.asarray(part, np.float32) for name, part in data.readings._asdict().items()}
        given |= {"command": np.asarray(data.command), "memory": memory}
        target, memory, obs = session.run(None, given)
        expected, state_after = decide(state, rng.key(100 + number))
        np.testing.assert_allclose(obs, state.obs, atol=2e-4)
        np.testing.assert_allclose(target, expected, atol=1e-3)
        state, moved = state_after, moved + bool(np.any(data.command))
    assert moved > 5


@pytest.mark.parametrize(
    ("name", "command", "low", "high"),
    [("walk", "0.3", 2.0, 3.5), ("walk_dog", "0.3", 2.0, 3.5), ("stand", "0", 0.0, 0.2)],
)
def test_the_loop_of_the_page_drives_the_robot_by_the_contract_alone(name, command, low, high, tmp_path):
    """The walkers come some 3 m far in 10 s; a robot that falls lies below four fifths of its first height."""
    for ending in ("onnx", "xml"):
        export(name, tmp_path / f"{name}.{ending}")
    page = (ROOT / "docs" / "on_your_robot.md").read_text(encoding="utf-8")
    (loop,) = (block.text for block in blocks(page) if block.title == "on_robot.py")
    assert "humanoid_mjx" not in loop and len(loop.splitlines()) <= 35
    (tmp_path / "loop.py").write_text(loop)
    paths = os.pathsep.join(path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path != str(ROOT))
    words = subprocess.run(
        [sys.executable, "loop.py", name, command, "0", "0"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": paths},
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    contract = json.loads((tmp_path / f"{name}.json").read_text())
    assert low <= float(words[0]) <= high
    assert float(words[-3]) > 0.8 * contract["start_height"]


def test_the_contract_is_that_of_the_robot_and_in_every_file(tmp_path):
    export("walk", tmp_path / "walk.onnx")
    contract = json.loads((tmp_path / "walk.json").read_text())
    for graph in ("walk.onnx", "walk_controller.onnx"):
        session = onnxruntime.InferenceSession(str(tmp_path / graph))
        assert json.loads(session.get_modelmeta().custom_metadata_map["contract"]) == contract
    task = find_policy("walk").learner.task
    assert contract["joints"] == list(task.robot.joints)
    assert sum(part["size"] for part in contract["observation"]["parts"]) == contract["observation"]["size"] == 46
    assert contract["control_period"] == 0.02 and contract["torque_limits"] == [2.0] * 10
    assert len(contract["normalisation"]["mean"]) == 46
    export("walk", tmp_path / "c.c")
    of_c = json.loads((tmp_path / "c.json").read_text())
    assert of_c == {key: value for key, value in contract.items() if key != "controller"}
    export("walk", tmp_path / "walk.c")  # beside the graphs, whose controller the contract goes on to describe
    assert json.loads((tmp_path / "walk.json").read_text()) == contract


def test_limits_of_set_points_are_null_where_there_is_none(tmp_path):
    """One of eight joints has a position actuator with a range; the contract is JSON without numbers that are none."""
    joints = [f"{kind}_{i}_{j}" for kind in ("hip", "knee") for i in "01" for j in "01"]
    actuators = HOLD + "".join(f'<motor joint="{joint}"/>' for joint in joints[1:])
    (tmp_path / "r.xml").write_text(FOUR_LEGS.replace("</mujoco>", f"<actuator>{actuators}</actuator></mujoco>"))
    feet = "[foot_0_0, foot_1_0, foot_0_1, foot_1_1]"
    (tmp_path / "r.yaml").write_text(f"model: r.xml\nfeet: {feet}\nservo: {{stiffness: 80}}\ntorque: 20\n")
    task = make_task("walk", robot=str(tmp_path / "r.yaml"), symmetric=False, action_scale=45)
    contract = contract_of(trained_of(make_learner("deep_q", task, width=8, layers=1), rng.key(0)))
    limits = dict(zip(contract["joints"], contract["setpoint_limits"], strict=True))
    assert limits.pop("hip_0_0") == [-0.3, 0.5] and all(pair == [None, None] for pair in limits.values())
    np.testing.assert_allclose(contract["action_scale"], np.radians(45), rtol=1e-6)  # of the offset, without the limit
    json.dumps(contract, allow_nan=False)


def test_a_law_that_is_no_servo_has_no_gains_in_the_contract():
    learner = make_learner("deep_q", make_task("stand", control="computed_torque"), width=8, layers=1)
    contract = contract_of(trained_of(learner, rng.key(0)))
    assert contract["control"] == "computed_torque" and "stiffness" not in contract and contract["joints"]


def test_what_cannot_be_written_is_refused_in_a_sentence(tmp_path):
    with pytest.raises(InputError, match="posture_switch: only networks can be written as ONNX; this policy is of tab"):
        export("posture_switch", tmp_path / "policy.onnx")
    (tmp_path / "walk.json").write_text("{}")
    with pytest.raises(InputError, match=r"walk\.json: the contract of walk\.onnx goes here, but another file is"):
        export("walk", tmp_path / "walk.onnx")
    (tmp_path / "walk.json").unlink()
    learner = make_learner("deep_q", make_task("stand", observe="privileged"), width=8, layers=1)
    with pytest.raises(InputError, match="own: it observes the true motion of its torso"):
        write_onnx(trained_of(learner, rng.key(0)), tmp_path / "own.onnx")
    assert list(tmp_path.iterdir()) == []
