"""Memory of each world in LLVM's code: primitives of jax for traced functions, and the code that they become."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import reduce
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray
from jax.extend.core import Primitive

from humanoid_mjx.kernels.llvm import Code, Value, known, type_of
from humanoid_mjx.kernels.memory import THREADS, Region

read_words, write_words, add_words = map(Primitive, ("read_words", "write_words", "add_words"))
"""Memory of each world. The first argument is the token, for jax; code keeps the order in which they were traced. The
last is the place, if there is one."""

read_words.multiple_results = True
read_words.def_abstract_eval(lambda *_, dtype, count, **place: [ShapedArray((THREADS,), dtype)] * count)
for _primitive in (write_words, add_words):
    _primitive.def_abstract_eval(lambda *_, **params: ShapedArray((THREADS,), np.int32))


class Words(Region):
    """Words of each world, for `lower`; see `Region`.

    `region`: a number, for memory that the code reserves; the name of an array of the caller, (worlds, words); or words
    that are known while tracing, the same for all worlds. `words`: words of each world.
    """

    def __init__(self, region: int | str | tuple[int, ...], words: int):
        self.where, self.seen, self.address = {"region": region, "words": words}, [], None
        self.token = jnp.zeros(THREADS, jnp.int32)

    def read(self, word: int, place: Any, dtype: Any) -> Any:
        return self._bind(read_words, word, place, dtype=np.dtype(dtype), count=1)[0]

    def row(self, word: int, place: Any, dtype: Any, count: int) -> list[Any]:
        if not isinstance(self.where["region"], str):
            return super().row(word, place, dtype, count)
        return self._bind(read_words, word, place, dtype=np.dtype(dtype), count=count)

    def write(self, word: int, place: Any, values: Any) -> None:
        values = values.astype(jnp.int32) if values.dtype == bool else values
        self.token = self._bind(write_words, word, place, values, count=1)

    def add(self, word: int, place: Any, changes: Sequence[Any]) -> None:
        self.token = self._bind(add_words, word, place, *changes, count=len(changes))

    def fill(self, word: int, count: int, bits: int) -> None:
        self.token = self._bind(write_words, word, None, *[jnp.full(THREADS, bits, jnp.int32)] * count, count=count)

    def _bind(self, primitive: Primitive, word: int, place: Any, *values: Any, **params: Any) -> Any:
        places = [] if place is None else [place]
        return primitive.bind(self.token, *values, *places, **self.where, word=word, **params)


def _at(code: Code, address: Value, *values: tuple[str, str]) -> tuple[tuple[str, str], ...]:
    """Arguments of LLVM's intrinsics that access memory of each world, with those that follow the address."""
    every = code.type_of(bool), "splat (i1 true)"
    return (f"<{code.width} x ptr>", address.name), ("i32", "4"), every, *values


def _read(code: Code, params: dict[str, Any], args: list[Value]) -> list[Value]:
    """Words that follow each other, by half as many loads as there are words."""
    dtype, count, found = params["dtype"], params["count"], []
    width, pair = code.width, 1 if code.width == 1 else 2
    whole, both = f"<{width} x i64>", type_of(dtype, 2 * width)
    for each in range(0, count, pair):
        address = _address(code, params, each, args[1:])
        if each == count - 1 or pair == 1:
            found.append(_loaded(code, address, dtype, 1 if isinstance(params["region"], tuple) else width))
            continue
        words = code.call(whole, f"masked.gather.v{width}i64.v{width}p0", *_at(code, address, (whole, "poison")))
        pairs = code.value(f"bitcast {whole} {words} to {both}")
        for first in (0, 1):
            order = ", ".join(f"i32 {number}" for number in range(first, 2 * width, 2))
            name = code.value(f"shufflevector {both} {pairs}, {both} poison, <{width} x i32> <{order}>")
            found.append(Value(name, dtype, False))
    return found


def _loaded(code: Code, address: Value, dtype: np.dtype, apart: int) -> Value:
    """Load the value at an address, or at one for each world; `apart`: numbers from one word to the next."""
    kind = code.type_of(dtype, address.uniform and apart == 1)
    if address.uniform:
        return Value(code.value(f"load {kind}, ptr {address.name}, align {4 * apart}"), dtype, apart == 1)
    name = f"masked.gather.v{code.width}{'f32' if dtype.kind == 'f' else 'i32'}.v{code.width}p0"
    return Value(code.call(kind, name, *_at(code, address, (kind, "poison"))), dtype, False)


def _written(code: Code, params: dict[str, Any], args: list[Value]) -> list[Value]:
    values, place = args[1 : 1 + params["count"]], args[1 + params["count"] :]
    for word, value in enumerate(values):
        _store(code, value, _address(code, params, word, place))
    return [known(0, np.int32)]


def _added(code: Code, params: dict[str, Any], args: list[Value]) -> list[Value]:
    """Products are rounded before they are added, as by XLA."""
    _, *changes, place = args
    if len(changes) > 1 and isinstance(params["region"], str) and code.width > 1:
        _add_seldom(code, params, replace(place, name=code.vector(place), uniform=False), changes)
        return [known(0, np.int32)]
    for word, change in enumerate(changes):
        address = _address(code, params, word, [place])
        old = _loaded(code, address, change.dtype, code.width)
        add = "fadd" if change.dtype.kind == "f" else "add"
        new = code.value(f"{add} {code.type_of(change.dtype)} {old.name}, {code.vector(change)}")
        _store(code, Value(new, change.dtype, False), address)
    return [known(0, np.int32)]


def _add_seldom(code: Code, params: dict[str, Any], place: Value, changes: list[Value]) -> None:
    """Add words that follow each other in those worlds alone where one of them is not 0, world by world.

    In most steps there is none: what a step adds to a learning curve is 0 unless it ends an episode.
    """
    number, width, flags = next(code.numbers), code.width, code.type_of(bool)
    worlds, vectors = f"i{width}", [(code.type_of(each.dtype), code.vector(each)) for each in changes]
    some = [
        code.value(f"{'fcmp une' if 'float' in kind else 'icmp ne'} {kind} {name}, zeroinitializer")
        for kind, name in vectors
    ]
    some = reduce(lambda one, two: code.value(f"or {flags} {one}, {two}"), some)
    some = code.value(f"bitcast {flags} {some} to {worlds}")
    code.add(f"br i1 {code.value(f'icmp ne {worlds} {some}, 0')}, label %some{number}, label %none{number}")
    code.begin(f"some{number}")
    lanes = ", ".join(f"i32 {lane * params['words'] + params['word']}" for lane in range(width))
    kind = code.type_of(place.dtype)
    index = kind, code.value(f"add {kind} {place.name}, <{lanes}>")
    scratch = f"_{number}"
    code.regions[scratch] = 1 + len(changes)
    for word, (kind, name) in enumerate([index, *vectors]):
        at = code.value(f"getelementptr i32, ptr %region{scratch}, i32 {width * word}")
        code.add(f"store {kind} {name}, ptr {at}, align {4 * width}")
    code.add(f"br label %each{number}")
    code.begin(f"each{number}")
    left, rest = f"%left{number}", f"%rest{number}"
    code.add(f"{left} = phi {worlds} [ {some}, %some{number} ], [ {rest}, %each{number} ]")
    world = code.value(f"zext {worlds} {code.call(worlds, f'cttz.{worlds}', (worlds, left), ('i1', 'true'))} to i32")

    def of_world(word: int, kind: str) -> str:
        at = f"getelementptr i32, ptr %region{scratch}, i32 {code.value(f'add i32 {world}, {width * word}')}"
        return code.value(f"load {kind}, ptr {code.value(at)}, align 4")

    first = code.value(f"getelementptr i32, ptr %{params['region']}, i32 {of_world(0, 'i32')}")
    for word, change in enumerate(changes):
        at, kind = code.value(f"getelementptr i32, ptr {first}, i32 {word}"), type_of(change.dtype)
        old, add = code.value(f"load {kind}, ptr {at}, align 4"), "fadd" if kind == "float" else "add"
        code.add(f"store {kind} {code.value(f'{add} {kind} {old}, {of_world(1 + word, kind)}')}, ptr {at}, align 4")
    code.add(f"{rest} = and {worlds} {left}, {code.value(f'sub {worlds} {left}, 1')}")
    code.add(f"br i1 {code.value(f'icmp ne {worlds} {rest}, 0')}, label %each{number}, label %none{number}")
    code.begin(f"none{number}")


def _store(code: Code, value: Value, address: Value) -> None:
    kind, vector = code.type_of(value.dtype), code.vector(value)
    if address.uniform:
        code.add(f"store {kind} {vector}, ptr {address.name}, align {4 * code.width}")
    else:
        name = f"masked.scatter.v{code.width}{'f32' if value.dtype.kind == 'f' else 'i32'}.v{code.width}p0"
        code.call("void", name, (kind, vector), *_at(code, address))


def _address(code: Code, params: dict[str, Any], more: int, place: list[Value]) -> Value:
    """Address of a word, so many behind the first; its vector, or each world's own, or that of all worlds."""
    region, words, word = params["region"], params["words"], params["word"] + more
    if isinstance(region, tuple):
        table = code.tables.setdefault(region, len(code.tables))
        return _beyond(code, f"@table{table}", word, place, 1, "zeroinitializer")
    if isinstance(region, str):
        lanes = f"<{', '.join(f'i32 {lane * words}' for lane in range(code.width))}>"
        at = code.vector(place[0] if place else known(0, np.int32))
        return _beyond(code, f"%{region}", word, [Value(at, np.dtype(np.int32), False)], 1, lanes)
    code.regions[region] = words
    lanes = f"<{', '.join(f'i32 {lane}' for lane in range(code.width))}>"
    return _beyond(code, f"%region{region}", word, place, code.width, lanes)


def _beyond(code: Code, base: str, word: int, place: list[Value], apart: int, lanes: str) -> Value:
    """The address of a word, so many words from a place, with words so many numbers apart."""
    pointer = np.dtype(np.int32)  # LLVM's pointers have no type
    if code.width == 1 or all(each.uniform for each in place):
        index = f"add i32 {place[0].name if place else 0}, {word}"
        index = code.value(f"mul i32 {code.value(index)}, {apart}")
        return Value(code.value(f"getelementptr i32, ptr {base}, i32 {index}"), pointer, True)
    index, kind = place[0].name, code.type_of(np.int32)
    index = code.value(f"add {kind} {index}, splat (i32 {word})")
    index = code.value(f"mul {kind} {index}, splat (i32 {apart})")
    index = code.value(f"add {kind} {index}, {lanes}")
    return Value(code.value(f"getelementptr i32, ptr {base}, {kind} {index}"), pointer, False)


MEMORY: dict[str, Callable[[Code, dict[str, Any], list[Value]], list[Value]]] = {
    "read_words": _read,
    "write_words": _written,
    "add_words": _added,
}
