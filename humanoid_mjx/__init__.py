"""Batched simulation and Q-learning for the lower body of a humanoid, in JAX.

Public names load on first use, so that importing the package costs nothing.
"""

# pyright: reportUnsupportedDunderAll=false

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_PUBLIC = {
    "InputError": "humanoid_mjx.spec:InputError",
    "Leg": "humanoid_mjx.robot.leg:Leg",
    "control": "humanoid_mjx.control:",
    "dynamics": "humanoid_mjx.mechanics.dynamics:",
    "kinematics": "humanoid_mjx.mechanics.kinematics:",
    "make_learner": "humanoid_mjx.learners:make_learner",
    "make_task": "humanoid_mjx.tasks:make_task",
    "sweep": "humanoid_mjx.training.sweep:sweep",
}

__all__ = [
    "InputError",
    "Leg",
    "__version__",
    "control",
    "dynamics",
    "kinematics",
    "make_learner",
    "make_task",
    "sweep",
]


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'humanoid_mjx' has no attribute {name!r}")
    module, _, attribute = _PUBLIC[name].partition(":")
    value = import_module(module)
    return getattr(value, attribute) if attribute else value


def __dir__() -> list[str]:
    return sorted(__all__)
