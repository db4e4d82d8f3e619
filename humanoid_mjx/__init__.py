"""Batched simulation and Q-learning for the lower body of a humanoid, in JAX.

Public names load on first use, so that importing the package costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # redundant names: what a type checker takes as exported
    from humanoid_mjx import control as control
    from humanoid_mjx.api import Policy as Policy
    from humanoid_mjx.api import Trained as Trained
    from humanoid_mjx.api import draw as draw
    from humanoid_mjx.api import evaluate as evaluate
    from humanoid_mjx.api import load_policy as load_policy
    from humanoid_mjx.api import load_run as load_run
    from humanoid_mjx.api import play as play
    from humanoid_mjx.api import plot as plot
    from humanoid_mjx.api import rollout as rollout
    from humanoid_mjx.api import train as train
    from humanoid_mjx.compute import start as start
    from humanoid_mjx.compute.rng import key as key
    from humanoid_mjx.control.laws import Law as Law
    from humanoid_mjx.learners import make_learner as make_learner
    from humanoid_mjx.learners.base import Learner as Learner
    from humanoid_mjx.learners.base import Outcome as Outcome
    from humanoid_mjx.learners.base import StepLearner as StepLearner
    from humanoid_mjx.learners.rollout import Episode as Episode
    from humanoid_mjx.mechanics import dynamics as dynamics
    from humanoid_mjx.mechanics import kinematics as kinematics
    from humanoid_mjx.physics import Physics as Physics
    from humanoid_mjx.physics import make_physics as make_physics
    from humanoid_mjx.robot import Robot as Robot
    from humanoid_mjx.robot import make_robot as make_robot
    from humanoid_mjx.robot.leg import Leg as Leg
    from humanoid_mjx.spec import InputError as InputError
    from humanoid_mjx.spec import traced as traced
    from humanoid_mjx.tasks import make_task as make_task
    from humanoid_mjx.tasks.base import Task as Task
    from humanoid_mjx.tasks.continuous import ContinuousTask as ContinuousTask
    from humanoid_mjx.tasks.continuous import State as State
    from humanoid_mjx.tasks.finite import FiniteTask as FiniteTask
    from humanoid_mjx.tasks.legged.rewards import Rewards as Rewards
    from humanoid_mjx.training.sweep import Run as Run
    from humanoid_mjx.training.sweep import sweep as sweep

__version__ = "0.3.0"

_NAMES = {
    "api": "Policy Trained draw evaluate load_policy load_run play plot rollout train",
    "compute": "start",
    "compute.rng": "key",
    "control.laws": "Law",
    "learners": "make_learner",
    "learners.base": "Learner Outcome StepLearner",
    "learners.rollout": "Episode",
    "physics": "Physics make_physics",
    "robot": "Robot make_robot",
    "robot.leg": "Leg",
    "spec": "InputError traced",
    "tasks": "make_task",
    "tasks.base": "Task",
    "tasks.continuous": "ContinuousTask State",
    "tasks.finite": "FiniteTask",
    "tasks.legged.rewards": "Rewards",
    "training.sweep": "Run sweep",
}
_HOMES = {name: (module, name) for module, names in _NAMES.items() for name in names.split()}
_HOMES |= {name: (f"mechanics.{name}", "") for name in ("dynamics", "kinematics")} | {"control": ("control", "")}

__all__ = ["__version__", *_HOMES]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'humanoid_mjx' has no attribute {name!r}")
    home, attribute = _HOMES[name]
    module = import_module(f"humanoid_mjx.{home}")
    return getattr(module, attribute) if attribute else module


def __dir__() -> list[str]:
    return sorted(__all__)
