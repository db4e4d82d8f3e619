"""The command `bench`."""

import sys
from collections.abc import Sequence
from importlib import import_module
from json import dumps
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Exit, Option

from humanoid_mjx.commands import console

BENCHES = {
    "tabular": "benches:tables",
    "physics": "benches:physics",
    "control": "benches:control",
    "training": "trainings:run",
    "startup": "startup:run",
}
"""Module in the folder `benchmarks` and its function `(say) -> list[Record]`; the subjects are timed in turn."""


def bench(
    names: Annotated[
        list[str] | None,
        Argument(
            metavar="[NAME]...",
            help="tabular, physics, control, training, startup or all; compare OLD.json NEW.json: two results, with "
            "exit code 1 where something became slow.",
        ),
    ] = None,
    json: Annotated[Path | None, Option(metavar="FILE", help="Write the figures as JSON.")] = None,
    seeds: Annotated[int | None, Option(min=1, help="Seeds of every learner that training trains; 5.")] = None,
) -> None:
    """Measure steps and episodes per second against the alternatives, compile time apart."""
    from humanoid_mjx import compute
    from humanoid_mjx.files import write_text
    from humanoid_mjx.spec import InputError, check_folder, known

    chosen = names or ["all"]
    if seeds is not None and not {"training", "all"} & set(chosen):
        raise InputError("bench --seeds: only training has seeds.")
    if chosen[0] == "compare":
        compare_benches(chosen[1:])
        return
    if odd := [name for name in chosen if name not in (*BENCHES, "all")]:
        there = (*BENCHES, "all", "compare")
        raise InputError(f"bench: unknown benchmark {odd[0]!r}; {known(odd[0], there)}.")
    if json is not None:
        check_folder(json, "--json")
    compute.start()
    made_by = compute.made_by()  # before the first benchmark: the checkout may change meanwhile
    records: list[dict[str, Any]] = []
    for name in BENCHES if "all" in chosen else chosen:
        console.print(f"{name}:")
        options = {"seeds": seeds} if name == "training" and seeds is not None else {}
        found = measuring(name)(lambda line: console.print("  " + line), **options)
        records += [record.as_json() | {"commit": made_by["commit"]} for record in found]
    if json is not None:
        write_text(json, dumps(made_by | {"records": records}, indent=2) + "\n")
        console.print(f"{json}")


def measuring(name: str) -> Any:
    """The function of a benchmark."""
    module, _, function = BENCHES[name].partition(":")
    return getattr(_module(module), function)


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
