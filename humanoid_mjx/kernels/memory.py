"""Memory of each thread of a kernel, for arrays whose entries are looked up at indices not known while tracing.

Registers have no index, and to choose among all entries takes an instruction for each. Inline assembly reaches a
thread's local memory, and memory of constants that all threads share. It may be moved unless something depends on it,
hence a write gives a token, which all that comes later takes, and before a write the token depends on all that was
read.
"""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Int, Shaped

from humanoid_mjx.kernels.assembly import assembly

THREADS = 32
"""Threads of a block: one warp."""

Address = Int[Array, " threads"]
Values = Shaped[Array, " threads"]


class Region:
    """Words of 32 bits of each thread.

    Args:
      number: of the region, unlike that of any other in the kernel.
      words: how many.
      interpret: for Pallas's interpreter, where the token is what the memory holds.
    """

    given = False
    """True for memory of an argument, which a function may change in its place."""

    def __init__(self, number: int, words: int, interpret: bool):
        self.token: Array = jnp.zeros((words, THREADS) if interpret else THREADS, jnp.int32)
        name = f"region{number}_${{:uid}}"
        code = f".local .align 4 .b8 {name}[{4 * words}]; mov.u32 $0, {name};"
        self.address = None if interpret else assembly(code, "=r,r", jnp.int32, self.token)
        """That of the first word, in bytes."""
        self.seen: list[Values] = []
        """What was read since the last write."""

    def place(self, words: Address) -> Address:
        """The place so many words from the beginning."""
        return words if self.address is None else self.address + 4 * words

    def read(self, word: int, place: Address | None, dtype: Any) -> Values:
        """A word, counted from a place; None: the beginning."""
        if self.address is None:
            return lax.bitcast_convert_type(self.token[self._index(word, place)], dtype)
        code, kinds = f"ld.local.b32 $0, [$1+{4 * word}];", f"={_kind(dtype)},r,r"
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
        code, kinds = f"st.local.b32 [$1+{4 * word}], $2; mov.b32 $0, $3;", f"=r,r,{_kind(values.dtype)},r"
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


class Constants(Region):
    """Words that are known while tracing, the same for all threads."""

    def __init__(self, number: int, words: Sequence[np.generic], interpret: bool):
        numbers, name = [bits(word) for word in words], f"constants{number}_${{:uid}}"
        self.token = jnp.array(numbers, jnp.int32)[:, None].repeat(THREADS, axis=1) if interpret else jnp.int32(0)
        code = f".const .align 4 .b32 {name}[{len(numbers)}] = {{{', '.join(map(str, numbers))}}}; mov.u32 $0, {name};"
        self.address = None if interpret else assembly(code, "=r,r", jnp.int32, jnp.zeros(THREADS, jnp.int32))

    def read(self, word: int, place: Address | None, dtype: Any) -> Values:
        if self.address is None:
            return lax.bitcast_convert_type(self.token[self._index(word, place)], dtype)
        place = self.address if place is None else place
        return assembly(f"ld.const.b32 $0, [$1+{4 * word}];", f"={_kind(dtype)},r", dtype, place)


def bits(number: np.generic) -> int:
    """A float32, an int32 or a bool as a word."""
    return int(np.asarray(number, np.int32 if number.dtype == bool else number.dtype).view(np.int32))


def _kind(dtype: Any) -> str:
    """LLVM's letter for registers of this type."""
    return "f" if dtype == jnp.float32 else "r"
