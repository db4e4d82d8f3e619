"""Write the record of a sweep from its run folder: success, return and rate of every point and seed.

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
    config, summary = read_config(run), humanoid_mjx.load_run(run).summary
    axes = list((config.get("sweep") or {}).get("axes", {}))
    points = []
    for point in np.unique(summary["point"]):
        mine = summary["point"] == point
        row = {axis: summary[axis][mine][0].item() for axis in axes}
        found = {name: summary[name][mine].tolist() for name in ("greedy_success", "greedy_return", "whole_success")}
        points.append(row | found | {"diverged": int(summary["diverged"][mine].sum())})
    record = read_provenance(run) | {"command": command, "config": config, "points": points}
    target.write_text(json.dumps(record) + "\n")
    print(target)


if __name__ == "__main__":
    main()
