"""Columns of the tables of several runs, side by side, and what they are called on a figure."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from humanoid_mjx.report.figures import COUNTED, CURVES, HEAT_MAPS
from humanoid_mjx.runs.folder import read_config
from humanoid_mjx.runs.tables import column_names, read_table
from humanoid_mjx.spec import InputError, known

RUN = "run"
"""The column that several runs are told apart by."""

RECORD = "record"
"""The column that says which record point of its run a row is."""

TIME = "wall_s"

NAMES = {
    **CURVES,
    **HEAT_MAPS,
    **COUNTED,
    TIME: "seconds of training",
    "greedy_return": "return of a greedy episode (undiscounted)",
    "diverged": "share of runs that diverged",
}
"""Labels of columns on an axis."""


class Rows(NamedTuple):
    """Rows of the tables of all runs, side by side: of their learning curves, or one for each point and seed."""

    columns: dict[str, np.ndarray]
    """By name: those asked for, `run`, `point`, `seed` and `record`."""
    runs: list[str]
    """Their names."""
    axes: list[str]
    """The parameters that any of the runs swept."""
    counter: str
    """The column that counts the training: `episode` or `step`."""


def read_rows(paths: Sequence[Path], x: str | None, y: str, by: str | None) -> Rows:
    """The rows that a figure needs.

    They are of learning curves where `x` (by default) or `by` says how far the training is, else of final values.

    Raises:
      InputError: no run folder, a column that a run does not have, or runs that count their training in other units.
    """
    names = [path.resolve().name for path in paths]
    names = names if len(set(names)) == len(names) else [str(path) for path in paths]
    if doubled := [name for name in names if names.count(name) > 1]:
        raise InputError(f"plot: {doubled[0]} is named twice.")
    configs = [read_config(path) for path in paths]
    available = [column_names(path / "results.parquet") for path in paths]
    if missing := [path for path, columns in zip(paths, available, strict=True) if not columns]:
        raise InputError(f"{missing[0]}: no run in it is finished yet.")
    counters = ["step" if "step" in columns else "episode" for columns in available]
    if len(set(counters)) > 1:
        few, many = counters.index("episode"), counters.index("step")
        raise InputError(f"plot: {names[few]} counts episodes and {names[many]} control steps; plot them apart.")
    x = x or counters[0]
    curves = bool({x, y, by} & {*COUNTED, TIME})
    wanted = [name for name in dict.fromkeys((x, y, by, "point", "seed")) if name and name != RUN]
    tables = [_read(path, wanted, curves) for path in paths]
    columns = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    columns[RUN] = np.repeat(np.array(names, object), [len(table["point"]) for table in tables])
    axes = dict.fromkeys(axis for config in configs for axis in (config.get("sweep") or {}).get("axes", {}))
    return Rows(columns, names, list(axes), counters[0])


def _read(path: Path, wanted: Sequence[str], curves: bool) -> dict[str, np.ndarray]:
    """The columns of one run, and `record`."""
    file = path / ("results.parquet" if curves else "summary.parquet")
    timing, there = path / "timing.parquet", column_names(file)
    timed = curves and TIME in column_names(timing)
    for name in wanted:
        if name not in there and not (timed and name == TIME):
            if name in column_names(path / "summary.parquet"):
                raise InputError(
                    f"{path}: {name!r} is known at the end of training only; choose another column as --x."
                )
            kind = "learning curves" if curves else "final values"
            names = [*there, *([TIME] if timed else []), RUN]
            raise InputError(f"{path}: there is no column {name!r} among its {kind}; {known(name, names)}.")
    table = read_table(file, [name for name in wanted if name in there])
    if TIME in wanted and TIME not in table:
        table |= read_table(timing, [TIME])
    run = table["point"].astype(np.int64) * (int(table["seed"].max(initial=0)) + 1) + table["seed"]
    starts = np.flatnonzero(np.diff(run, prepend=-1))
    lengths = np.diff(starts, append=len(run))
    table[RECORD] = np.arange(len(run)) - np.repeat(starts, lengths)
    return table
