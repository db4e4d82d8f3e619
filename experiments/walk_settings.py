"""Draw how every training run of the last five series of settings of `walk` walks, from their record.

python experiments/walk_settings.py            # writes docs/walk_settings.png, in seconds
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from humanoid_mjx.report.style import COLORS, figure

ROOT = Path(__file__).parent.parent
RECORD = ROOT / "docs" / "bench" / "h200_walk_stride.json"

PANELS = (
    ("forward, m/s, when\ntold 0.3, 0.5, 0.8", "forward", ("forward 0.3", "forward 0.5", "forward 0.8"), None),
    ("upright for 20 s\nat 0.5 m/s", "success", ("forward 0.5",), 0.98),
    ("slip at 0.3 m/s,\nm/s", "slip", ("forward 0.3",), 0.03),
    ("heading off after 20 s\nat 0.3 m/s, degrees", "heading_error", ("forward 0.3",), 10.0),
    ("45 degrees at once\nwithin 1.5 s", "turn_success", ("sudden turn",), 0.9),
)
"""Heading, figure of the record, commands, and the goal."""

USUAL = {
    "stance": (("task", "gait", "stance"), 0.62),
    "cadence": (("task", "gait", "cadence"), 0.5),
    "smoothing": (("task", "smoothing"), 0.5),
    "slip": (("task", "rewards", "slip"), -0.6),
    "speed": (("task", "rewards", "speed"), 0.6),
    "flight": (("task", "rewards", "flight"), -0.3),
    "smooth": (("task", "rewards", "smooth"), -0.06),
    "discount": (("learner", "discount"), 0.97),
}
"""What a row says only where it differs: where it stands in a setting, and its usual value."""

BEFORE = {"F": ("cadence", "smoothing", "slip", "speed", "smooth"), "G": ("cadence", "smoothing", "smooth")}
"""What whole series differ in, which their rows do not repeat."""


def words(setting: dict[str, Any]) -> str:
    """A setting by its servo's stiffness, the largest offset, the period, and what is unusual."""
    series, task = setting["series"], setting["task"]
    text = f"{series}   {task['control']['stiffness']:g} N m/rad, {task['offset']:g}°, {task['gait']['period']:g} s"
    for name, (place, usual) in USUAL.items():
        value: Any = setting
        for part in place:
            value = value.get(part, 0.0)
        if abs(value - usual) > 1e-6 and name not in BEFORE.get(series, ()):
            text += f", {name} {value:.2g}"
    fastest = task["command"]["forward"][1]
    return text + (f", up to {fastest:g} m/s" if fastest != 0.8 else "")


def draw(target: Path) -> None:
    """One row for each setting, one dot for each training seed."""
    record = json.loads(RECORD.read_text())
    settings, commands = record["settings"], record["commands"]
    rows = np.arange(len(settings))[::-1]
    with figure(target, 1, len(PANELS), size=(2.4, 8.0), sharey=True) as (_, axes):
        for panel, (heading, name, told, goal) in zip(axes[0], PANELS, strict=True):
            for color, command in zip(COLORS, told, strict=False):
                column = commands.index(command)
                for row, setting in zip(rows, settings, strict=True):
                    values = [seed[column] for seed in setting["figures"][name]]
                    panel.plot(values, np.full(len(values), row), "o", color=color, alpha=0.7, markersize=4)
                if len(told) > 1:
                    panel.axvline(float(command.split()[1]), color=color, linewidth=0.8)
            if goal is not None:
                panel.axvline(goal, color="black", linewidth=0.8, linestyle="--")
            panel.set_title(heading)
        axes[0, 0].set_yticks(rows, [words(setting) for setting in settings])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="the folder")
    target = parser.parse_args().out / "walk_settings.png"
    draw(target)
    print(target)


if __name__ == "__main__":
    main()
