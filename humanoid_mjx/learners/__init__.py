"""Learners. `make_learner("tabular_q", task, epsilon=0.2)` builds and checks a learner for a task."""

from typing import TYPE_CHECKING, Any, Literal, get_args, overload

from humanoid_mjx.compute.settings import check_settings
from humanoid_mjx.learners.base import Learner
from humanoid_mjx.spec import InputError, find, make, shown
from humanoid_mjx.tasks import name_of
from humanoid_mjx.tasks.base import Task

if TYPE_CHECKING:
    from humanoid_mjx.learners.brax_ppo import BraxPPO
    from humanoid_mjx.learners.deep import DeepQ
    from humanoid_mjx.learners.linear import LinearQ
    from humanoid_mjx.learners.tabular import TabularQ

LEARNERS = {
    "brax_ppo": "humanoid_mjx.learners.brax_ppo:BraxPPO",
    "deep_q": "humanoid_mjx.learners.deep:DeepQ",
    "linear_q": "humanoid_mjx.learners.linear:LinearQ",
    "tabular_q": "humanoid_mjx.learners.tabular:TabularQ",
}


@overload
def make_learner(name: Literal["brax_ppo"], /, task: Task, **params: Any) -> "BraxPPO": ...
@overload
def make_learner(name: Literal["deep_q"], /, task: Task, **params: Any) -> "DeepQ": ...
@overload
def make_learner(name: Literal["linear_q"], /, task: Task, **params: Any) -> "LinearQ": ...
@overload
def make_learner(name: Literal["tabular_q"], /, task: Task, **params: Any) -> "TabularQ": ...
@overload
def make_learner(name: str, /, task: Task, **params: Any) -> Learner: ...
def make_learner(name: str, /, task: Task, **params: Any) -> Learner:
    """Build the learner called `name` for `task`, or a user's own given as "package.module:Class".

    Its learning curve has `record` entries, by default 100 or one for each update of a shorter training.

    Raises:
      InputError: unknown name or parameter, a value out of range, a task of a kind that it cannot learn, or a setting
        of jax with which no learner trains.
    """
    check_settings()
    cls = find("learner", LEARNERS, Learner, name)
    if not isinstance(task, Task):
        instead = f"make_task({task!r})" if isinstance(task, str) else f"{getattr(task, '__name__', 'make_task')}(...)"
        raise InputError(f"make_learner: task must be a Task, got {shown(task)}; pass {instead}.")
    if not isinstance(task, wanted := _kinds(cls)):
        fit = ", ".join(n for n in LEARNERS if isinstance(task, _kinds(find("learner", LEARNERS, Learner, n))))
        kinds = " or ".join(kind.__name__.removesuffix("Task").lower() for kind in wanted)
        no = f"{name} learns {kinds} tasks, which {name_of(task)} is not"
        advice = f"learners for it are {fit}" if fit else "derive it from FiniteTask or ContinuousTask"
        raise InputError(f"learner.name: {no}; {advice}.")
    if odd := [unit for unit in ("episodes", "total_steps") if unit in params and unit not in cls.model_fields]:
        counts = "episodes" if cls.unit == "episodes" else "control steps of all environments"
        typed = f"in commands --set {odd[0]}=null --set {cls.unit}=N"
        raise InputError(f"{odd[0]}: {name} counts {counts}; write {cls.unit} in its place ({typed}).")
    learner = make("learner", LEARNERS, Learner, name, task=task, **params)
    if "record" not in params:
        return learner.replace(record=min(learner.record, -(-learner.budget // learner.update_steps)))
    if learner.record > learner.budget:
        raise InputError(f"record ({learner.record}) must be at most {learner.unit} ({learner.budget}).")
    return learner


def _kinds(cls: type[Learner]) -> tuple[type[Task], ...]:
    """The kinds of task that a learner learns."""
    declared = cls.model_fields["task"].annotation
    return tuple(kind for kind in get_args(declared) or (declared,) if isinstance(kind, type)) or (Task,)
