"""Train the same sweeps on one and on several cards of this machine, and write the record.

python experiments/scaling.py [--cards 1,2] [--only joint1,walk] [--once] [--small] [docs/bench/h100_scaling.json]
python experiments/scaling.py docs/bench/h100_scaling.json --draw docs/scaling.png    # a record

Each sweep is a whole command in a process of its own that sees so many cards: once with nothing compiled, and
unless told `--once` again. The record has the rate of training, the seconds of the command, the memory and the cores
that it takes of the host, and whether tables of results are the same, byte by byte, as those of the first number of
cards, and as those of the second time. Each sweep but those of `UNKILLED` is also killed on the largest number of cards
and resumed on the smallest. Without a GPU devices of the CPU stand for cards. `--small` tries the script.
"""

import argparse
import hashlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pyarrow.parquet as pq

from humanoid_mjx import compute
from humanoid_mjx.report.style import COLORS, figure
from humanoid_mjx.runs.listing import look_at
from humanoid_mjx.spec import InputError

SWEEPS = {
    "joint1": ["seeds=3_400", "episodes=8_000", "record=5"],  # a million tables
    "leg_reach": ["seeds=64", "total_steps=20_000_000"],
    "stand": ["seeds=8"],
    "walk": ["seeds=40", "total_steps=10_000_000"],
    "walk_dog": ["seeds=10"],
    "walk_humanoid": ["seeds=40", "total_steps=4_000_000"],
}
"""Sweeps with work for several cards, and what they change of their config."""

UNKILLED = ("leg_reach", "stand", "walk_humanoid")
"""Sweeps that are not killed: too long to be trained again, or too short for a state to be stored before the end."""

TINY = ["learner.envs=64", "learner.evaluation_envs=16", "learner.minibatches=1", "total_steps=20_000", "record=5"]
SMALL = {
    "joint1": ["seeds=1", "episodes=100"],
    "leg_reach": ["seeds=4", "learner.evaluations=1", *TINY],
    "walk_dog": ["seeds=2", "learner.evaluations=1", *TINY],
}
TABLES = ("results.parquet", "summary.parquet")


def command(config: str, settings: list[str], out: Path, *options: str) -> list[str]:
    sets = [word for setting in settings for word in ("--set", setting)]
    return [sys.executable, "-m", "humanoid_mjx", "sweep", config, *sets, "--out", str(out), *options]


def environment(cards: int, cache: Path) -> dict[str, str]:
    """The environment of a process that sees so many cards."""
    seen = {"JAX_NUM_CPU_DEVICES": str(cards)}
    if jax.default_backend() == "gpu":
        seen = {"CUDA_VISIBLE_DEVICES": ",".join(map(str, range(cards)))}
    return os.environ | seen | {"JAX_COMPILATION_CACHE_DIR": str(cache)}


def digest(out: Path) -> str:
    return hashlib.sha256(b"".join((out / name).read_bytes() for name in TABLES)).hexdigest()


def success(out: Path) -> float:
    """The mean success of all runs at their end."""
    return round(float(np.mean(pq.read_table(out / "summary.parquet")["greedy_success"])), 4)


def trained(config: str, settings: list[str], cards: int, place: Path, times: tuple[str, ...]) -> dict[str, Any]:
    """One row of the record: the same command twice, with an empty cache and with what the first left there."""
    row: dict[str, Any] = {"config": config, "set": settings, "cards": cards}
    for which in times:
        out, began = place / f"{config}-{cards}-{which}", time.perf_counter()
        with tempfile.TemporaryFile("w+") as errors:
            env = environment(cards, place / f"cache-{cards}")
            process = subprocess.Popen(
                command(config, settings, out), env=env, stdout=subprocess.DEVNULL, stderr=errors
            )
            _, status, used = os.wait4(process.pid, 0)
            seconds = time.perf_counter() - began
            process.returncode = os.waitstatus_to_exitcode(status)
            if process.returncode:
                errors.seek(0)
                return row | {"error": errors.read().strip().splitlines()[-1:]}
        host = {"host_gb": used.ru_maxrss / 1e6, "host_cores": (used.ru_utime + used.ru_stime) / seconds}
        made = json.loads((out / "provenance.json").read_text())
        rates = {name: made.get(name) for name in ("steps_per_s", "wall_s", "compile_s")}
        row[which] = rates | {"command_s": round(seconds, 1)} | {name: round(value, 1) for name, value in host.items()}
        row[which] |= {"tables": digest(out), "success": success(out)}
        print(config, cards, which, row[which], flush=True)
    return row | {"same_bits_again": row["first"]["tables"] == row["again"]["tables"] if len(times) > 1 else None}


def stored(out: Path) -> float:
    """The share of a sweep's training that its folder holds."""
    try:
        return look_at(out).share
    except InputError:  # nothing yet
        return 0.0


def resumed(config: str, settings: list[str], cards: tuple[int, int], after: float, place: Path) -> dict[str, Any]:
    """Kill a sweep on the first number of cards, some of it stored or after so long; resume on the second."""
    out = place / f"{config}-killed"
    words = command(config, settings, out)
    process = subprocess.Popen(words, env=environment(cards[0], place / f"cache-{cards[0]}"), stdout=subprocess.DEVNULL)
    began = time.perf_counter()
    while process.poll() is None and time.perf_counter() - began < after and not stored(out):
        time.sleep(0.2)
    ended, after = process.poll() is not None, time.perf_counter() - began
    process.send_signal(signal.SIGKILL)
    process.wait()
    share = stored(out)
    env = environment(cards[1], place / f"cache-{cards[1]}")
    again = subprocess.run([*words, "--resume"], env=env, stdout=subprocess.DEVNULL)
    found = {"config": config, "killed_on": cards[0], "resumed_on": cards[1], "after_s": round(after, 1)}
    found |= {"stored": share}
    return found | {"ended_before": ended, "code": again.returncode, "tables": digest(out), "success": success(out)}


def draw(record: dict[str, Any], target: Path) -> None:
    """Draw how many times as fast as on one card sweeps train, and how long the commands take."""
    with figure(target, 1, 2) as (whole, panels):
        speed, command_s = panels.flat
        for config, color in zip({row["config"]: None for row in record["rows"]}, COLORS, strict=False):
            rows = [row for row in record["rows"] if row["config"] == config and "error" not in row]
            cards, made = [row["cards"] for row in rows], [row.get("again", row["first"]) for row in rows]
            times = [one["steps_per_s"] / made[0]["steps_per_s"] for one in made]
            speed.plot(cards, times, "o-", color=color, label=config)
            command_s.plot(cards, [one["command_s"] for one in made], "o-", color=color, label=config)
        speed.plot(record["cards"], record["cards"], "--", color="0.6", label="as many times as cards")
        for panel, words in (speed, "times the steps a second on one card, while training"), (command_s, "command, s"):
            panel.set_title(words, loc="left")
            panel.set_xlabel(f"cards of one host, {record['machine']['device']}")
            panel.set_xticks(record["cards"])
            panel.set_ylim(bottom=0)
        whole.legend(*speed.get_legend_handles_labels(), loc="outside lower center", ncols=4)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, nargs="?")
    parser.add_argument("--cards", default="1,2")
    parser.add_argument("--only")
    parser.add_argument("--once", action="store_true")
    parser.add_argument("--small", action="store_true")
    parser.add_argument("--draw", type=Path)
    given = parser.parse_args()
    if given.draw:
        return draw(json.loads(given.file.read_text(encoding="utf-8")), given.draw)
    cards, sweeps = [int(number) for number in given.cards.split(",")], SMALL if given.small else SWEEPS
    only = given.only.split(",") if given.only else list(sweeps)
    times = ("first",) if given.once else ("first", "again")
    record = compute.made_by() | {"command": "python experiments/scaling.py", "cards": cards, "rows": [], "resumed": []}
    with tempfile.TemporaryDirectory() as folder:
        for config in only:
            rows = [trained(config, sweeps[config], count, Path(folder), times) for count in cards]
            done, last = [row for row in rows if "error" not in row], times[-1]
            for row in done:
                row["same_bits_as_first"] = row[last]["tables"] == done[0][last]["tables"]
            record["rows"] += rows
            if config not in UNKILLED and len(done) == len(cards):
                after = 0.7 * done[-1][last]["command_s"]  # before the end, if nothing is stored until then
                killed = resumed(config, sweeps[config], (cards[-1], cards[0]), after, Path(folder))
                killed["same_bits"] = killed["tables"] == done[0][last]["tables"]
                record["resumed"].append(killed)
                print(killed, flush=True)
            if given.file:
                given.file.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
