"""The base of all tasks."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from humanoid_mjx.compute import Arithmetic
from humanoid_mjx.physics.base import Controller, Physics
from humanoid_mjx.spec import Spec
from humanoid_mjx.types import FloatScalar


class Task(Spec):
    """Base of tasks: derive from `FiniteTask` or `ContinuousTask`.

    A task is a pytree: the values of its `traced` fields are data of compiled programs, and `self.stride` inside a
    method is an array there. Array shapes and Python's `if` may depend on static fields only.

    A task can be played, as `humanoid-mjx play` does, if it has a `simulator`, which is the `Physics` of a robot, and a
    `period`, s between decisions, and if the data of its states hold a `World` anywhere. It may show more by `drive`,
    `push_on` and `told`.
    """

    @property
    def arithmetic(self) -> Arithmetic:
        """Kind of the task's arithmetic, which chooses XLA's options: that of its `simulator`, if it has one."""
        return getattr(self, "simulator", Physics).arithmetic

    def drive(self, data: Any, action: Array) -> tuple[Physics, Controller]:
        """Return what moves the robot through a decision: the physics, and the controller that acts at every time step.

        A task whose decisions are longer than a frame of a video implements it to be shown between them.

        Args:
          data: the task's own, before the decision.
          action: choices of the joints as integers, or commands in [-1, 1].
        """
        raise NotImplementedError

    def push_on(self, data: Any, key: Key[Array, ""]) -> Float[Array, "3"]:
        """The force on the torso during the decision to come, N, in the world; `key` is the one that `step` gets."""
        return jnp.zeros(3)

    def told(self, data: Any) -> dict[str, FloatScalar]:
        """The present command to the robot, by a name with its unit, such as `forward, m/s`."""
        return {}

    @property
    def told_ranges(self) -> dict[str, tuple[float, float]]:
        """Lowest and highest of each part of the command that a person may give, by the names of `told`."""
        return {}

    def steered(self, data: Any, told: dict[str, FloatScalar]) -> Any:
        """Replace the command in the data of a state by `told`; for tasks with `told_ranges`."""
        raise NotImplementedError

    def for_driving(self) -> Any:
        """Return the task for a person who steers: without own commands, pushes and time limit."""
        return self
