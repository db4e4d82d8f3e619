"""Try faults on trainings, files, configs and policies, and write what came of each into docs/bench/faults.json.

    python experiments/faults.py                          # all: about half an hour on two cores
    python experiments/faults.py kill-deep_q --tries 10   # some of them; the record keeps what it has of the others

A real disk that is full, or read-only, needs the right to mount, and is left out without it. What should not have
happened is printed, and the exit code is 1. `python docs/build.py tables` writes the record into docs/faults.md.
"""

import argparse
import json
import sys
import tempfile
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import fault_configs
import fault_disks
import fault_input
import fault_numbers
import fault_odd
import fault_running
from fault_trying import CONFIGS, Matrix

from humanoid_mjx.compute import made_by
from humanoid_mjx.files import write_text

RECORD = Path(__file__).parent.parent / "docs" / "bench" / "faults.json"


def experiments(matrix: Matrix, folder: Path, tries: int | None, seed: int) -> dict[str, Callable[[], None]]:
    """Everything that is tried, by name. `tries`: in the place of each one's own number."""

    def many(usual: int) -> int:
        return usual if tries is None else tries

    found: dict[str, Callable[[], None]] = {
        f"kill-{learner}": partial(fault_running.kills, matrix, learner, many(50), seed) for learner in CONFIGS
    }
    for kind, words in fault_disks.AT_A_WRITE.items():
        found[kind] = partial(fault_disks.at_every_write, matrix, kind, words, folder / kind, many(1000))
    found |= {
        "disks": partial(fault_disks.small_disks, matrix, folder / "disks", 32),
        "processes": partial(fault_running.crowds, matrix, folder / "processes", many(5)),
        "clocks": partial(fault_running.clocks, matrix, folder / "clocks"),
        "memory": partial(fault_numbers.memory, matrix, folder / "memory"),
        "nan": partial(fault_numbers.not_finite, matrix, folder / "nan"),
        "runs": partial(fault_input.damaged_runs, matrix, "tabular_q", folder / "runs", many(8), seed),
        "runs-deep_q": partial(fault_input.damaged_runs, matrix, "deep_q", folder / "runs-deep_q", many(4), seed),
        "odd": partial(fault_odd.odd_files, matrix, folder / "odd"),
        "policies": partial(fault_input.policies, matrix, folder / "policies", many(200), seed),
        "configs": partial(fault_configs.configs, matrix, folder / "configs", many(200), seed),
        "bombs": partial(fault_configs.bombs, matrix, folder / "bombs"),
    }
    return found


def store(made: dict[str, Any], matrix: Matrix) -> None:
    """Put the rows found into the record, in the place of those of the same fault and subject.

    A row has its commit, of `made`; the record's own is that of the rows without one.
    """
    old = json.loads(RECORD.read_text()) if RECORD.exists() else {"rows": []}
    when = {"tried": f"{datetime.now(UTC):%Y-%m-%d}", "commit": made["commit"]}
    new = [row._asdict() | when for row in matrix.rows]
    seen = {(row["fault"], row["subject"]) for row in new}
    kept = [row for row in old["rows"] if (row["fault"], row["subject"]) not in seen]
    rows = sorted(kept + new, key=lambda row: (row["fault"], row["subject"]))
    head = {key: old.get(key, value) for key, value in made.items()} if kept else made
    write_text(RECORD, json.dumps(head | {"rows": rows}, indent=1) + "\n")


def main() -> None:
    """Try what the command line names."""
    matrix = Matrix(partial(print, flush=True), partial(store, made_by()))  # the record itself changes the checkout
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    known = experiments(matrix, Path(), None, 0)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(known)}; by default all")
    parser.add_argument("--tries", type=int, help="in the place of each one's own number")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    if odd := [name for name in args.names if name not in known]:
        parser.error(f"unknown: {odd[0]}")
    with tempfile.TemporaryDirectory() as folder:
        chosen = experiments(matrix, Path(folder), args.tries, args.seed)
        for name in args.names or chosen:
            chosen[name]()
    sys.exit(any(row.wrong for row in matrix.rows))


if __name__ == "__main__":
    main()
