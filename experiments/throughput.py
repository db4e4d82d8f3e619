"""Draw steps a second against how many robots or agents run side by side, from the records of `bench tabular physics`.

python experiments/throughput.py            # writes docs/throughput.png, in seconds
"""

import argparse
import json
import statistics
from collections import defaultdict
from pathlib import Path
from typing import Any

import matplotlib.ticker as ticks
import numpy as np

from humanoid_mjx.report.style import COLORS, figure, label_lines, log_axis

ROOT = Path(__file__).parent.parent
MACHINES = {"two CPU cores": "cpu_2_cores", "one NVIDIA H200": "h200"}
"""The rows of panels: of which record of `docs/bench`. Native MuJoCo and numba use all cores of that machine's CPU."""

BLUE, RED, GREEN, PINK, SKY, ORANGE, *_ = COLORS
CONTROLLED = "control+physics steps/s"
PANELS: dict[tuple[str, str], dict[tuple[str, str], tuple[str, str]]] = {
    ("tables", "agents"): {
        ("scan", "steps/s"): ("scan", BLUE),
        ("fused", "steps/s"): ("fused", SKY),
        ("naive_scan", "steps/s"): ("naive scan", RED),
        ("cuda", "steps/s"): ("CUDA by hand", ORANGE),
        ("numba", "steps/s"): ("numba", GREEN),
        ("python", "steps/s"): ("plain Python", PINK),
    },
    ("the leg under computed torque", "legs"): {
        ("chain", CONTROLLED): ("chain", BLUE),
        ("mjx-jax", CONTROLLED): ("MJX", RED),
        ("mjx-jax plain", CONTROLLED): ("MJX, plain XLA", PINK),
        ("mujoco", "physics steps/s"): ("native MuJoCo", GREEN),
    },
    ("the body standing under a servo", "bodies"): {
        ("tree ground", CONTROLLED): ("tree", BLUE),
        ("mjx-jax ground", CONTROLLED): ("MJX", RED),
        ("mjx-warp ground", CONTROLLED): ("MJX on Warp", SKY),
        ("mujoco ground", CONTROLLED): ("native MuJoCo", GREEN),
    },
    ("thrown about as in a training", "bodies"): {
        ("tree ground moving", CONTROLLED): ("tree", BLUE),
        ("mjx-jax ground moving", CONTROLLED): ("MJX", RED),
        ("mujoco ground moving", CONTROLLED): ("native MuJoCo", GREEN),
    },
}
"""The columns of panels: by heading and what is counted, the label and the colour of each subject and unit."""


def draw(target: Path, records: dict[str, Any]) -> None:
    """Draw a row for each machine and a column for each kind of subject."""
    with figure(target, len(records), len(PANELS), size=(3.5, 2.7), sharey="col") as (_, axes):
        for row, (machine, record) in zip(axes, records.items(), strict=True):
            row[0].set_ylabel(f"steps/s on {machine}")
            for axis, ((heading, counted), lines) in zip(row, PANELS.items(), strict=True):
                measured = [each for each in record["records"] if each["bench"] in ("tabular", "physics")]
                found = [each for each in measured if (each["subject"], each["unit"]) in lines]
                commits = sorted({each.get("commit", record.get("commit"))[:7] for each in found})
                axis.set_title(f"{heading}\n" + f"(commit {', '.join(commits)})" * bool(found))
                axis.set_xlabel(f"{counted} side by side")
                _panel(axis, found, lines)


def _panel(axis: Any, found: list[dict[str, Any]], lines: dict[tuple[str, str], tuple[str, str]]) -> None:
    """Draw one kind of subject on one machine, the median where a batch was measured several times."""
    axis.yaxis.set_major_locator(ticks.MultipleLocator(1.0))
    axis.yaxis.set_major_formatter("1e{x:.0f}")
    log_axis(axis, counted=True)
    if not found:
        axis.text(0.5, 0.5, "not measured yet", transform=axis.transAxes, ha="center", color="0.4")
        return
    for subject, (label, color) in lines.items():
        rates = defaultdict(list)
        for each in found:
            if (each["subject"], each["unit"]) == subject:
                rates[each["batch"]].append(each["value"])
        batches = sorted(rates)
        middle = np.log10([statistics.median(rates[batch]) for batch in batches])
        axis.plot(batches, middle, "o-", color=color, markersize=4, label=label)
    label_lines(axis)
    decades = np.log10([each["batch"] for each in found])
    axis.set_xlim(0.7 * 10.0 ** np.floor(decades.min()), 1.4 * 10.0 ** np.ceil(decades.max()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="the folder")
    target = parser.parse_args().out / "throughput.png"
    folder = ROOT / "docs" / "bench"
    draw(target, {name: json.loads((folder / f"{record}.json").read_text()) for name, record in MACHINES.items()})
    print(target)


if __name__ == "__main__":
    main()
