"""Files: those that ship with the package, configs and policies, found by name; and those that are written whole."""

import contextlib
import errno
import hashlib
import os
from collections.abc import Iterator
from pathlib import Path

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
        with temporary.open("rb") as file:
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
def refusing(path: Path) -> Iterator[None]:
    """Turn errors of the system within the block into what to say of a path that cannot be written.

    Raises:
      InputError: there was one.
    """
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}.") from error


def write_text(path: Path, text: str) -> None:
    """Write a text file, as a whole or not at all."""
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


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


def shipped(kind: str, name: str, suffix: str) -> Path:
    """The file `name`: a path, or the name of a shipped one.

    Raises:
      InputError: there is neither.
    """
    path = Path(name)
    refuse_pipe(path)
    if path.suffix == suffix or path.is_file():
        if not path.is_file():
            raise InputError(f"{name}: there is no such file.")
        return path
    path = folder(kind) / f"{name}{suffix}"
    if path.is_file() and path.stem in names(kind, suffix):
        return path
    raise InputError(f"{name}: neither a file nor a shipped {kind[:-1]}; {known(name, names(kind, suffix))}.")
