"""MJX on a CPU in a process of its own: it needs more of XLA's threads than all else is fastest with.

That process is this program's child, begun when it is first asked, and waits while others are timed.
"""

import itertools
import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from typing import Any

import jax

from humanoid_mjx import compute

_numbers = itertools.count()
_calls: dict[int, Callable[[], Any]] = {}
"""The calls that the other process keeps, by number."""


class Elsewhere:
    """A call made and kept in the other process: its result is what the call returns there, as numpy's arrays."""

    def __init__(self, make: Callable[..., Callable[[], Any]], *arguments: Any, plain: bool = False) -> None:
        """`make(*arguments)` makes the call. `plain`: with XLA's default flags, without `XLA_FLAGS`."""
        self.process, self.number = _process(plain), next(_numbers)
        self.made = self.process.submit(_make, self.number, make, *arguments)

    def __call__(self) -> Any:
        self.made.result()
        return self.process.submit(_call, self.number).result()


def with_room(make: Callable[..., Callable[[], Any]], *arguments: Any) -> Callable[[], Any]:
    """The call `make(*arguments)` where MJX has room for its threads: elsewhere on a CPU, here on a GPU."""
    return Elsewhere(make, *arguments) if jax.default_backend() == "cpu" else make(*arguments)


@cache
def _process(plain: bool) -> ProcessPoolExecutor:
    pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), initializer=_start, initargs=(plain,))
    pool.submit(jax.device_count).result()
    return pool


def _start(plain: bool) -> None:
    compute.start(mjx=True)
    if plain:
        os.environ["XLA_FLAGS"] = os.environ["XLA_FLAGS"].replace(compute.XLA_FLAGS, "")


def _make(number: int, make: Callable[..., Callable[[], Any]], *arguments: Any) -> None:
    _calls[number] = make(*arguments)


def _call(number: int) -> Any:
    return jax.device_get(_calls[number]())
