"""Faults of disks and folders: full, read-only, forbidden, gone, at every write of a sweep."""

import errno
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from fault_trying import FINE, TINY, Matrix, Try, begin, command, completed, isolated, whole, write_config

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


def _sweep_at_fault(case: tuple[str, int]) -> Try:
    """A sweep at whose n-th file operation something happens."""
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
    return completed(done, config, run, f"{kind}, {number}, {trap.sprung}")


def _operations(folder: Path) -> int:
    """Number of file operations of a sweep."""
    _watch()
    trap = Trap(folder / "run", NEVER, print)
    command("sweep", write_config(folder, TINY), "--out", folder / "run")
    TRAPS.clear()
    return NEVER - trap.left


NEVER = 10**9


def at_every_write(matrix: Matrix, kind: str, words: str, folder: Path, most: int) -> None:
    """A fault at the first, second, ... file operation of a sweep, until there are no more."""

    def tried() -> list[Try]:
        begin(folder)
        (count,) = isolated(_operations, [folder], folder)
        return isolated(_sweep_at_fault, [(kind, number) for number in range(1, min(count, most) + 1)], folder)

    matrix.row(words, "sweep of tables", tried)


@contextmanager
def _disk(name: str, size: str) -> Iterator[Path]:
    """A disk of its own."""
    disk = Path.cwd() / name
    disk.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(disk)], check=True)
    sweep_module.check_disk = lambda *_: None  # it would refuse
    try:
        yield disk
    finally:
        subprocess.run(["umount", "-l", str(disk)], check=True)


def _on_small_disk(free_kib: int) -> Try:
    """A sweep on a disk with so much space left; then with more, resumed."""
    with _disk(f"disk-{free_kib}", f"{free_kib}k") as disk:
        config, run = write_config(Path.cwd(), TINY), disk / "run"
        done = command("sweep", config, "--out", run)
        subprocess.run(["mount", "-o", "remount,size=64m", str(disk)], check=True)
        return completed(done, config, run, f"disk of {free_kib} KiB")


def _on_read_only_disk(call: tuple[object, ...]) -> Try:
    """A command on a read-only disk with a finished run in `run`; words are within the disk."""
    with _disk(" ".join(map(str, call)), "64m") as disk:
        whole(disk / "run")
        subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
        os.chdir(disk)
        done = command(*call)
        os.chdir(disk.parent)
    return ("worked or one sentence", "") if done.how in FINE else ("traceback", f"read-only disk: {done.said}")


LOOKS: tuple[tuple[object, ...], ...] = (
    *(("runs", "."), ("report", "run"), ("plot", "run"), ("evaluate", "run", "--json", "x.json")),
    *(("export", "run", "p.npz"), ("sweep", "tables.yaml", "--out", "run", "--resume"), ("sweep", "tables.yaml")),
)
"""Commands on a read-only disk."""


def small_disks(matrix: Matrix, folder: Path, step_kib: int) -> None:
    """Real disks of every size up to what a sweep takes. Needs the right to mount."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "tmpfs", str(folder)], capture_output=True)
    if mounted.returncode:
        matrix.say("disk full, read-only disk: not tried, since mounting is not allowed")
        return

    def tried() -> list[Try]:
        isolated(whole, [folder / "whole"], folder)
        used = sum(path.stat().st_size for path in (folder / "whole").rglob("*") if path.is_file())
        return isolated(_on_small_disk, range(8, used // 1024 + 8 * step_kib, step_kib), folder)

    try:
        matrix.row("a real disk that is full", "sweep of tables", tried)
        read_only = partial(isolated, _on_read_only_disk, LOOKS, folder)
        matrix.row("a real read-only disk, seven commands", "run folder", read_only)
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)
