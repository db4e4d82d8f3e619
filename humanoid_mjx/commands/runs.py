"""The commands about runs that exist already: `runs`, `plot`, `report`."""

import re
from collections.abc import Sequence
from functools import partial
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rich.filesize import decimal
from rich.measure import Measurement
from rich.table import Column, Table
from typer import Argument, Option

from humanoid_mjx.commands import Trust, console, trusting
from humanoid_mjx.training.progress import Bar

if TYPE_CHECKING:
    from humanoid_mjx.runs.listing import Listed

UNBOUNDED, LEAST_COLUMNS = 10_000, 5
"""A width that holds every table, and the columns that the narrowest screen shows, with broken cells."""


def runs(
    folder: Annotated[Path, Argument(metavar="[FOLDER]", help="Where the run folders are.")] = Path("runs"),
) -> None:
    """List run folders: task, learner, progress, and the result of the best point."""
    from humanoid_mjx.runs.listing import list_runs

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


def runs_table(found: Sequence["Listed"]) -> Table:
    """A row for each run folder, the newest last."""
    words, number = partial(Column, overflow="fold"), partial(Column, justify="right", no_wrap=True)
    columns = [words("run", min_width=12), words("task"), words("learner"), number("points x seeds"), words("state")]
    columns += map(number, ("success", "return", "started", "size"))
    table = Table(*columns, box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for run in found:
        count, started = f"{run.points:,} x {run.seeds:,}", f"{run.started.astimezone():%Y-%m-%d %H:%M}"
        success = f"{run.success:.1%}" if isfinite(run.success) else ""
        total = f"{run.greedy_return:.4g}" if isfinite(run.greedy_return) else ""
        about = _name(run), run.task, run.learner, count, _state(run)
        table.add_row(*about, success, total, started, decimal(run.size))
    return table


def _name(run: "Listed") -> str:
    """A run folder's name, with that of its config where it does not follow from it."""
    from humanoid_mjx.runs.folder import THEN

    path = run.path.resolve()
    name = f"{path.parent.name}/{THEN}" if path.name == THEN else path.name
    return name if re.fullmatch(rf"{re.escape(run.config)}(-\d+)?(/{THEN})?", name) else f"{name} ({run.config})"


def _state(run: "Listed") -> str:
    state = run.state if run.state == "finished" else f"{run.state} at {run.share:.0%}"
    return f"{state}, {run.diverged:,} diverged" if run.diverged else state


def plot(
    run: Annotated[list[Path], Argument(metavar="RUN...", help="Run folders.")],
    x: Annotated[str | None, Option("--x", metavar="COLUMN", help="Across; by default episodes or steps.")] = None,
    y: Annotated[str, Option("--y", metavar="COLUMN", help="Upwards; learned: what the best table knows.")] = "success",
    by: Annotated[
        str | None,
        Option("--by", metavar="COLUMN", help="A line for each value; run: for each run. By default the swept key."),
    ] = None,
    out: Annotated[
        Path | None,
        Option(metavar="FILE.png", help="By default in the first run's figures. For learned also a .gif: a film."),
    ] = None,
) -> None:
    """Draw any column of the tables of runs over any other: lines with their 95 % interval over seeds."""
    from humanoid_mjx.report import plotting

    target, notes = plotting.plot(run, x, y, by, out)
    for note in notes:
        console.print(note)
    console.print(f"{target}", soft_wrap=True)


def report(
    run: Annotated[Path, Argument(metavar="RUN", help="A run folder, or a folder that reproduce has written.")],
    out: Annotated[Path | None, Option(metavar="FILE.html", help="By default RUN/report.html.")] = None,
    motion: Annotated[bool, Option(help="Show the robot under the best policy.")] = True,
    trust: Trust = False,
) -> None:
    """Write one self-contained web page: config, curves, tables, the robot's motion, the command to run it again."""
    from humanoid_mjx import compute
    from humanoid_mjx.files import meant, refusing, write_text
    from humanoid_mjx.report.page import run_page
    from humanoid_mjx.reproduction.page import findings_page
    from humanoid_mjx.spec import InputError, check_folder

    if not run.is_dir():
        raise InputError(f"{run}: there is no such folder{meant(str(run), 'run')}.")
    target = out or run / "report.html"
    check_folder(target)
    compute.start()
    with trusting(trust, run), Bar(console) as bar:
        if (run / "config.yaml").exists():
            page = run_page(run, bar, motion)
        elif (run / "reproduce.json").is_file():
            page = findings_page(run)
        else:
            neither = "neither a run folder (no config.yaml) nor what reproduce has written (no reproduce.json)"
            raise InputError(f"{run}: {neither}{meant(str(run), 'run')}.")
        with refusing(target):
            write_text(target, page)
    console.print(f"{target}", soft_wrap=True)
