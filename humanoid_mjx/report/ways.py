"""Ways to OpenGL by the values of MUJOCO_GL, and which of them to try.

MuJoCo takes the way that MUJOCO_GL names when it is imported, and that import fails where there is no such way. So the
command line takes the variable out of its own environment, and only the process that paints (`opengl.py`) is told one.
"""

import os
import sys

OFF = ("disable", "disabled", "off", "false", "0")
"""Values by which the environment forbids OpenGL."""

DISPLAY = ("enable", "enabled", "on", "true", "1", "glfw", "glx")
"""Values that all mean a window that is not shown, which needs a display."""

_told: list[str] = []


def take_over() -> None:
    """Remember what MUJOCO_GL says, and take it out of the environment. Must come before MuJoCo is imported."""
    if "MUJOCO_GL" in os.environ:
        _told[:] = [os.environ.pop("MUJOCO_GL")]


def ways() -> list[str]:
    """The values of MUJOCO_GL to try in turn, that of the environment first; none where it forbids OpenGL."""
    told = (os.environ.get("MUJOCO_GL") or "".join(_told)).lower().strip()
    if told in OFF:
        return []
    if sys.platform != "linux":
        return [""]
    shown = ["glfw"] if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY") else []
    first = ["glfw" if told in DISPLAY else told] if told else []
    return list(dict.fromkeys([*first, "egl", *shown, "osmesa"]))
