"""Chunks trained by the workers of a Ray cluster: those of this machine, or of many that come and go.

A worker is an actor that has one GPU, or one CPU core where the cluster has no GPU. Results and states come to the
driver through Ray's object store, so that workers need no access to the run folder.
"""

import logging
import os
import socket
import time
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from typing import Any

import jax
import numpy as np

from humanoid_mjx import compute
from humanoid_mjx.compute import kept
from humanoid_mjx.config import parse
from humanoid_mjx.spec import InputError, package
from humanoid_mjx.training import chunks
from humanoid_mjx.training.chunks import Chunk, Desk, Engine, Event, Given, Here, Note, UnderWay, Work, key_of
from humanoid_mjx.training.plan import Plan, make_plan
from humanoid_mjx.training.progress import counted
from humanoid_mjx.user_code import in_words

LOCAL = "local"
"""The address that stands for a cluster of this machine, which ends with the sweep."""

TRIES = 4
"""Largest number of trainings of a chunk whose workers are lost."""

LOOK_EVERY_S = 1.0
"""Seconds between two messages of a worker about its progress."""

STATE_BYTES_PER_S = 1 << 20
"""The most that a worker sends of its state, so that hundreds do not flood the driver."""

REACH_S = 5.0
"""Seconds in which the address of a cluster must answer."""

ALONE_S = 60.0
"""Seconds without any worker after which a sentence says so."""

SETTINGS = {
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",  # a cluster of one machine, bound to 127.0.0.1
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_worker_niceness": "0",  # 15 by default: workers would starve on a busy machine
}
"""Environment of a cluster of this machine."""


class Worker:
    """The process that trains, one chunk after another."""

    def __init__(self, config: Mapping[str, Any], platforms: str | None):
        """Prepare to train chunks of a resolved config on some of jax's platforms."""
        jax.config.update("jax_platforms", platforms)
        with suppress(RuntimeError):  # jax computes already
            jax.config.update("jax_num_cpu_devices", 1)
            os.environ["JAX_NUM_CPU_DEVICES"] = "1"
        self.config, self.plan, self.work, self.leaves = parse(dict(config)), None, None, False
        self.engines: dict[int, Here] = {}
        """By the group of runs."""
        compute.start(mjx="mjx-jax" in self.config.physics)
        self.keeping = ExitStack()
        self.keeping.enter_context(kept.keeping())

    def about(self) -> tuple[str, dict[str, str]]:
        """Return the machine and process, and the versions of what computes."""
        return f"{socket.gethostname()}:{os.getpid()}", compute.versions()

    def train(self, chunk: Chunk, given: Given, every_s: float, look_s: float) -> Iterator[Event | str]:
        """Yield what the training of a chunk gives: its state each `every_s` seconds, its progress each `look_s`. Where
        it cannot be trained, wherever it is tried, a sentence says so."""
        try:
            self.plan = self.plan or make_plan(self.config)
            if chunk.group not in self.engines:
                self.engines[chunk.group] = Here(self.plan, groups=[chunk.group])
            for work in self.engines[chunk.group].works([chunk], given, every_s):
                self.work = work
                if self.leaves:
                    return
                events = work.events(look_s)
                next(events)  # a note on how many train side by side
                yield from events
                if work.stopped.is_set():
                    return
        except InputError as error:
            yield str(error)
        except Exception as error:
            yield f"{in_words(error)}."

    def stop(self) -> list[Event]:
        """Stop the training under way, or one that begins later; return what it has to give."""
        self.leaves = True
        return self.work.stop() if isinstance(self.work, Work) else []


class OnRay(Engine):
    """The engine that is a Ray cluster."""

    def __init__(self, plan: Plan, address: str = LOCAL):
        """Start a cluster of this machine, or connect to the one at HOST:PORT.

        Raises:
          InputError: ray is not installed, or the cluster cannot be reached.
        """
        self.plan, self.ray = plan, _cluster(address)
        self.config = plan.resolved()
        self.resource = "GPU" if self.ray.cluster_resources().get("GPU") else "CPU"
        self.at_once = [min(len(group.first_runs), plan.chunk * max(self._room(), 1)) for group in plan.groups]
        options = {"num_gpus": 1} if self.resource == "GPU" else {"num_cpus": 1}
        self.actor = self.ray.remote(max_concurrency=2, **options)(Worker)
        self.starting: dict[Any, Any] = {}
        """By the promise of its `about`: a worker that starts."""
        self.idle: dict[Any, str] = {}
        """Workers without a chunk, with their names."""
        self.busy: dict[Any, tuple[Any, str, Chunk]] = {}
        """By the stream of its events: a worker, its name and its chunk."""

    def train(self, chosen: Sequence[Chunk], desk: Desk) -> None:
        finished = desk.given(chosen).finished  # a damaged state is refused before any worker trains
        waiting = deque(chunk for chunk in chosen if not finished.issuperset(chunk.runs))
        tries: Counter[int] = Counter()
        given_up: list[str] = []
        sizes = f"{counted(len(waiting), 'chunk')} of up to {self.plan.chunk:,} runs"
        desk.take(Note(f"{sizes} for {counted(self._room(), 'worker')} with a {self.resource} each"))
        if self.resource == "GPU" and (words := too_narrow(self.plan, self._room())):
            desk.take(Note(words))
        alone = time.monotonic()
        try:
            while waiting or self.busy:
                self._enlist(len(waiting))
                while waiting and self.idle:
                    self._begin(waiting.popleft(), desk)
                if self.idle or self.busy:
                    alone = time.monotonic()
                elif time.monotonic() - alone > ALONE_S:
                    alone = time.monotonic()
                    desk.take(Note(f"no worker has come for {ALONE_S:.0f} s; the sweep waits for one"))
                promises = [*self.starting, *self.busy]
                ready, _ = self.ray.wait(promises, num_returns=1, timeout=LOOK_EVERY_S) if promises else ([], [])
                for promise in ready:
                    if promise in self.starting:
                        self._started(promise, desk)
                    elif lost := self._hear(promise, desk):
                        worker, chunk, why = lost
                        tries[chunk.number] += 1
                        if tries[chunk.number] < TRIES:
                            waiting.appendleft(chunk)
                            desk.take(Note(f"worker {worker} was lost ({why}); chunk {chunk.number} goes to another"))
                        else:
                            given_up.append(f"chunk {chunk.number}, at last {worker} ({why})")
                if not promises:
                    time.sleep(LOOK_EVERY_S)
        except BaseException:
            self._stop(desk)
            raise
        if given_up:
            raise InputError(
                f"{counted(len(given_up), 'chunk')} lost the worker {TRIES} times ({'; '.join(given_up)}); the others "
                "are stored, and the same command with resume=True trains the rest."
            )

    def close(self) -> None:
        self.ray.shutdown()

    def _room(self) -> int:
        """Return the number of workers that the cluster holds."""
        return int(self.ray.cluster_resources().get(self.resource, 0))

    def _enlist(self, wanted: int) -> None:
        """Start workers while the cluster holds more, and chunks wait for them."""
        there = len(self.starting) + len(self.idle) + len(self.busy)
        for _ in range(min(self._room() - there, wanted - len(self.starting) - len(self.idle))):
            worker = self.actor.remote(self.config, "cpu" if self.resource == "CPU" else None)
            self.starting[worker.about.remote()] = worker

    def _started(self, promise: Any, desk: Desk) -> None:
        worker = self.starting.pop(promise)
        try:
            name, versions = self.ray.get(promise)
        except self.ray.exceptions.RayTaskError as error:
            raise InputError(f"a worker cannot start: {in_words(error.cause)}.") from error
        except self.ray.exceptions.RayError:
            return  # its machine has left
        mine = compute.versions()
        if odd := [each for each in mine if versions.get(each) != mine[each]]:
            there, here = versions.get(odd[0]), mine[odd[0]]
            raise InputError(f"worker {name} has {odd[0]} {there} and this machine {here}; install the same there.")
        self.idle[worker] = name
        desk.machines.add(name.rpartition(":")[0])
        desk.take(Note(f"worker {name} trains"))

    def _begin(self, chunk: Chunk, desk: Desk) -> None:
        """Hand a chunk to an idle worker."""
        worker, name = self.idle.popitem()
        size = self.plan.groups[chunk.group].bytes * len(chunk.runs)
        every_s = max(chunks.CHECKPOINT_EVERY_S, size / STATE_BYTES_PER_S)
        given = desk.given([chunk])
        stream = worker.train.options(num_returns="streaming").remote(chunk, given, every_s, LOOK_EVERY_S)
        self.busy[stream] = worker, name, chunk

    def _hear(self, stream: Any, desk: Desk) -> tuple[str, Chunk, str] | None:
        """Take the next event of a stream. Return worker, chunk and reason where the worker is lost.

        Raises:
          InputError: the chunk cannot be trained.
        """
        worker, name, chunk = self.busy[stream]
        try:
            event = self.ray.get(next(stream))
        except StopIteration:
            del self.busy[stream]
            self.idle[worker] = name
        except self.ray.exceptions.RayError as error:
            del self.busy[stream]
            nothing = np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 3))
            desk.take(UnderWay(key_of([chunk]), chunk.group, "starting", *nothing))
            return name, chunk, type(error).__name__
        else:
            if isinstance(event, str):
                raise InputError(f"chunk {chunk.number}, worker {name}: {event}")
            desk.take(event)
        return None

    def _stop(self, desk: Desk) -> None:
        """Stop all workers and store what they have."""
        promises = [worker.stop.remote() for worker, _, _ in self.busy.values()]
        if not promises:
            return
        deadline = time.monotonic() + chunks.LEAVE_AFTER_S + 2 * LOOK_EVERY_S
        ready, _ = self.ray.wait(promises, num_returns=len(promises), timeout=deadline - time.monotonic())
        for stream in [*self.busy]:  # what their streams had taken before, to the end of each
            with suppress(InputError):
                while stream in self.busy and self.ray.wait([stream], timeout=max(deadline - time.monotonic(), 0))[0]:
                    self._hear(stream, desk)
        for promise in ready:
            with suppress(self.ray.exceptions.RayError):
                for event in self.ray.get(promise):
                    desk.take(event)


def too_narrow(plan: Plan, workers: int) -> str:
    """Return words for chunks of networks as wide as the cache of a CPU core holds, which so many GPUs are to train;
    none where the config names the width, or they are as wide as can be."""
    wider = -(-plan.num_runs // workers)
    if plan.config.chunk or plan.learners[0].program == "tabular" or wider <= plan.chunk:
        return ""
    narrow = f"chunks of {counted(plan.chunk, 'run')} suit the cache of a CPU core"
    return f"{narrow}; GPUs train more side by side in little more time: --set chunk={wider}"


def _cluster(address: str) -> Any:
    """Return the package ray, connected to a cluster. It reads its settings when it is imported."""
    for name, value in SETTINGS.items() if address == LOCAL else ():
        os.environ.setdefault(name, value)
    ray = package("ray", "ray", "--ray")
    with suppress(AttributeError):  # it prints a paragraph on each worker that is lost
        ray._private.worker.print_to_stdstream = lambda *_, **__: None
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR, "configure_logging": False}
    if address == LOCAL:
        options |= {"num_cpus": compute.cores(), "include_dashboard": False}
    elif address != "auto":
        host, _, port = address.rpartition(":")
        try:
            socket.create_connection((host, int(port)), REACH_S).close()
        except (OSError, ValueError, OverflowError) as error:
            raise InputError(
                f"--ray {address}: no cluster answers there ({error}); write HOST:PORT as ray start prints it, or "
                "leave the address out for a cluster of this machine."
            ) from error
    try:
        ray.init(**{"address": address} | options)
    except Exception as error:  # ray raises a dozen kinds, of many lines
        raise InputError(f"--ray {address}: {' '.join(str(error).split())[:300]}") from error
    return ray
