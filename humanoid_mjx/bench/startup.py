"""Seconds from a command to the beginning of its training, with nothing compiled before it and the second time.

`humanoid-mjx sweep` runs in a process of its own, with a folder of its own for compiled programs, and is ended once it
trains: what counts is importing, tracing, compiling and reading what was compiled. On a GPU it takes memory as it needs
it, because it shares the GPU with the process that measures.

    cold               the folder is empty
    warm               the same command again
"""

import os
import re
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import jax

from humanoid_mjx.bench.measure import Record, spread
from humanoid_mjx.bench.training import environments
from humanoid_mjx.config import load
from humanoid_mjx.spec import InputError
from humanoid_mjx.training.plan import resolved

CONFIGS = ("joint1", "leg_reach", "stand")

REPEATS = 3


def run(
    say: Callable[[str], None],
    configs: Sequence[str] = CONFIGS,
    overrides: Sequence[str] = (),
    repeats: int = REPEATS,
) -> list[Record]:
    """Start a sweep of every config so many times, cold and warm in turn."""
    records: list[Record] = []
    for name in configs:
        times: dict[str, list[float]] = {"cold": [], "warm": []}
        for _ in range(repeats):
            with TemporaryDirectory() as folder:
                for kind, seconds in times.items():
                    seconds.append(seconds_to_training(name, overrides, Path(folder), kind))
        envs = environments(resolved(load(name, overrides))["learner"])
        for kind, seconds in times.items():
            records.append(
                Record(
                    bench="startup",
                    subject=f"{name} {kind}",
                    device=jax.devices()[0].device_kind,
                    batch=envs,
                    value=round(statistics.median(seconds), 3),
                    unit="s to training",
                    compile_s=0.0,
                    repeats=repeats,
                    spread=spread(seconds),
                )
            )
        say(f"{name:12} training begins after {records[-2].value:5.1f} s, the second time {records[-1].value:5.1f} s")
    return records


def seconds_to_training(config: str, overrides: Sequence[str], folder: Path, out: str) -> float:
    """Seconds until a sweep in a process of its own trains. `folder` keeps what it compiles, and its run folder `out`.

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
    with subprocess.Popen(command, env=environment, **pipes) as process:
        try:
            for line in process.stdout or ():
                if re.match(r" *[\d.]+ s  training", line):
                    return time.perf_counter() - start
                told.append(line.strip())
        finally:
            process.kill()
    raise InputError(f"bench startup: {config} did not come to training: {told[-1] if told else 'it said nothing.'}")
