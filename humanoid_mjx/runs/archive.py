"""Archives of numpy arrays, read so that a damaged one, or one of another run, is never taken for the right one."""

import struct
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from humanoid_mjx.files import refuse_pipe
from humanoid_mjx.spec import InputError

DAMAGE = (
    *(OSError, ValueError, EOFError, LookupError, TypeError, AttributeError, zipfile.BadZipFile, zlib.error),
    *(struct.error, SyntaxError, tokenize.TokenError, NotImplementedError, RuntimeError, OverflowError, MemoryError),
)
"""Errors of numpy and zipfile on damaged files: numpy parses the header of an array as Python, and a flipped bit can
ask for a password, for another compression, or for more memory than there is."""

MOST = 1 << 24
"""Bytes that the arrays of a small file may have."""

HEADER = 1 << 10
"""Bytes of an array, at most, beside its numbers."""


def read_archive(
    path: Path,
    prefixes: tuple[str, ...] = ("",),
    most: int | None = None,
    damage: str = "this file is truncated or damaged",
) -> dict[str, np.ndarray]:
    """The arrays of a file that `numpy.savez` wrote whose names start with one of `prefixes`.

    `numpy.load` stops where an array's shape says so, and checks no sum of what it has not read to the end: a flipped
    bit of a shape would pass for a shorter array. Here every byte is read, and the shape must take them all. Sizes are
    compared before anything is inflated, since a file of a megabyte may hold gigabytes of zeros: all the arrays have at
    most `most` bytes, by default those of the file, which `savez` does not compress, or `MOST`.

    Raises:
      InputError: the file cannot be read, it is too large, or it is damaged, which the words `damage` say.
    """
    refuse_pipe(path)
    try:
        with zipfile.ZipFile(path) as archive:
            wanted = [member for member in archive.infolist() if member.filename.startswith(prefixes)]
            size, most = sum(member.file_size for member in wanted), most or max(MOST, path.stat().st_size)
            if size > most:
                words = f"{size:,} bytes, and {most:,} are the most; {damage}"
                raise InputError(f"{path}: what it holds does not fit: {words}.")
            return {member.filename.removesuffix(".npy"): _array(archive, member) for member in wanted}
    except DAMAGE as error:
        if isinstance(error, InputError):
            raise
        words = f"cannot be read: {error.strerror}" if isinstance(error, PermissionError) else damage
        raise InputError(f"{path}: {words}.") from error


def misplaced(stored: object, digest: str) -> str | None:
    """The fault of a file that stores this digest of a config, or None, in the folder of a run of `digest`; None where
    it is that run's own."""
    if stored is None:
        return "is truncated or damaged: it does not say which run it belongs to"
    return None if stored == digest else "belongs to another run, or config.yaml was edited (then undo that)"


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError("a compression that is not numpy's, which zipfile inflates without limit")
    with archive.open(member) as file:
        array = np.lib.format.read_array(file, allow_pickle=False)
        if file.read(1):  # at its end its checksum is compared
            raise ValueError("an array that is shorter than its file")
    return array


def check_finite(
    arrays: Mapping[str, np.ndarray],
    what: str,
    then: str = "choose another run, or train again with a smaller learning rate",
) -> None:
    """Raise an InputError if a number is not finite; the words `what` and `then` begin and end it."""
    for name, array in arrays.items():
        if array.dtype.kind in "fc" and not np.isfinite(array).all():
            raise InputError(f"{what} holds numbers that are not finite, in {name}; {then}.")
