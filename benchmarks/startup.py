"""Seconds from a command to the beginning of its training, with nothing compiled before it and the second time.

`humanoid-mjx sweep` runs in a process of its own, with a folder of its own for compiled programs, and is ended once it
trains: what counts is importing, tracing, compiling and reading what was kept. On a GPU it takes memory as it needs
it, because it shares the GPU with the process that measures.

    cold               the folder is empty
    warm               the same command again
    s to training      by the clock
    processor s ...    of all threads together; other programs change it little
    share of importing until the progress begins: Python, jax, MuJoCo
    share of starting  config and plan; tracing of a training step, to estimate the memory; the runs' first states
    share of tracing   tracing and lowering of the training steps, the rest of which are compiled meanwhile
    share of compiling waiting for XLA, or for what is read from the folder
"""

import math
import os
import re
import statistics
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import jax
from timing import Record, spread
from trainings import environments

from humanoid_mjx.config import load
from humanoid_mjx.spec import InputError
from humanoid_mjx.training.plan import resolved

REPEATS = 2

KEEPS_S = 20.0
"""Seconds in which a process that trains has stored what it compiled."""


class Start(NamedTuple):
    """Durations of a start."""

    phases: dict[str, float]
    """Seconds of each phase."""
    processor_s: float


def run(
    say: Callable[[str], None], configs: Sequence[str], overrides: Sequence[str] = (), repeats: int = REPEATS
) -> list[Record]:
    """Start a sweep of every config so many times, cold and warm in turn."""
    records: list[Record] = []
    for name in configs:
        starts: dict[str, list[Start]] = {"cold": [], "warm": []}
        for _ in range(repeats):
            with TemporaryDirectory() as folder:
                for kind, found in starts.items():
                    found.append(start_up(name, overrides, Path(folder), kind))
        common = {
            "bench": "startup",
            "device": jax.devices()[0].device_kind,
            "batch": environments(resolved(load(name, overrides))["learner"]),
            "compile_s": 0.0,
            "repeats": repeats,
        }
        for kind, found in starts.items():
            seconds, processor = [sum(each.phases.values()) for each in found], [each.processor_s for each in found]
            shares = {phase: sum(each.phases.get(phase, 0.0) for each in found) for phase in found[0].phases}
            figures = {"s to training": seconds, "processor s to training": processor}
            records += [
                Record(
                    subject=f"{name} {kind}", value=round(statistics.median(x), 3), unit=u, spread=spread(x), **common
                )
                for u, x in figures.items()
            ]
            records += [
                Record(subject=f"{name} {kind}", value=round(x / sum(seconds), 4), unit=f"share of {phase}", **common)
                for phase, x in shares.items()
            ]
            told = ", ".join(f"{phase} {x / repeats:.1f}" for phase, x in shares.items())
            say(f"{name:12} {kind} training begins after {statistics.median(seconds):5.1f} s: {told}; "
                f"{statistics.median(processor):.1f} s of processor time")  # fmt: skip
    return records


def start_up(config: str, overrides: Sequence[str], folder: Path, out: str) -> Start:
    """A sweep in a process of its own until it trains. `folder` keeps what it compiles, and its run folder `out`.

    Raises:
      InputError: it ended before it trained.
    """
    environment = os.environ | {
        "JAX_COMPILATION_CACHE_DIR": str(folder / "xla"),
        "XLA_PYTHON_CLIENT_PREALLOCATE": "false",
    }
    words = [word for override in overrides for word in ("--set", override)]
    command = [sys.executable, "-m", "humanoid_mjx", "sweep", config, "--out", str(folder / out), *words]
    start, told = time.perf_counter(), []
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    phases: defaultdict[str, float] = defaultdict(float)
    phase, last = "starting", 0.0
    with subprocess.Popen(command, env=environment, **pipes) as process:
        try:
            for line in process.stdout or ():
                told.append(line.strip())
                if not (found := re.match(r" *([\d.]+) s  (\w+)", line)):
                    continue
                phases[phase] += float(found[1]) - last
                last, phase = float(found[1]), found[2]
                if phase == "training":
                    phases["importing"] = time.perf_counter() - start - last
                    used = _processor_s(process.pid)
                    until = time.perf_counter() + KEEPS_S
                    while time.perf_counter() < until and not _kept(folder / "xla"):
                        time.sleep(0.1)
                    return Start(phases, used)
        finally:
            process.kill()
    raise InputError(f"bench startup: {config} did not come to training: {told[-1] if told else 'it said nothing.'}")


def _kept(folder: Path) -> bool:
    return all(any(folder.glob(f"{name}-*-traced")) for name in ("begin", "advance"))


def _processor_s(process: int) -> float:
    """Seconds that all threads of a process have computed; NaN where the system does not say."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return math.nan
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
