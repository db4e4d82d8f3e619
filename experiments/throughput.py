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
        "the body standing under a servo",
        "bodies",
        (
            Line("tree ground", CONTROLLED, "tree", BLUE),
            Line("mjx-jax ground", CONTROLLED, "MJX", RED),
            Line("mjx-warp ground", CONTROLLED, "MJX on Warp", SKY),
            Line("mujoco ground", CONTROLLED, "native MuJoCo", GREEN),
        ),
    ),
    Panel(
        "thrown about as in a training",
        "bodies",
        (
            Line("tree ground moving", CONTROLLED, "tree", BLUE),
            Line("mjx-jax ground moving", CONTROLLED, "MJX", RED),
            Line("mujoco ground moving", CONTROLLED, "native MuJoCo", GREEN),
        ),
    ),
)


def rows_of(record: Mapping[str, Any], line: Line) -> list[Mapping[str, Any]]:
    """Return the rows of a subject, each with its commit."""
    rows = (
        {"commit": record.get("commit")} | row for row in record["records"] if row["bench"] in ("tabular", "physics")
    )
    return [row for row in rows if (row["subject"], row["unit"]) == (line.subject, line.unit)]


def measured(record: Mapping[str, Any], line: Line) -> tuple[list[int], list[float]]:
    """Return how many ran side by side, and their steps a second; the median where several were measured."""
    values = defaultdict(list)
    for row in rows_of(record, line):
        values[row["batch"]].append(row["value"])
    return sorted(values), [statistics.median(values[batch]) for batch in sorted(values)]


def commits(record: Mapping[str, Any], panel: Panel) -> str:
    """Return the commits at which the rows of a panel were measured."""
    return ", ".join(sorted({row["commit"][:7] for line in panel.lines for row in rows_of(record, line)}))


def draw(target: Path, records: Mapping[str, Mapping[str, Any]]) -> None:
    """A row for each machine, named in `records`, a column for each kind of subject that one of them has."""
    panels = [panel for panel in PANELS if any(commits(record, panel) for record in records.values())]
    with figure(target, len(records), len(panels), size=(3.5, 2.7), sharey="col") as (_, axes):
        for row, (machine, record) in zip(axes, records.items(), strict=True):
            row[0].set_ylabel(f"steps/s on {machine}")
            for axis, panel in zip(row, panels, strict=True):
                made = commits(record, panel)
                axis.set_title(f"{panel.heading}\n" + f"(commit {made})" * bool(made))
                _panel(axis, [(line, *measured(record, line)) for line in panel.lines])
                axis.set_xlabel(f"{panel.counted} side by side")


def _panel(axis: Any, found: Sequence[tuple[Line, list[int], list[float]]]) -> None:
    """One kind of subject on one machine."""
    axis.yaxis.set_major_locator(ticks.MultipleLocator(1.0))
    axis.yaxis.set_major_formatter("1e{x:.0f}")
    log_axis(axis, counted=True)
    if not any(batches for _, batches, _ in found):
        axis.text(0.5, 0.5, "not measured yet", transform=axis.transAxes, ha="center", color="0.4")
        return
    for line, batches, rates in found:
        axis.plot(batches, np.log10(rates), "o-", color=line.color, markersize=4, label=line.label)
    label_lines(axis)
    decades = np.log10([batch for _, batches, _ in found for batch in batches])
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
