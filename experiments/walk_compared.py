"""Draw how `walk` walks, from the records: by learner and by the gait that is corrected, and by the learner's values.

python experiments/walk_compared.py   # writes docs/walk_compared.png and docs/walk_learning.png, in seconds
"""

import argparse
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from humanoid_mjx.report.style import COLORS, figure

ROOT = Path(__file__).parent.parent

RUNS = ("h200_walk_40m", "h100_walk_quick", "h200_walk_seeds", "h200_walk_ppo", "h200_walk_control")
"""Records of `humanoid-mjx evaluate RUN --gait --json FILE`."""

Seeds: TypeAlias = Callable[[str, str], list[float]]
"""The training seeds' values of a figure under a command."""

TOLD = {"forward 0.3": COLORS[0], "forward 0.5": COLORS[1], "forward 0.8": COLORS[2]}

PANELS = (
    ("speed, m/s", "forward", tuple(TOLD), None),
    ("upright for 20 s,\nshare of episodes", "success", ("forward 0.5",), 0.98),
    ("slip, m/s", "slip", ("forward 0.3", "forward 0.5"), 0.03),
    ("heading error after\n20 s, degrees", "heading_error", ("forward 0.3",), 10.0),
    ("45° within 1.5 s,\nshare of turns", "turn_success", ("sudden turn",), 0.9),
)
"""Heading, figure of the record, commands, and the aim; the aims of the first panel are the commands."""

GAITS = {
    "steps": "steps as commanded",
    "clock": "a clock alone",
    "table": "poses of Table 4.5",
    "oscillators": "oscillators",
}


def words(task: Mapping[str, Any], learner: str, steps: float) -> str:
    """Return the learner, the gait that it corrects, the weight of slip and the length of the training."""
    gait = task.get("gait") or {}
    kind = GAITS[gait.get("name", "steps")]
    if gait.get("stride") == 0.0:
        kind = GAITS["clock"] if gait.get("lift") == 0.0 else "steps on the spot"
    law = "computed torque, " if task["control"]["name"] == "grounded" else ""
    return f"{learner}, {law}{kind}, slip {task['rewards']['slip']:g}, {steps / 1e6:.0f}M steps"


def record(name: str) -> dict[str, Any]:
    return json.loads((ROOT / "docs" / "bench" / f"{name}.json").read_text())


def evaluated(name: str) -> dict[str, Seeds]:
    """Return the groups of seeds of a record of `evaluate --gait`, by label."""

    def seeds(result: dict[str, Any]) -> Seeds:
        greedy = {gait["scenario"]: gait["figures"] for gait in result["gaits"] if gait["agent"] == "greedy"}
        return lambda figure, command: [seed[0] for seed in greedy[command][figure]["seeds"]]

    results = record(name)["results"]
    configs = [result["policies"][0]["config"] for result in results]
    labels = (words(config["task"], config["learner"]["name"], config["total_steps"]) for config in configs)
    return dict(zip(labels, map(seeds, results), strict=True))


def series(name: str, label: Callable[[dict[str, Any]], str]) -> dict[str, Seeds]:
    """Return the groups of seeds of a record of several settings, by label."""
    found = record(name)

    def seeds(setting: dict[str, Any]) -> Seeds:
        return lambda figure, command: [seed[found["commands"].index(command)] for seed in setting["figures"][figure]]

    return {label(setting): seeds(setting) for setting in found["settings"]}


def draw(target: Path, rows: Mapping[str, Seeds]) -> None:
    """Draw one row for each group, one dot for each training seed."""
    places = np.arange(len(rows))[::-1]
    with figure(target, 1, len(PANELS), size=(2.6, 0.9 + 0.24 * len(rows)), sharey=True) as (fig, axes):
        for panel, (heading, name, commands, aim) in zip(axes[0], PANELS, strict=True):
            for command in commands:
                color = TOLD.get(command, "0.35")
                for place, values in zip(places, rows.values(), strict=True):
                    seeds = values(name, command)
                    panel.plot(seeds, np.full(len(seeds), place), "o", color=color, alpha=0.7, markersize=4)
                if name == "forward":
                    panel.axvline(float(command.split()[1]), color=color, linewidth=0.8, linestyle="--")
            if aim is not None:
                panel.axvline(aim, color="black", linewidth=0.8, linestyle="--")
            panel.set_title(heading)
        axes[0, 0].set_yticks(places, list(rows))
        dots = [axes[0, 0].plot([], [], "o", color=color)[0] for color in TOLD.values()]
        labels = [f"told {command.split()[1]} m/s" for command in TOLD]
        fig.legend(dots, labels, loc="outside lower right", ncols=3, frameon=False)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="the folder")
    out = parser.parse_args().out
    compared = {label: seeds for name in RUNS for label, seeds in evaluated(name).items()}
    compared |= series("h200_walk_gaits", lambda one: words(one["task"], "deep_q", one["steps"]))
    learning = series("h200_walk_learning", lambda one: one["setting"])
    for name, rows in {"walk_compared": compared, "walk_learning": learning}.items():
        draw(out / f"{name}.png", rows)
        print(out / f"{name}.png")


if __name__ == "__main__":
    main()
