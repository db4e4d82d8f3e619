"""Draw how `walk` walks by learner and by the gait that is corrected, from the records.

python experiments/walk_compared.py            # writes docs/walk_compared.png, in seconds
"""

import argparse
import json
from pathlib import Path
from typing import Any

from walk_settings import ROOT, Row, draw, seeds_of

RUNS = ("h200_walk_seeds", "h200_walk_ppo", "h200_walk_control")
"""Records of `humanoid-mjx evaluate RUN --gait --json FILE`."""

GAITS_RECORD = "h200_walk_gaits"
"""The record of settings that differ in the gait."""

LEARNERS = {"deep_q": "Q(λ)", "brax_ppo": "PPO"}
GAITS = {
    "steps": "steps as commanded",
    "clock": "no steps, a clock",
    "table": "poses of Table 4.5",
    "oscillators": "oscillators",
}


def words(task: dict[str, Any], learner: str, steps: float) -> str:
    """What is trained, what it corrects, how heavily slip weighs, and for how long."""
    gait = task.get("gait") or {}
    kind = GAITS[gait.get("name", "steps")]
    if gait.get("stride") == 0.0:
        kind = "no steps, a clock" if gait.get("lift") == 0.0 else "steps on the spot"
    law = "computed torque, " if task["control"]["name"] == "grounded" else ""
    return f"{LEARNERS[learner]}, {law}{kind}, slip {task['rewards']['slip']:g}, {steps / 1e6:.0f}M control steps"


def rows() -> list[Row]:
    """A row for each group of seeds."""

    def row(result: dict[str, Any]) -> Row:
        greedy = {gait["scenario"]: gait["figures"] for gait in result["gaits"] if gait["agent"] == "greedy"}
        config = result["policies"][0]["config"]
        label = words(config["task"], config["learner"]["name"], config["total_steps"])
        return label, lambda name, command: [seed[0] for seed in greedy[command][name]["seeds"]]

    bench = ROOT / "docs" / "bench"
    found = [row(result) for name in RUNS for result in json.loads((bench / f"{name}.json").read_text())["results"]]
    record = json.loads((bench / f"{GAITS_RECORD}.json").read_text())
    return found + [(words(one["task"], "deep_q", one["steps"]), seeds_of(record, one)) for one in record["settings"]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="the folder")
    target = parser.parse_args().out / "walk_compared.png"
    draw(target, rows(), (2.4, 2.7))
    print(target)


if __name__ == "__main__":
    main()
