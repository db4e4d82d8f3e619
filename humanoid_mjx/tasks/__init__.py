"""Tasks. `make_task("joint_reach", joint=4)` builds and checks a task."""

from typing import TYPE_CHECKING, Any, Literal, overload

from humanoid_mjx.spec import make
from humanoid_mjx.tasks.base import Task

if TYPE_CHECKING:
    from humanoid_mjx.tasks.joint_reach import JointReach
    from humanoid_mjx.tasks.leg_reach import LegReach
    from humanoid_mjx.tasks.legged.stand import Stand
    from humanoid_mjx.tasks.legged.walk import Walk
    from humanoid_mjx.tasks.navigate import Navigate
    from humanoid_mjx.tasks.posture_switch import PostureSwitch
    from humanoid_mjx.tasks.squat import Squat

TASKS = {
    "joint_reach": "humanoid_mjx.tasks.joint_reach:JointReach",
    "leg_reach": "humanoid_mjx.tasks.leg_reach:LegReach",
    "navigate": "humanoid_mjx.tasks.navigate:Navigate",
    "posture_switch": "humanoid_mjx.tasks.posture_switch:PostureSwitch",
    "squat": "humanoid_mjx.tasks.squat:Squat",
    "stand": "humanoid_mjx.tasks.legged.stand:Stand",
    "walk": "humanoid_mjx.tasks.legged.walk:Walk",
}


def name_of(task: Task) -> str:
    """Return the name of a task, of a user's own the name of its class."""
    cls = type(task)
    return next((name for name, place in TASKS.items() if place == f"{cls.__module__}:{cls.__name__}"), cls.__name__)


@overload
def make_task(name: Literal["joint_reach"], /, **params: Any) -> "JointReach": ...
@overload
def make_task(name: Literal["leg_reach"], /, **params: Any) -> "LegReach": ...
@overload
def make_task(name: Literal["navigate"], /, **params: Any) -> "Navigate": ...
@overload
def make_task(name: Literal["posture_switch"], /, **params: Any) -> "PostureSwitch": ...
@overload
def make_task(name: Literal["squat"], /, **params: Any) -> "Squat": ...
@overload
def make_task(name: Literal["stand"], /, **params: Any) -> "Stand": ...
@overload
def make_task(name: Literal["walk"], /, **params: Any) -> "Walk": ...
@overload
def make_task(name: str, /, **params: Any) -> Task: ...
def make_task(name: str, /, **params: Any) -> Task:
    """Build the task called `name`, or a user's own given as "package.module:Class".

    Raises:
      InputError: unknown name or parameter, or a value out of range, in one sentence.
    """
    return make("task", TASKS, Task, name, **params)
