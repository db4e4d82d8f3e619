"""A figure of one's own: any column of the tables of runs over any other, a line for each value of a third."""

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.ticker import NullLocator

from humanoid_mjx.report.drawing import COUNTED, CURVES, HEAT_MAPS, draw_line, over_seeds, possible
from humanoid_mjx.report.learned import draw_learned
from humanoid_mjx.report.rendering import FILMS
from humanoid_mjx.report.style import COLORS, count_axis, figure, is_geometric, label_lines, log_axis, shades
from humanoid_mjx.runs.curves import swept
from humanoid_mjx.runs.folder import read_config
from humanoid_mjx.runs.ranking import MAX_LEVELS, Levels, find_levels, furthest, short
from humanoid_mjx.runs.tables import column_names, read_table
from humanoid_mjx.spec import InputError, check_folder, known, shown

RUN = "run"
"""The column that several runs are told apart by."""

RECORD = "record"
"""The column that says which record point of its run a row is."""

TIME = "wall_s"

LEARNED = "learned"
"""In place of a column: what the best run has in its table."""

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
    return Rows(columns, names, counters[0])


def _read(path: Path, wanted: Sequence[str], curves: bool) -> dict[str, np.ndarray]:
    """The columns of one run, and `record`."""
    file = path / ("results.parquet" if curves else "summary.parquet")
    timing, there = path / "timing.parquet", column_names(file)
    timed = curves and TIME in column_names(timing)
    for name in wanted:
        if name not in there and not (timed and name == TIME):
            if name in column_names(path / "summary.parquet"):
                raise InputError(f"{path}: {name!r} is known at the end of training only; choose another --x.")
            kind, axes = "learning curves" if curves else "final values", swept(read_config(path))[1]
            names = [each for each in there if each in axes or not each.startswith(("task.", "learner."))]
            near = known(name, [*names, *(each.rpartition(".")[2] for each in names)]).partition("known are")[0]
            listed = ", ".join([*names, *([TIME] if timed else []), RUN])
            raise InputError(
                f"{path}: there is no column {name!r} in its {kind}; {near}there are {listed}, keys not swept."
            )
    halved = {"rung"} & {*there} - {*wanted}
    table = read_table(file, [name for name in (*wanted, *halved) if name in there])
    if TIME in wanted and TIME not in table:
        table |= read_table(timing, [TIME])
    if halved:  # points that were stopped are no part of a line, unless the figure says at which rung they were
        table = {name: values for name, values in furthest(table).items() if name != "rung"}
    run = table["point"].astype(np.int64) * (int(table["seed"].max(initial=0)) + 1) + table["seed"]
    starts = np.flatnonzero(np.diff(run, prepend=-1))
    lengths = np.diff(starts, append=len(run))
    table[RECORD] = np.arange(len(run)) - np.repeat(starts, lengths)
    return table


MAX_LINES = 24
"""More lines than this cannot be told apart."""

BINS, MAX_VALUES = 12, 36
"""The x axis has so many bins of equally many values where a swept parameter has more values than the second."""

STYLES = ("-", "--", ":", "-.")
"""Styles of the lines of several runs, where colours tell something else."""


class Across(NamedTuple):
    """Places of the rows on the x axis."""

    x: np.ndarray
    place: np.ndarray | None
    """Number of the place that each row belongs to; None: rows of equal `x` belong together."""
    joined: bool
    """True if lines go through the places, which are in order."""
    labels: list[str] | None
    """Words below 0, 1, 2 ... where x is no number."""


def plot(paths: Sequence[Path], x: str | None, y: str, by: str | None, out: Path | None) -> tuple[Path, list[str]]:
    """Draw a column over another: lines with the 95 % interval over seeds, one for each value of `by` and each run.

    Args:
      paths: run folders.
      x: the column across; by default what counts the training. A measured one gives points and no lines.
      y: the column drawn, or `LEARNED`.
      by: the column that tells the lines apart; by default the swept parameter, where there is one only.
      out: the file; by default in the figures of the first run.

    Returns:
      the file, and what the figure leaves out, in sentences.

    Raises:
      InputError: no run folder, a damaged table, a column that is not there or cannot be drawn, too many lines.
    """
    if not paths:
        raise InputError("plot: name a run folder.")
    given = [y, *(name for name in (x, by) if name is not None)]
    if odd := [name for name in given if not (name and isinstance(name, str))]:
        raise InputError(f"plot: a column is named by text such as 'steps', got {shown(odd[0])}.")
    if out is not None:
        films = FILMS if y == LEARNED else ()
        if out.suffix not in (".png", *films):
            also = f", or {', '.join(films)} for a film of the training" if films else ""
            raise InputError(f"--out {out}: the file must end in .png{also}.")
        check_folder(out, "--out")
    if y == LEARNED:
        if len(paths) > 1 or x or by:
            raise InputError(f"--y {LEARNED}: this draws the table of one run; leave out the other runs, --x and --by.")
        return draw_learned(paths[0], out)
    axes = list(dict.fromkeys(axis for path in paths for axis in swept(read_config(path))[1]))
    short_names = {axis.rpartition(".")[2]: axis for axis in reversed(axes)}
    x, y, by = x and short_names.get(x, x), short_names.get(y, y), by and short_names.get(by, by)
    if by is None and len(axes) == 1 and axes[0] != x:
        by = axes[0]
    rows = read_rows(paths, x, y, by)
    x = x or rows.counter
    if rows.columns[y].dtype.kind not in "biuf":
        raise InputError(f"--y {y}: this column holds words; choose one that holds numbers.")
    kept = np.ones(len(rows.columns["point"]), bool)
    for name in filter(None, (x, by)):
        kept &= np.isfinite(rows.columns[name]) if rows.columns[name].dtype.kind == "f" else True
    if not kept.any():
        raise InputError(f"plot: no row has a number for {' and '.join(filter(None, (x, by)))}.")
    rows = rows._replace(columns={name: values[kept] for name, values in rows.columns.items()})
    parts = [part.replace(".", "_") for part in (y, "over", x, *(("by", by) if by else ()))]
    target = out or paths[0] / "figures" / f"{'_'.join(parts)}.png"
    across = _across(rows, x)
    others = [axis for axis in axes if axis not in (x, by)] if across.joined else []
    runs = [rows.columns["seed"][rows.columns[RUN] == run] for run in rows.runs]
    counts = sorted({len(np.unique(seeds)) for seeds in runs if len(seeds)})
    seeds = 1 if "seed" in (x, by) else counts[0] if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    words = over_seeds(seeds, "band" if across.joined else "bar")
    words += ", over all values of the other parameters" * bool(others)
    each = "" if across.joined else "each point of the sweep, "
    with figure(target, 1, 1, (6.4, 4.2), f"{', '.join(rows.runs)}: {each}{words}") as (_, panels):
        panel = panels[0, 0]
        left_out = _draw(panel, rows, across, x, y, by)
        if others and by is None:
            left_out.append(f"One line for all values of {', '.join(others)}; --by {others[0]} tells them apart.")
        halved = [path for path in paths if "rung" in column_names(path / "results.parquet")]
        if halved and "rung" not in (x, y, by):
            left_out.append(f"Of {halved[0]} only the points of the last rung are drawn; --by rung shows all.")
        panel.set_xlabel(NAMES.get(x, x))
        panel.set_ylabel(NAMES.get(y, y))
    return target, left_out


def _draw(panel: Any, rows: Rows, across: Across, x: str, y: str, by: str | None) -> list[str]:
    """Draw all lines, the x axis and the labels; what is left out, in sentences."""
    columns, lines = rows.columns, _lines(rows, by)
    seed = columns["seed"] if x != "seed" else np.zeros_like(columns["seed"])
    few = len(np.unique(across.x if across.place is None else across.place)) <= MAX_LEVELS
    drawn = []
    for label, chosen, color, style in lines:
        look: dict[str, Any] = {"linestyle": style} | ({"marker": "o", "markersize": 3} if few else {})
        place = None if across.place is None else across.place[chosen]
        at, seeds, values = (each[chosen] for each in (across.x, seed, columns[y]))
        look = (look if across.joined else {}) | {"label": label or "_"}
        look |= {"place": place, "joined": across.joined, "within": possible(y)}
        drawn.append((label, *draw_line(panel, at, seeds, values, color, **look)))
    _ticks(panel, across, x in (rows.counter, TIME))
    heading = by or (RUN if len(rows.runs) > 1 else "")
    if across.joined and heading:
        label_lines(panel)
        panel.set_title(NAMES.get(heading, heading))
    elif heading:
        panel.legend(title=heading, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    empty = [label for label, end, _ in drawn if np.isnan(end)]
    if len(empty) == len(drawn):
        raise InputError(f"plot: {y} has nowhere a number for every seed over {x}.")
    partly = sum(left_out for *_, left_out in drawn)
    notes = [f"Left out for want of a number of every seed: {partly:,} place{'s' * (partly > 1)}."] if partly else []
    if empty:
        notes.append(f"Not drawn for want of a number of every seed: {', '.join(empty)}.")
    return notes


def _across(rows: Rows, x: str) -> Across:
    values = rows.columns[x]
    if values.dtype.kind not in "iuf":
        levels = find_levels(values)
        return Across(levels.index.astype(float), None, True, levels.labels)
    values, place, record = values.astype(float), None, rows.columns[RECORD]
    parameter = x.startswith(("task.", "learner."))
    measured = not parameter and x not in (TIME, rows.counter, "point", "seed")
    if x == TIME:  # seeds reach a record point at different times
        place = record
    elif measured:  # every seed has its own
        place = rows.columns["point"].astype(np.int64) * (record.max() + 1) + record
    elif parameter and len(distinct := np.unique(values)) > MAX_VALUES:
        edges = np.quantile(distinct, np.linspace(0, 1, BINS + 1))
        place = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, BINS - 1)
    return Across(values, place, not measured, None)


def _lines(rows: Rows, by: str | None) -> list[tuple[str, np.ndarray, Any, str]]:
    """The lines of a figure, for each value of `by`, and where there are several runs for each of them: label, flags of
    its rows, colour and style."""
    columns, whole = rows.columns, Levels([""], np.zeros(len(rows.columns["point"]), int))
    apart = find_levels(columns[RUN]) if len(rows.runs) > 1 and by != RUN else whole
    levels = find_levels(columns[by]) if by else whole
    ordered = by is not None and by != RUN and columns[by].dtype.kind in "biuf"
    lines = []
    for (i, level), (j, run) in product(enumerate(levels.labels), enumerate(apart.labels)):
        chosen = (levels.index == i) & (apart.index == j)
        if not chosen.any():
            continue
        k = i if by else j
        color = shades(len(levels.labels))[i] if ordered else COLORS[k % len(COLORS)]
        style = STYLES[j % len(STYLES)] if by else "-"
        lines.append((", ".join(filter(None, (level, run))), chosen, color, style))
    if len(lines) > MAX_LINES:
        raise InputError(f"plot: {len(lines)} lines cannot be told apart; choose another --by, or fewer runs.")
    return lines


def _ticks(panel: Any, across: Across, counted: bool) -> None:
    distinct = np.unique(across.x)
    if across.labels is not None:
        crowded = len(across.labels) > 5
        turn, side = (45, "right") if crowded else (0, "center")
        panel.set_xticks(range(len(across.labels)), across.labels, rotation=turn, ha=side)
    elif counted:
        count_axis(panel)
    elif across.joined and is_geometric(distinct):
        log_axis(panel)
        if len(distinct) <= MAX_LEVELS:
            panel.xaxis.set_minor_locator(NullLocator())
            panel.set_xticks(distinct, [short(value) for value in distinct])
