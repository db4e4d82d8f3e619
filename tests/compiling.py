"""The programs that jax compiles, those that it reads from the cache on disk among them."""

from contextlib import contextmanager

import jax.monitoring


@contextmanager
def counting_compiles():
    """A list that gets an entry for each program that is compiled in the block."""
    programs = []

    def listen(event, *_, **__):
        if event == "/jax/core/compile/backend_compile_duration":
            programs.append(event)

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield programs
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)
