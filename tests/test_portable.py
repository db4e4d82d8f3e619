"""Other systems, by what they lack: modules of Unix, and its locks."""

import errno
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from small_sweep import CONFIG

from humanoid_mjx import InputError
from humanoid_mjx.compute.limits import available_memory
from humanoid_mjx.runs.folder import RunFolder
from humanoid_mjx.runs.listing import _in_use

ROOT = Path(__file__).parent.parent
UNIX_ONLY = ("fcntl", "grp", "nis", "posix", "pty", "pwd", "resource", "syslog", "termios", "tty")

IMPORT_ALL = f"""
import builtins, importlib, os, pkgutil, sys
whole = builtins.__import__

def hiding(name, scope=None, *rest):
    if name in {UNIX_ONLY} and (scope or {{}}).get("__name__", "").startswith("humanoid_mjx"):
        raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
    return whole(name, scope, *rest)

builtins.__import__ = hiding
del os.sched_getaffinity, os.sysconf
import humanoid_mjx
count = 0
for module in pkgutil.walk_packages(humanoid_mjx.__path__, "humanoid_mjx."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)
        count += 1
print(count)
"""


def test_every_module_is_imported_without_modules_of_unix():
    environment = os.environ | {"PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg"}
    done = subprocess.run([sys.executable, "-c", IMPORT_ALL], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr[-2000:]
    assert int(done.stdout.split()[-1]) > 200


@pytest.fixture
def windows(monkeypatch):
    """`msvcrt` in place of `fcntl`: locks of one handle for each file, which refuse all others."""
    held = {}

    def locking(handle, kind, size):
        assert size == 1 and os.lseek(handle, 0, os.SEEK_CUR) == 0
        file = os.fstat(handle).st_ino
        if kind == 0:
            if held.get(file) != handle:
                raise PermissionError(errno.EACCES, "not locked")
            del held[file]
        elif held.setdefault(file, handle) != handle:
            raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setitem(sys.modules, "fcntl", None)
    monkeypatch.setitem(sys.modules, "msvcrt", SimpleNamespace(locking=locking, LK_UNLCK=0, LK_NBLCK=2))
    return held


def test_a_run_folder_is_locked_on_windows(windows, tmp_path):
    folder = RunFolder.create(tmp_path / "run", CONFIG)
    with pytest.raises(InputError, match="run: is in use by another process"):
        RunFolder.resume(tmp_path / "run", CONFIG)
    assert _in_use(tmp_path / "run")
    folder.close()
    windows.clear()
    jobs = [RunFolder.resume(tmp_path / "run", CONFIG, shared=True) for _ in range(2)]
    for job in jobs:
        job.close()
    windows.clear()  # closing gives a lock up
    RunFolder.resume(tmp_path / "run", CONFIG).close()


def test_memory_is_guessed_where_the_system_does_not_say_it(monkeypatch):
    monkeypatch.setattr(Path, "is_file", lambda path: False)
    monkeypatch.delattr(os, "sysconf")
    assert available_memory() == 4 << 30
