"""What all tasks have in common."""

from humanoid_mjx.spec import Spec


class Task(Spec):
    """Base of tasks: derive from `FiniteTask` or `ContinuousTask`."""
