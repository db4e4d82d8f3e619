"""Batched simulation and Q-learning for the lower body of a humanoid, in JAX.

Public names load on first use, so that importing the package costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from humanoid_mjx import control
    from humanoid_mjx.commands.notebook import evaluate, load_run, play, plot
    from humanoid_mjx.compute import start
    from humanoid_mjx.learners import make_learner
    from humanoid_mjx.mechanics import dynamics, kinematics
    from humanoid_mjx.robot.leg import Leg
    from humanoid_mjx.spec import InputError
    from humanoid_mjx.tasks import make_task
    from humanoid_mjx.training.sweep import sweep

__version__ = "0.2.0"

__all__ = [
    "InputError",
    "Leg",
    "__version__",
    "control",
    "dynamics",
    "evaluate",
    "kinematics",
    "load_run",
    "make_learner",
    "make_task",
    "play",
    "plot",
    "start",
    "sweep",
]

_HOMES = {
    "InputError": "humanoid_mjx.spec:InputError",
    "Leg": "humanoid_mjx.robot.leg:Leg",
    "control": "humanoid_mjx.control:",
    "dynamics": "humanoid_mjx.mechanics.dynamics:",
    "evaluate": "humanoid_mjx.commands.notebook:evaluate",
    "kinematics": "humanoid_mjx.mechanics.kinematics:",
    "load_run": "humanoid_mjx.commands.notebook:load_run",
    "make_learner": "humanoid_mjx.learners:make_learner",
    "make_task": "humanoid_mjx.tasks:make_task",
    "play": "humanoid_mjx.commands.notebook:play",
    "plot": "humanoid_mjx.commands.notebook:plot",
    "start": "humanoid_mjx.compute:start",
    "sweep": "humanoid_mjx.training.sweep:sweep",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'humanoid_mjx' has no attribute {name!r}")
    module, _, attribute = _HOMES[name].partition(":")
    value = import_module(module)
    return getattr(value, attribute) if attribute else value


def __dir__() -> list[str]:
    return sorted(__all__)
