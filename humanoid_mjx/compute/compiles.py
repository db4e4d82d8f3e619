"""Counting of compiled programs and of the time that tracing and compiling take."""

import math
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

import jax.monitoring


class CompileCount:
    """Programs compiled and seconds of tracing and compiling, while `counting_compiles` runs."""

    def __init__(self) -> None:
        self.events: Counter[str] = Counter()
        self.times: list[tuple[float, float]] = []
        """Start and end of each event, s, by the monotonic clock. Events overlap: programs compile in several threads,
        and tracing a function includes tracing the functions that it calls."""

    def __call__(self, event: str, duration_secs: float, **kwargs: str | int) -> None:
        if event.startswith("/jax/core/compile/"):
            self.events[event] += 1
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

    @property
    def programs(self) -> int:
        """Number of compiled programs."""
        return self.events["/jax/core/compile/backend_compile_duration"]


@contextmanager
def counting_compiles() -> Iterator[CompileCount]:
    """Count the programs that jax compiles in the block. A program read from the cache on disk counts too."""
    count = CompileCount()
    jax.monitoring.register_event_duration_secs_listener(count)
    try:
        yield count
    finally:
        jax.monitoring.unregister_event_duration_listener(count)
