"""Bytes on disk: what a folder takes, and how to say it."""

import os
from pathlib import Path


def disk_used(path: Path) -> int:
    """The bytes of all files below a folder."""
    sizes = 0
    for place, _, names in os.walk(path):
        for name in names:
            try:
                sizes += os.lstat(os.path.join(place, name)).st_size
            except FileNotFoundError:  # renamed meanwhile by a sweep that writes
                continue
    return sizes


def in_words(size: float) -> str:
    """A number of bytes for a reader: `831 B`, `4.2 MiB`, `763 GiB`."""
    for unit in ("B", "KiB", "MiB", "GiB"):
        if size < 1000:
            return f"{size:.0f} {unit}" if unit == "B" or size >= 100 else f"{size:.1f} {unit}"
        size /= 1024
    return f"{size:,.1f} TiB"
