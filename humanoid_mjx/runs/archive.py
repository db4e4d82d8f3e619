"""Archives of numpy arrays, read so that a damaged one, or one of another run, is never taken for the right one."""

import io
import struct
import tokenize
import zipfile
import zlib
from pathlib import Path

import numpy as np

DAMAGE = (
    *(OSError, ValueError, EOFError, LookupError, TypeError, AttributeError, zipfile.BadZipFile, zlib.error),
    *(struct.error, SyntaxError, tokenize.TokenError, NotImplementedError, RuntimeError, OverflowError, MemoryError),
)
"""Errors of numpy and zipfile on damaged files: numpy parses the header of an array as Python, and a flipped bit can
ask for a password, for another compression, or for more memory than there is."""

HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def read_archive(path: Path, prefixes: tuple[str, ...] = ("",)) -> dict[str, np.ndarray]:
    """The arrays of a file that `numpy.savez` wrote whose names start with one of `prefixes`, not to be written to.

    `numpy.load` stops where an array's shape says so, and checks no sum of what it has not read to the end: a flipped
    bit of a shape would pass for a shorter array. Here every byte is read, and the shape must take them all.

    Raises:
      one of `DAMAGE`: the file is truncated or damaged, or holds something else.
    """
    with zipfile.ZipFile(path) as archive:
        wanted = [name for name in archive.namelist() if name.startswith(prefixes)]
        return {name.removesuffix(".npy"): _array(archive.read(name)) for name in wanted}


def misplaced(stored: object, digest: str) -> str | None:
    """The fault of a file that stores this digest of a config, or None, in the folder of a run of `digest`; None where
    it is that run's own."""
    if stored is None:
        return "is truncated or damaged: it does not say which run it belongs to"
    return None if stored == digest else "belongs to another run, or config.yaml was edited (then undo that)"


def _array(data: bytes) -> np.ndarray:
    file = io.BytesIO(data)
    shape, fortran_order, dtype = HEADERS[np.lib.format.read_magic(file)](file)
    if dtype.hasobject:
        raise ValueError("an array of Python objects")
    array = np.frombuffer(data, dtype, offset=file.tell()) if file.tell() < len(data) else np.empty(0, dtype)
    return array.reshape(shape, order="F" if fortran_order else "C")
