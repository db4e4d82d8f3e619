"""The learning curves of a sweep by point and seed, read from a run folder a column at a time."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Num

from humanoid_mjx.runs.ranking import NOT_COMPARED, Compared, at_end, by_point, compared, furthest, ranked
from humanoid_mjx.runs.tables import opened, read_table
from humanoid_mjx.spec import InputError


@dataclass(frozen=True)
class Learning:
    """Results of a sweep: curves and final values, by point and seed; NaN where a run has no number."""

    mode: str
    """`grid`, `zip`, `random`, or `halving`, of which the points that were stopped are left out."""
    axes: Mapping[str, np.ndarray]
    """Swept parameters: the value of each point."""
    unit: str
    """Counter of the training: `episode` or `step`."""
    places: Num[np.ndarray, " record"]
    names: Sequence[str]
    """Measures that have curves."""
    read: Callable[[str], Float[np.ndarray, "points seeds record"]]
    """The curves of a measure."""
    seeds: int
    points: Sequence[int]
    """The points' numbers."""
    order: Sequence[int]
    """Indices of the points, the best first."""
    finals: Callable[[str], Float[np.ndarray, "points seeds"] | None] = lambda name: None
    """A column of `summary.parquet`; None where there is none."""
    compared: Compared = NOT_COMPARED


def swept(config: Mapping[str, Any]) -> tuple[str, list[str]]:
    """Mode and axes of a config's sweep; a grid without axes where it has none."""
    sweep = config.get("sweep") or {}
    return str(sweep.get("mode", "grid")), list(sweep.get("axes", {}))


def read_learning(path: Path, config: Mapping[str, Any], summary: Mapping[str, np.ndarray], quickest: bool) -> Learning:
    """The learning curves of a run folder.

    Raises:
      InputError: a table is missing, damaged or does not fit the config.
    """
    file, (mode, axes) = path / "results.parquet", swept(config)
    with opened(file) as table:
        schema, rows, columns = table.schema_arrow, table.metadata.num_rows, table.schema_arrow.names
    if missing := [axis for axis in axes if axis not in summary or axis not in columns]:
        raise InputError(f"{path}: its tables do not fit its config; they have no column {missing[0]}.")
    unit, runs, kept = "step" if "step" in columns else "episode", len(summary["point"]), at_end(summary)
    names = [name for name in columns if str(schema.field(name).type) in ("float", "double") and "." not in name]
    record, odd = divmod(rows, runs)
    if odd or not record:
        raise InputError(f"{path}: its tables do not fit together; --resume the run to write them anew.")
    places = read_table(file, [unit])[unit].reshape(runs, record)[np.argmax(kept)]
    summary = furthest(summary)
    points, first, row = np.unique(summary["point"], return_index=True, return_inverse=True)
    seeds, column = np.unique(summary["seed"], return_inverse=True)

    def read(name: str) -> np.ndarray:
        curves = read_table(file, [name])[name].reshape(runs, record)
        found = np.full((len(points), len(seeds), record), np.nan, curves.dtype)
        found[row, column] = curves[kept]
        return found

    @cache
    def finals(name: str) -> np.ndarray | None:
        return by_point(summary, name)[1] if name in summary else None

    values, judged = {axis: summary[axis][first] for axis in axes}, compared(mode, axes, summary, quickest)
    order = np.searchsorted(points, [each.point for each in ranked(axes, summary, quickest)]).tolist()
    return Learning(mode, values, unit, places, names, read, len(seeds), points.tolist(), order, finals, judged)
