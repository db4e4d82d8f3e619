"""A jitted program on shares of the work."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax


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
