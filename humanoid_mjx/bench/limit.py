"""What this machine can do at best, measured as programs of XLA: operations a second, and bytes a second.

    operations  multiply-adds in float32, element by element, many for each number that is read. No product of matrices:
                physics and tables are made of scalar code, and units for matrices do not help it.
    bytes       `x * s + b` in place over arrays of several sizes, as STREAM's triad: two numbers read and one written
                for each element. Small arrays stay in a cache, large ones do not.

All devices work at once, as in the other benchmarks. The fastest of a few repeats counts.
"""

import time
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from humanoid_mjx import runtime
from humanoid_mjx.bench.cost import Programs

SIZES = (2**19, 2**21, 2**23, 2**26, 2**30)
"""Bytes of the arrays of all devices together. The last fits no cache."""

MOVED = 2**31
"""Bytes of arrays worked on for each size, in as many turns as that takes."""

ELEMENTS, TURNS = 2**22, 4
"""Numbers on which all devices together compute, and how often."""

CHAINS, DEPTH = 8, 64
"""Multiply-adds for each number in one kernel: chains that wait for nothing but themselves, and links of a chain."""

REPEATS = 3


class Limit(NamedTuple):
    """Rates of the whole machine."""

    operations: float
    """1/s."""
    bytes: Mapping[int, float]
    """1/s, by the bytes of what the program holds."""

    def bandwidth(self, held: float) -> float:
        """Bytes a second that a program can move at best which holds so many."""
        return max(rate for size, rate in self.bytes.items() if size >= min(held, max(self.bytes)))


@cache
def machine_limit() -> Limit:
    """Measured once in a process."""
    return Limit(most_operations(), {size: most_bytes(size) for size in SIZES})


def measured() -> dict[str, Any]:
    """What a result says of the machine; nothing where no benchmark asked for it."""
    if not machine_limit.cache_info().currsize:
        return {}
    best = machine_limit()
    return {"limit": {"operations/s": best.operations, "bytes/s": {str(size): x for size, x in best.bytes.items()}}}


def most_operations() -> float:
    """Operations a second, a multiply-add being two."""
    share = ELEMENTS // jax.local_device_count()
    return 2.0 * CHAINS * DEPTH * ELEMENTS * TURNS / _fastest(_on_each(multiply_add, (jnp.ones(share),), TURNS))


def most_bytes(size: int) -> float:
    """Bytes a second over arrays of `size` bytes together."""
    turns = max(1, MOVED // size)
    share = size // (2 * 4 * jax.local_device_count())
    call = _on_each(triad, (jnp.ones(share), jnp.ones(share)), turns)
    return 1.5 * size * turns / _fastest(call)


def multiply_add(x: jax.Array, a: jax.Array) -> jax.Array:
    """`2 * CHAINS * DEPTH` operations on each element."""
    chains = [x + place for place in range(CHAINS)]
    for _ in range(DEPTH):
        chains = [chain * a + a for chain in chains]
    return sum(chains[1:], chains[0]) / CHAINS


def triad(x: jax.Array, a: jax.Array, b: jax.Array) -> jax.Array:
    """STREAM's, whose result takes the place of what it was made from."""
    return x * a + b


def _on_each(step: Callable[..., jax.Array], arrays: tuple[jax.Array, ...], turns: int) -> Programs:
    """Each device takes the step again and again, on arrays of its own."""

    def loop(x: jax.Array, turns: jax.Array, *rest: jax.Array) -> jax.Array:
        return jax.lax.fori_loop(0, turns, lambda _, x: step(x, *rest), x)  # a number that XLA knows might be unrolled

    options = runtime.on_every_device(runtime.SHARED_KERNELS)
    first, *rest = arrays
    inputs = turns, jnp.float32(0.5), *rest
    shares = [[jax.device_put((first.copy(), *inputs), device)] for device in jax.local_devices()]
    return Programs(jax.jit(loop, donate_argnums=0, compiler_options=options), shares, turns)


def _fastest(call: Programs) -> float:
    """Seconds of the fastest call after the first, which compiles. Each takes the place of what the last one made."""
    times = []
    for _ in range(1 + REPEATS):
        start = time.perf_counter()
        made = call()
        times.append(time.perf_counter() - start)
        call.by_device = [[(*new, *share[1:])] for new, (share,) in zip(made, call.by_device, strict=True)]
    return min(times[1:])
