"""Train each sweep twice on this machine, and say whether both left the same bits.

python experiments/same_bits.py [--only joint1,walk] [--small] [docs/bench/same_bits_gpu.json]

Each training is a process of its own; both of a sweep run side by side, and what is compared are the files of results
and of the summary, byte by byte, and the policies. The exit code is 1 where two differ. `--small` tries the script.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from scaling import TABLES, command

from humanoid_mjx import compute

SWEEPS = {
    "joint1": ["seeds=16"],
    "leg_reach": ["seeds=4"],
    "leg_reach_linear": ["seeds=4"],
    "leg_reach_ppo": ["seeds=1"],
    "walk": ["seeds=2", "total_steps=4_000_000"],
    "walk_linear_sweep": ["seeds=1", "total_steps=1_000_000"],
    "walk_ppo": ["seeds=1", "total_steps=4_000_000"],
}
"""A sweep of each learner that this package has, and what changes of its config."""

SMALL = {"joint1": ["seeds=1", "episodes=100"], "leg_reach_linear": ["seeds=1", "total_steps=20_000", "record=5"]}


def started(config: str, settings: list[str], out: Path) -> subprocess.Popen[str]:
    env = os.environ | {"XLA_PYTHON_CLIENT_PREALLOCATE": "false"}
    return subprocess.Popen(
        command(config, settings, out), env=env, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )


def digests(out: Path) -> dict[str, str]:
    """Digests of the tables of a run folder, and of all policies in the order of points and seeds."""
    found = {name: hashlib.sha256((out / name).read_bytes()) for name in TABLES}
    runs: dict[tuple[int, int], list[bytes]] = {}
    for file in (out / "checkpoint").glob("*.npz"):
        with np.load(file) as arrays:
            policy = [arrays[name] for name in sorted(arrays) if name.startswith("policy")]
            for row, run in enumerate(zip(arrays["point"].tolist(), arrays["seed"].tolist(), strict=True)):
                runs[run] = [array[row].tobytes() for array in policy]
    found["policies"] = hashlib.sha256(b"".join(part for run in sorted(runs) for part in runs[run]))
    return {name: digest.hexdigest() for name, digest in found.items()}


def compared(config: str, settings: list[str], place: Path) -> dict[str, Any]:
    """One row of the record: the files of two trainings that are the same, and those that differ."""
    outs = [place / f"{config}-{which}" for which in ("first", "second")]
    processes = [started(config, settings, out) for out in outs]
    said = [process.communicate()[1].strip().splitlines()[-1:] for process in processes]
    row: dict[str, Any] = {"config": config, "set": settings}
    if any(process.returncode for process in processes):
        return row | {"error": said}
    first, second = map(digests, outs)
    differ = sorted(name for name in first | second if first.get(name) != second.get(name))
    return row | {"same": sorted(first.keys() - differ), "differ": differ}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, nargs="?")
    parser.add_argument("--only")
    parser.add_argument("--small", action="store_true")
    given = parser.parse_args()
    sweeps = SMALL if given.small else SWEEPS
    record = compute.made_by() | {"command": "python experiments/same_bits.py", "rows": []}
    with tempfile.TemporaryDirectory() as folder:
        for config in given.only.split(",") if given.only else sweeps:
            row = compared(config, sweeps[config], Path(folder))
            record["rows"].append(row)
            print(json.dumps(row), flush=True)
            if given.file:
                given.file.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    sys.exit(any(row.get("error") or row["differ"] for row in record["rows"]))


if __name__ == "__main__":
    main()
