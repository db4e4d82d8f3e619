"""The simulation of `experiments/scheduler.py`, against what can be said without it."""

import numpy as np
import pytest
from scheduler import simulate


@pytest.mark.parametrize(("chunks", "workers"), [(1, 3), (12, 4), (13, 4), (100, 7)])
def test_chunks_that_are_alike_take_whole_rounds(chunks, workers):
    found = simulate([5.0] * chunks, [1.0] * workers, start_s=2.0)
    end = 2.0 + 5.0 * -(-chunks // workers)
    assert found.makespan_s == pytest.approx(end) and found.taken == found.repeated_s == 0
    assert found.idle_share == pytest.approx(1 - 5.0 * chunks / (end * workers))


@pytest.mark.parametrize("workers", [8, 64])
def test_workers_share_uneven_runs_though_one_is_slow(workers):
    """Every other run is fifteen times as long, as where a sweep has an axis of two values. With sixteen chunks of four
    runs a worker, 85 % of the ideal is kept; a static split of runs gives half of the workers the long ones."""
    runs = np.where(np.arange(64 * workers) % 2, 15.0, 1.0)
    speeds, chunks = [0.5] + [1.0] * (workers - 1), runs.reshape(-1, 4).sum(axis=1)
    assert runs.sum() / sum(speeds) / simulate(chunks.tolist(), speeds).makespan_s > 0.85
    static = max(sum(runs[worker::workers]) / speeds[worker] for worker in range(workers))
    assert runs.sum() / sum(speeds) / static < 0.6


def test_work_is_done_once_but_for_what_came_after_the_last_state():
    lengths, workers = [100.0] * 40, 4
    found = simulate(lengths, [1.0] * workers, taken_every_s=150.0, state_every_s=30.0, back_s=10.0)
    busy = (1 - found.idle_share) * found.makespan_s * workers
    assert busy == pytest.approx(sum(lengths) + found.repeated_s) and found.taken > 10
    assert 0 < found.repeated_s <= 30.0 * found.taken
    assert found.makespan_s > simulate(lengths, [1.0] * workers).makespan_s
