"""Faults of disks and folders: full, read-only, forbidden, gone, at every write of a sweep."""

import errno
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fault_trying import SAME, TINY, Done, Matrix, bits, command, isolated, whole, write_config

from humanoid_mjx.training import sweep as sweep_module

AT_A_WRITE = {
    "full": "disk is full at one of the writes",
    "read-only": "disk is read-only at one of the writes",
    "forbidden": "writing is forbidden at one of the writes",
    "vanished": "folder is gone at one of the writes",
}
"""Faults at each write of a sweep in turn."""


class Trap:
    """Does something at the n-th time that a file below a folder is opened for writing, renamed, or a folder made."""

    def __init__(self, below: Path, number: int, act: Callable[[str], None]):
        self.below, self.left, self.act, self.sprung = str(below), number, act, ""
        TRAPS[:] = [self]

    def look(self, event: str, args: tuple[Any, ...]) -> None:
        """Count one operation."""
        writes = (
            event == "os.rename"
            or (event == "os.mkdir" and not os.path.isdir(args[0]))
            or (event == "open" and isinstance(args[2], int) and args[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))
        )
        if not writes or not os.path.abspath(str(args[0])).startswith(self.below):
            return
        self.left -= 1
        if self.left == 0:
            self.sprung = f"{event} {Path(str(args[0])).name}"
            self.act(str(args[0]))


TRAPS: list[Trap] = []


def _watch() -> None:
    """Let Python tell the trap what it does with files."""
    if not getattr(sys, "watched", False):
        sys.addaudithook(
            lambda event, args: TRAPS[0].look(event, args) if TRAPS and event[:2] in ("op", "os") else None
        )
        setattr(sys, "watched", True)  # noqa: B010


def _sweep_at_fault(case: tuple[str, int]) -> tuple[str, Done, str]:
    """A sweep at whose n-th file operation something happens: which, what the sweep says, and how it resumes."""
    kind, number = case
    _watch()
    here = Path.cwd() / f"{kind}-{number}"
    here.mkdir()
    config, run = write_config(here, TINY), here / "run"

    def fail(place: str) -> None:
        TRAPS.clear()
        if kind == "vanished":  # at once: what removes file by file races with what another thread writes
            run.rename(here / "gone")
        else:
            code = {"full": errno.ENOSPC, "read-only": errno.EROFS, "forbidden": errno.EACCES}[kind]
            raise OSError(code, os.strerror(code), place)

    trap = Trap(run, number, fail)
    done = command("sweep", config, "--out", run)
    TRAPS.clear()
    again = command("sweep", config, "--out", run, *(["--resume"] if (run / "checkpoint").is_dir() else []))
    same = again.how == "worked" and bits(run) == bits(Path.cwd() / "whole")
    return trap.sprung, done, SAME if same else f"not resumed: {again.said}"


def _operations(folder: Path) -> int:
    """How many file operations a sweep has."""
    _watch()
    trap = Trap(folder / "run", NEVER, print)
    command("sweep", write_config(folder, TINY), "--out", folder / "run")
    TRAPS.clear()
    return NEVER - trap.left


NEVER = 10**9


def at_every_write(matrix: Matrix, kind: str, words: str, folder: Path, most: int) -> None:
    """A fault at the first, second, ... file operation of a sweep, until there are no more."""

    def tried() -> tuple[list[str], list[str]]:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        outcomes: list[str] = []
        wrong: list[str] = []
        isolated(whole, [folder / "whole"], folder)
        (count,) = isolated(_operations, [folder], folder)
        cases = [(kind, number) for number in range(1, min(count, most) + 1)]
        for number, found in enumerate(isolated(_sweep_at_fault, cases, folder), 1):
            if isinstance(found, str):
                outcomes.append(found)
                wrong.append(f"{words} at write {number}: {found}")
                continue
            sprung, done, resumed = found
            fine = done.how in ("one sentence", "worked") and resumed == SAME
            outcomes.append(f"{done.how}, {SAME}" if fine else "wrong")
            wrong += [] if fine else [f"{words}, {number}, {sprung}: {done.how}: {done.said} / {resumed}"]
        return outcomes, wrong

    matrix.row(words, "sweep of tables", tried)


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
            *(
                ("sweep", config, "--out", run, "--resume"),
                ("export", run, disk / "p.npz"),
                ("sweep", config, "--out", disk / "b"),
            ),
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
        isolated(whole, [folder / "whole"], folder)
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
