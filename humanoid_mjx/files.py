"""Files: those that ship with the package, configs and policies, found by name; and those that are written whole."""

import contextlib
import difflib
import errno
import hashlib
import importlib
import json
import os
import re
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from humanoid_mjx.environment import of_system
from humanoid_mjx.spec import InputError, known

_PACKAGE = Path(__file__).parent

DIGEST = hashlib.sha256().digest_size
"""Bytes of a digest."""


def folder(name: str) -> Path:
    """The folder `name`: inside the package when installed, beside it in a checkout."""
    inside = _PACKAGE / name
    return inside if inside.is_dir() else _PACKAGE.parent / name


def refuse_pipe(path: Path) -> None:
    """Raise an InputError where a pipe, a socket or a device stands: to read one may wait forever or never end."""
    if path.exists() and not path.is_file() and not path.is_dir():
        raise InputError(f"{path}: this is a pipe, a socket or a device, and no file.")


def read_text(path: Path) -> str:
    """Return the text of a file.

    Raises:
      InputError: there is none, it cannot be read, or it is not UTF-8.
    """
    refuse_pipe(path)
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is not UTF-8; save it as UTF-8"
        raise InputError(f"{path}: cannot be read as text: {why}.") from error


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A temporary path beside `path`, whose file takes its place when the block ends well.

    A kill, an error or a full disk leaves the old file or the new one, never half of one.

    Raises:
      InputError: a pipe, a socket or a device stands at `path`.
    """
    refuse_pipe(path)
    temporary = path.with_name(f".new-{path.name}")
    try:
        if temporary.is_symlink() or not temporary.is_file():
            temporary.unlink(missing_ok=True)  # it would lead elsewhere
        yield temporary
        with temporary.open("rb+") as file:  # Windows flushes only what may be written
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        if error.filename is None or (Path(error.filename) == temporary and error.errno != errno.EISDIR):
            error.filename = str(path)  # writing to an open file names none
        raise
    finally:
        with contextlib.suppress(OSError):  # what went wrong before is what there is to say
            temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def refusing(path: Path, done: str = "written") -> Iterator[None]:
    """Turn an error of the system within the block into an InputError that says that a path cannot be `done`."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be {done}: {of_system(error)}.") from error


def lock(handle: int, shared: bool = False) -> None:
    """Lock an open file for this process, or `shared` for several; Windows, which has no such locks, lets these be.

    Raises:
      BlockingIOError: another process holds it.
      OSError: the file system has no locks.
    """
    try:
        import fcntl
    except ImportError:
        _lock_on_windows(handle, shared)
    else:
        fcntl.flock(handle, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)


def _lock_on_windows(handle: int, shared: bool) -> None:
    msvcrt: Any = importlib.import_module("msvcrt")
    os.lseek(handle, 0, os.SEEK_SET)
    try:
        msvcrt.locking(handle, msvcrt.LK_UNLCK if shared else msvcrt.LK_NBLCK, 1)
    except OSError as error:
        if not shared:  # then there was no lock to give up
            raise BlockingIOError(errno.EWOULDBLOCK, os.strerror(errno.EWOULDBLOCK)) from error


def write_text(path: Path, text: str) -> None:
    """Write a text file, as a whole or not at all."""
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path, data: Any, indent: int | None = None) -> None:
    """Write plain values as JSON, which has no NaN and no infinity: null stands in their place."""
    plain = json.loads(json.dumps(data), parse_constant=lambda _: None)
    write_text(path, json.dumps(plain, indent=indent) + "\n")


def write_sealed(path: Path, data: bytes, seal: bytes = b"") -> None:
    """Write data whole, with its digest and a seal that says what it follows from; the folder is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary:
        temporary.write_bytes(seal + hashlib.sha256(data).digest() + data)


def read_sealed(path: Path, seal: bytes = b"") -> bytes | None:
    """Return what `write_sealed` wrote there; None if there is no such file, it has another seal or is damaged.

    Raises:
      OSError: it cannot be read.
    """
    if not path.is_file():
        return None
    found, begin = path.read_bytes(), len(seal) + DIGEST
    whole = found[:begin] == seal + hashlib.sha256(found[begin:]).digest()
    return found[begin:] if whole else None


def names(kind: str, suffix: str) -> list[str]:
    """The names of what ships in a folder."""
    return sorted(path.stem for path in folder(kind).glob(f"*{suffix}") if not path.stem.startswith("_"))


def find_config(name: str) -> Path:
    """Return the file of a config: a path, or the name of a shipped one. Raise an InputError if there is neither."""
    path, shipping = Path(name), names("configs", ".yaml")
    refuse_pipe(path)
    if path.is_file() and kind_of(path) in ("config", None):
        return path
    if name in shipping and not path.is_file():
        return folder("configs") / f"{name}.yaml"
    missing = "there is no such file" if path.suffix == ".yaml" else "neither a file nor a shipped config"
    instead = meant(name, "config") or f"; {known(name, shipping, 'info')}"
    raise InputError(f"{name}: {'this is no config' if path.is_file() else missing}{instead}.")


KINDS = {
    "config": "a config: humanoid-mjx sweep {0} trains it",
    "robot": "a robot: humanoid-mjx info {0} shows it, humanoid-mjx sweep stand --set task.robot={0} trains it",
    "policy": "a policy: humanoid-mjx play {0} shows it",
    "model": "an MJCF: humanoid-mjx info {0} shows it, and a YAML beside it with the keys model and feet "
    "makes it a robot (docs/your_robot.md)",
    "urdf": "a URDF: humanoid-mjx info {0} says how it becomes an MJCF",
    "run": "a run folder: humanoid-mjx report {0} shows it, and "
    "humanoid-mjx sweep {0}/config.yaml --out {0} --resume completes it",
}
"""Kinds of things that a name stands for, with the words to type."""

ENDINGS = {".yaml": "config", ".yml": "config", ".npz": "policy", ".xml": "model", ".urdf": "urdf"}


def kind_of(path: Path) -> str | None:
    """The entry of `KINDS` that a path is; None if it is none."""
    if (path / "config.yaml").is_file():
        return "run"
    kind = ENDINGS.get(path.suffix) if path.is_file() else None
    if kind == "config":
        with contextlib.suppress(OSError):
            keys = set(re.findall(r"\b(model|task)\b[\"']?\s*:", path.read_text(encoding="utf-8", errors="replace")))
            return "robot" if keys == {"model"} else kind
    return kind


def meant(name: str, *wanted: str, folders: Sequence[str] = (".",)) -> str:
    """Words that end the refusal of a name that is none of the `wanted` kinds: files and run folders beside it that
    are, else what it is and what to type for it; empty if nothing is found.

    `folders`: where files are looked for.
    """
    with contextlib.suppress(OSError, ValueError):  # names that no file can have
        path, stem = Path(name), os.path.splitext(name)[0]
        tries = [name, *(each + ending for ending in ENDINGS for each in (name, stem)), f"runs/{name}", *path.parents]
        tries += (inside for inside in sorted(path.glob("*")) if inside.is_dir())
        there = {str(each): kind for each in tries for here in folders if (kind := kind_of(Path(here, each)))}
        for place, kind in (("configs", "config"), ("policies", "policy"), ("robots", "robot")):
            there |= dict.fromkeys({name, stem} & {each.stem for each in folder(place).glob("*")}, kind)
        found = [each for each, kind in there.items() if kind in wanted and each != name]
        if not found:  # perhaps a letter is wrong
            files = [path.parent / file.name for here in folders for file in Path(here, path.parent).glob("*.*")]
            files += Path("runs").glob("*")
            near = difflib.get_close_matches(path.stem, {file.stem for file in files}, n=1, cutoff=0.8)
            files = [str(file) for file in files if file.stem in near and str(file) != name]
            found = [file for file in files if any(kind_of(Path(here, file)) in wanted for here in folders)]
        if found:
            more = f" and {len(found) - SHOWN} more" if len(found) > SHOWN else ""
            return f", but {' and '.join(found[:SHOWN])}{more} {'are' if len(found) > 1 else 'is one'}"
        for _, each, kind in sorted(
            (kind != "robot", each, kind) for each, kind in there.items() if kind not in wanted
        ):
            return f"; {'it' if each == name else each} is {KINDS[kind].format(shlex.quote(each))}"
    return ""


SHOWN = 5
"""Names of files and run folders in a refusal."""
