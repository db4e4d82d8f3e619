"""The reference of keys: what it lists is what a config may hold, with the defaults that a config gets."""

import pytest

from humanoid_mjx import make_task
from humanoid_mjx.keys import keys_of
from humanoid_mjx.learners import LEARNERS, Learner
from humanoid_mjx.spec import find
from humanoid_mjx.tasks import TASKS
from humanoid_mjx.tasks.base import Task


@pytest.mark.parametrize("name", [*TASKS, *LEARNERS])
def test_every_key_has_a_kind_and_is_listed_once(name):
    kind, registry, base = ("learner", LEARNERS, Learner) if name in LEARNERS else ("task", TASKS, Task)
    keys = list(keys_of(find(kind, registry, base, name), kind))
    assert len({key.name for key in keys}) == len(keys) > 3
    assert all(key.allowed and key.name.startswith(f"{kind}.") for key in keys)


def test_defaults_are_those_of_the_task_not_of_its_parts():
    keys, walk = {key.name: key for key in keys_of(find("task", TASKS, Task, "walk"), "task")}, make_task("walk")
    assert keys["task.sensors.encoder_noise"].default == str(walk.sensors.encoder_noise) != "0.0"
    assert keys["task.control.stiffness"].default == str(walk.control.stiffness)
    assert keys["task.rewards.slip"].traced and not keys["task.bins"].traced
    assert keys["task.action_scale"].allowed == "number, above 0, at most 90"
