"""The command `bench`."""

from collections.abc import Sequence
from json import dumps
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Exit, Option

from humanoid_mjx.commands import console


def bench(
    names: Annotated[
        list[str] | None,
        Argument(
            metavar="[NAME]...",
            help="tabular, physics, control or all, in a checkout also training and startup; compare OLD.json "
            "NEW.json: two results, with exit code 1 where something became slow.",
        ),
    ] = None,
    json: Annotated[Path | None, Option(metavar="FILE", help="Write the figures as JSON.")] = None,
    seeds: Annotated[int | None, Option(min=1, help="Seeds of every learner that training trains; 5.")] = None,
) -> None:
    """Measure steps and episodes per second against the alternatives, compile time apart."""
    from humanoid_mjx import compute
    from humanoid_mjx.bench import BENCHES, measuring
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
        if (measure := measuring(name)) is None:
            console.print("  not measured: it is part of a checkout of the repository")
            continue
        options = {"seeds": seeds} if name == "training" and seeds is not None else {}
        found = measure(lambda line: console.print("  " + line), **options)
        records += [record.as_json() | {"commit": made_by["commit"]} for record in found]
    if json is not None:
        write_text(json, dumps(made_by | {"records": records}, indent=2) + "\n")
        console.print(f"{json}")


def compare_benches(files: Sequence[str]) -> None:
    """`humanoid-mjx bench compare`."""
    from humanoid_mjx.bench.compare import changes, read_result, table, verdict, warnings
    from humanoid_mjx.spec import InputError

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
        raise Exit(1)
