"""Write the record of a sweep from its run folder: success, return and rate of every point and seed, and their curves.

python experiments/sweep_record.py runs/stand_sweep "humanoid-mjx sweep stand_sweep" docs/bench/h200_stand_sweep.json
"""

import json
import sys
from pathlib import Path

import numpy as np

import humanoid_mjx
from humanoid_mjx.runs.folder import read_config, read_provenance


def main() -> None:
    run, command, target = Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3])
    config, folder = read_config(run), humanoid_mjx.load_run(run)
    summary, results = folder.summary, folder.results
    axes = list((config.get("sweep") or {}).get("axes", {}))
    points = []
    for point in np.unique(summary["point"]):
        mine = summary["point"] == point
        row = {axis: summary[axis][mine][0].item() for axis in axes}
        found = {name: summary[name][mine].tolist() for name in ("greedy_success", "greedy_return", "whole_success")}
        points.append(row | found | {"diverged": int(summary["diverged"][mine].sum())})
    # Tables have a row for each point, seed and record step, in this order.
    measures = ("return",) if "step" in results else ("return", "steps")
    counter, shape = "step" if "step" in results else "episode", (len(points), -1, int(config["record"]))
    curves = {
        counter: results[counter][: shape[2]].tolist(),
        "curves": {name: _short(results[name].reshape(shape)) for name in measures},
    }
    record = read_provenance(run) | {"command": command, "config": config, "points": points} | curves
    target.write_text(json.dumps(record) + "\n")
    print(target)


def _short(values: np.ndarray) -> list[list[list[float]]]:
    """Numbers of four digits, nested as the array is."""
    return [[[float(f"{x:.4g}") for x in seed] for seed in point] for point in values]


if __name__ == "__main__":
    main()
