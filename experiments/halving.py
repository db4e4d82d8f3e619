"""Compare halving with the whole grid: the best setting that each finds, and the processor time that each takes.

    python experiments/halving.py maze --json docs/bench/halving_maze.json             # two minutes of processor time
    python experiments/halving.py leg_reach --json docs/bench/halving_leg_reach.json   # five minutes a repeat

Each repeat draws other settings and other seeds. Both searches train the same settings with the same seeds; the whole
search, in mode random, trains all of them to the end. Halving found a setting as good if its best is the best of the
whole search, or one of those that the common seeds do not tell from it (`statistics.not_worse`).
"""

import argparse
import json
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import humanoid_mjx
from humanoid_mjx import compute
from humanoid_mjx.config import load
from humanoid_mjx.runs.ranking import compared

REPEATS = 10

TABLES = {
    "learner.epsilon": {"uniform": [0.0, 1.0]},
    "learner.epsilon_decay": {"uniform": [0.9, 1.0]},
    "learner.learning_rate": {"loguniform": [0.001, 1.0]},
    "learner.discount": {"uniform": [0.3, 0.99]},
}

TILES = {
    "learner.epsilon": {"uniform": [0.0, 1.0]},
    "learner.epsilon_decay": {"uniform": [0.6, 1.0]},
    "learner.learning_rate": {"loguniform": [0.01, 1.0]},
}

SEARCHES = {
    "maze": ("maze", ["seeds=8", "episodes=1000", "learner.evaluation_envs=10"], 600, TABLES, {"eta": 3, "rungs": 4}),
    "leg_reach": (
        "leg_reach_sweep",
        ["seeds=3", "total_steps=400000", "record=10", "learner.evaluations=1"],
        54,
        TILES,
        {"eta": 9, "rungs": 2},
    ),
}
"""By name: a shipped config, what is changed in it, the number of settings, what they are drawn from, and the
keys of mode halving."""


def main() -> None:
    """Measure, and write a record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("search", choices=SEARCHES)
    parser.add_argument("--json", type=Path, required=True, help="the record")
    parser.add_argument("--repeats", type=int, default=REPEATS)
    given = parser.parse_args()
    compute.start()
    name, changes, points, axes, halving = SEARCHES[given.search]
    config = load(name, changes).model_dump(mode="json", exclude_none=True)
    record = compute.made_by() | {"search": given.search, "config": config, "points": points, "axes": axes}
    record |= {"halving": halving, "repeats": []}
    for seed in range(given.repeats):
        record["repeats"].append(repeat(config | {"seed": seed}, points, axes, halving))
        print(record["repeats"][-1], flush=True)
        given.json.write_text(json.dumps(record) + "\n")


def repeat(
    config: Mapping[str, Any], points: int, axes: Mapping[str, Any], halving: Mapping[str, int]
) -> dict[str, Any]:
    """Return the best of both searches, and their seconds of processor time, compiling included."""
    seconds, runs = {}, {}
    with tempfile.TemporaryDirectory() as folder:
        for mode, keys in {"random": {}, "halving": halving}.items():
            sweep, began = {"mode": mode, "points": points, "axes": axes, **keys}, time.process_time()
            runs[mode] = humanoid_mjx.sweep({**config, "sweep": sweep}, Path(folder) / mode, quiet=True)
            seconds[mode] = round(time.process_time() - began, 2)
        whole, best = runs["random"].summary, {mode: run.best["point"] for mode, run in runs.items()}
        order = [each["point"] for each in runs["random"].points()]
    told = compared("random", list(axes), whole, quickest="episodes" in config).policy
    measured = {mode: whole[told.measure][whole["point"] == point] for mode, point in best.items()}
    return {
        "seconds": seconds,
        "best": best,
        "measure": told.measure,
        "of_best": {mode: [float(f"{x:.5g}") for x in values] for mode, values in measured.items()},
        "rank_of_halving": order.index(best["halving"]) + 1,
        "as_good": len(told.as_good),
        "found": best["halving"] in told.as_good,
    }


if __name__ == "__main__":
    main()
