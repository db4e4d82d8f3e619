"""Configs: what is accepted, and that everything else gets one sentence that says what would be right."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml

from humanoid_mjx import InputError, make_task
from humanoid_mjx.compute import rng
from humanoid_mjx.config import check_overrides, config_digest, dump_yaml, load, parse, parse_yaml
from humanoid_mjx.files import names
from humanoid_mjx.training.plan import at_point, make_plan, resolved

BASE = """
name: small
task: {name: joint_reach, joint: 5, states: 13}
learner: {name: tabular_q, epsilon: 0.5}
sweep:
  axes:
    learner.epsilon: [0.1, 0.2]
episodes: 20
record: 10
"""


@pytest.fixture
def write(tmp_path):
    def write(text):
        path = tmp_path / "config.yaml"
        path.write_text(text)
        return str(path)

    return write


@pytest.mark.parametrize("name", names("configs", ".yaml"))
def test_every_shipped_config_makes_a_plan(name):
    plan = make_plan(load(name))
    assert plan.config.name == name
    written = yaml.safe_load(dump_yaml(resolved(plan.config)))
    assert config_digest(written) == config_digest(resolved(plan.config))
    again = make_plan(parse(written))
    assert again.points == plan.points
    assert again.learners == plan.learners


READY = {
    "posture_switch": ["task.physics=chain", "sweep=null"],
    "squat": ["task.physics=mujoco"],
    "stand": ["task.physics=mujoco"],
    "walk": ["task.physics=mujoco"],
    "walk_sturdy": ["task.terrain={stairs: 0.01, least: 0.0}"],
}
"""Legs and bodies on the ground in the physics that is traced and compiled first."""

OF_ITS_OWN = {"walk_sturdy", "walk_dog", "walk_humanoid"}
"""Configs whose world or robot is traced otherwise than that of the others of their task and learner."""


def one_of_each():
    """The name of a config for each task and learner, and of those that are like no other."""
    pairs = {}
    for name in names("configs", ".yaml"):
        config = load(name)
        pairs.setdefault((config.task["name"], config.learner["name"]) + (name,) * (name in OF_ITS_OWN), name)
    return pairs.values()


@pytest.mark.parametrize("name", one_of_each())
def test_an_update_of_every_task_and_learner_returns_what_it_takes(name):
    """Traced, not run, with the sizes of the config: the other tests of a learner or a task have one size."""
    ready = READY.get(load(name).task["name"], []) + READY.get(name, [])
    for group in make_plan(load(name, ready)).groups:
        key = jax.eval_shape(lambda: rng.key(0))
        before = jax.eval_shape(lambda learner, key: learner.init(key), group.learner(), key)
        after, _ = jax.eval_shape(lambda learner, carry: learner.train_step(carry), group.learner(), before)
        assert jax.tree.map(lambda x: (x.shape, x.dtype), after) == jax.tree.map(lambda x: (x.shape, x.dtype), before)


BAD = {
    "unknown key": ("episodes: 20", "episodez: 20", ["episodez", "unknown key", "episodes"]),
    "another library's name": ("epsilon: 0.5", "gamma: 0.5", ["learner.gamma", "did you mean 'discount'?"]),
    "epsilon at the top level": ("episodes: 20", "epsilon: 0.1\nepisodes: 20", ["write learner.epsilon"]),
    "axes at the top level": ("sweep:\n  axes:", "axes:", ["axes: this key", "write sweep.axes"]),
    "another library's name at the top": ("episodes: 20", "n_envs: 4\nepisodes: 20", ["n_envs", "write learner.envs"]),
    "environment steps": ("episodes: 20", "total_timesteps: 20", ["did you mean 'total_steps'?"]),
    "unknown task": ("name: joint_reach", "name: joint_rich", ["task.name", "joint_rich", "joint_reach"]),
    "wrong type": ("epsilon: 0.5", "epsilon: half", ["learner.epsilon", "number", "half"]),
    "an axis in the learner": ("epsilon: 0.5", "epsilon: [0.1]", ["got [0.1]; several", "sweep.axes.learner.epsilon."]),
    "a float for one of some integers": ("joint: 5", "joint: 4.0", ["task.joint must be one of 1, 4, 5, got 4.0."]),
    "true for one of some integers": ("joint: 5", "joint: true", ["task.joint must be one of 1, 4, 5, got True."]),
    "a float for an integer": ("episodes: 20", "episodes: 2e1", ["episodes must be an integer; write 20, got 20.0"]),
    "a name that YAML reads as true": ("name: small", "name: yes", ["name must be text, got True; put it into quotes"]),
    "NaN": ("epsilon: 0.5", "epsilon: .nan", ["learner.epsilon", "finite"]),
    "empty axis": ("[0.1, 0.2]", "[]", ["sweep.axes.learner.epsilon", "empty"]),
    "no axes": ("    learner.epsilon: [0.1, 0.2]", "    {}", ["sweep.axes must hold at least 1 entry, got {}"]),
    "an axis with a value twice": ("[0.1, 0.2]", "[0.1, 0.2, 0.1]", ["learner.epsilon: the axis holds 0.1 twice"]),
    "an axis with a number twice": ("[0.1, 0.2]", "[1, 0.2, 1.0]", ["learner.epsilon: the axis holds 1.0 twice"]),
    "an axis below another one": (
        "learner.epsilon: [0.1, 0.2]", "{task.robot.steps: [1, 2], task.robot: [go1, go2]}",
        ["sweep.axes.task.robot.steps: values of the axis task.robot replace it; leave one of them out."],
    ),
    "a list of seeds": ("episodes: 20", "episodes: 20\nseeds: [1, 2]", ["seeds must be a valid integer, got [1, 2]."]),
    "an axis of too many values": ("[0.1, 0.2]", "{linspace: [0, 1, 2000000000]}", ["from 1 to 100,000"]),
    "an axis of which a value is no integer": (
        "learner.epsilon: [0.1, 0.2]", "task.states: {linspace: [10, 13, 3]}",
        ["task.states must be a valid integer, got 11.5"],
    ),
    "a task that the learner cannot learn": (
        "{name: joint_reach, joint: 5, states: 13}", "{name: leg_reach}",
        ["learner.name: tabular_q learns finite tasks, which leg_reach is not; "
         "learners for it are brax_ppo, deep_q, linear_q"],
    ),
    "a task that is no mapping": (
        "{name: joint_reach, joint: 5, states: 13}", "joint_reach", ["task must be a mapping of keys, such as {name"],
    ),
    "axis that does not exist": ("learner.epsilon: [", "learner.epsilom: [", ["learner.epsilom", "unknown key"]),
    "axis value out of range": ("[0.1, 0.2]", "[0.1, 2.0]", ["learner.epsilon", "at most 1", "2.0"]),
    "axis of another shape": ("[0.1, 0.2]", "{linspace: [0, 1]}", ["linspace takes 3", "learner.epsilon"]),
    "goal that is not hit": ("states: 13", "action: 7", ["task", "goal 40", "steps of 7"]),
    "a step far beyond the goal": ("states: 13", "action: 1.0e+12", ["goal 40 cannot be hit in steps of 1e+12"]),
    "record above episodes": ("record: 10", "record: 30", ["record", "at most episodes"]),
    "tags": ("epsilon: 0.5", "epsilon: !!python/object:os.system 1", ["plain YAML", "line 4"]),
    "a number of base 8": ("episodes: 20", "episodes: 020", ["020 is 16 to YAML; write 16, the number that you mean"]),
    "a number of base 60": ("epsilon: 0.5", "epsilon: 0:00.5", ["0:00.5 is 0.5 to YAML; write 0.5,"]),
    "broken YAML": ("epsilon: 0.5}", "epsilon: 0.5", ["plain YAML", "line"]),
    "nested 3,000 deep": ("epsilon: 0.5", "epsilon: " + 3000 * "[" + 3000 * "]", ["nested too deep"]),
    "a key twice": ("episodes: 20", "episodes: 20\nepisodes: 30", ["episodes", "twice"]),
    "a bad name": ("name: small", "name: ../small", ["name must match the pattern", "letters, digits and . _ -"]),
    "no task": ("task: {name: joint_reach, joint: 5, states: 13}", "", ["task", "required"]),
    "random without points": ("sweep:", "sweep:\n  mode: random", ["sweep", "points"]),
    "a grid with rungs": ("sweep:", "sweep:\n  rungs: 3", ["rungs belongs to mode halving and has no meaning"]),
    "halving without a rest": ("sweep:", "sweep:\n  mode: halving\n  eta: 1", ["sweep.eta must be at least 2, got 1"]),
    "halving of too few points": ("sweep:", "sweep:\n  mode: halving", ["4 rungs with eta 3 need 27 points", "has 2"]),
    "halving of too few episodes": (
        "sweep:", "sweep:\n  mode: halving\n  points: 27", ["27 episodes, and the sweep has 27 and 20"]
    ),
    "zip of unequal axes": (
        "sweep:\n  axes:", "sweep:\n  mode: zip\n  axes:\n    task.bonus: [1.0]", ["equally long", "task.bonus: 1"]
    ),
    "a task class that is none": ("name: joint_reach", "name: 'os:path'", ["task.name", "derived from"]),
    "a task that is not there": ("name: joint_reach", "name: 'nowhere.tasks:Hop'", ["task.name", "imported"]),
}  # fmt: skip


@pytest.mark.parametrize("fault", BAD)
def test_bad_input_gets_one_sentence(write, fault):
    old, new, words = BAD[fault]
    assert old in BASE
    path = write(BASE.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        make_plan(load(path))
    message = str(caught.value)
    assert "\n" not in message and message.endswith((".", "?"))
    assert path in message
    for word in words:
        assert word in message, message


def test_values_of_python_and_numpy_are_those_of_a_file(write):
    data = yaml.safe_load(BASE)
    data |= {"name": np.str_("small"), "episodes": np.int64(20), "task": data["task"] | {"states": np.int32(13)}}
    linear = {"linspace": (0.1, 0.2, np.int8(2))}
    for axis in (np.array([0.1, 0.2]), [np.float64(0.1), jnp.array(0.2)], (0.1, 0.2), linear):
        found = make_plan(parse(data | {"sweep": {"axes": {"learner.epsilon": axis}}}))
        np.testing.assert_allclose([point["learner.epsilon"] for point in found.points], [0.1, 0.2], rtol=1e-7)
        assert found.resolved() | {"sweep": 0} == make_plan(load(write(BASE))).resolved() | {"sweep": 0}
    for axis in (range(1, 4), {"linspace": [1, 3, 3]}):
        agents = parse(data | {"sweep": {"axes": {"learner.agents": axis}}})
        assert [point["learner.agents"] for point in make_plan(agents).points] == [1, 2, 3]


def test_merge_keys_are_those_of_yaml(write):
    text = "a: {b: {c: &x {<<: &y {k: 1, j: 3}, k: 2}}}\ntop: {<<: *x, z: 1}\nmany: {<<: [*y, {k: 5, l: 6}], j: 4}"
    assert parse_yaml(text, "text") == yaml.safe_load(text)
    shared = BASE.replace("{name: tabular_q,", "{<<: {name: tabular_q, epsilon: 0.9},")
    assert load(write(shared)).learner == load(write(BASE)).learner


BAD_OVERRIDES = {"learner.epsilon": "key=value", "=1": "key=value", "learner.epsilon.x=1": "holds a value"}
BAD_OVERRIDES |= {"learner.epsilon=[": "plain YAML", "nothing=1": "nothing: unknown key"}


@pytest.mark.parametrize("override", BAD_OVERRIDES)
def test_bad_override_gets_one_sentence(write, override):
    with pytest.raises(InputError, match=BAD_OVERRIDES[override]):
        make_plan(load(write(BASE), [override]))


def test_overrides_and_numbers_without_a_point(write):
    config = load(write(BASE), ["learner.learning_rate=1e-2", "sweep.axes.learner.epsilon=[0.3]", "seeds=3"])
    plan = make_plan(config)
    assert plan.learners[0].learning_rate == 0.01
    assert plan.points == [{"learner.epsilon": 0.3}] and plan.num_runs == 3


@pytest.mark.parametrize(
    "overrides",
    [
        ["seeds=1", "seeds=2"],
        ["seeds=1", "seed=2", "seeds=3"],
        ["task.joint=1", "task={name: joint_reach}"],
        ["sweep.axes.learner.epsilon=[0.1, 0.2]", "learner.epsilon=0.3"],
    ],
)
def test_a_value_that_is_set_twice_is_refused(overrides, said):
    options = [word for override in overrides for word in ("--set", override)]
    for command in (["info", "joint1"], ["sweep", "joint1"], ["reproduce", "table-7.1"], ["evaluate", "walk"]):
        code, _, err = said(*command, *options)
        assert code == 2 and err.startswith(f"error: --set {overrides[-1]}: ") and err.count("\n") == 1, err
        assert err.endswith(" is set twice; leave one of them out.\n")


def test_values_within_one_that_is_set_and_names_that_begin_alike_are_not_set_twice():
    check_overrides(["learner={name: a}", "learner.epsilon=0.3", "learner.epsilon_min=0.1", "learner.epsilon=0.3"])
    with pytest.raises(InputError, match=r"task\.physics is set twice"):
        check_overrides(["task.physics=mujoco", "task.physics=chain"])


def test_a_name_that_file_systems_may_refuse_is_refused():
    assert load("joint1", [f"name={'a' * 200}"]).name == "a" * 200
    with pytest.raises(InputError, match="at most 200 letters"):
        load("joint1", [f"name={'a' * 201}"])


def test_a_swept_key_that_is_set_is_swept_no_more(write):
    swept = write(BASE.replace("[0.1, 0.2]\n", "[0.1, 0.2]\n    learner.discount: [0.5, 0.9]\n"))
    plan = make_plan(load(swept, ["learner.epsilon=0.3"]))
    assert plan.points == [{"learner.discount": 0.5}, {"learner.discount": 0.9}]
    assert plan.config.learner["epsilon"] == 0.3
    assert load(swept, ["learner.epsilon=0.3", "learner.discount=0.7"]).sweep is None
    again = load(swept, ["learner.epsilon=0.3", "sweep.axes.learner.epsilon=[0.4]"])
    assert again.sweep.axes["learner.epsilon"] == [0.4]


def test_an_axis_below_null_makes_a_mapping_and_changes_nothing_that_was_given():
    given = {"task": {"name": "walk", "randomise": None}}
    assert at_point(given, {"task.randomise.mass": 0.1})["task"]["randomise"] == {"mass": 0.1}
    assert given == {"task": {"name": "walk", "randomise": None}}
    with pytest.raises(InputError, match=r"^sweep\.axes\.task\.name\.x: name holds a value"):
        at_point(given, {"task.name.x": 1})


def test_missing_config_names_those_that_ship():
    with pytest.raises(InputError, match=r"joint1x.*did you mean 'joint1'"):
        load("joint1x")
    with pytest.raises(InputError, match="no such file"):
        load("nowhere/joint1.yaml")


def sweep_of(mode, **axes):
    text = yaml.safe_load(BASE) | {"sweep": {"mode": mode, "axes": axes}}
    if mode == "random":
        text["sweep"]["points"] = 200
    return make_plan(parse(text)).points


def test_grid_is_every_combination_last_axis_fastest_and_zip_goes_side_by_side():
    points = sweep_of("grid", **{"learner.epsilon": [0.1, 0.2], "learner.discount": {"linspace": [0.5, 0.9, 3]}})
    assert [tuple(p.values()) for p in points] == [(e, d) for e in (0.1, 0.2) for d in (0.5, 0.7, 0.9)]
    points = sweep_of("zip", **{"learner.epsilon": [0.1, 0.2], "learner.discount": [0.5, 0.6]})
    assert [tuple(p.values()) for p in points] == [(0.1, 0.5), (0.2, 0.6)]
    points = sweep_of("grid", **{"learner.learning_rate": {"logspace": [0.01, 1, 3]}})
    np.testing.assert_allclose([p["learner.learning_rate"] for p in points], [0.01, 0.1, 1.0])
    points = sweep_of("grid", **{"learner.agents": {"logspace": [1, 16, 5]}})
    assert [p["learner.agents"] for p in points] == [1, 2, 4, 8, 16]


def test_random_draws_stay_in_range_and_repeat():
    axes = {
        "learner.epsilon": {"uniform": [0.2, 0.4]},
        "learner.learning_rate": {"loguniform": [0.001, 1.0]},
        "task.states": {"integers": [5, 7]},
        "learner.discount": [0.5, 0.9],
    }
    points = sweep_of("random", **axes)
    columns = {name: np.array([p[name] for p in points]) for name in axes}
    assert columns["learner.epsilon"].min() >= 0.2 and columns["learner.epsilon"].max() <= 0.4
    assert 0.25 < (columns["learner.learning_rate"] < 0.0316).mean() < 0.75
    assert set(columns["task.states"]) == {5, 6, 7} and set(columns["learner.discount"]) == {0.5, 0.9}
    assert points == sweep_of("random", **axes)


def test_points_that_differ_in_numbers_share_a_program():
    text = yaml.safe_load(BASE)
    text["sweep"] = {"axes": {"task.states": [13, 5], "learner.epsilon": [0.1, 0.2], "task.bonus": [1.0, 2.0]}}
    groups = make_plan(parse(text)).groups
    assert [len(group.points) for group in groups] == [4, 4]
    assert groups[1].points.tolist() == [4, 5, 6, 7]
    np.testing.assert_allclose(groups[0].learners.epsilon, [0.1, 0.1, 0.2, 0.2])
    np.testing.assert_allclose(groups[0].learners.task.bonus, [1.0, 2.0, 1.0, 2.0])


def test_a_joint_that_is_swept_takes_its_own_start_and_goal():
    text = yaml.safe_load(BASE)
    text["sweep"] = {"axes": {"task.joint": [1, 4, 5]}}
    plan = make_plan(parse(text))
    written = yaml.safe_load(dump_yaml(resolved(plan.config)))
    assert config_digest(written) == config_digest(resolved(plan.config))
    again = make_plan(parse(written))
    for learners in (plan.learners, again.learners):
        assert [(x.task.start, x.task.goal) for x in learners] == [(-15, 100), (0, 120), (-20, 40)]


def test_a_map_without_a_way_is_refused():
    with pytest.raises(InputError, match=r"task: map has no way from S to G"):
        make_task("navigate", map=["S#G"])
