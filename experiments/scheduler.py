"""Simulate how workers share the chunks of a sweep, and write the record of `walk` on 8, 64 and 512 GPUs.

python experiments/scheduler.py [docs/bench/scheduler.json]

A worker that is free takes the next chunk, as with `sweep --ray`. It may be slower than others, and it may be taken
away: then the chunk goes on from its last state with the next free worker, and another machine comes. The seconds of a
chunk and of the start are those of five seeds of `walk` on one H100 (docs/bench/h100_walk.json).
"""

import argparse
import heapq
import itertools
import json
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from humanoid_mjx.config import load
from humanoid_mjx.training.cost import finished_bytes
from humanoid_mjx.training.on_ray import STATE_BYTES_PER_S
from humanoid_mjx.training.plan import make_plan

BENCH = Path(__file__).parent.parent / "docs" / "bench"

SETTINGS, SEEDS, GPUS = 10_000, 5, (8, 64, 512)
SPEEDS = (0.8, 1.0)
"""Speeds of GPUs that are nominally alike: each draws one between these."""
TAKEN_EVERY_S = 6 * 3600.0
"""Mean time until a machine of a cloud that may be taken away is, s."""
BACK_S = 300.0
"""Seconds until another one comes."""


class Schedule(NamedTuple):
    """The end of a sweep."""

    makespan_s: float
    """Seconds until the last chunk is trained."""
    idle_share: float
    """Share of the workers' time, from the start to that end, in which they have no chunk: they start or wait."""
    repeated_s: float
    """Seconds of training that were done twice, since they came after the last state."""
    taken: int
    """Number of times that a machine was taken away."""


def simulate(
    lengths: Sequence[float],
    speeds: Sequence[float],
    start_s: float = 0.0,
    taken_every_s: float = np.inf,
    state_every_s: float = 30.0,
    back_s: float = BACK_S,
    seed: int = 0,
) -> Schedule:
    """Let workers take chunks, one after another.

    Args:
      lengths: seconds of each chunk on a worker of speed 1, in the order in which they are handed out.
      speeds: those of the workers.
      start_s: seconds from the beginning, or from its coming, until a worker trains.
      taken_every_s: mean seconds until a worker is taken away.
      state_every_s: seconds between two states of a chunk.
      back_s: seconds until another worker comes in the place of one that was taken away.
      seed: of the times at which workers are taken away.
    """
    rng, waiting, order = np.random.default_rng(seed), deque(lengths), itertools.count()
    lives = [rng.exponential(taken_every_s) if np.isfinite(taken_every_s) else np.inf for _ in speeds]
    events: list[tuple[float, int, int, float, float]] = []
    """Time, tie breaker, worker, seconds trained, seconds of its chunk that are left then."""
    for worker in range(len(speeds)):
        heapq.heappush(events, (start_s, next(order), worker, 0.0, 0.0))
    busy = repeated = end = 0.0
    taken, free = 0, deque[int]()
    while events:
        now, _, worker, trained, left = heapq.heappop(events)
        busy, end = busy + trained, now if trained else end
        if left:  # it was taken away
            waiting.appendleft(left)
            taken += 1
            lives[worker] = now + back_s + rng.exponential(taken_every_s)
            heapq.heappush(events, (now + back_s + start_s, next(order), worker, 0.0, 0.0))
        else:
            free.append(worker)
        while waiting and free:
            chosen, length = free.popleft(), waiting.popleft()
            ends = now + length / speeds[chosen]
            if ends <= lives[chosen]:
                heapq.heappush(events, (ends, next(order), chosen, ends - now, 0.0))
                continue
            passed = max(lives[chosen] - now, 0.0)
            kept = passed // state_every_s * state_every_s
            repeated += passed - kept
            rest = length - kept * speeds[chosen]
            heapq.heappush(events, (max(lives[chosen], now), next(order), chosen, passed, rest))
    return Schedule(end, 1.0 - busy / (end * len(speeds)), repeated, taken)


def row(gpus: int, chunk: int, rate: float, start_s: float, sizes: tuple[int, int], steps: int) -> dict[str, Any]:
    """Return the figures of the sweep of `walk` on so many GPUs."""
    runs = SETTINGS * SEEDS
    length, state, result = chunk * steps / rate, chunk * sizes[0], chunk * sizes[1]
    every_s = max(30.0, state / STATE_BYTES_PER_S)
    lengths, speeds = [length] * -(-runs // chunk), np.random.default_rng(0).uniform(*SPEEDS, gpus)
    alike = simulate(lengths, np.ones(gpus).tolist(), start_s)
    uneven = simulate(lengths, speeds.tolist(), start_s)
    taken = simulate(lengths, speeds.tolist(), start_s, TAKEN_EVERY_S, every_s)
    return {
        "gpus": gpus,
        "chunk": chunk,
        "chunks": len(lengths),
        "chunk_s": length,
        "gpu_hours": runs * steps / rate / 3600,
        "results_bytes": result * len(lengths),
        "state_bytes_per_s": gpus * state / every_s if length > every_s else 0.0,
        "result_bytes_per_s": gpus * result / length,
        "alike": alike._asdict(),
        "uneven": uneven._asdict() | {"ideal_s": runs * steps / rate / speeds.sum()},
        "taken": taken._asdict(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, nargs="?", default=BENCH / "scheduler.json")
    measured = json.loads((BENCH / "h100_walk.json").read_text())["training"]
    plan = make_plan(load("walk", [f"seeds={SEEDS}"]))
    group = plan.groups[0]
    sizes = group.bytes, finished_bytes(group)
    # Nothing is compiled: the rest of the command is the start of Python, tracing and compiling.
    start_s = measured["command_s"] - measured["wall_s"] + measured["compile_s"]
    rows = [row(gpus, SEEDS, measured["steps_per_s"], start_s, sizes, plan.budget) for gpus in GPUS]
    record = {
        "command": "python experiments/scheduler.py",
        "measured": "docs/bench/h100_walk.json",
        "settings": SETTINGS,
        "seeds": SEEDS,
        "speeds": SPEEDS,
        "taken_every_s": TAKEN_EVERY_S,
        "back_s": BACK_S,
        "start_s": start_s,
        "state_bytes": sizes[0],
        "finished_bytes": sizes[1],
        "rows": rows,
    }
    parser.parse_args().file.write_text(json.dumps(record, indent=1) + "\n")
    for each in rows:
        print(each)


if __name__ == "__main__":
    main()
