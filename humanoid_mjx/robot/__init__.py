# pyright: reportAttributeAccessIssue=false
"""The robots: the leg as a serial chain, the lower body as a MuJoCo model. `robot_spec` gives either as MJCF."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from humanoid_mjx.spec import InputError, known

if TYPE_CHECKING:
    import mujoco

ROBOTS = {
    "leg": "humanoid_mjx.robot.legs:leg_spec",
    "legs": "humanoid_mjx.robot.legs:legs_spec",
    "lower_body": "humanoid_mjx.robot.lower_body:lower_body_spec",
}
"""Functions that return the robot as a MuJoCo spec."""


def robot_spec(name: str, **options: Any) -> "mujoco.MjSpec":
    """The robot called `name` as a MuJoCo model that can still be changed; `options` are those of its function.

    Raises:
      InputError: an unknown robot, or an option that it does not take.
    """
    if name not in ROBOTS:
        raise InputError(f"unknown robot {name!r}; {known(name, ROBOTS)}.")
    module, _, function = ROBOTS[name].partition(":")
    return getattr(import_module(module), function)(**options)
