"""What all tasks have in common."""

from collections.abc import Mapping

from humanoid_mjx.spec import Spec


class Task(Spec):
    """Base of tasks: derive from `FiniteTask` or `ContinuousTask`.

    A task is a pytree: the values of its `traced` fields are data of compiled programs, and `self.stride` inside a
    method is an array there. Array shapes and Python's `if` may depend on static fields only.
    """

    @property
    def compiler_options(self) -> Mapping[str, str | bool]:
        """XLA's options for the programs that train tables on the task: `runtime.SHARED_KERNELS` where they pass."""
        return {}
