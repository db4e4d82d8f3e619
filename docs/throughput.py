"""Draw steps a second against how many robots or agents run side by side, from the records of `benchmarks/publish.py`.

python docs/build.py tables            # writes docs/throughput.png, too
"""

import statistics
from collections import defaultdict
from pathlib import Path
from typing import Any

import matplotlib.ticker as ticks
import numpy as np
import tables

from humanoid_mjx.report.style import COLORS, figure, label_lines, log_axis

BLUE, RED, GREEN, PINK, SKY, *_ = COLORS
PANELS: dict[tuple[str, str], dict[str, tuple[str, str]]] = {
    ("the lower body, thrown about", "robots"): {
        "lower_body tree": ("tree", BLUE),
        "lower_body mjx-jax": ("MJX", RED),
        "lower_body mjx-warp": ("MJX on Warp", SKY),
        "lower_body mujoco": ("native MuJoCo", GREEN),
    },
    ("the leg under computed torque", "legs"): {
        "legs chain": ("chain", BLUE),
        "legs mjx-jax": ("MJX", RED),
        "legs mjx-jax plain": ("MJX, plain XLA", PINK),
        "legs mujoco": ("native MuJoCo", GREEN),
    },
    ("tables", "agents"): {
        "scan": ("scan", BLUE),
        "fused": ("fused", SKY),
        "naive_scan": ("naive scan", RED),
        "numba": ("numba", GREEN),
        "python": ("plain Python", PINK),
    },
}
"""The columns of panels: by heading and what is counted, the label and the colour of each subject."""


def draw(target: Path) -> None:
    """Draw a row for each machine and a column for each kind of subject."""
    records = dict(zip(tables.machine_names(), tables.speed_records(), strict=True))
    with figure(target, len(records), len(PANELS), size=(3.5, 2.7), sharey="col") as (_, axes):
        for row, (machine, record) in zip(axes, records.items(), strict=True):
            row[0].set_ylabel(f"steps/s on {machine}")
            for axis, ((heading, counted), lines) in zip(row, PANELS.items(), strict=True):
                found = [each for each in record["records"] if each["subject"] in lines and "steps" in each["unit"]]
                axis.set_title(heading)
                axis.set_xlabel(f"{counted} side by side")
                _panel(axis, found, lines)


def _panel(axis: Any, found: list[dict[str, Any]], lines: dict[str, tuple[str, str]]) -> None:
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
            if each["subject"] == subject:
                rates[each["batch"]].append(each["value"])
        batches = sorted(rates)
        middle = np.log10([statistics.median(rates[batch]) for batch in batches])
        axis.plot(batches, middle, "o-", color=color, markersize=4, label=label)
    label_lines(axis)
    decades = np.log10([each["batch"] for each in found])
    axis.set_xlim(0.7 * 10.0 ** np.floor(decades.min()), 1.4 * 10.0 ** np.ceil(decades.max()))
