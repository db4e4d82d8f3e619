"""Several processes, on one machine or on many, that share a job through `jax.distributed`.

Each computes on its own devices. What they tell each other goes through the key-value store of jax's coordinator, which
is in process 0: no array crosses the network, so that it need not be fast, and NCCL need not work.
"""

import ctypes
import itertools
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

import jax
import numpy as np

from humanoid_mjx.spec import InputError

HEARTBEAT_S = 100
"""Seconds of silence after which a process is taken for lost; jax's own default."""

WAIT_S = 30 * 24 * 3600
"""Seconds that processes wait for each other: as long as any job lasts. One that is lost ends the wait."""

LEAVE_S = 60
"""Seconds that process 0 waits at its end until the others have left."""

T = TypeVar("T")


@ctypes.CFUNCTYPE(None, ctypes.c_int)
def _say_why(_: int) -> None:
    """Handle SIGABRT: jax's client aborts a process that has lost process 0, and its callback for that is broken."""
    os.write(2, b"error: jax aborts this process, as it does when process 0 is lost; --resume the sweep to go on.\n")


@contextmanager
def joined() -> Iterator[int]:
    """Be one of several processes, where the environment says so. Must begin before jax first computes.

    Yields the number of this process. At the end process 0 waits until the others have left, for `LEAVE_S` at most,
    since its own end ends them at once. When it is told to stop it waits for nobody.

    Raises:
      InputError: the environment contradicts itself, or the other processes cannot be reached.
    """
    _join()
    try:
        yield jax.process_index()
    finally:
        told_to_stop = isinstance(sys.exception(), (KeyboardInterrupt, SystemExit))
        if jax.process_index() == 0 and not told_to_stop:
            _apart(lambda: [_lost([0, other]) for other in range(1, jax.process_count())], LEAVE_S)


def _join() -> None:
    """Start jax's distributed runtime where the environment asks for it.

    It does so by `JAX_COORDINATOR_ADDRESS`, `JAX_NUM_PROCESSES` and `JAX_PROCESS_ID`, or where Slurm's `srun` has
    started several tasks. A task that is alone on its node takes all devices there; of several each takes one, as is
    jax's custom.
    """
    where: dict[str, Any]
    if "JAX_NUM_PROCESSES" in os.environ:
        names = ("JAX_COORDINATOR_ADDRESS", "JAX_NUM_PROCESSES", "JAX_PROCESS_ID")
        if missing := [name for name in names if name not in os.environ]:
            raise InputError(f"{missing[0]} is not set, which a job of several processes needs beside {names[1]}.")
        address, *numbers = (os.environ[name] for name in names)
        try:
            count, index = map(int, numbers)
        except ValueError:
            raise InputError(f"{names[1]} and {names[2]} must be whole numbers, got {' and '.join(numbers)}.") from None
        if not 0 <= index < count or not address.rpartition(":")[2].isdigit():
            raise InputError(f"{names[0]} must be HOST:PORT, and {names[2]} at least 0 and less than {names[1]}.")
        where = {"coordinator_address": address, "num_processes": count, "process_id": index}
        where["cluster_detection_method"] = "deactivate"
    elif "SLURM_STEP_NODELIST" in os.environ:
        count = int(os.environ.get("SLURM_NTASKS", "1"))
        alone = os.environ.get("SLURM_STEP_NUM_NODES") == str(count)
        where = {"local_device_ids": []} if alone else {}  # no choice among them: all that are seen
    else:
        return
    if count > 1:
        jax.config.update("jax_enable_recoverability", True)  # what is left of a job goes on without a lost process
        jax.config.update("jax_enable_preemption_service", False)  # SIGTERM ends the process, as ever
        try:
            if os.name == "posix":  # elsewhere the C library has another name
                ctypes.CDLL(None).signal(signal.SIGABRT, _say_why)
            jax.distributed.initialize(**where, heartbeat_timeout_seconds=HEARTBEAT_S)
        except RuntimeError as error:
            raise InputError(f"the {count} processes of this job cannot reach each other: {error}.") from error


class Processes:
    """The processes of a job, as one of them sees them; a process alone is process 0 of 1 and waits for nobody.

    All of them make as many, and call the same methods in the same order.
    """

    _made = itertools.count()

    def __init__(self) -> None:
        self.index, self.count = jax.process_index(), jax.process_count()
        self._prefix = f"humanoid_mjx/{next(self._made)}"
        self._client = _client()

    def share(self, runs: np.ndarray) -> np.ndarray:
        """Every `count`-th of some runs: this process's own, whichever are finished."""
        return runs[self.index :: self.count]

    def first(self, act: Callable[[], T], tell: Callable[[T], str], follow: Callable[[str], T]) -> T:
        """Let process 0 act, and the others follow what it tells them.

        Raises:
          InputError: what `act` or `follow` raised; an error of `act` is raised in all processes.
        """
        if self.count == 1:
            return act()
        key = f"{self._prefix}/first"
        if self.index:
            told = json.loads(self._client.blocking_key_value_get(key, WAIT_S * 1000))
            if "error" in told:
                raise InputError(told["error"])
            return follow(told["value"])
        try:
            found = act()
        except InputError as error:
            self._client.key_value_set(key, json.dumps({"error": str(error)}))
            raise
        self._client.key_value_set(key, json.dumps({"value": tell(found)}))
        return found

    def meet(self) -> None:
        """Wait until all processes have come here.

        Raises:
          InputError: a process is lost.
        """
        self._meet([range(self.count)])

    def collect(self, name: str, word: str) -> list[str]:
        """Let process 0 wait for all others, each of which waits for process 0 alone.

        Returns:
          the word of each process; in others than process 0 nothing.

        Raises:
          InputError: a process is lost. Process 0 has waited for those that are not.
        """
        if self.count == 1:
            return [word]
        self._client.key_value_set(f"{self._prefix}/{name}/{self.index}", word)
        self._meet([(0, other) for other in ([self.index] if self.index else range(1, self.count))])
        keys = (f"{self._prefix}/{name}/{index}" for index in range(self.count if not self.index else 0))
        return [self._client.blocking_key_value_get(key, WAIT_S * 1000) for key in keys]

    def _meet(self, meetings: Sequence[Sequence[int]]) -> None:
        """Meet groups of processes, one after another."""
        if self.count == 1:
            return
        lost: set[int] = set()
        _apart(lambda: [lost.update(_lost(members)) for members in meetings])
        if lost:
            if len(meetings) > 1:  # the others meet all next: they are told before process 0 leaves
                _apart(lambda: _lost(range(self.count)))
            numbers = " and ".join(map(str, sorted(lost)))
            raise InputError(f"process {numbers} of this job was lost; what is finished is stored, --resume goes on.")


def _apart(call: Callable[[], Any], seconds: float = WAIT_S) -> None:
    """Call what may wait in a thread of its own, so that Ctrl-C is heard, for so long at most."""
    thread = threading.Thread(target=call, daemon=True)
    thread.start()
    until = time.monotonic() + seconds
    while thread.is_alive() and time.monotonic() < until:
        thread.join(0.1)


def _lost(members: Sequence[int]) -> set[int]:
    """Wait until each of some processes asks the same or is gone; those that are gone."""
    try:
        return set(members) - set(_client().get_live_nodes(list(members)))
    except RuntimeError:
        return {0}  # which answers such questions


def _client() -> Any:
    from jax._src import distributed  # the store and the list of the living have no public name

    return distributed.global_state.client
