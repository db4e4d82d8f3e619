"""The run folder: what a sweep leaves on disk, valid at every moment.

    config.yaml         the resolved config
    provenance.json     versions, device, precision, seed, wall and compile times
    results.parquet     one row per sweep point, seed and record step
    summary.parquet     one row per sweep point and seed
    timing.parquet      seconds since training began, per sweep point, seed and record step
    figures/            learning curves and heat maps
    tensorboard/        where asked for: event files, a folder for each sweep point
    policy.npz          the best policy, where trackers follow the sweep
    checkpoint/         part-00000.npz ...: finished runs (curves, scores, policies), by the first of them;
                        pool-0-63.npz ...: those under way, by their chunks; diverged-POINT-SEED.npz: where runs
                        stopped whose numbers were no longer finite

Every file is written beside its place and renamed into it, so a kill leaves the old or the new, never half of one.
Tables, checkpoint files and the provenance hold the digest of the config as `config`, by which one of another run is
refused.
"""

import contextlib
import errno
import json
import logging
import math
import os
import re
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from humanoid_mjx.config import config_digest, dump_yaml, parse, parse_yaml
from humanoid_mjx.files import lock, meant, read_text, refuse_pipe, refusing, whole_file, write_text
from humanoid_mjx.runs.archive import misplaced, read_archive
from humanoid_mjx.spec import InputError

Arrays = Mapping[str, np.ndarray]

THEN = "then"
"""Folder in a run folder of the training that goes on from it."""


class RunFolder:
    """A run folder, locked while this object lives."""

    def __init__(self, path: Path, lock: int, config: Mapping[str, Any]):
        self.path, self.digest = path, config_digest(config)
        self._lock = lock

    @classmethod
    def create(cls, path: Path, config: Mapping[str, Any]) -> "RunFolder":
        """Make a run folder and write its config.

        Raises:
          InputError: the place is taken or cannot be written; nothing is left behind.
        """
        with refusing(path):
            if path.exists() and not _only_begun(path):
                there = (path / "config.yaml").exists()
                words = "exists; resume it with resume=True, or" if there else "exists and is no run folder;"
                raise InputError(f"{path}: already {words} choose another place with out=PATH.")
            check_inside(path)
            (path / "checkpoint").mkdir(parents=True, exist_ok=True)
            run = cls(path, _lock(path), config)
        try:
            if not _only_begun(path):  # another process was quicker
                raise InputError(f"{path}: is in use by another process; choose another place with out=PATH.")
            with refusing(path):
                write_text(path / "config.yaml", dump_yaml(dict(config)))
        except BaseException:
            run.close()
            raise
        return run

    @classmethod
    def resume(cls, path: Path, config: Mapping[str, Any], shared: bool = False) -> "RunFolder":
        """Open a run folder to complete it; one that a kill left before its config was written begins anew.

        `shared`: for this job of an array among others, which complete other runs.

        Raises:
          InputError: there is none, it is in use, or it was made with another config.
        """
        if (path / "checkpoint").is_dir() and _only_begun(path):
            return cls.create(path, config)
        stored = read_config(path)
        with refusing(path):
            run = cls(path, _lock(path, shared), stored)
        moved = config["learner"].get("start_from") == str(path.parent)  # `then` of a folder that stands elsewhere now
        goes_on = "then" in stored
        may = {"modules", *(["learner.start_from"] if moved else []), *([] if goes_on else ["then"])}
        if changed := [key for key in _differences(stored, dict(config)) if key not in may]:
            run.close()
            first = min(changed, key="chunk".__eq__)  # its default follows from the others
            raise InputError(
                f"{path}: was made with another config ({first} differs); "
                "resume with the same values, or choose another place with out=PATH."
            )
        if "then" in config and not goes_on:
            with refusing(path):
                write_text(path / "config.yaml", dump_yaml(stored | {"then": config["then"]}))
        for left_by_a_kill in () if shared else path.rglob(".new-*"):
            left_by_a_kill.unlink()
        return run

    def close(self) -> None:
        """Let other programs write to the folder."""
        os.close(self._lock)

    def write_json(self, name: str, data: dict[str, Any]) -> None:
        """Write plain values, and a checksum of them, as JSON, as a whole or not at all."""
        write_text(self.path / name, json.dumps(data | {"checksum": _checksum(data)}, indent=2) + "\n")

    def write_arrays(self, name: str, arrays: Arrays) -> None:
        """Write a checkpoint file: numpy arrays and the digest of the config, as a whole or not at all."""
        with self.writing(name) as temporary, temporary.open("wb") as file:
            np.savez(file, allow_pickle=False, config=np.array(self.digest), **arrays)

    def writing(self, name: str) -> contextlib.AbstractContextManager[Path]:
        """A temporary path whose file becomes `name` when the block ends well."""
        target = self.path / name
        if target.parent != self.path:  # a run folder that is gone stays so
            target.parent.mkdir(exist_ok=True)
        return whole_file(target)


def diverged_name(point: int, seed: int) -> str:
    """The file of the last training state of a run whose numbers were no longer finite."""
    return f"checkpoint/diverged-{point}-{seed}.npz"


def parts(path: Path) -> list[Path]:
    """The files of finished runs of a run folder."""
    return sorted(part for part in (path / "checkpoint").glob("part-*.npz") if re.fullmatch(r"part-\d+", part.stem))


def pools(path: Path, first: float = -math.inf, last: float = math.inf) -> list[Path]:
    """The files of the runs that a run folder has under way, the newest first; of some chunks by their numbers."""
    files = [(os.stat(file).st_mtime, file) for file in (path / "checkpoint").glob("pool-*.npz") if file.exists()]
    names = {file: re.fullmatch(r"pool-(\d+)-(\d+)", file.stem) for _, file in sorted(files, reverse=True)}
    return [file for file, name in names.items() if not name or (int(name[1]) <= last and int(name[2]) >= first)]


def read_arrays(path: Path, prefixes: tuple[str, ...] = ("",), digest: str | None = None) -> dict[str, np.ndarray]:
    """The arrays of one checkpoint file whose names start with one of `prefixes`.

    `digest`: that of its run's config; by default of `config.yaml`.

    Raises:
      InputError: the file is truncated, damaged or of another run, or cannot be read.
    """
    arrays = read_archive(path, (*prefixes, "config"), damage=f"this file is truncated or damaged; {REMOVE}")
    stored = arrays.pop("config", np.array(None)).tolist()
    if how := misplaced(stored, digest or config_digest(read_config(path.parent.parent))):
        raise damaged(path, how)
    return arrays


REMOVE = "remove it, and --resume trains its runs again"
"""The cure of a damaged file of the checkpoint."""


def damaged(path: Path, how: str = "is truncated or damaged") -> InputError:
    """The error of a file of a run folder that cannot be used, with its cure: tables and provenance are made anew."""
    made_anew = path.suffix in (".parquet", ".json")
    return InputError(f"{path}: this file {how}; {'--resume the run to write it again' if made_anew else REMOVE}.")


def read_config(path: Path) -> dict[str, Any]:
    """The resolved config of a run folder as plain values.

    Raises:
      InputError: `path` is no run folder, or its config is none.
    """
    file = path / "config.yaml"
    if not file.exists():
        raise InputError(f"{path}: this is no run folder (it holds no config.yaml){meant(str(path), 'run')}.")
    check_inside(path)
    data = parse_yaml(read_text(file), str(file))
    if not isinstance(data, dict):
        raise InputError(f"{file}: this file is damaged.")
    parse(data, str(file))
    return data


def check_inside(path: Path, below: Path | None = None) -> None:
    """Raise an InputError if a folder holds a link that leads out of it, a pipe, a socket or a device, or cannot be
    read: a run folder of a stranger may hold links to anything."""
    try:
        with os.scandir(below or path) as entries:
            for entry in entries:
                if entry.is_symlink() and not Path(entry).resolve().is_relative_to(path.resolve()):
                    raise InputError(f"{entry.path}: this link leads out of {path}; put its target in its place.")
                if entry.is_dir(follow_symlinks=False):
                    check_inside(path, Path(entry))
                elif not entry.is_file(follow_symlinks=False):
                    refuse_pipe(Path(entry))
    except (FileNotFoundError, NotADirectoryError):
        pass  # nothing to read: a place to write to, or a folder that another process has just removed
    except (OSError, RuntimeError) as error:  # links that lead to each other
        raise InputError(f"{below or path}: cannot be read: {error}.") from error


def _checksum(data: dict[str, Any]) -> int:
    return zlib.crc32(json.dumps(data).encode())


def read_provenance(path: Path) -> dict[str, Any]:
    """The content of a run folder's `provenance.json`; empty where there is none.

    Raises:
      InputError: the file is damaged or of another run, or cannot be read.
    """
    file = path / "provenance.json"
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
        if found.pop("checksum", None) not in (None, _checksum(found)):  # older runs have none
            raise ValueError("a value was changed")
        if not all(math.isfinite(each["wall_s"] + each["compile_s"]) for each in found.get("sessions", [])):
            raise ValueError("a time that is none")
    except FileNotFoundError:
        return {}
    except PermissionError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror}.") from error
    except (OSError, ValueError, RecursionError, LookupError, TypeError, AttributeError) as error:
        raise damaged(file) from error
    if "config" in found and (how := misplaced(found["config"], config_digest(read_config(path)))):
        raise damaged(file, how)
    return found


def run_path(name: str, resume: bool = False, root: Path = Path("runs")) -> Path:
    """Return the path after the last of runs/name, runs/name-2, runs/name-3, ..., or to `resume` the last of them.
    Raise an InputError if there is none to resume."""
    form, paths = re.compile(rf"{re.escape(name)}(?:-(\d+))?"), root.iterdir() if root.is_dir() else ()
    numbers = [int(match[1] or 1) for path in paths if (match := form.fullmatch(path.name))]
    if resume and not numbers:
        raise InputError(f"{root / name}: there is no run to resume; leave resume out to begin one.")
    number = max(numbers, default=0) + (not resume)
    return root / (name if number == 1 else f"{name}-{number}")


def disk_used(path: Path) -> int:
    """The bytes of all files below a folder."""
    size = 0
    for file in path.rglob("*"):
        with contextlib.suppress(FileNotFoundError):  # renamed meanwhile by a sweep that writes
            size += file.lstat().st_size * (not file.is_dir())
    return size


def _only_begun(path: Path) -> bool:
    """True if a folder holds nothing, or what a kill leaves of a run folder before it has a config."""
    checkpoint = path / "checkpoint"
    if not path.is_dir() or (checkpoint.is_dir() and any(checkpoint.iterdir())):
        return False
    left = {".lock", ".new-config.yaml"} | ({"checkpoint"} if checkpoint.is_dir() else set())
    return {entry.name for entry in path.iterdir()} <= left


def _lock(path: Path, shared: bool = False) -> int:
    handle = os.open(path / ".lock", os.O_RDWR | os.O_CREAT, 0o644)
    try:
        lock(handle, shared)
    except OSError as error:
        if error.errno in (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP):
            words = "%s: this file system has no locks; let no other sweep write there."
            logging.getLogger(__name__).warning(words, path)
            return handle
        os.close(handle)
        if error.errno not in (errno.EWOULDBLOCK, errno.EACCES):
            raise
        raise InputError(f"{path}: is in use by another process; wait for it, or choose another place.") from error
    return handle


def _differences(old: Any, new: Any, key: str = "") -> list[str]:
    """The dotted keys in which two configs differ."""
    if isinstance(old, dict) and isinstance(new, dict):
        keys = sorted(set(old) | set(new), key=str)
        return [d for k in keys for d in _differences(old.get(k), new.get(k), f"{key}.{k}".lstrip("."))]
    return [] if old == new else [key]
