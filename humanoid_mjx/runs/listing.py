"""A list of run folders: what each trained, how far it is, and how its best point does."""

from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from humanoid_mjx.config import parse
from humanoid_mjx.config.axes import sweep_points
from humanoid_mjx.files import SHOWN, lock, meant, refusing
from humanoid_mjx.runs.folder import THEN, damaged, disk_used, pools, read_arrays, read_config, read_provenance
from humanoid_mjx.runs.ranking import ranked
from humanoid_mjx.runs.tables import all_runs, read_table, run_numbers
from humanoid_mjx.spec import InputError


class Listed(NamedTuple):
    """A run folder in a few words and numbers."""

    path: Path
    config: str
    """The name of its config."""
    task: str
    learner: str
    points: int
    seeds: int
    state: str
    """`finished`, `training` or `interrupted`."""
    share: float
    """Share of the training that is done."""
    success: float
    """Share of greedy episodes of the best point that succeed: the mean over seeds. NaN where no run is finished."""
    greedy_return: float
    """Return of greedy episodes of the best point: the interquartile mean over seeds. NaN as above."""
    diverged: int
    """Runs that stopped at numbers that were not finite."""
    started: datetime
    size: int
    """Bytes on disk."""


def list_runs(folder: Path) -> tuple[list[Listed], list[str]]:
    """The run folders directly in `folder`, or `folder` itself where it is one; the oldest first.

    Returns:
      the run folders; and a sentence for each that is broken, and one for all folders that are none.

    Raises:
      InputError: there is no such folder, or it cannot be read.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder{meant(str(folder), 'run')}.")
    with refusing(folder, "read"):
        inside = [path for path in sorted(folder.iterdir()) if path.is_dir() and not path.name.startswith(".")]
    found, problems = [], []
    if (folder / "config.yaml").is_file():
        inside = [folder]
    foreign = [path for path in inside if not any((path / name).exists() for name in ("config.yaml", "checkpoint"))]
    if foreign:
        more = f" and {len(foreign) - SHOWN} more" if len(foreign) > SHOWN else ""
        kind = "no run folders (they hold" if len(foreign) > 1 else "this is no run folder (it holds"
        problems.append(f"{', '.join(map(str, foreign[:SHOWN]))}{more}: {kind} no config.yaml).")
    own = [run for run in inside if run not in foreign]
    for path in [each for run in own for each in (run, run / THEN) if each.is_dir()]:
        try:
            with refusing(path, "read"):
                found.append(look_at(path))
        except InputError as error:
            problems.append(str(error))
    return sorted(found, key=lambda run: run.started), problems


def look_at(path: Path) -> Listed:
    """Describe a run folder; raise an InputError if it is none, or what it holds is damaged."""
    config, provenance = read_config(path), read_provenance(path)
    try:
        seeds = int(config.get("seeds", 1))
        sweep = parse(config, str(path / "config.yaml")).sweep
        points = int(provenance.get("points", 0)) or (len(sweep_points(sweep, config["seed"])) if sweep else 1)
        started = _started(path, provenance)
        runs = seeds * sum(points // factor for factor in (sweep.factors if sweep else [1]))
        share = _share(path, runs, points, seeds, provenance)
        success, greedy_return, diverged = _outcome(path, config)
        named = (str(config["name"]), str(config["task"]["name"]), str(config["learner"]["name"]))
    except InputError:
        raise
    except (LookupError, TypeError, ValueError, ArithmeticError) as error:
        raise InputError(f"{path}: its config, provenance and tables do not fit together.") from error
    waits = "then" in config and not (path / THEN).is_dir()
    state = "finished" if share >= 1.0 and not waits else "training" if _in_use(path) else "interrupted"
    return Listed(path, *named, points, seeds, state, share, success, greedy_return, diverged, started, disk_used(path))


def _started(path: Path, provenance: Mapping[str, Any]) -> datetime:
    if "started" in provenance:
        found = datetime.fromisoformat(provenance["started"])
        return (found if found.tzinfo else found.replace(tzinfo=UTC)).astimezone(UTC)
    return datetime.fromtimestamp((path / "config.yaml").stat().st_mtime, UTC)


def _share(path: Path, runs: int, points: int, seeds: int, provenance: Mapping[str, Any]) -> float:
    """Share of all runs that is trained: of finished ones all, of those under way as their checkpoint says."""
    if runs < 1:
        raise ValueError("no runs")
    if provenance.get("runs_finished") == runs:
        return 1.0
    finished = run_numbers(all_runs(path, ("point", "seed")), points, seeds)
    if len(finished) >= runs:
        return 1.0
    under_way: dict[int, float] = {}
    for file in reversed(pools(path)):
        try:
            pool = read_arrays(file, ("slots", "progress"))
        except InputError:
            if file.exists():
                raise
            continue  # its runs have ended meanwhile
        try:
            waits = (pool["slots"] >= 0) & ~np.isin(pool["slots"], finished)
            shares = np.minimum(pool["progress"][waits], 1.0).tolist()
            under_way |= zip(pool["slots"][waits].tolist(), shares, strict=True)
        except (LookupError, TypeError, ValueError) as error:
            raise damaged(file, "does not fit this training") from error
    return min((len(finished) + sum(under_way.values())) / runs, 0.999)


def _outcome(path: Path, config: Mapping[str, Any]) -> tuple[float, float, int]:
    """Success and return of the best point, and how many runs diverged."""
    if not (path / "summary.parquet").is_file():
        return float("nan"), float("nan"), 0
    summary = read_table(path / "summary.parquet")
    best = ranked((), summary, quickest=bool(config.get("episodes")))[0]
    return best.success, best.greedy_return, int(np.sum(summary["diverged"]))


def _in_use(path: Path) -> bool:
    """True if a process, or several that share the folder, holds its lock."""
    with suppress(OSError), (path / ".lock").open("rb") as file:  # some file systems lock only what may be written
        try:
            lock(file.fileno())
        except BlockingIOError:
            return True
    return False
