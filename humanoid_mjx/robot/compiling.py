# pyright: reportAttributeAccessIssue=false
"""MuJoCo's compiler: its errors and warnings as sentences, and an empty default class for all that the package adds."""

import warnings
from collections.abc import Callable
from typing import Any

import mujoco

from humanoid_mjx.spec import InputError

BLANK = mujoco.MjSpec()
PLAIN = BLANK.default
"""An empty default class. Elements that the package adds to a user's spec would else inherit the spec's main class."""


def checked(function: Callable[[], Any], what: str = "model: MuJoCo cannot compile it") -> tuple[Any, tuple[str, ...]]:
    """Call a function of MuJoCo's compiler; return its result and MuJoCo's warnings.

    Raises:
      InputError: MuJoCo's error in one line, after `what` is wrong.
    """
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        try:
            return function(), tuple(dict.fromkeys(_line(warning.message) for warning in found))
        except ValueError as error:
            raise InputError(f"{what}: {_line(error).rstrip('.')}.") from error


def _line(message: object) -> str:
    """A message of MuJoCo in one line; plugins repeat lines."""
    return " ".join(" ".join(line.split()) for line in dict.fromkeys(str(message).splitlines()))


def name_bodies(spec: mujoco.MjSpec) -> None:
    """Name each body that has no name, as sensors find bodies by name."""
    taken = {body.name for body in spec.bodies}
    for index, body in enumerate(spec.bodies):
        if not body.name:
            body.name = next(name for end in range(len(taken) + 1) if (name := f"body{index}" + "_" * end) not in taken)
            taken.add(body.name)
