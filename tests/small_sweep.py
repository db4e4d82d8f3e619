"""A small sweep that tests train in this process and in others."""

import json
import os
import subprocess
import sys

import numpy as np

from humanoid_mjx.runs.curves import Learning

CONFIG = {
    "name": "small",
    "task": {"name": "joint_reach", "joint": 5, "states": 13, "max_episode_steps": 40},
    "learner": {"name": "tabular_q", "epsilon_decay": 0.99},
    "sweep": {"axes": {"learner.epsilon": [0.2, 0.6, 1.0], "learner.learning_rate": [0.1, 0.7]}},
    "seeds": 3,
    "seed": 5,
    "episodes": 60,
    "record": 10,
}

LONG = {
    "task": CONFIG["task"] | {"joint": 1, "states": 24, "max_episode_steps": 400},
    "sweep": {"axes": {"learner.discount": [0.5, 0.97], "learner.epsilon": [0.3, 0.6, 1.0]}},
    "episodes": 1000,
    "seeds": 15,
}
"""Half of these runs wait before the goal and take 20 times as long as the others: a kill finds them half done."""

SWITCHING = {
    "name": "posture",
    "task": {"name": "posture_switch", "places": 3},
    "learner": {"name": "tabular_q", "epsilon": 0.7, "epsilon_decay": 0.95, "learning_rate": 0.3},
    "seeds": 2,
    "episodes": 50,
}
"""A sweep that learns to switch postures."""


def run_cli(*arguments, cwd, devices="2", **kwargs):
    environment = os.environ | {"JAX_NUM_CPU_DEVICES": devices}
    command = [sys.executable, "-m", "humanoid_mjx", *arguments]
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, **kwargs)


def write_config(folder, **changes):
    path = folder / "small.yaml"
    path.write_text(json.dumps(CONFIG | changes))
    return str(path)


def assert_same_tables(run, other):
    """The tables of two run folders are the same, byte by byte."""
    for name in ("results.parquet", "summary.parquet"):
        assert (run / name).read_bytes() == (other / name).read_bytes(), name


def of_rows(rows, axes, mode="grid", order=()):
    """The learning curves of columns as `results.parquet` has them. `order`: numbers of points, the best first."""
    unit = "step" if "step" in rows else "episode"
    places, at = np.unique(rows[unit], return_inverse=True)
    points, first, row = np.unique(rows["point"], return_index=True, return_inverse=True)
    seeds, column = np.unique(rows["seed"], return_inverse=True)

    def read(name):
        found = np.full((len(points), len(seeds), len(places)), np.nan)
        found[row, column, at] = rows[name]
        return found

    names = [name for name, values in rows.items() if values.dtype.kind == "f" and "." not in name]
    by_axis, numbers = {axis: rows[axis][first] for axis in axes}, points.tolist()
    ranked = [numbers.index(each) for each in order] or list(range(len(points)))
    return Learning(mode, by_axis, unit, places, names, read, len(seeds), numbers, ranked)
