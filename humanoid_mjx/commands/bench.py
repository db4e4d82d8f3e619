"""The command `bench`."""

import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Exit, Option

from humanoid_mjx.commands import console

BENCHES = ("tabular", "physics", "training", "startup")
"""Benchmarks of `benchmarks/publish.py`."""


def bench(
    names: Annotated[
        list[str] | None,
        Argument(
            metavar="[NAME]...",
            help="tabular, physics, training, startup or all; compare OLD.json NEW.json: two results, with "
            "exit code 1 where something became slow.",
        ),
    ] = None,
    json: Annotated[Path | None, Option(metavar="FILE", help="Write the figures as JSON.")] = None,
    limit: Annotated[float | None, Option(metavar="S", help="Begin no row after so many seconds.")] = None,
) -> None:
    """Measure steps and episodes per second against the alternatives, compile time apart."""
    from humanoid_mjx.spec import InputError, check_folder, known

    chosen = names or ["all"]
    if chosen[0] == "compare":
        compare_benches(chosen[1:])
        return
    if odd := [name for name in chosen if name not in (*BENCHES, "all")]:
        raise InputError(f"bench: unknown benchmark {odd[0]!r}; {known(odd[0], (*BENCHES, 'all', 'compare'))}.")
    if json is not None:
        check_folder(json, "--json")
    command = " ".join(["humanoid-mjx bench", *chosen])
    _module("publish").publish(() if "all" in chosen else chosen, json, command, limit=limit)


def _module(name: str) -> Any:
    """A module of the folder `benchmarks`."""
    from humanoid_mjx.files import folder

    if (place := str(folder("benchmarks"))) not in sys.path:  # of this process, and of those that it starts
        sys.path.insert(0, place)
    return import_module(name)


def compare_benches(files: Sequence[str]) -> None:
    """`humanoid-mjx bench compare`."""
    from humanoid_mjx.spec import InputError

    results = _module("results")
    if len(files) != 2:
        raise InputError("bench compare: give two files that `bench --json` wrote, the older first.")
    before, after = (results.read_result(Path(name)) for name in files)
    found = results.changes(before, after)
    if not found:
        raise InputError(f"bench compare: {files[0]} and {files[1]} have no figure in common.")
    console.print(results.table(found))
    for line in (*results.warnings(before, after), results.verdict(found)):
        console.print(line, soft_wrap=True)
    if any(change.regressed for change in found):
        raise Exit(1)
