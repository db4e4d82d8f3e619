"""What the benchmarks say that a program costs, against counts by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from humanoid_mjx import runtime
from humanoid_mjx.bench import limit
from humanoid_mjx.bench.cost import Cost, Programs, cost

BATCH, TURNS = 512, 37


def counted(function, *given, turns=None) -> Cost:
    return cost(jax.jit(function).lower(*given).compile(), turns)


def add(x, _):
    return x + 1.0, None


def test_a_scan_of_additions_costs_what_a_hand_counts():
    found = counted(lambda x: jax.lax.scan(add, x, length=TURNS)[0], jnp.zeros(BATCH))
    # A turn adds one to each number, four bytes in and four out, and counts its turns: an addition, a comparison and
    # some bytes. Outside of the loop the argument is copied.
    assert found.operations == pytest.approx(TURNS * (BATCH + 2), abs=2)
    assert 0 <= found.bytes - (TURNS + 1) * 8 * BATCH < 100 * (TURNS + 1)
    assert 8 * BATCH <= found.memory < 20 * BATCH and not found.at_least


def test_loops_within_loops_are_multiplied():
    def inner(x, _):
        return jax.lax.scan(lambda x, _: (jnp.sin(x), None), x + 1.0, length=5)[0], None

    found = counted(lambda x: jax.lax.scan(inner, x, length=TURNS)[0], jnp.zeros(BATCH))
    assert found.operations == pytest.approx(TURNS * 6 * BATCH, rel=0.05)


def test_a_loop_of_unknown_length_is_counted_with_one_turn_or_as_the_caller_says():
    def repeated(x, turns):
        return jax.lax.fori_loop(0, turns, lambda _, x: x * 2.0, x)

    once, often = (counted(repeated, jnp.zeros(BATCH), 7, turns=turns) for turns in (None, 7))
    assert once.at_least and once.operations == pytest.approx(BATCH, abs=4)
    assert not often.at_least and often.operations == pytest.approx(7 * BATCH, abs=30)

    def until_done(x, _):
        return jax.lax.while_loop(lambda x: x[0] < 1.0, lambda x: x + 0.1, x), None

    # What the caller says is of the outermost loop only.
    assert counted(lambda x: jax.lax.scan(until_done, x, length=3)[0], jnp.zeros(BATCH), turns=9).at_least


def test_of_a_large_array_only_what_changes_is_counted():
    def step(turn, tables):
        return jax.vmap(lambda table, place: table.at[(turn + place) % 1000].add(1.0))(tables, jnp.arange(BATCH))

    once, often = (counted(lambda x, n=n: jax.lax.fori_loop(0, n, step, x), jnp.zeros((BATCH, 1000))) for n in (8, 64))
    # Of each agent's 1,000 numbers a turn reads and writes one, 8 bytes. Kernels before it make the place, of two
    # numbers with a few bytes each. The whole table would be 8,000.
    assert 8 * BATCH <= (often.bytes - once.bytes) / 56 < 200 * BATCH


def test_a_library_counts_nothing_and_a_kernel_is_not_known():
    solved = counted(jnp.linalg.cholesky, jnp.eye(8))
    assert solved.at_least and solved.operations is not None
    many = counted(lambda x: jax.lax.top_k(x, 2)[0], jnp.zeros((4, 64)))  # a kernel of XLA's own on a CPU
    assert (many.operations, many.bytes) == (None, None) and many.memory


def test_programs_run_every_share_and_count_them_all():
    devices = jax.local_devices()
    program = jax.jit(lambda x: jax.lax.scan(add, x, length=TURNS)[0])
    shares = [[(jax.device_put(np.full(BATCH, i, np.float32), device),) for i in range(3)] for device in devices]
    call = Programs(program, shares)
    found = call()
    assert [float(x[0]) for x in found[-1]] == [TURNS, 1.0 + TURNS, 2.0 + TURNS] and len(found) == len(devices)
    with runtime.counting_compiles() as compiles:
        total = call.cost
    assert compiles.programs == 0
    one = cost(program.lower(*shares[0][0]).compile())
    assert total == Cost(*(3 * len(devices) * x for x in one[:2]), len(devices) * one.memory, False)


@pytest.mark.parametrize(
    ("step", "arrays", "operations", "moved"),
    [
        # 1,024 of multiply-adds; one more to begin each of 8 chains but the first, 7 to add them up, one to divide.
        (limit.multiply_add, 1, 2 * limit.CHAINS * limit.DEPTH + 15, 8),
        (limit.triad, 2, 2, 12),
    ],
)
def test_the_machine_is_measured_by_programs_that_do_what_is_said(step, arrays, operations, moved):
    """One kernel each: the first reads and writes a number for all its arithmetic, the second is STREAM's."""
    size, turns = 2**14, 5
    call = limit._on_each(step, (jnp.ones(size),) * arrays, turns)
    found, elements = call.cost, size * turns * len(call.by_device)
    assert found.operations / elements == pytest.approx(operations, rel=0.01)
    assert found.bytes / elements == pytest.approx(moved, rel=0.01) and not found.at_least


def test_the_limit_of_what_is_held_is_the_best_of_as_much_or_more(monkeypatch):
    best = limit.Limit(1.0, {100: 5.0, 200: 7.0, 300: 2.0})
    assert [best.bandwidth(held) for held in (1, 100, 101, 200, 201, 1000)] == [7.0, 7.0, 7.0, 7.0, 2.0, 2.0]
    monkeypatch.setattr(limit, "SIZES", (2**12, 2**13))
    monkeypatch.setattr(limit, "MOVED", 2**13)
    monkeypatch.setattr(limit, "ELEMENTS", 2**10)
    found = limit.machine_limit.__wrapped__()
    assert set(found.bytes) == {2**12, 2**13} and 0.0 < found.operations < np.inf
    assert all(0.0 < rate < np.inf for rate in found.bytes.values())
