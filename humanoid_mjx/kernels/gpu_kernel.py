"""A function of many worlds as one GPU kernel, a thread for each world or for each lane of one.

XLA makes some four hundred kernels of a time step, moves what is between them through memory, and lets all worlds wait
for the one whose contacts are found last. One kernel keeps a world in registers, and those of 32 threads wait for each
other.
"""

import math
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.experimental import pallas as pl
from jax.experimental.pallas import triton as gpu
from jax.extend import core
from jaxtyping import Array, Float

from humanoid_mjx.kernels.memory import (
    THREADS,
    Columns,
    Constants,
    Device,
    Record,
    Region,
    Shared,
    Table,
    Words,
    assembly,
    bits,
)
from humanoid_mjx.kernels.primitives import operations
from humanoid_mjx.kernels.signature import Kind, Signature, signature
from humanoid_mjx.kernels.sums import fused
from humanoid_mjx.kernels.threads import Threads, power_of_two

Results = Callable[[Sequence[Array]], list[Float[Array, " worlds"]]]
"""From the elements of a function's arguments to those of what it gives, each of all worlds of a block."""

MOST_WORK = 250_000
"""Numbers that a world takes, times operations, of a kernel in which each number is loaded by itself. Triton's time
grows with it (see `_Stage`): 3 s for 26,000, 6 s for 99,000, 98 s for 690,000, on the host of an H100."""

PAGE = 48 * 1024 // (4 * THREADS)
"""Rows, or words of each thread, that fit into the shared memory that a block may declare."""


def gpu_kernel(function: Callable[..., Any], *args: Any, lanes: int = 1, interpret: bool = False) -> Any:
    """`function(*args)`, both pytrees of arrays whose last axis is of worlds that do not mix: of float32, or of flags.

    `lanes`: length of the axis before that of worlds of which each thread computes one entry.
    `interpret`: run on a CPU, slowly.
    """
    leaves, structure = jax.tree.flatten(args)
    worlds, lanes = leaves[0].shape[-1], lanes if lanes <= THREADS else 1
    known = signature(function, structure, tuple(Kind(leaf.shape[:-1], leaf.dtype) for leaf in leaves), False)
    results, shapes = _results(known, lanes, interpret), known.shapes
    each = power_of_two(lanes)
    outputs = jax.tree.leaves(shapes)
    sizes = [math.prod(x.shape[:-1]) for x in outputs]
    found = pl.pallas_call(
        partial(_kernel, results=results, worlds=worlds, each=each, staged=not interpret),
        grid=(pl.cdiv(worlds, THREADS // each),),
        out_shape=jax.ShapeDtypeStruct((sum(sizes) * worlds,), jnp.float32),
        compiler_params=gpu.CompilerParams(num_warps=THREADS // 32, num_stages=1),
        interpret=interpret,
    )(jnp.concatenate([leaf.astype(jnp.float32).reshape(-1) for leaf in leaves]))
    parts = jnp.split(found.reshape(-1, worlds), np.cumsum(sizes)[:-1])
    found = [part.astype(x.dtype).reshape(*x.shape[:-1], worlds) for part, x in zip(parts, outputs, strict=True)]
    return jax.tree.unflatten(jax.tree.structure(shapes), found)


def call(
    known: Signature, leaves: Sequence[Array], worlds: int, interpret: bool = False
) -> tuple[list[Array], list[Kind]]:
    """Call a function of one world, each in a thread; see `cpu_kernel.call`."""
    found, in_place, constants = kinds_of_results(known)
    flat = [
        leaf.reshape((worlds, -1) if kind.in_memory else -1).astype(_stored(kind.dtype))
        for leaf, kind in zip(leaves, known.given, strict=True)
    ]
    shapes = [(worlds, kind.size) if kind.in_memory else (kind.size * worlds,) for kind in found]
    results = pl.pallas_call(
        partial(_kernel_of_one, known=known, in_place=in_place, worlds=worlds, interpret=interpret),
        grid=(worlds // THREADS,),
        out_shape=[jax.ShapeDtypeStruct(shape, _stored(x.dtype)) for shape, x in zip(shapes, found, strict=True)],
        input_output_aliases=in_place,
        compiler_params=gpu.CompilerParams(num_warps=THREADS // 32, num_stages=1),
        interpret=interpret,
    )(*flat, *map(jnp.asarray, constants))
    return [x.reshape(kind.of_all(worlds)).astype(kind.dtype) for x, kind in zip(results, found, strict=True)], found


@lru_cache
def kinds_of_results(known: Signature) -> tuple[list[Kind], dict[int, int], list[np.ndarray]]:
    """Return the kinds of the results, arguments in whose place results are, see `Signature.evaluate`, and the words of
    each array of constants that is looked up."""
    if any(np.dtype(kind.dtype).itemsize > 4 for kind in known.given):
        raise NotImplementedError("threads compute with numbers of 32 bits")
    kept: list[Any] = []
    constants: list[np.ndarray] = []

    def looked_up(_: int, words: Words) -> Region:
        constants.append(np.array([bits(word) for word in words], np.int32))
        return Table(constants[-1])

    def results(numbers: Sequence[Array]) -> list[Array]:
        threads = _threads(1, True, looked_up)
        rows, *others = known.evaluate(threads, numbers, lambda at, kind: Region(at, kind.size, True))
        kept.append(tuple(others))
        return rows

    work = len(known.numbers) * operations(jax.make_jaxpr(results)(known.numbers).jaxpr)
    if work > MOST_WORK:
        raise NotImplementedError(
            f"Triton takes minutes for {len(known.numbers)} numbers a world in so many operations"
        )
    return *kept[0], constants


def _stored(dtype: Any) -> Any:
    return jnp.int32 if np.dtype(dtype).kind == "b" else dtype


def _kernel_of_one(*refs: Any, known: Signature, in_place: dict[int, int], worlds: int, interpret: bool) -> None:
    """A block of worlds, each in a thread."""
    given, out = refs[: len(known.given)], refs[len(refs) - len(jax.tree.leaves(known.shapes)) :]
    known_words = iter(refs[len(given) :])
    world = pl.program_id(0) * THREADS + jnp.arange(THREADS, dtype=jnp.int32)
    numbers: list[Array] = []
    for ref, kind in zip(given, known.given, strict=True):
        if kind.role == "uniform":
            numbers += [ref[row] for row in range(kind.size)]
        elif kind.role == "rows":
            numbers += [gpu.load(ref.at[row * worlds + world]) for row in range(kind.size)]
    room, regions = PAGE, {}

    def memory(place: int, kind: Kind) -> Region:
        nonlocal room
        array = out[in_place[place]] if place in in_place else given[place]
        if kind.role == "record":
            regions[place] = Record(array, world, math.prod(kind.shape[1:]))
        elif interpret or kind.size > room:
            regions[place] = Device(array, world)
        else:
            room, regions[place] = room - kind.size, Shared(place, array, world)
        return regions[place]

    threads = _threads(1, interpret, lambda *_: Table(next(known_words)))
    rows, found, _ = known.evaluate(threads, numbers, memory)
    rest = iter(rows)
    for ref, kind in zip(out, found, strict=True):
        for row in range(0 if kind.in_memory else kind.size):
            gpu.store(ref.at[row * worlds + world], next(rest).astype(_stored(kind.dtype)))
    for place in sorted(in_place):
        regions[place].leave(out[in_place[place]], world)


def _shuffled(each: int, interpret: bool, values: Array, index: int) -> Array:
    """The vector of what thread `index` of each world holds.

    All threads of a warp must come here together, as they do: a kernel branches for whole blocks.
    """
    if interpret:
        return values.reshape(-1, each)[:, index].repeat(each)
    if values.dtype == bool:
        return _shuffled(each, interpret, values.astype(jnp.int32), index) != 0
    kind = "f" if values.dtype == jnp.float32 else "r"
    width = (32 - each) << 8 | 31
    code = f"shfl.sync.idx.b32 $0, $1, {index}, {width}, 0xffffffff;"
    return assembly(code, f"={kind},{kind}", values.dtype, values)


def _summed(each: int, interpret: bool, values: Array) -> Array:
    """The sums of float32 over the threads of each world, the same in all of these to the bit."""
    for step in (1 << power for power in range(each.bit_length() - 1)):
        if interpret:
            values = values + values.reshape(-1, each)[:, np.arange(each) ^ step].reshape(-1)
            continue
        # The sum is in the assembly: a compiler would contract it with products of one thread and not of the other.
        code = f"shfl.sync.bfly.b32 other, $1, {step}, {(32 - each) << 8 | 31}, 0xffffffff; add.rn.f32 $0, $1, other;"
        values = assembly(f"{{ .reg .f32 other; {code} }}", "=f,f", values.dtype, values)
    return values


def _any(flags: Array) -> Array:
    """Return whether any of a block's flags is true. Triton has no sum of flags."""
    return jnp.max(flags.astype(jnp.int32)) > 0


def _kernel(numbers: Any, out: Any, *, results: Results, worlds: int, each: int, staged: bool) -> None:
    """A block of worlds, from rows of a number for each world to rows of results, all rows one after another."""
    # The threads that are left over in the last block repeat the last world.
    thread = pl.program_id(0) * THREADS + jnp.arange(THREADS, dtype=jnp.int32)
    world = jnp.minimum(thread // each, worlds - 1)
    given, found = numbers.shape[0] // worlds, out.shape[0] // worlds
    if not staged:
        for row, result in enumerate(results([numbers[row * worlds + world] for row in range(given)])):
            out[row * worlds + world] = result
        return
    stage, values = _Stage(0, min(PAGE, max(given, found)), False), []
    for first in range(0, given, PAGE):
        count = min(PAGE, given - first)
        stage.bring(numbers, first * worlds + world, worlds, count)
        values += stage.row(0, None, jnp.float32, count)
    rows = results(values)
    for first in range(0, len(rows), PAGE):
        page = rows[first : first + PAGE]
        for row, result in enumerate(page):
            stage.write(row, None, result)
        stage.leave(out, first * worlds + world, worlds, len(page))


@lru_cache
def _results(known: Signature, lanes: int, interpret: bool) -> Results:
    """A function as arithmetic of threads, which is traced once whatever the number of worlds.

    `Threads` holds tokens of the trace that it writes to. jax traces this function again under a mesh, in another
    precision or after `jax.clear_caches()`, so each trace makes its own.
    """

    def results(numbers: Sequence[Array]) -> list[Float[Array, " worlds"]]:
        rows, *_ = known.evaluate(_threads(lanes, interpret), numbers)
        return [number.astype(jnp.float32) for number in rows]

    return jax.jit(lambda numbers: core.jaxpr_as_fun(fused(jax.make_jaxpr(results)(numbers)))(*numbers))


def _threads(lanes: int, interpret: bool, constants: Callable[[int, Words], Region] | None = None) -> Threads:
    """The threads of a block; with `constants`, which makes memory of known words, of functions of one world."""
    shuffled, summed = (partial(each, power_of_two(lanes), interpret) for each in (_shuffled, _summed))
    region, fixed = (partial(kind, interpret=interpret) for kind in (Region, Constants))
    return Threads(constants is not None, region, constants or fixed, _any, lanes, shuffled, summed)


class _Stage(Columns):
    """Memory on the way between the device's memory and the registers.

    For every access to the device's memory in a program Triton looks at all that has an operand in common with what
    depends on it: with one for each number a time step did not compile within four minutes. So there is one for each
    `PAGE`, in loops that take nothing from outside, addresses neither: with any, a time step compiles in 24 s, without
    in 8. From loops over a range Triton looks outside all the same, hence `while`.
    """

    def bring(self, numbers: Any, place: Array, stride: int, count: int) -> None:
        """Bring so many rows from the device's memory, the first from `place`."""
        self._each(lambda at, place: self.write(0, at, gpu.load(numbers.at[place])), place, stride, count)

    def leave(self, out: Any, place: Array, stride: int, count: int) -> None:
        """Bring so many rows to the device's memory, the first to `place`."""
        self._each(lambda at, place: gpu.store(out.at[place], self.read(0, at, jnp.float32)), place, stride, count)

    def _each(self, one: Callable[[Array, Array], None], place: Array, stride: int, count: int) -> None:
        def further(carry: tuple[Array, ...]) -> tuple[Array, ...]:
            row, self.token, address, place = carry
            one(address, place)
            return row + 1, self.settle(), _plus(address, 4 * THREADS), _plus(place, stride)

        start = jnp.int32(0), self.settle(), self.address, place
        self.token = lax.while_loop(lambda carry: carry[0] < count, further, start)[1]


def _plus(values: Array, number: int) -> Array:
    """Add a constant in assembly, where Triton does not see it.

    To Triton equal constants are one operand, and for an access to memory it looks at all that shares an operand.
    """
    return assembly(f"add.s32 $0, $1, {number};", "=r,r", jnp.int32, values)
