"""Learners: how to learn it. `make_learner("tabular_q", task, epsilon=0.2)` builds a checked one for a task."""

from typing import Any

from humanoid_mjx.learners.base import Learner
from humanoid_mjx.spec import find, make
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
      InputError: unknown name or parameter, a value out of range, or a task of a kind that it cannot learn.
    """
    return make("learner", LEARNERS, Learner, name, task=task, **params)


def learner_class(name: str) -> type[Learner]:
    """The class of the learner called `name`.

    Raises:
      InputError: unknown name.
    """
    return find("learner", LEARNERS, Learner, name)
