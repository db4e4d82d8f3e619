"""The reference of keys: what it lists is what a config may hold, with the defaults that a config gets."""

import pytest
from command_line import told

from humanoid_mjx import InputError, make_task
from humanoid_mjx.control.drives import DRIVES, Drive
from humanoid_mjx.control.laws import LAWS, Law
from humanoid_mjx.keys import keys_of
from humanoid_mjx.learners import LEARNERS, Learner
from humanoid_mjx.spec import find
from humanoid_mjx.tasks import TASKS
from humanoid_mjx.tasks.base import Task
from humanoid_mjx.tasks.legged.gait import GAITS, Gait


@pytest.mark.parametrize(
    ("kind", "registry", "base"),
    [
        ("task", TASKS, Task),
        ("learner", LEARNERS, Learner),
        ("control", LAWS, Law),
        ("gait", GAITS, Gait),
        ("actuator", DRIVES, Drive),
    ],
)
def test_every_key_has_a_kind_and_a_meaning_and_is_listed_once(kind, registry, base):
    for name in registry:
        keys = list(keys_of(find(kind, registry, base, name), kind))
        assert len({key.name for key in keys}) == len(keys) and (keys or kind not in ("task", "learner"))
        top = {key.name for key in keys if not key.name.startswith(f"{kind}.")}
        units = [{"record", unit} for unit in ("episodes", "total_steps")]
        assert all(key.allowed and key.meaning for key in keys) and (top in units if kind == "learner" else not top), (
            name
        )


def test_a_program_reads_one_key_a_line():
    lines = told("info", "walk", "--keys").splitlines()
    (noise,) = [line for line in lines if line.startswith("task.sensors.encoder_noise ")]
    (heading,) = [line for line in lines if line.startswith("key ")]
    at = heading.index("in a sweep")
    assert noise[at:].split()[0] == "traced" and noise[at:].split()[1:]
    assert [line for line in lines if line.startswith(" ")] == []
    assert any(line.startswith("task.terrain.slope ") for line in lines), "a part that is off by default"


def test_all_keys_are_shown_without_a_name_and_unknown_names_lead_to_tasks_and_learners():
    lines = told("info", "--keys").splitlines()
    for kind, registry in (("task", TASKS), ("learner", LEARNERS)):
        assert [name for name in registry if f"{kind} {name}" not in [line.strip() for line in lines]] == []
    assert "learner.width " in "".join(told("info", "humanoid_mjx.learners.deep:DeepQ", "--keys"))
    with pytest.raises(InputError, match=r"did you mean 'deep_q'\? known are .* and 55 more: humanoid-mjx info"):
        told("info", "deep_qq", "--keys")


def test_defaults_are_those_of_the_task_not_of_its_parts():
    keys, walk = {key.name: key for key in keys_of(find("task", TASKS, Task, "walk"), "task")}, make_task("walk")
    assert keys["task.sensors.encoder_noise"].default == str(walk.sensors.encoder_noise) != "0.0"
    assert keys["task.control.stiffness"].default == str(walk.control.stiffness)
    assert keys["task.rewards.slip"].traced and not keys["task.bins"].traced
    assert keys["task.action_scale"].allowed == "number, above 0, at most 90"
