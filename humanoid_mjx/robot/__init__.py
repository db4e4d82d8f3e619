"""Robots: their descriptions, the leg as a serial chain, the legs and the lower body as MuJoCo models."""

from typing import TYPE_CHECKING, Annotated, Any, Literal, overload

import pydantic

from humanoid_mjx.files import meant, names
from humanoid_mjx.robot.declared import is_shipped, make_declared
from humanoid_mjx.robot.description import Robot
from humanoid_mjx.spec import InputError, make, search_folders, written

if TYPE_CHECKING:
    from humanoid_mjx.robot.legs import Legs, SingleLeg
    from humanoid_mjx.robot.lower_body import LowerBody

__all__ = ["ROBOTS", "Robot", "RobotKey", "make_robot"]

ROBOTS = {
    "leg": "humanoid_mjx.robot.legs:SingleLeg",
    "legs": "humanoid_mjx.robot.legs:Legs",
    "lower_body": "humanoid_mjx.robot.lower_body:LowerBody",
}
"""Robots made in Python, by name. The folder `robots/` holds the robots of a YAML and an MJCF."""


@overload
def make_robot(name: Literal["leg"], /, **values: Any) -> "SingleLeg": ...
@overload
def make_robot(name: Literal["legs"], /, **values: Any) -> "Legs": ...
@overload
def make_robot(name: Literal["lower_body"], /, **values: Any) -> "LowerBody": ...
@overload
def make_robot(name: str, /, **values: Any) -> Robot: ...
def make_robot(name: str, /, **values: Any) -> Robot:
    """Build a robot: a name, the path of a YAML, or a user's own class as "package.module:Class".

    Raises:
      InputError: unknown name or key, or a value that does not fit the robot's model.
    """
    if isinstance(name, str) and (is_shipped(name) or name.endswith((".yaml", ".yml"))):
        return make_declared(name, **values)
    registry = ROBOTS | dict.fromkeys(names("robots", ".yaml"), "")
    if isinstance(name, str) and name not in registry and (other := meant(name, "robot", folders=search_folders())):
        raise InputError(f"robot.name: unknown robot {name!r}{other}.")
    return make("robot", registry, Robot, name, **values)


RobotKey = Annotated[pydantic.SerializeAsAny[Robot], written("robot", make_robot)]
"""The type of a field `robot`: `robot: {name: lower_body, ranges: human}`, a name, or a path of a YAML."""
