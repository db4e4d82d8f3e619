"""Faults that hit a training under way: kills, disks, folders, other processes, clocks, memory, numbers."""

import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from fault_trying import CONFIGS, SAME, TINY, Matrix, Try, begin, bits, command, isolated, processes, write_config

from humanoid_mjx import compute
from humanoid_mjx.runs.folder import parts
from humanoid_mjx.runs.listing import list_runs
from humanoid_mjx.training import chunks as chunks_module
from humanoid_mjx.training import pool as pool_module
from humanoid_mjx.training import session as session_module
from humanoid_mjx.training.sweep import sweep

KILLS_OF_A_RUN, AT_ONCE = 5, 4


def train(config: dict[str, Any], run: Path, began: Any) -> None:
    """Train, or go on with what a kill has left, storing much more often than usual."""
    compute.start()
    chunks_module.CHECKPOINT_EVERY_S = 0.05
    pool_module.CHUNK_S, pool_module.HARVEST_AFTER_S, pool_module.HARVEST_SHARE = 0.02, 0.2, 0.05
    began.set()
    sweep(config, run, resume=(run / "checkpoint").is_dir())


def started(config: dict[str, Any], run: Path) -> Any:
    """A process that trains, as soon as it does."""
    began = processes().Event()
    process = processes().Process(target=train, args=(config, run, began))
    process.start()
    began.wait()
    return process


def killed(config: dict[str, Any], run: Path, after_s: float | None) -> tuple[bool, float]:
    """Train in a process and kill it after so many seconds; whether it was quicker, and how long it took."""
    process, start = started(config, run), time.monotonic()
    process.join(after_s)
    took, over = time.monotonic() - start, not process.is_alive()
    process.kill()
    process.join()
    if over and process.exitcode:
        raise RuntimeError(f"training ended with exit code {process.exitcode}")
    return over, took


def _left(run: Path) -> str:
    """Outcome of a kill."""
    if not (run / "config.yaml").exists():
        return "before the config was there"
    stored = "under way" if any((run / "checkpoint").glob("pool-*.npz")) else "nothing under way stored"
    return f"{len(parts(run))} parts stored, {stored}" if parts(run) else f"no run over, {stored}"


def kills(matrix: Matrix, learner: str, tries: int, seed: int) -> None:
    """Kill -9 at random moments. A run is killed a few times, each time resumed, and compared when it is over."""
    config, draw = CONFIGS[learner], random.Random(seed)
    found: list[str] = []

    def tried() -> list[Try]:
        outcomes: list[Try] = []
        with tempfile.TemporaryDirectory() as folder:
            place = Path(folder)
            killed(config, place / "warm", None)  # compiles what the cache lacks
            _, whole_s = killed(config, place / "whole", None)
            expected = bits(place / "whole")
            while len(outcomes) < tries:
                run = place / f"run-{len(outcomes)}"
                outcomes += _chain(config, run, min(KILLS_OF_A_RUN, tries - len(outcomes)), whole_s, expected)
        return outcomes

    def _chain(config: dict[str, Any], run: Path, kills: int, whole_s: float, expected: str) -> list[Try]:
        """Kill a run up to so many times, and let it end."""
        ends: list[Try] = []
        try:
            while not killed(config, run, draw.uniform(0.0, whole_s) if len(ends) < kills else None)[0]:
                found.append(_left(run))
                problems = list_runs(run)[1] if (run / "config.yaml").exists() else []
                ends.append((SAME, f"after a kill: {problems[0]}" if problems else ""))
        except RuntimeError as error:
            return [("did not go on", f"{run.name} after {len(ends)} kills: {error}")] * max(len(ends), 1)
        same = bits(run) == expected
        return ends if same else [("other bits", f"{run.name} after {len(ends)} kills: other bits")] * max(len(ends), 1)

    matrix.row("kill -9 at a random moment", learner, tried)
    matrix.say(f"  what was stored then: {json.dumps(dict(sorted({x: found.count(x) for x in found}.items())))}")


def crowds(matrix: Matrix, folder: Path, rounds: int) -> None:
    """Processes that start at once: in one folder, and with folders of their own choice."""

    def start(*arguments: object) -> list[subprocess.Popen[str]]:
        call = [sys.executable, "-m", "humanoid_mjx", "sweep", *map(str, arguments)]
        return [
            subprocess.Popen(call, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
            for _ in range(AT_ONCE)
        ]

    def ended(all_of_them: list[subprocess.Popen[str]]) -> list[tuple[int, str]]:
        said = [process.communicate()[1] for process in all_of_them]
        return [(process.returncode, words) for process, words in zip(all_of_them, said, strict=True)]

    def tried() -> list[Try]:
        begin(folder)
        config, found = write_config(folder, TINY), []
        for number in range(rounds):
            ends = ended(start(config, "--out", folder / f"one-{number}"))
            refused = [
                words for code, words in ends if code == 2 and words.startswith("error: ") and words.count("\n") == 1
            ]
            fine = len(refused) == AT_ONCE - 1 and bits(folder / f"one-{number}") == bits(folder / "whole")
            found.append(("one trained, the others got a sentence", "") if fine else ("wrong", str(ends)))
        ends = ended(start(config))
        runs = [path for path in sorted((folder / "runs").iterdir()) if bits(path) == bits(folder / "whole")]
        fine = not any(code for code, _ in ends) and len(runs) == AT_ONCE
        return [*found, ("each trained in a folder of its own", "") if fine else ("wrong", str(ends))]

    matrix.row(f"{AT_ONCE} processes at once", "sweep of tables", tried)


def _at_odd_time(kind: str) -> Try:
    """A sweep while the clock is wrong; and what the list of runs says."""
    real, jump = time.time, random.Random(0)
    shift = {"a day back at each look": lambda n: -86_400.0 * n, "ten years ahead": lambda n: 3.2e8,
             "at random by years": lambda n: jump.uniform(-1e9, 1e9)}[kind]  # fmt: skip
    looks = iter(range(10**9))
    time.time = lambda: max(0.0, real() + shift(next(looks)))
    session_module.datetime = _Clock  # type: ignore[attr-defined]
    run = Path.cwd() / kind.replace(" ", "-")
    done = command("sweep", write_config(Path.cwd(), TINY), "--out", run)
    os.utime(run / "config.yaml", (4e9, 4e9))
    listed = command("runs", Path.cwd())
    fine = done.how == listed.how == "worked" and bits(run) == bits(Path.cwd() / "whole")
    return ("the same bits", "") if fine else ("wrong", f"{done.said} {listed.said}")


class _Clock:
    """In the place of `datetime`: its `now` is what `time.time` says."""

    @staticmethod
    def now(zone: Any) -> Any:
        from datetime import datetime

        return datetime.fromtimestamp(time.time(), zone)


def clocks(matrix: Matrix, folder: Path) -> None:
    """Clocks that jump, and a process that stands still for two seconds."""

    def tried() -> list[Try]:
        begin(folder)
        found = isolated(_at_odd_time, ["a day back at each look", "ten years ahead", "at random by years"], folder)
        process = started(TINY, folder / "stopped")
        for sign, seconds in ((signal.SIGSTOP, 2.0), (signal.SIGCONT, 0.0)):
            os.kill(process.pid, sign)
            time.sleep(seconds)
        process.join()
        same = bits(folder / "stopped") == bits(folder / "whole")
        return [*found, ("the same bits", "") if same else ("wrong", "a process that was stopped: other bits")]

    matrix.row("clock that jumps, process that is stopped", "sweep of tables", tried)
