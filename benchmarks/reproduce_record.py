"""Write the record of `humanoid-mjx reproduce`: its verdicts, and the time of each experiment.

    python benchmarks/reproduce_record.py    # writes docs/bench/cpu_2_cores_reproduce.json in some minutes

Nothing else may run meanwhile. Nothing is compiled before: the command gets an empty folder for its programs.
"""

import json
import os
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

RECORD = Path(__file__).parent.parent / "docs" / "bench" / "cpu_2_cores_reproduce.json"

WHAT = (
    "`reproduce` of everything, alone on the machine, no compiled program on disk. `cpu_s` is the time of all cores "
    "together, `wall_s` that on the clock, `command_s` that of the whole command, both with compilation."
)


def main() -> None:
    with TemporaryDirectory() as folder:
        out, start = Path(folder) / "reproduced", time.perf_counter()
        command = [sys.executable, "-m", "humanoid_mjx", "reproduce", "--out", str(out)]
        cache = {"JAX_COMPILATION_CACHE_DIR": str(Path(folder) / "xla")}
        subprocess.run(command, check=True, env=os.environ | cache)
        command_s = time.perf_counter() - start
        findings = json.loads((out / "reproduce.json").read_text())
        (run,) = json.loads((out / "reproduce_runs.json").read_text())
    times = run.pop("times")
    record = run | {
        "what": WHAT,
        "verdicts": Counter(finding["verdict"] for finding in findings),
        "command_s": round(command_s, 1),
        **{clock: {name: seconds[clock] for name, seconds in times.items()} for clock in ("cpu_s", "wall_s")},
    }
    RECORD.write_text(json.dumps(record, indent=1) + "\n")
    print(RECORD)


if __name__ == "__main__":
    main()
