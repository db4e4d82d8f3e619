"""What all tasks have in common."""

from collections.abc import Mapping

from humanoid_mjx.spec import Spec


class Task(Spec):
    """Base of tasks: derive from `FiniteTask` or `ContinuousTask`."""

    @property
    def compiler_options(self) -> Mapping[str, str | bool]:
        """For XLA, of the programs that train on the task."""
        return {}
