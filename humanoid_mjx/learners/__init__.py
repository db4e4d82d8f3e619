"""Learners. `make_learner("tabular_q", task, epsilon=0.2)` builds and checks a learner for a task."""

from typing import Any, get_args

from humanoid_mjx.compute import check_settings
from humanoid_mjx.learners.base import Learner
from humanoid_mjx.spec import InputError, find, make
from humanoid_mjx.tasks import name_of
from humanoid_mjx.tasks.base import Task

LEARNERS = {
    "brax_ppo": "humanoid_mjx.learners.brax_ppo:BraxPPO",
    "deep_q": "humanoid_mjx.learners.deep:DeepQ",
    "linear_q": "humanoid_mjx.learners.linear:LinearQ",
    "tabular_q": "humanoid_mjx.learners.tabular:TabularQ",
}


def make_learner(name: str, /, task: Task, **params: Any) -> Any:
    """Build the learner called `name` for `task`, or a user's own given as "package.module:Class".

    Raises:
      InputError: unknown name or parameter, a value out of range, a task of a kind that it cannot learn, or a setting
        of jax with which no learner trains.
    """
    check_settings()
    class_for(name, task)
    return make("learner", LEARNERS, Learner, name, task=task, **params)


def class_for(name: str, task: Task) -> type[Learner]:
    """The class of the learner called `name`, which learns `task`.

    Raises:
      InputError: unknown name, or a task of a kind that it cannot learn.
    """
    cls = find("learner", LEARNERS, Learner, name)
    if isinstance(task, Task) and not isinstance(task, wanted := _kinds(cls)):
        fit = ", ".join(n for n in LEARNERS if isinstance(task, _kinds(find("learner", LEARNERS, Learner, n))))
        kinds = " or ".join(kind.__name__.removesuffix("Task").lower() for kind in wanted)
        no = f"{name} learns {kinds} tasks, which {name_of(task)} is not"
        raise InputError(f"learner.name: {no}; learners for it are {fit}.")
    return cls


def _kinds(cls: type[Learner]) -> tuple[type[Task], ...]:
    """The kinds of task that a learner learns."""
    declared = cls.model_fields["task"].annotation
    return tuple(kind for kind in get_args(declared) or (declared,) if isinstance(kind, type)) or (Task,)
