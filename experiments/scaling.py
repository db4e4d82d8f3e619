"""Measure how training scales over the devices of this machine: all n of them with n times the work, against one.

python experiments/scaling.py --json scaling.json     # about two minutes on two GPUs

A sweep has n times the runs. Efficiency is the rate of all devices over the rate of one, by their number; 1 is ideal.
The two train in turn, round after round, by the same loop as `humanoid-mjx sweep`, so that a machine whose speed drifts
favours neither. On a CPU a device alone uses the other cores, too, and an efficiency below 1 is no loss.
"""

import argparse
import json
import statistics
import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax

from humanoid_mjx import compute
from humanoid_mjx.bench.measure import Record, spread
from humanoid_mjx.config import parse
from humanoid_mjx.training.plan import make_plan
from humanoid_mjx.training.pool import Pool
from humanoid_mjx.types import Device

SUBJECTS: dict[str, dict[str, Any]] = {
    "tabular_q sweep": {
        "task": {"name": "joint_reach", "joint": 1, "max_episode_steps": 100},
        "learner": {"name": "tabular_q", "epsilon_decay": 1.0},
        "sweep": {"axes": {"learner.epsilon": {"linspace": [0.1, 0.9, 16]}}},
        "episodes": 10_000_000,
    },
    "deep_q sweep": {
        "task": {"name": "leg_reach", "physics": "chain"},
        "learner": {"name": "deep_q", "learning_rate": 1e-4},
        "total_steps": 2_000_000_000,
    },
}
"""Trainings that last longer than the measurement, at every moment with the same work."""

SIZES = {"cpu": (32, 2), "gpu": (4096, 32)}
"""Seeds of each point for each device, by backend and subject, where one is well used."""

ROUNDS, ROUND_S = 7, 1.5


def training(subject: str, devices: Sequence[Device], seeds: int) -> Pool:
    """The runs of a subject on some devices, with so many seeds for each, compiled and under way."""
    (group,) = make_plan(parse({"name": "scaling", "seeds": seeds * len(devices)} | SUBJECTS[subject])).groups
    pool = Pool(group, deque(group.runs.tolist()), len(group.runs) // len(devices), devices, 0)
    pool.fill()
    pool.train()
    rate(pool)  # chunks find their length
    return pool


def rate(pool: Pool) -> float:
    """What all runs together train a second: episodes, or control steps."""
    before, began = pool.progress.sum(dtype=float), time.monotonic()
    while time.monotonic() - began < ROUND_S:
        pool.train()
    trained = float((pool.progress.sum(dtype=float) - before) * pool.group.learner().budget)
    return trained / (time.monotonic() - began)


def measure(subject: str, size: int) -> list[Record]:
    """The rates of one device and of all, and the efficiency."""
    devices, pools, compile_s = jax.local_devices(), {}, {}
    for count in (1, len(devices)):
        with compute.counting_compiles() as compiles:
            pools[count] = training(subject, devices[:count], size)
        compile_s[count] = round(compiles.seconds, 3)
    rounds = [{count: rate(pool) for count, pool in pools.items()} for _ in range(ROUNDS)]

    def record(name: str, count: int, values: list[float], unit: str) -> Record:
        return Record(
            bench="scaling",
            subject=f"{subject}{name}",
            device=f"{count} x {devices[0].device_kind}",
            batch=count * size,
            value=statistics.median(values),
            unit=unit,
            compile_s=compile_s[count],
            repeats=ROUNDS,
            spread=spread(values),
        )

    unit = "steps/s" if pools[1].group.learners.unit == "total_steps" else "episodes/s"
    rates = [record("", count, [each[count] for each in rounds], unit) for count in pools]
    shares = [each[len(devices)] / each[1] / len(devices) for each in rounds]
    return [*rates, record(" efficiency", len(devices), shares, "1")]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there, too")
    parser.add_argument("--size", type=int, nargs=2, metavar="N", help="seeds of tables, of networks")
    given = parser.parse_args()
    compute.start()
    if len(jax.local_devices()) < 2:
        parser.error("this machine has one device.")
    sizes = given.size or SIZES.get(jax.default_backend(), SIZES["gpu"])
    made_by = compute.made_by()
    records = [found.as_json() for pair in zip(SUBJECTS, sizes, strict=True) for found in measure(*pair)]
    text = json.dumps(made_by | {"records": records}, indent=2)
    print(text)
    if given.json is not None:
        given.json.write_text(text + "\n")


if __name__ == "__main__":
    main()
