"""Memory of each thread of a kernel, for arrays whose entries are looked up at indices not known while tracing.

Registers have no index, and to choose among all entries takes an instruction for each. Inline assembly reaches a
thread's local memory, and memory of constants that all threads share. It may be moved unless something depends on it,
hence a write gives a token, which all that comes later takes, and before a write the token depends on all that was
read.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.experimental.pallas import triton as gpu
from jaxtyping import Array, Int, Shaped

THREADS = 32
"""Threads of a block: one warp."""

MOST = 16_384
"""Words of all constants of a kernel: 64 KB."""

Address = Int[Array, " threads"]
Values = Shaped[Array, " threads"]
Words = Sequence[np.generic]


def assembly(code: str, constraints: str, dtype: Any, *args: Array) -> Array:
    """Run PTX `code` on each element of arrays of one shape, for an array of this type (LLVM's constraints)."""
    result = jax.ShapeDtypeStruct(args[0].shape, dtype)
    return gpu.elementwise_inline_asm(code, args=args, constraints=constraints, pack=1, result_shape_dtypes=[result])[0]


class Region:
    """Words of 32 bits of each thread, by default in its local memory.

    `number`: unlike that of any other region of the kernel in the same space. `interpret`: for Pallas's interpreter,
    where the token is what the memory holds.
    """

    space = "local"
    stride = 1
    """From one word of a thread to its next, in words."""

    def __init__(self, number: int, words: int, interpret: bool):
        self.token: Array = jnp.zeros((words, THREADS) if interpret else THREADS, jnp.int32)
        name = f"region{number}_${{:uid}}"
        code = f".{self.space} .align 4 .b8 {name}[{4 * self.stride * words}]; mov.u32 $0, {name};"
        self.address = None if interpret else assembly(code, "=r,r", jnp.int32, self.token)
        """Address of the first word, in bytes."""
        self.seen: list[Values] = []
        """Values read since the last write."""

    def place(self, words: Address) -> Address:
        """The place so many words from the beginning."""
        return words if self.address is None else self.address + 4 * self.stride * words

    def read(self, word: int, place: Address | None, dtype: Any) -> Values:
        """A word, counted from a place; None: the beginning."""
        if self.address is None:
            return lax.bitcast_convert_type(self.token[self._index(word, place)], dtype)
        code, kinds = f"ld.{self.space}.b32 $0, [$1+{4 * self.stride * word}];", f"={_kind(dtype)},r,r"
        place = self.address if place is None else place
        self.seen.append(assembly(code, kinds, dtype, place, self.token))
        return self.seen[-1]

    def row(self, word: int, place: Address | None, dtype: Any, count: int) -> list[Values]:
        """A word and those that follow."""
        return [self.read(word + each, place, dtype) for each in range(count)]

    def write(self, word: int, place: Address | None, values: Values) -> None:
        """Change a word; a bool is 1 or 0."""
        values = values.astype(jnp.int32) if values.dtype == bool else values
        if self.address is None:
            self.token = self.token.at[self._index(word, place)].set(lax.bitcast_convert_type(values, jnp.int32))
            return
        token, place = self.settle(), self.address if place is None else place
        code, kinds = (
            f"st.{self.space}.b32 [$1+{4 * self.stride * word}], $2; mov.b32 $0, $3;",
            f"=r,r,{_kind(values.dtype)},r",
        )
        self.token = assembly(code, kinds, jnp.int32, place, values, token)

    def add(self, word: int, place: Address | None, changes: Sequence[Values]) -> None:
        """Add to a word and those that follow."""
        for each, change in enumerate(changes, word):
            self.write(each, place, self.read(each, place, change.dtype) + change)

    def fill(self, word: int, count: int, bits: int) -> None:
        """Write the same into so many words, four or more, by a loop whose code is short."""
        if self.address is None:
            self.token = self.token.at[word : word + count].set(bits)
            return
        store, rest = (f"st.local.b32 [place+{4 * each}], {bits};" for each in range(4)), count % 4
        begin = "".join(f"st.local.b32 [$1+{4 * (word + each)}], {bits};" for each in range(rest))
        code = (
            f"{{ .reg .pred more; .reg .b32 place, end; {begin} add.u32 place, $1, {4 * (word + rest)}; "
            f"add.u32 end, $1, {4 * (word + count)}; again${{:uid}}: {''.join(store)} add.u32 place, place, 16; "
            f"setp.lt.u32 more, place, end; @more bra again${{:uid}}; mov.b32 $0, $2; }}"
        )
        self.token = assembly(code, "=r,r,r", jnp.int32, self.address, self.settle())

    def _index(self, word: int, place: Address | None) -> Any:
        return word if place is None else (word + place, jnp.arange(THREADS))

    def settle(self) -> Array:
        """The token, which depends on all that was read."""
        for first in range(0, len(self.seen), 8):
            group = self.seen[first : first + 8]
            kinds = ",".join(["=r", "r", *(_kind(values.dtype) for values in group)])
            self.token = assembly("mov.b32 $0, $1;", kinds, jnp.int32, self.token, *group)
        self.seen = []
        return self.token


class Columns(Region):
    """Words in the memory that the threads of a block share, a column for each thread, so that no two banks collide."""

    space, stride = "shared", THREADS

    def __init__(self, number: int, words: int, interpret: bool):
        super().__init__(number, words, interpret)
        self.address = self.address + 4 * jnp.arange(THREADS, dtype=jnp.int32)


class Shared(Columns):
    """Words of an array of the device, (worlds, words), until `leave` brings them back."""

    def __init__(self, number: int, array: Any, world: Address):
        super().__init__(number, array.shape[1], False)
        self._each(array, lambda at: self.write(0, self.place(at), gpu.load(array.at[world, at])))

    def leave(self, array: Any, world: Address) -> None:
        """Bring the words back to an array of the device."""
        self._each(array, lambda at: gpu.store(array.at[world, at], self.read(0, self.place(at), array.dtype)))

    def _each(self, array: Any, bring: Callable[[Address], None]) -> None:
        def one(word: Array, token: Array) -> Array:
            self.token = token
            bring(jnp.full(THREADS, word))
            return self.settle()

        self.token = lax.fori_loop(0, array.shape[1], one, self.settle())


class Device(Region):
    """Words of an array of the device, (worlds, words); of any number, and for Pallas's interpreter too."""

    def __init__(self, array: Any, world: Address):
        self.array, self.world, self.seen, self.address = array, world, [], None
        self.token = jnp.zeros(THREADS, jnp.int32)

    def read(self, word: int, place: Address | None, dtype: Any) -> Values:
        return gpu.load(self._at(word, place))

    def write(self, word: int, place: Address | None, values: Values) -> None:
        gpu.store(self._at(word, place), values.astype(self.array.dtype))

    def leave(self, array: Any, world: Address) -> None:
        """Leave the words to an array of the device, in whose place they are."""

    def _at(self, word: int, place: Address | None) -> Any:
        return self.array.at[self.world, jnp.full(THREADS, word) if place is None else place + word]


class Record(Device):
    """Words of an array of the device that are only added to, by rows.

    Its token is the row that changed last and the sums of it, in registers: an atomic addition of Triton's, or a sum
    that is loaded and stored in each step, takes several times as long as all else in a step of a table.
    """

    def __init__(self, array: Any, world: Address, width: int):
        super().__init__(array, world)
        first = jnp.zeros(THREADS, jnp.int32)
        self.token: Any = first, *(gpu.load(self._at(each, first)) for each in range(width))

    def add(self, word: int, place: Address | None, changes: Sequence[Values]) -> None:
        row, *sums = self.token
        new = jnp.full(THREADS, word) if place is None else place + word
        if len(changes) != len(sums):
            raise NotImplementedError("threads add to whole rows of an array alone")
        self._put(moved := new != row)
        sums = [gpu.load(self._at(each, new), mask=moved, other=old) for each, old in enumerate(sums)]
        self.token = new, *(old + change for old, change in zip(sums, changes, strict=True))

    def leave(self, array: Any, world: Address) -> None:
        self._put(self.token[0] >= 0)

    def _put(self, mask: Array) -> None:
        """Store the sums where the mask is true."""
        row, *sums = self.token
        for each, values in enumerate(sums):
            gpu.store(self._at(each, row), values, mask=mask)


class Constants(Region):
    """Words that are known while tracing, the same for all threads."""

    def __init__(self, number: int, words: Words, interpret: bool):
        if len(words) > MOST:
            raise NotImplementedError(f"threads look up at most {MOST} constants")
        numbers, name = [bits(word) for word in words], f"constants{number}_${{:uid}}"
        rows = [jnp.full(THREADS, number, jnp.int32) for number in numbers] if interpret else []
        self.token = jnp.stack(rows) if interpret else jnp.int32(0)
        code = f".const .align 4 .b32 {name}[{len(numbers)}] = {{{', '.join(map(str, numbers))}}}; mov.u32 $0, {name};"
        self.address = None if interpret else assembly(code, "=r,r", jnp.int32, jnp.zeros(THREADS, jnp.int32))

    def read(self, word: int, place: Address | None, dtype: Any) -> Values:
        if self.address is None:
            return lax.bitcast_convert_type(self.token[self._index(word, place)], dtype)
        place = self.address if place is None else place
        return assembly(f"ld.const.b32 $0, [$1+{4 * word}];", f"={_kind(dtype)},r", dtype, place)


class Table(Region):
    """Words that are known while tracing, the same for all threads, in an array of the device, by reference or itself.

    Threads that look up different words there wait for each other less than at memory of constants.
    """

    def __init__(self, array: Any):
        self.array, self.seen, self.address, self.token = array, [], None, jnp.int32(0)

    def read(self, word: int, place: Address | None, dtype: Any) -> Values:
        place = word + (jnp.zeros(THREADS, jnp.int32) if place is None else place)
        known = isinstance(self.array, np.ndarray)
        words = jnp.asarray(self.array)[place] if known else gpu.load(self.array.at[place])
        return lax.bitcast_convert_type(words, dtype)


def bits(number: np.generic) -> int:
    """A float32, an int32 or a bool as a word."""
    return int(np.asarray(number, np.int32 if number.dtype == bool else number.dtype).view(np.int32))


def _kind(dtype: Any) -> str:
    """LLVM's letter for registers of this type."""
    return "f" if dtype == jnp.float32 else "r"
