"""The command `bench`."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import typer

from humanoid_mjx import compute
from humanoid_mjx.commands import console
from humanoid_mjx.files import write_text
from humanoid_mjx.spec import InputError, check_folder, known


def run_bench(chosen: Sequence[str], file: Path | None, seeds: int | None = None) -> None:
    """`humanoid-mjx bench`."""
    from humanoid_mjx.bench import BENCHES, measuring

    if seeds is not None and not {"training", "all"} & set(chosen):
        raise InputError("bench --seeds: only training has seeds.")
    if chosen[0] == "compare":
        compare_benches(chosen[1:])
        return
    if odd := [name for name in chosen if name not in (*BENCHES, "all")]:
        names = (*BENCHES, "all", "compare")
        raise InputError(f"bench: unknown benchmark {odd[0]!r}; {known(odd[0], names)}.")
    if file is not None:
        check_folder(file, "--json")
    compute.start()
    made_by = compute.made_by()  # before the first benchmark: the checkout may change meanwhile
    records: list[dict[str, Any]] = []
    for name in BENCHES if "all" in chosen else chosen:
        console.print(f"{name}:")
        if (measure := measuring(name)) is None:
            console.print("  not measured: it is part of a checkout of the repository")
            continue
        options = {"seeds": seeds} if name == "training" and seeds is not None else {}
        found = measure(lambda line: console.print("  " + line), **options)
        records += [record.as_json() | {"commit": made_by["commit"]} for record in found]
    if file is not None:
        write_text(file, json.dumps(made_by | {"records": records}, indent=2) + "\n")
        console.print(f"{file}")


def compare_benches(files: Sequence[str]) -> None:
    """`humanoid-mjx bench compare`."""
    from humanoid_mjx.bench.compare import changes, read_result, table, verdict, warnings

    if len(files) != 2:
        raise InputError("bench compare: give two files that `bench --json` wrote, the older first.")
    before, after = (read_result(Path(name)) for name in files)
    found = changes(before, after)
    if not found:
        raise InputError(f"bench compare: {files[0]} and {files[1]} have no figure in common.")
    console.print(table(found))
    for line in (*warnings(before, after), verdict(found)):
        console.print(line, soft_wrap=True)
    if any(change.regressed for change in found):
        raise typer.Exit(1)
