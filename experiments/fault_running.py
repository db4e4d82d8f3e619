"""Faults that hit a training under way: kills, disks, folders, other processes, clocks, memory, numbers."""

import errno
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fault_trying import CONFIGS, TINY, Done, Matrix, bits, command, isolated, processes, write_config

from humanoid_mjx import runtime
from humanoid_mjx.runs.folder import parts
from humanoid_mjx.runs.listing import list_runs
from humanoid_mjx.training import pool as pool_module
from humanoid_mjx.training import sweep as sweep_module

SAME = "resumed to the same bits"


def train(config: dict[str, Any], run: Path, began: Any) -> None:
    """Train, or go on with what a kill has left, storing much more often than usual."""
    runtime.start()
    sweep_module.CHECKPOINT_EVERY_S = 0.05
    pool_module.CHUNK_S, pool_module.HARVEST_AFTER_S, pool_module.HARVEST_SHARE = 0.02, 0.2, 0.05
    began.set()
    sweep_module.sweep(config, run, resume=(run / "checkpoint").is_dir())


def _killed(config: dict[str, Any], run: Path, after_s: float | None) -> tuple[bool, float]:
    """Train in a process and kill it after so many seconds; whether it was quicker, and how long it took."""
    context = processes()
    began = context.Event()
    process = context.Process(target=train, args=(config, run, began))
    process.start()
    began.wait()
    start = time.monotonic()
    process.join(after_s)
    took, over = time.monotonic() - start, not process.is_alive()
    process.kill()
    process.join()
    if over and process.exitcode:
        raise RuntimeError(f"training ended with exit code {process.exitcode}")
    return over, took


def _left(run: Path) -> str:
    """What a kill found."""
    if not (run / "config.yaml").exists():
        return "before the config was there"
    stored = "under way" if any((run / "checkpoint").glob("pool-*.npz")) else "nothing under way stored"
    return f"{len(parts(run))} parts stored, {stored}" if parts(run) else f"no run over, {stored}"


def kills(matrix: Matrix, learner: str, tries: int, seed: int) -> None:
    """Kill -9 at random moments; the same run is killed again and again until it is over, and then compared."""
    config, draw = CONFIGS[learner], random.Random(seed)
    found: list[str] = []

    def tried() -> tuple[list[str], list[str]]:
        outcomes: list[str] = []
        wrong: list[str] = []
        with tempfile.TemporaryDirectory() as folder:
            place = Path(folder)
            _killed(config, place / "warm", None)  # compiles what the cache lacks
            _, whole_s = _killed(config, place / "whole", None)
            expected, chain, number = bits(place / "whole"), 0, 0
            while len(outcomes) + chain < tries or chain:
                run = place / f"run-{number}"
                ends = len(outcomes) + chain >= tries
                over, _ = _killed(config, run, None if ends else draw.uniform(0.0, whole_s))
                if not over:
                    chain += 1
                    found.append(_left(run))
                    if run.exists() and (run / "config.yaml").exists() and (problems := list_runs(run)[1]):
                        wrong.append(f"after a kill: {problems[0]}")
                    continue
                same = bits(run) == expected
                if not same:
                    wrong.append(f"{run.name} after {chain} kills: other bits")
                outcomes += [SAME if same else "other bits"] * chain
                chain, number = 0, number + 1
        return outcomes, wrong

    matrix.row("kill -9 at a random moment", learner, tried)
    matrix.say(f"  what was stored then: {json.dumps(dict(sorted({x: found.count(x) for x in found}.items())))}")


class Trap:
    """Does something at the n-th time that a file below a folder is opened for writing, renamed, or a folder made."""

    def __init__(self, below: Path, number: int, act: Callable[[str], None]):
        self.below, self.left, self.act, self.sprung = str(below), number, act, False
        TRAPS[:] = [self]

    def look(self, event: str, args: tuple[Any, ...]) -> None:
        """Count one operation."""
        writes = event in ("os.mkdir", "os.rename") or (
            event == "open" and isinstance(args[2], int) and args[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
        )
        if not writes or not os.path.abspath(str(args[0])).startswith(self.below):
            return
        self.left -= 1
        if self.left == 0:
            self.sprung = True
            self.act(str(args[0]))


TRAPS: list[Trap] = []


def _watch() -> None:
    """Let Python tell the trap what it does with files."""
    if not getattr(sys, "watched", False):
        sys.addaudithook(lambda event, args: TRAPS[0].look(event, args) if TRAPS and event[:2] in ("op", "os") else None)
        setattr(sys, "watched", True)  # noqa: B010


def _sweep_at_fault(case: tuple[str, int]) -> tuple[bool, Done, str]:
    """A sweep at whose n-th file operation something happens; then what it says, and how it resumes."""
    kind, number = case
    _watch()
    here = Path.cwd() / f"{kind}-{number}"
    here.mkdir()
    config, run = write_config(here, TINY), here / "run"

    def fail(place: str) -> None:
        TRAPS.clear()
        if kind == "vanished":
            shutil.rmtree(run, ignore_errors=True)
        else:
            code = {"full": errno.ENOSPC, "read-only": errno.EROFS, "forbidden": errno.EACCES}[kind]
            raise OSError(code, os.strerror(code), place)

    trap = Trap(run, number, fail)
    done = command("sweep", config, "--out", run)
    TRAPS.clear()
    again = command("sweep", config, "--out", run, *(["--resume"] if (run / "checkpoint").is_dir() else []))
    same = again.how == "worked" and bits(run) == bits(Path.cwd() / "whole")
    return trap.sprung, done, SAME if same else f"not resumed: {again.said}"


def at_every_write(matrix: Matrix, kind: str, words: str, folder: Path, most: int) -> None:
    """A fault at the first, second, ... file operation of a sweep, until there are no more."""

    def tried() -> tuple[list[str], list[str]]:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        outcomes: list[str] = []
        wrong: list[str] = []
        isolated(_whole, [folder / "whole"], folder)
        for number, found in enumerate(isolated(_sweep_at_fault, [(kind, n) for n in range(1, most)], folder), 1):
            if isinstance(found, str):
                outcomes.append(found)
                wrong.append(f"{words} at write {number}: {found}")
                continue
            sprung, done, resumed = found
            if not sprung:
                continue
            fine = done.how in ("one sentence", "worked") and resumed == SAME
            outcomes.append(f"{done.how}, {SAME}" if fine else "wrong")
            wrong += [] if fine else [f"{words} at write {number}: {done.how}: {done.said} / {resumed}"]
        return outcomes, wrong

    matrix.row(words, "sweep of tables", tried)


def _whole(run: Path) -> Done:
    return command("sweep", write_config(run.parent, TINY), "--out", run)


def _on_small_disk(free_kib: int) -> tuple[Done, str, str]:
    """A sweep on a disk with so much space left; then with more, resumed; and a look at the disk read-only."""
    disk = Path.cwd() / f"disk-{free_kib}"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={free_kib}k", "tmpfs", str(disk)]
    subprocess.run(mount, check=True)
    sweep_module.check_disk = lambda *_: None  # it would refuse
    try:
        config, run = write_config(Path.cwd(), TINY), disk / "run"
        done = command("sweep", config, "--out", run)
        subprocess.run(["mount", "-o", "remount,size=64m", str(disk)], check=True)
        resume = ["--resume"] if (run / "checkpoint").is_dir() else []
        again = command("sweep", config, "--out", run, *resume)
        same = again.how == "worked" and bits(run) == bits(Path.cwd() / "whole")
        subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
        looks = [
            *(("runs", disk), ("report", run), ("plot", run), ("evaluate", run, "--json", disk / "x.json")),
            *(("sweep", config, "--out", run, "--resume"), ("export", run, disk / "p.npz"), ("sweep", config, "--out", disk / "b")),
        ]
        ends = [command(*look) for look in looks]
        odd = [end.said for end in ends if end.how not in ("worked", "one sentence")]
        return done, SAME if same else f"not resumed: {again.said}", odd[0] if odd else ""
    finally:
        subprocess.run(["umount", "-l", str(disk)], check=True)


def small_disks(matrix: Matrix, folder: Path, step_kib: int) -> None:
    """Real disks of every size up to what a sweep takes. Needs the right to mount."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "tmpfs", str(folder)], capture_output=True)
    if mounted.returncode:
        matrix.say("disk full, read-only disk: not tried, since mounting is not allowed")
        return
    read_only: list[str] = []

    def tried() -> tuple[list[str], list[str]]:
        isolated(_whole, [folder / "whole"], folder)
        used = sum(path.stat().st_size for path in (folder / "whole").rglob("*") if path.is_file())
        sizes = list(range(8, used // 1024 + 8 * step_kib, step_kib))
        outcomes: list[str] = []
        wrong: list[str] = []
        for size, found in zip(sizes, isolated(_on_small_disk, sizes, folder), strict=True):
            if isinstance(found, str):
                outcomes.append(found)
                wrong.append(f"disk of {size} KiB: {found}")
                continue
            done, resumed, odd = found
            read_only.append("traceback" if odd else "worked or one sentence")
            fine = done.how in ("worked", "one sentence") and resumed == SAME
            outcomes.append(f"{done.how}, {SAME}" if fine else "wrong")
            wrong += [] if fine else [f"disk of {size} KiB: {done.how}: {done.said} / {resumed}"]
            wrong += [f"read-only disk: {odd}"] if odd else []
        return outcomes, wrong

    try:
        matrix.row("a real disk that is full", "sweep of tables", tried)
        matrix.row("a real read-only disk, seven commands", "run folder", lambda: (read_only, []))
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def crowds(matrix: Matrix, folder: Path, rounds: int, size: int = 4) -> None:
    """Processes that start at once: in one folder, and with folders of their own choice."""

    def start(*arguments: object) -> list[subprocess.Popen[str]]:
        call = [sys.executable, "-m", "humanoid_mjx", "sweep", *map(str, arguments)]
        return [subprocess.Popen(call, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) for _ in range(size)]

    def ended(all_of_them: list[subprocess.Popen[str]]) -> list[tuple[int, str]]:
        said = [process.communicate()[1] for process in all_of_them]
        return [(process.returncode, words) for process, words in zip(all_of_them, said, strict=True)]

    def tried() -> tuple[list[str], list[str]]:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        config, outcomes, wrong = write_config(folder, TINY), [], []
        isolated(_whole, [folder / "whole"], folder)
        for number in range(rounds):
            ends = ended(start(config, "--out", folder / f"one-{number}"))
            refused = [words for code, words in ends if code == 2 and words.startswith("error: ") and words.count("\n") == 1]
            fine = len(refused) == size - 1 and bits(folder / f"one-{number}") == bits(folder / "whole")
            outcomes.append("one trained, the others got a sentence" if fine else "wrong")
            wrong += [] if fine else [str(ends)]
        ends = ended(start(config))
        runs = [path for path in sorted((folder / "runs").iterdir()) if bits(path) == bits(folder / "whole")]
        fine = not any(code for code, _ in ends) and len(runs) == size
        outcomes.append("each trained in a folder of its own" if fine else "wrong")
        wrong += [] if fine else [str(ends)]
        return outcomes, wrong

    matrix.row(f"{size} processes at once", "sweep of tables", tried)


def _at_odd_time(kind: str) -> str:
    """A sweep while the clock is wrong; and what the list of runs says."""
    real, jump = time.time, random.Random(0)
    shift = {"a day back at each look": lambda n: -86_400.0 * n, "ten years ahead": lambda n: 3.2e8,
             "at random by years": lambda n: jump.uniform(-1e9, 1e9)}[kind]  # fmt: skip
    looks = iter(range(10**9))
    time.time = lambda: max(0.0, real() + shift(next(looks)))
    sweep_module.datetime = _Clock  # type: ignore[attr-defined]
    run = Path.cwd() / kind.replace(" ", "-")
    done = command("sweep", write_config(Path.cwd(), TINY), "--out", run)
    os.utime(run / "config.yaml", (4e9, 4e9))
    listed = command("runs", Path.cwd())
    fine = done.how == listed.how == "worked" and bits(run) == bits(Path.cwd() / "whole")
    return "the same bits" if fine else f"wrong: {done.said} {listed.said}"


class _Clock:
    """In the place of `datetime`: its `now` is what `time.time` says."""

    @staticmethod
    def now(zone: Any) -> Any:
        from datetime import datetime

        return datetime.fromtimestamp(time.time(), zone)


def clocks(matrix: Matrix, folder: Path) -> None:
    """Clocks that jump, and a process that stands still for two seconds."""

    def tried() -> tuple[list[str], list[str]]:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        isolated(_whole, [folder / "whole"], folder)
        found = isolated(_at_odd_time, ["a day back at each look", "ten years ahead", "at random by years"], folder)
        context = processes()
        began = context.Event()
        process = context.Process(target=train, args=(TINY, folder / "stopped", began))
        process.start()
        began.wait()
        for sign, seconds in ((signal.SIGSTOP, 2.0), (signal.SIGCONT, 0.0)):
            os.kill(process.pid, sign)
            time.sleep(seconds)
        process.join()
        found.append("the same bits" if bits(folder / "stopped") == bits(folder / "whole") else "wrong: stopped")
        return [word.partition(":")[0] for word in found], [word for word in found if word != "the same bits"]

    matrix.row("clock that jumps, process that is stopped", "sweep of tables", tried)
