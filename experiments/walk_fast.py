"""Train `walk` for commands beyond its own, and measure how fast the body goes.

    python experiments/walk_fast.py --run runs/walk_fast --json docs/bench/walk_fast.json

All points of `AXES` are trained side by side with five seeds each, and played for 20 s straight ahead at each of
`SPEEDS`. The record has a figure of each seed under each command. The Froude number is the squared speed by gravity and
the length of the legs; running is time without a foot on the ground.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from chapter_8 import train
from walk_worlds import walked

import humanoid_mjx
from humanoid_mjx import compute
from humanoid_mjx.evaluation.gait.scenarios import Scenario, settings_of, trained_seeds, walking_task
from humanoid_mjx.evaluation.policy import in_world

SPEEDS = 0.3, 0.5, 0.65, 0.8, 1.0, 1.2, 1.4, 1.6
"""m/s, straight ahead."""

KEPT = 0.9
"""Share of the episodes in which a body must stay up for its speed to count."""

TRAINING = (
    "task.command={forward: [0.0, 1.6], sideways: [0.0, 0.0], turn: [-0.5, 0.5], sudden: 0.0}",
    "task.rewards.speed=1.0",
    "task.rewards.flight=0.0",
    "learner.precision=bfloat16",
    "learner.evaluations=1",
    "total_steps=40_000_000",
    "seeds=5",
    "sweep.mode=zip",
)
"""Values of `walk` that differ in all trainings."""

AXES = {
    "task.gait.stance": [0.62, 0.5, 0.5],
    "task.gait.cadence": [0.4, 0.4, 0.8],
    "task.action_scale": [16.0, 24.0, 24.0],
    "task.rewards.slip": [-0.9, -0.9, -0.3],
}
"""The settings, point by point: long stances, a clock that knows of no time with both feet down, and less care."""

FIGURES = "success", "forward", "heading_error", "slip", "flight", "duty", "step_frequency", "cost_of_transport"


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, play and write the record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", type=Path, default=Path("runs/walk_fast"), help="the run folder")
    parser.add_argument("--episodes", type=int, default=64, help="of each seed under each command")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="of the training")
    parser.add_argument("--json", type=Path, required=True, metavar="FILE")
    given = parser.parse_args(arguments)
    humanoid_mjx.start()
    overrides = [*TRAINING, *(f"sweep.axes.{key}={values}" for key, values in AXES.items()), *given.set]
    train(given.run, "walk", overrides)
    scenarios, rows = [Scenario(f"forward {speed}", (speed, 0.0, 0.0)) for speed in SPEEDS], []
    for point in range(len(next(iter(AXES.values())))):
        policies = [in_world(policy, None, settings_of([])) for policy in trained_seeds([str(given.run)], point)]
        found = walked(policies, given.episodes, FIGURES, scenarios)
        pace = walking_task(policies[0].learner.task).robot.pace
        froude = [[(speed or 0.0) ** 2 / pace**2 for speed in seeds] for seeds in found["forward"]]
        kept = [np.mean(seeds) >= KEPT for seeds in found["success"]]
        speeds = [np.mean(seeds) if keeps else 0.0 for seeds, keeps in zip(found["forward"], kept, strict=True)]
        changed = {key: values[point] for key, values in AXES.items()}
        rows.append({"point": point, "changed": changed, **found, "froude": froude, "fastest": float(max(speeds))})
        print(f"{changed}: {max(speeds):.2f} m/s is kept for 20 s by {KEPT:.0%}", flush=True)
    record = compute.made_by() | {"set": overrides, "episodes": given.episodes, "rows": rows}
    given.json.write_text(json.dumps(record) + "\n")


if __name__ == "__main__":
    main()
