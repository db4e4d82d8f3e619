"""The tables of a run folder, derived from its finished blocks."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Int

from humanoid_mjx.config import config_digest
from humanoid_mjx.runs.archive import misplaced
from humanoid_mjx.runs.folder import RunFolder, damaged, parts, read_arrays, read_config
from humanoid_mjx.runs.statistics import mean_known
from humanoid_mjx.spec import InputError

LAST_SHARE = 0.1
"""The share of a learning curve, from its end, over which the summary averages."""


ROWS = 2**20
"""Rows of a table that are made and written at once: few enough to stay in a cache."""


def write_tables(
    folder: RunFolder, hyper: Mapping[str, list[Any]], unit: str, places: Int[np.ndarray, "rungs record"]
) -> None:
    """Write results, summary and timing of all runs that are finished, ordered by point and seed.

    `hyper`: the hyper-parameters as columns, an entry for each sweep point. `unit`: `episode` or `step`. `places`: the
    count of the unit at each record point, by the rung of the run: one rung but in mode halving.

    Raises:
      InputError: a file of the checkpoint is damaged or of another training.
    """
    arrays = finished_runs(folder.path, ("point", "seed", "curve.", "final.", "time."))
    if not arrays:
        return
    encoded = {name: pa.array(values).dictionary_encode() for name, values in hyper.items()}
    size = max(1, ROWS // places.shape[1])
    parts = [{name: array[i : i + size] for name, array in arrays.items()} for i in range(0, len(arrays["seed"]), size)]

    def tables(name: str) -> Iterator[pa.Table]:
        try:
            for part in parts:
                yield pa.table(_columns(name, encoded, unit, places, part), metadata={"config": folder.digest})
        except (LookupError, ValueError, pa.ArrowException) as error:
            raise InputError(f"{folder.path / 'checkpoint'}: what it holds does not fit this training.") from error

    for name in ("results", "summary", "timing"):
        first = next(made := tables(name))
        with (
            folder.writing(f"{name}.parquet") as path,
            pq.ParquetWriter(path, first.schema, compression="zstd", write_page_checksum=True) as writer,
        ):
            for table in chain([first], made):
                writer.write_table(table)


def _columns(
    table: str, hyper: Mapping[str, pa.DictionaryArray], unit: str, places: np.ndarray, arrays: dict[str, np.ndarray]
) -> dict[str, Any]:
    """The columns of a table, of some runs: a row for each run in the summary, for each record point in the others."""
    rows: dict[str, Any] = {"point": arrays["point"], "seed": arrays["seed"]}
    rows |= {"rung": arrays["rung"] + 1} if "rung" in arrays else {}
    if table != "summary":
        rows = {name: np.repeat(numbers, places.shape[1]) for name, numbers in rows.items()}
        counts = places[arrays.get("rung", np.zeros_like(arrays["point"]))]
        rows[unit] = counts.reshape(-1).astype(np.int32)
    if table == "timing":
        return rows | {"wall_s": arrays["time.wall_s"].reshape(-1)}
    point = pa.array(rows["point"])
    for name, column in hyper.items():
        rows[name] = pa.DictionaryArray.from_arrays(column.indices.take(point), column.dictionary)
    curves = {name: curve.reshape(-1) for name, curve in named(arrays, "curve").items()}
    return rows | (scores(arrays) if table == "summary" else curves)


def finished_runs(path: Path, prefixes: tuple[str, ...], *points: int) -> dict[str, np.ndarray]:
    """The arrays of `all_runs`; in mode halving those of the last rung that each point has reached."""
    arrays = all_runs(path, prefixes, *points)
    if "rung" not in arrays:
        return arrays
    order = np.lexsort((arrays["rung"], arrays["seed"], arrays["point"]))
    point, seed = arrays["point"][order], arrays["seed"][order]
    last = order[np.append((np.diff(point) != 0) | (np.diff(seed) != 0), True)]
    return {name: array[last] for name, array in arrays.items()}


def kept_runs(path: Path, prefixes: tuple[str, ...]) -> dict[str, np.ndarray]:
    """The arrays of `finished_runs`, of a run folder that is read and not trained.

    Raises:
      InputError: as of `all_runs`, or the checkpoint has lost runs that the summary has.
    """
    arrays, told = finished_runs(path, prefixes), 0
    with suppress(InputError):  # of a summary that is missing or damaged
        told = len(read_table(path / "summary.parquet", ["point"])["point"])
    if arrays and (lost := told - len(arrays["point"])) > 0:
        raise InputError(f"{path / 'checkpoint'}: lacks {lost:,} of the runs of summary.parquet; --resume trains them.")
    return arrays


def all_runs(path: Path, prefixes: tuple[str, ...], *points: int) -> dict[str, np.ndarray]:
    """The arrays of a run folder's finished runs whose names start so, ordered by rung, point and seed.

    `points`: leaves out files that hold none of these. Files of points with other static values have policies of other
    sizes, and curves of other names, which are NaN in the rows of other files. `rung` counts from 0, in mode halving
    only.

    Raises:
      InputError: a file of the checkpoint is damaged, of another run, or there twice, or policies have other sizes.
    """
    digest = config_digest(read_config(path))
    loaded = {part: read_arrays(part, (*prefixes, "rung"), digest) for part in parts(path)}
    if odd := [part for part, arrays in loaded.items() if not _are_runs(arrays)]:
        raise damaged(odd[0], "is of another training")
    loaded = {part: each for part, each in loaded.items() if not points or np.isin(each["point"], points).any()}
    if not loaded:
        return {}
    like = {name: array[:1] * np.float32(np.nan) for arrays in loaded.values() for name, array in arrays.items()}
    try:
        whole = {
            name: np.concatenate([arrays.get(name, nan.repeat(len(arrays["seed"]), 0)) for arrays in loaded.values()])
            for name, nan in like.items()
        }
    except ValueError as error:
        raise InputError(f"{path / 'checkpoint'}: what it holds does not fit this training.") from error
    keys = np.stack([whole["seed"], whole["point"], whole.get("rung", np.zeros_like(whole["point"]))])
    order = np.lexsort(keys)
    if len(again := order[1:][(np.diff(keys[:, order]) == 0).all(axis=0)]):
        ends = np.cumsum([len(arrays["seed"]) for arrays in loaded.values()])
        raise damaged([*loaded][int(np.searchsorted(ends, again[0], "right"))], "holds runs that another one holds")
    return {name: array[order] for name, array in whole.items()}


def run_numbers(runs: Mapping[str, np.ndarray], points: int, seeds: int) -> np.ndarray:
    """(runs,) Numbers of stored runs: (rung * points + point) * seeds + seed."""
    if not runs:
        return np.zeros(0, np.int64)
    return (runs["point"] + runs.get("rung", np.int64(0)) * points) * seeds + runs["seed"]


def _are_runs(arrays: dict[str, np.ndarray]) -> bool:
    """Return whether arrays have a row for each of some runs."""
    numbers = [arrays.get(name, np.array(None)) for name in ("point", "seed")]
    fit = all(array.dtype.kind == "i" and array.ndim == 1 for array in numbers)
    return fit and all(array.shape[:1] == numbers[0].shape for array in arrays.values())


NEEDED: dict[str, tuple[set[str], ...]] = {
    "results": ({"point"}, {"seed"}, {"episode", "step"}),
    "summary": ({"point"}, {"seed"}, {"greedy_success"}, {"diverged"}),
    "timing": ({"point"}, {"seed"}, {"episode", "step"}, {"wall_s"}),
}
"""Columns without which a parquet file of a run folder is another one: one of each set."""


def opened(path: Path) -> pq.ParquetFile:
    """A parquet file of a run folder, to be read within `with`.

    Raises:
      InputError: the file is missing, truncated, damaged, another one or of another run.
    """
    if not path.is_file():
        raise InputError(f"{path}: there is no such file; --resume the run to write it.")
    try:
        file = pq.ParquetFile(path, page_checksum_verification=True)
        columns = set(file.schema_arrow.names)
    except (pa.ArrowException, OSError, ValueError) as error:  # names that are no text
        raise damaged(path) from error
    stored = (file.schema_arrow.metadata or {}).get(b"config")
    if how := misplaced(stored and stored.decode(errors="replace"), config_digest(read_config(path.parent))):
        raise damaged(path, how)
    fits = all(one & columns for one in NEEDED.get(path.stem, ()))
    if not (fits and file.metadata.num_rows) or (path.stem == "results" and "wall_s" in columns):
        raise damaged(path, "is another one")
    return file


def read_table(path: Path, columns: Sequence[str] | None = None) -> dict[str, np.ndarray]:
    """The columns of a parquet file of a run folder (`opened`): all, or those named."""
    with opened(path) as file:
        try:
            table = file.read(None if columns is None else list(columns))
            return {name: table[name].to_numpy() for name in table.column_names}
        except (pa.ArrowException, OSError, ValueError, MemoryError) as error:
            raise damaged(path) from error


def column_names(path: Path) -> list[str]:
    """The names of the columns of a parquet file of a run folder (`opened`); none where there is no such file."""
    if not path.is_file():
        return []
    with opened(path) as file:
        return file.schema_arrow.names


def named(arrays: dict[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    """The arrays whose names start with `prefix.`, without it."""
    return {name.removeprefix(prefix + "."): a for name, a in arrays.items() if name.startswith(prefix + ".")}


WHOLE = ("return", "steps", "success")
"""Curves of which the summary has the mean over all of training, too: the area under the curve."""


def scores(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The scores of finished runs, (runs,) each: means over the last part of their curves, over the whole of some as
    `whole_...`, and scores at their end."""
    curves = named(arrays, "curve")
    parts = {name: curve[:, -max(1, round(curve.shape[1] * LAST_SHARE)) :] for name, curve in curves.items()}
    parts |= {f"whole_{name}": curves[name] for name in WHOLE if name in curves}
    means = {name: mean_known(part, axis=1).astype(np.float32) for name, part in parts.items()}
    return means | named(arrays, "final")
