"""A jitted program on shares of the work, and the memory that it takes."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any

import jax


def memory_of(compiled: jax.stages.Compiled) -> float | None:
    """Return the bytes of arguments, results and temporary arrays together; None where the backend does not say.

    A result in the place of an argument takes no bytes of its own.
    """
    found = compiled.memory_analysis()
    if found is None:
        return None
    held, shared = ("argument", "output", "temp"), found.alias_size_in_bytes
    return float(sum(getattr(found, f"{part}_size_in_bytes") for part in held) - shared)


class Programs:
    """A call of one jitted program on shares of the work: a thread for each device, one share after another.

    Its result is a list for each device, of what the program returns for each share.
    """

    def __init__(self, program: Callable[..., Any], by_device: Sequence[Sequence[Sequence[Any]]]) -> None:
        """`by_device`: the arguments for each share."""
        self.program, self.by_device = program, by_device
        self.threads = ThreadPoolExecutor(len(by_device))

    def __call__(self) -> list[list[Any]]:
        return list(self.threads.map(self._work, self.by_device))

    def _work(self, shares: Sequence[Sequence[Any]]) -> list[Any]:
        return [jax.block_until_ready(self.program(*share)) for share in shares]

    @cached_property
    def memory(self) -> float | None:
        """Bytes of the shares that run at once, by `memory_of`.

        After a call this compiles nothing: jax finds what it has.
        """
        program: Any = self.program
        held = memory_of(program.lower(*self.by_device[0][0]).compile())
        return held and len(self.by_device) * held
