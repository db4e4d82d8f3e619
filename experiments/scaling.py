"""Measure how a sweep scales over the devices of this machine: n of them with n times the runs, against one alone.

python experiments/scaling.py --json scaling.json     # about two minutes on two GPUs

Efficiency is the rate of all devices over the rate of one, by their number; 1 is ideal. The two train in turn, round
after round, by the same loop as `humanoid-mjx sweep`, so that a machine whose speed drifts favours neither. On a CPU a
device alone uses the other cores, too, and an efficiency below 1 is no loss.
"""

import argparse
import json
import statistics
import time
from collections import deque
from pathlib import Path

import jax

from humanoid_mjx import runtime
from humanoid_mjx.bench.measure import Record, spread
from humanoid_mjx.config import parse
from humanoid_mjx.training.plan import make_plan
from humanoid_mjx.training.pool import Pool
from humanoid_mjx.types import Device

TABLES = {
    "task": {"name": "joint_reach", "joint": 1, "max_episode_steps": 100},
    "learner": {"name": "tabular_q", "epsilon_decay": 1.0},
    "sweep": {"axes": {"learner.epsilon": {"linspace": [0.1, 0.9, 16]}}},
    "episodes": 10_000_000,
}
NETWORKS = {
    "task": {"name": "leg_reach", "physics": "chain"},
    "learner": {"name": "deep_q", "envs": 128, "learning_rate": 1e-4},
    "total_steps": 2_000_000_000,
}
SWEEPS = {"tabular_q": TABLES, "deep_q": NETWORKS}
"""What is swept: trainings that last longer than the measurement, at every moment with the same work."""

SEEDS = {"cpu": {"tabular_q": 32, "deep_q": 2}, "gpu": {"tabular_q": 4096, "deep_q": 32}}
"""Seeds on each device, by backend: where one is well used."""

ROUNDS, ROUND_S = 5, 3.0


def pool_on(devices: list[Device], config: dict, seeds: int) -> Pool:
    """Runs on some devices, so many seeds on each, compiled and under way."""
    (group,) = make_plan(parse({"name": "scaling", "seeds": seeds * len(devices), **config})).groups
    pool = Pool(group, deque(group.runs.tolist()), len(group.runs) // len(devices), devices, seed=0)
    pool.fill()
    until = time.monotonic() + ROUND_S  # chunks find their length
    pool.train()
    while time.monotonic() < until:
        pool.train()
    return pool


def rate(pool: Pool) -> float:
    """What all runs together train a second: episodes, or control steps."""
    before, began = pool.progress.sum(), time.monotonic()
    while time.monotonic() - began < ROUND_S:
        pool.train()
    return float((pool.progress.sum() - before) * pool.group.learner().budget / (time.monotonic() - began))


def measure(name: str, seeds: int) -> list[Record]:
    """The rates of one device and of all, and the efficiency."""
    devices, pools, compile_s = jax.local_devices(), {}, {}
    for count in (1, len(devices)):
        with runtime.counting_compiles() as compiles:
            pools[count] = pool_on(devices[:count], SWEEPS[name], seeds)
        compile_s[count] = round(compiles.seconds, 3)
    rounds = [{count: rate(pool) for count, pool in pools.items()} for _ in range(ROUNDS)]

    def record(subject: str, count: int, values: list[float], unit: str) -> Record:
        return Record(
            bench="scaling",
            subject=subject,
            device=f"{count} x {devices[0].device_kind}",
            batch=len(pools[count].slots),
            value=statistics.median(values),
            unit=unit,
            compile_s=compile_s[count],
            repeats=ROUNDS,
            spread=spread(values),
        )

    unit = "steps/s" if pools[1].group.learners.unit == "total_steps" else "episodes/s"
    rates = [record(name, count, [each[count] for each in rounds], unit) for count in pools]
    shares = [each[len(devices)] / each[1] / len(devices) for each in rounds]
    return [*rates, record(f"{name} efficiency", len(devices), shares, "1")]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there, too")
    for name in SWEEPS:
        parser.add_argument(f"--{name.replace('_', '-')}", type=int, metavar="SEEDS", help="seeds on each device")
    given = vars(parser.parse_args())
    runtime.start()
    if len(jax.local_devices()) < 2:
        parser.error("this machine has one device.")
    seeds = SEEDS.get(jax.default_backend(), SEEDS["gpu"])
    records = [record.as_json() for name in SWEEPS for record in measure(name, given[name] or seeds[name])]
    text = json.dumps(runtime.made_by() | {"records": records}, indent=2)
    print(text)
    if given["json"] is not None:
        given["json"].write_text(text + "\n")


if __name__ == "__main__":
    main()
