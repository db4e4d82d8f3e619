"""The time that tracing and compiling take."""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager

import jax.monitoring


class CompileTime:
    """Seconds of tracing and compiling, while `timing_compiles` runs."""

    def __init__(self) -> None:
        self.times: list[tuple[float, float]] = []
        """Start and end of each event, s, by the monotonic clock. Events overlap: programs compile in several threads,
        and tracing a function includes tracing the functions that it calls."""

    def __call__(self, event: str, duration_secs: float, **kwargs: str | int) -> None:
        if event.startswith("/jax/core/compile/"):
            now = time.monotonic()
            self.times.append((now - duration_secs, now))

    @property
    def seconds(self) -> float:
        """Seconds in which at least one thread traced or compiled."""
        total, last = 0.0, -math.inf
        for begin, end in sorted(self.times):
            total += max(0.0, end - max(begin, last))
            last = max(last, end)
        return total


@contextmanager
def timing_compiles() -> Iterator[CompileTime]:
    """Time what jax traces and compiles in the block. Reading a program from the cache on disk counts too."""
    time_taken = CompileTime()
    jax.monitoring.register_event_duration_secs_listener(time_taken)
    try:
        yield time_taken
    finally:
        jax.monitoring.unregister_event_duration_listener(time_taken)
