"""The commands about runs that exist already: `runs`, `plot`, `report`."""

import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from rich.filesize import decimal
from rich.measure import Measurement
from rich.table import Column, Table

from humanoid_mjx import compute
from humanoid_mjx.commands import console
from humanoid_mjx.files import meant, refusing, write_text
from humanoid_mjx.runs.listing import Listed, list_runs
from humanoid_mjx.spec import InputError, check_folder
from humanoid_mjx.training.progress import Bar

UNBOUNDED, LEAST_COLUMNS = 10_000, 5
"""A width that holds every table, and the columns that the narrowest screen shows, with broken cells."""


def run_runs(folder: Path) -> None:
    """`humanoid-mjx runs`."""
    found, problems = list_runs(folder)
    if found:
        table, wide = runs_table(found), console.options.update_width(UNBOUNDED)
        while console.is_terminal and len(table.columns) > LEAST_COLUMNS:
            if Measurement.get(console, wide, table).maximum <= console.width:
                break
            table.columns.pop()
        console.print(table)
        console.print("Success and return are those of greedy episodes of the best point, over its seeds.")
    else:
        console.print(f"{folder}: there is no run folder in it.")
    for problem in problems:
        console.print(problem, soft_wrap=True)
    if any(run.state == "interrupted" for run in found):
        console.print("An interrupted run is completed by: humanoid-mjx sweep RUN/config.yaml --out RUN --resume")


def runs_table(found: Sequence[Listed]) -> Table:
    """A row for each run folder, the newest last."""
    words, number = partial(Column, overflow="fold"), partial(Column, justify="right", no_wrap=True)
    columns = [words("run", min_width=12), words("task"), words("learner"), number("points x seeds"), words("state")]
    columns += map(number, ("success", "return", "started", "size"))
    table = Table(*columns, box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for run in found:
        table.add_row(
            _name(run),
            run.task,
            run.learner,
            f"{run.points:,} x {run.seeds:,}",
            _state(run),
            f"{run.success:.1%}" if np.isfinite(run.success) else "",
            f"{run.greedy_return:.4g}" if np.isfinite(run.greedy_return) else "",
            f"{run.started.astimezone():%Y-%m-%d %H:%M}",
            decimal(run.size),
        )
    return table


def _name(run: Listed) -> str:
    """A run folder's name, with that of its config where it does not follow from it."""
    name = run.path.resolve().name
    return name if re.fullmatch(rf"{re.escape(run.config)}(-\d+)?", name) else f"{name} ({run.config})"


def _state(run: Listed) -> str:
    state = run.state if run.state == "finished" else f"{run.state} at {run.share:.0%}"
    return f"{state}, {run.diverged:,} diverged" if run.diverged else state


def run_plot(paths: Sequence[Path], x: str | None, y: str, by: str | None, out: Path | None) -> None:
    """`humanoid-mjx plot`."""
    from humanoid_mjx.report.plotting import plot

    if out is not None and out.suffix != ".png":
        raise InputError(f"--out {out}: the file must end in .png.")
    if out is not None:
        check_folder(out, "--out")
    target, notes = plot(paths, x, y, by, out)
    for note in notes:
        console.print(note)
    console.print(f"{target}", soft_wrap=True)


def run_report(path: Path, out: Path | None, motion: bool) -> None:
    """`humanoid-mjx report`, of a run folder or of what `reproduce` has written."""
    from humanoid_mjx.report.page import run_page
    from humanoid_mjx.reproduction.page import findings_page

    if not path.is_dir():
        raise InputError(f"{path}: there is no such folder{meant(str(path), 'run')}.")
    target = out or path / "report.html"
    check_folder(target)
    compute.start()
    with Bar(console) as bar:
        if (path / "config.yaml").exists():
            page = run_page(path, bar, motion)
        elif (path / "reproduce.json").is_file():
            page = findings_page(path)
        else:
            neither = "neither a run folder (no config.yaml) nor what reproduce has written (no reproduce.json)"
            raise InputError(f"{path}: {neither}{meant(str(path), 'run')}.")
        with refusing(target):
            write_text(target, page)
    console.print(f"{target}", soft_wrap=True)
