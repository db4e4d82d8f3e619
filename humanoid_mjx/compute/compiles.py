"""The time that tracing and compiling take."""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import jax.monitoring


@contextmanager
def timing_compiles() -> Iterator[Callable[[], float]]:
    """Time what jax traces and compiles in the block; yield a function that returns the seconds so far.

    They are those in which at least one thread traced or compiled. Reading a program from the cache on disk counts too.
    """
    times: list[tuple[float, float]] = []

    def listen(event: str, duration_secs: float, **kwargs: str | int) -> None:
        if event.startswith("/jax/core/compile/"):
            now = time.monotonic()
            times.append((now - duration_secs, now))

    def seconds() -> float:
        """Events overlap: threads compile at once, and tracing a function includes tracing those that it calls."""
        total, last = 0.0, -math.inf
        for begin, end in sorted(times):
            total += max(0.0, end - max(begin, last))
            last = max(last, end)
        return total

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield seconds
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)
