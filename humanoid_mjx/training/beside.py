"""Work done beside other work: a compiler leaves Python free, and most cores of a machine idle."""

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

T = TypeVar("T")


def beside(work: Callable[[], T]) -> "Future[T]":
    """What `work()` will return or raise. It runs in a thread of its own, which does not keep the process from ending:
    a compiler cannot be interrupted."""
    future: Future[T] = Future()

    def run() -> None:
        try:
            future.set_result(work())
        except BaseException as error:
            future.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return future
