"""LLVM's code under construction, and values of it: a number for each of the worlds that are computed together.

A value that is the same in all worlds, as a counter or a known number, is a scalar.
"""

import struct
from dataclasses import dataclass, field
from functools import cache
from itertools import count
from typing import Any

import numpy as np

WIDTH = 16
"""Worlds that are computed together, if there are several: floats of a vector of AVX-512. LLVM splits vectors for
processors with shorter ones."""


def together(worlds: int) -> int:
    """Return the width of the code for this number of worlds."""
    return 1 if worlds == 1 else WIDTH


@dataclass(frozen=True)
class Value:
    """A value of LLVM's code."""

    name: str
    dtype: np.dtype
    uniform: bool
    """True if it is the same in all worlds."""


@cache
def type_of(dtype: Any, numbers: int = 1) -> str:
    """LLVM's type of a scalar, or of a vector of so many."""
    kind = {"bool": "i1", "int32": "i32", "uint32": "i32", "float32": "float"}.get(np.dtype(dtype).name)
    if kind is None:
        raise NotImplementedError(f"kernels know no {dtype}")
    return kind if numbers == 1 else f"<{numbers} x {kind}>"


def known(number: Any, dtype: Any) -> Value:
    """A number as a scalar."""
    dtype = np.dtype(dtype)
    if dtype.kind == "b":
        return Value("true" if number else "false", dtype, True)
    if dtype.kind == "f":  # LLVM writes a float as the bits of a double
        return Value(f"0x{struct.unpack('<Q', struct.pack('<d', np.float32(number)))[0]:016X}", dtype, True)
    return Value(str((int(number) + 2**31) % 2**32 - 2**31), dtype, True)


@dataclass
class Code:
    """LLVM code under construction."""

    width: int = WIDTH
    """Worlds that it computes together; the numbers of one world are scalars."""
    lines: list[str] = field(default_factory=list)
    numbers: Any = field(default_factory=count)
    label: str = "entry"
    """The block that the next instruction belongs to."""
    declared: set[str] = field(default_factory=set)
    regions: dict[int | str, int] = field(default_factory=dict)
    """Words of memory by number."""
    tables: dict[tuple[int, ...], int] = field(default_factory=dict)

    def add(self, instruction: str) -> None:
        self.lines.append(f"  {instruction}")

    def value(self, instruction: str) -> str:
        name = f"%v{next(self.numbers)}"
        self.add(f"{name} = {instruction}")
        return name

    def begin(self, label: str) -> None:
        self.lines.append(f"{label}:")
        self.label = label

    def call(self, result: str, name: str, *args: tuple[str, str]) -> str:
        """Call one of LLVM's intrinsics; `args`: types and names."""
        self.declared.add(f"declare {result} @llvm.{name}({', '.join(kind for kind, _ in args)})")
        call = f"{result} @llvm.{name}({', '.join(map(' '.join, args))})"
        if result == "void":
            self.add(f"call {call}")
            return ""
        return self.value(f"call {'nsz contract ' * ('float' in result)}{call}")

    def type_of(self, dtype: Any, uniform: bool = False) -> str:
        """LLVM's type of a number for each world, or of one for all."""
        return type_of(dtype, 1 if uniform else self.width)

    def vector(self, value: Value, uniform: bool = False) -> str:
        """The name of a value as a number for each world; if `uniform`, as the scalar that it is."""
        if uniform or not value.uniform or self.width == 1:
            return value.name
        one, whole = type_of(value.dtype), self.type_of(value.dtype)
        if value.name[0] != "%":
            return f"splat ({one} {value.name})"
        first = self.value(f"insertelement {whole} poison, {one} {value.name}, i64 0")
        return self.value(f"shufflevector {whole} {first}, {whole} poison, <{self.width} x i32> zeroinitializer")
