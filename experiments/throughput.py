"""Draw steps a second against how many robots or agents run side by side, from the records of `bench tabular physics`.

python experiments/throughput.py            # writes docs/throughput.png, in seconds
"""

import argparse
import json
import statistics
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.ticker as ticks
import numpy as np

from humanoid_mjx.report.style import COLORS, figure, label_lines, log_axis

ROOT = Path(__file__).parent.parent

MACHINES = {"two CPU cores": "cpu_2_cores", "one NVIDIA H200": "h200"}
"""The rows of panels: of which record of `docs/bench`. Native MuJoCo and numba use all cores of that machine's CPU."""

BLUE, RED, GREEN, PINK, SKY, ORANGE, *_ = COLORS


class Line(NamedTuple):
    """A subject of a panel."""

    subject: str
    unit: str
    label: str
    color: str


class Panel(NamedTuple):
    """A column of panels."""

    heading: str
    counted: str
    lines: Sequence[Line]


CONTROLLED = "control+physics steps/s"

PANELS = (
    Panel(
        "tables",
        "agents",
        (
            Line("scan", "steps/s", "scan", BLUE),
            Line("fused", "steps/s", "fused", SKY),
            Line("naive_scan", "steps/s", "naive scan", RED),
            Line("cuda", "steps/s", "CUDA by hand", ORANGE),
            Line("numba", "steps/s", "numba", GREEN),
            Line("python", "steps/s", "plain Python", PINK),
        ),
    ),
    Panel(
        "the leg under computed torque",
        "legs",
        (
            Line("chain", CONTROLLED, "chain", BLUE),
            Line("mjx-jax", CONTROLLED, "MJX", RED),
            Line("mjx-jax plain", CONTROLLED, "MJX, plain XLA", PINK),
            Line("mujoco", "physics steps/s", "native MuJoCo", GREEN),
        ),
    ),
    Panel(
        "the body on the ground under a servo",
        "bodies",
        (
            Line("tree ground", CONTROLLED, "tree", BLUE),
            Line("mjx-jax ground", CONTROLLED, "MJX", RED),
            Line("mjx-warp ground", CONTROLLED, "MJX on Warp", SKY),
            Line("mujoco ground", CONTROLLED, "native MuJoCo", GREEN),
        ),
    ),
)


def measured(record: Mapping[str, Any], line: Line) -> tuple[list[int], list[float]]:
    """How many ran side by side, and their steps a second; the middle one where several were measured."""
    values = defaultdict(list)
    for found in record["records"]:
        if (found["subject"], found["unit"]) == (line.subject, line.unit) and found["bench"] in ("tabular", "physics"):
            values[found["batch"]].append(found["value"])
    return sorted(values), [statistics.median(values[batch]) for batch in sorted(values)]


def draw(target: Path, records: Mapping[str, Mapping[str, Any]]) -> None:
    """A row for each machine, named in `records`, a column for each kind of subject."""
    with figure(target, len(records), len(PANELS), size=(3.5, 2.6), sharey="col") as (_, axes):
        drawn = [
            (axis, [(line, *measured(record, line)) for line in panel.lines])
            for row, record in zip(axes, records.values(), strict=True)
            for axis, panel in zip(row, PANELS, strict=True)
        ]
        for axis, found in drawn:
            for line, batches, rates in found:
                axis.plot(batches, np.log10(rates), "o-", color=line.color, markersize=4, label=line.label)
            label_lines(axis)
            decades = np.log10([batch for _, batches, _ in found for batch in batches])
            axis.set_xlim(0.7 * 10.0 ** np.floor(decades.min()), 1.4 * 10.0 ** np.ceil(decades.max()))
        for row, machine in zip(axes, records, strict=True):
            row[0].set_ylabel(f"steps/s on {machine}")
            for axis, panel in zip(row, PANELS, strict=True):
                axis.set_title(panel.heading)
                axis.set_xlabel(f"{panel.counted} side by side")
                axis.yaxis.set_major_locator(ticks.MultipleLocator(1.0))
                axis.yaxis.set_major_formatter("1e{x:.0f}")
                log_axis(axis, counted=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="the folder")
    target = parser.parse_args().out / "throughput.png"
    folder = ROOT / "docs" / "bench"
    draw(target, {name: json.loads((folder / f"{record}.json").read_text()) for name, record in MACHINES.items()})
    print(target)


if __name__ == "__main__":
    main()
