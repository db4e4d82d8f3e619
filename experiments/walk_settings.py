"""Draw how every training run in the later series of settings of `walk` walks, from their records.

python experiments/walk_settings.py            # writes docs/walk_settings.png and three like it, in seconds
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from humanoid_mjx.report.style import COLORS, figure

ROOT = Path(__file__).parent.parent

RECORDS = {
    "walk_settings": ("h200_walk_stride", 8.0),
    "walk_finer": ("h200_walk_finer", 6.0),
    "walk_yawing": ("h200_walk_yawing", 4.6),
    "walk_learning": ("h200_walk_learning", 3.9),
}
"""The figures by name: of which record of `docs/bench`, and how high, inches."""

Seeds: TypeAlias = Callable[[str, str], list[float]]
"""The training seeds' values of a figure under a command."""

Row: TypeAlias = tuple[str, Seeds]
"""What a row is, and its seeds."""

PANELS = (
    ("forward, m/s, when\ntold 0.3, 0.5, 0.8", "forward", ("forward 0.3", "forward 0.5", "forward 0.8"), None),
    ("upright for 20 s\nat 0.5 m/s", "success", ("forward 0.5",), 0.98),
    ("slip, m/s, when\ntold 0.3, 0.5", "slip", ("forward 0.3", "forward 0.5"), 0.03),
    ("heading off after 20 s\nat 0.3 m/s, degrees", "heading_error", ("forward 0.3",), 10.0),
    ("45 degrees at once\nwithin 1.5 s", "turn_success", ("sudden turn",), 0.9),
)
"""Heading, figure of the record, commands, and the goal; lines of the first panel are the commands."""

USUAL = {
    "stance": (("task", "gait", "stance"), 0.62),
    "cadence": (("task", "gait", "cadence"), 0.5),
    "smoothing": (("task", "smoothing"), 0.5),
    "slip": (("task", "rewards", "slip"), -0.6),
    "yawing": (("task", "rewards", "yawing"), 0.0),
    "speed": (("task", "rewards", "speed"), 0.6),
    "flight": (("task", "rewards", "flight"), -0.3),
    "smooth": (("task", "rewards", "smooth"), -0.06),
    "discount": (("learner", "discount"), 0.97),
    "landing": (("task", "gait", "landing"), 0.0),
    "last epsilon": (("learner", "epsilon_min"), 0.03),
    "last rate": (("learner", "learning_rate_end"), 0.1),
}
"""What a row says only where it differs: where it stands in a setting, and its usual value."""

BEFORE = {"F": ("cadence", "smoothing", "slip", "speed", "smooth"), "G": ("cadence", "smoothing", "smooth")}
"""What whole series differ in, which their rows do not repeat."""


def words(setting: dict[str, Any]) -> str:
    """A setting by its servo's stiffness and largest offset, by its choices where all have the same servo, or by the
    weight of `yawing` where all begin from one setting; and what is unusual. By its name where that is all."""
    series, task = setting["series"], setting["task"]
    if "weight_averaging" in setting["learner"]:
        return f"{series}   {setting['setting']}"
    usually = {name: usual for name, (_, usual) in USUAL.items()}
    if (yawing := task["rewards"].get("yawing")) is not None:
        usually |= {"slip": -1.5, "smooth": -0.12, "yawing": yawing}
        text = f"{series}   yawing {yawing:g}" + (", little yaw" if task["action_shares"][1] < 0.8 else "")
    elif "bins" in task:
        grow = " growing" if setting["learner"].get("coarse_to_fine") else ""
        text = f"{series}   {task['bins']}{grow} choices, {task['action_scale']:g}°"
        text += ", more along the legs" if task["action_shares"][0] > 1.0 else ""
    else:
        stiffness, scale, period = task["control"]["stiffness"], task["action_scale"], task["gait"]["period"]
        text = f"{series}   {stiffness:g} N m/rad, {scale:g}°, {period:g} s"
    for name, (place, _) in USUAL.items():
        value: Any = setting
        for part in place:
            value = value.get(part, 0.0)
        if abs(value - usually[name]) > 1e-6 and name not in BEFORE.get(series, ()):
            text += f", {name} {value:.2g}"
    fastest, steps = task["command"]["forward"][1], setting["steps"] / 1e6
    text += f", up to {fastest:g} m/s" if fastest != 0.8 else ""
    return text + (f", {steps:.0f}M steps" if yawing is not None and steps > 45 else "")


def seeds_of(record: dict[str, Any], setting: dict[str, Any]) -> Seeds:
    """The seeds of one setting of the record."""
    return lambda name, command: [seed[record["commands"].index(command)] for seed in setting["figures"][name]]


def rows_of(record: dict[str, Any]) -> list[Row]:
    """A row for each setting of the record."""
    return [(words(setting), seeds_of(record, setting)) for setting in record["settings"]]


def draw(target: Path, rows: list[Row], size: tuple[float, float]) -> None:
    """One row for each setting, one dot for each training seed; `size` is a panel's, inches."""
    places = np.arange(len(rows))[::-1]
    with figure(target, 1, len(PANELS), size=size, sharey=True) as (_, axes):
        for panel, (heading, name, told, goal) in zip(axes[0], PANELS, strict=True):
            for color, command in zip(COLORS, told, strict=False):
                for place, (_, values) in zip(places, rows, strict=True):
                    seeds = values(name, command)
                    panel.plot(seeds, np.full(len(seeds), place), "o", color=color, alpha=0.7, markersize=4)
                if name == "forward":
                    panel.axvline(float(command.split()[1]), color=color, linewidth=0.8)
            if goal is not None:
                panel.axvline(goal, color="black", linewidth=0.8, linestyle="--")
            panel.set_title(heading)
        axes[0, 0].set_yticks(places, [label for label, _ in rows])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="the folder")
    out = parser.parse_args().out
    for name, (record, height) in RECORDS.items():
        target = out / f"{name}.png"
        draw(target, rows_of(json.loads((ROOT / "docs" / "bench" / f"{record}.json").read_text())), (2.4, height))
        print(target)


if __name__ == "__main__":
    main()
