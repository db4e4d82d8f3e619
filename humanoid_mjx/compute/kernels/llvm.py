"""Traced functions of vectors as LLVM code for a CPU: a number for each of the worlds that are computed together.

A value that is the same in all worlds, as a counter or a known number, is a scalar there. Loops and branches ask for
scalars, which `Threads` provides.
"""

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial, reduce
from itertools import count
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray
from jax.extend.core import ClosedJaxpr, Literal, Primitive

from humanoid_mjx.compute.kernels.memory import THREADS, Region, bits
from humanoid_mjx.compute.kernels.primitives import CALLS

WIDTH = 16
"""Worlds that are computed together: floats of a vector of AVX-512. LLVM splits vectors for processors with shorter
ones."""

read_word, write_word, fill_words, read_constant = map(Primitive, ("read_word", "write_word", "fill_words", "constant"))
"""Memory of each world. The first argument is the token, for jax; code keeps the order in which they were traced."""

read_word.def_abstract_eval(lambda *_, region, words, word, dtype: ShapedArray((THREADS,), dtype))
read_constant.def_abstract_eval(lambda *_, table, word, dtype: ShapedArray((THREADS,), dtype))
for _primitive in (write_word, fill_words):
    _primitive.def_abstract_eval(lambda *_, **params: ShapedArray((THREADS,), np.int32))


class Words(Region):
    """Words of each world, for `lower`; see `Region`."""

    def __init__(self, number: int, words: int):
        self.number, self.words, self.seen = number, words, []
        self.token = jnp.zeros(THREADS, jnp.int32)

    def place(self, words: Any) -> Any:
        return words

    def read(self, word: int, place: Any, dtype: Any) -> Any:
        return read_word.bind(self.token, *_some(place), **self._where(word), dtype=np.dtype(dtype))

    def write(self, word: int, place: Any, values: Any) -> None:
        values = values.astype(jnp.int32) if values.dtype == bool else values
        self.token = write_word.bind(self.token, values, *_some(place), **self._where(word))

    def fill(self, word: int, count: int, bits: int) -> None:
        self.token = fill_words.bind(self.token, **self._where(word), count=count, bits=bits)

    def settle(self) -> Any:
        return self.token

    def _where(self, word: int) -> dict[str, int]:
        return {"region": self.number, "words": self.words, "word": word}


class Table(Words):
    """Words that are known while tracing, the same for all worlds."""

    def __init__(self, number: int, words: Sequence[np.generic]):
        super().__init__(number, 0)
        self.table = tuple(map(bits, words))

    def read(self, word: int, place: Any, dtype: Any) -> Any:
        return read_constant.bind(self.token, *_some(place), table=self.table, word=word, dtype=np.dtype(dtype))


def _some(place: Any) -> list[Any]:
    return [] if place is None else [place]


@dataclass(frozen=True)
class Value:
    """A value of LLVM's code."""

    name: str
    dtype: np.dtype
    alike: bool
    """True for a scalar, which is the same in all worlds."""

    @property
    def type(self) -> str:
        return type_of(self.dtype, self.alike)


def type_of(dtype: Any, alike: bool) -> str:
    """LLVM's type of a scalar, or of a vector."""
    kind = {"bool": "i1", "int32": "i32", "uint32": "i32", "float32": "float"}.get(np.dtype(dtype).name)
    if kind is None:
        raise NotImplementedError(f"kernels know no {dtype}")
    return kind if alike else f"<{WIDTH} x {kind}>"


def known(number: Any, dtype: Any) -> Value:
    """A number as a scalar."""
    dtype = np.dtype(dtype)
    if dtype.kind == "b":
        return Value("true" if number else "false", dtype, True)
    if dtype.kind == "f":  # LLVM writes a float as the bits of a double
        return Value(f"0x{struct.unpack('<Q', struct.pack('<d', np.float32(number)))[0]:016X}", dtype, True)
    return Value(str((int(number) + 2**31) % 2**32 - 2**31), dtype, True)


FLOATS = {"add": "fadd contract", "sub": "fsub contract", "mul": "fmul contract", "div": "fdiv contract"}
INTEGERS = {name: name for name in ("add", "and", "mul", "or", "sub", "xor")}
"""LLVM's operations on two numbers."""

COMPARISONS = ("eq", "ne", "lt", "le", "gt", "ge")
FUNCTIONS = ("atan2", "ceil", "cos", "exp", "floor", "log", "pow", "sin", "sqrt", "tan")
"""Those that are one of LLVM's intrinsics, by the same name."""


@dataclass
class Code:
    """LLVM code under construction."""

    lines: list[str] = field(default_factory=list)
    numbers: Any = field(default_factory=count)
    label: str = "entry"
    """The block that the next instruction belongs to."""
    declared: set[str] = field(default_factory=set)
    regions: dict[int, int] = field(default_factory=dict)
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
        return self.value(f"call {'contract ' * ('float' in result)}{call}")

    def vector(self, value: Value) -> str:
        """The name of a value as a vector."""
        if not value.alike:
            return value.name
        if value.name[0] != "%":
            return f"splat ({value.type} {value.name})"
        whole = type_of(value.dtype, False)
        first = self.value(f"insertelement {whole} poison, {value.type} {value.name}, i64 0")
        return self.value(f"shufflevector {whole} {first}, {whole} poison, <{WIDTH} x i32> zeroinitializer")


def lower(code: Code, closed: ClosedJaxpr, args: Sequence[Value]) -> list[Value]:
    """Add a traced function to the code.

    Args:
      code: it gets the instructions.
      closed: function of vectors of `THREADS` and of scalars, of which the vectors become such of `WIDTH`.
      args: what the function is given.

    Raises:
      NotImplementedError: it has an operation that is none of kernels'.
    """
    values: dict[Any, Value] = dict(zip(closed.jaxpr.invars, args, strict=True))
    for var, constant in zip(closed.jaxpr.constvars, map(np.asarray, closed.consts), strict=True):
        if (constant != constant.flat[0]).any():
            raise NotImplementedError("kernels know constants that are alike in all worlds")
        values[var] = known(constant.flat[0], constant.dtype)

    def value(x: Any) -> Value:
        kind: Any = x.aval
        return known(np.asarray(x.val)[()], kind.dtype) if isinstance(x, Literal) else values[x]

    for eqn in closed.jaxpr.eqns:
        values |= zip(eqn.outvars, _lowered(code, eqn, [value(x) for x in eqn.invars]), strict=True)
    return [value(x) for x in closed.jaxpr.outvars]


def _lowered(code: Code, eqn: Any, args: list[Value]) -> list[Value]:
    """One operation."""
    name, params = eqn.primitive.name, eqn.params
    if name in CALLS:
        return lower(code, params[CALLS[name]], args)
    if name in CONTROL:
        return CONTROL[name](code, eqn, args)
    if name in MEMORY:
        return [MEMORY[name](code, params, args)]
    if name in ("broadcast_in_dim", "copy", "reshape", "squeeze"):  # scalars become vectors where they are used
        return args
    if name == "reduce_or":
        kind = (f"<{WIDTH} x i1>", code.vector(args[0]))
        return [Value(code.call("i1", f"vector.reduce.or.v{WIDTH}i1", kind), args[0].dtype, True)]
    return [_computed(code, name, params, args, eqn.outvars[0].aval.dtype)]


def _computed(code: Code, name: str, params: dict[str, Any], args: list[Value], dtype: Any) -> Value:
    """Arithmetic on each number."""
    alike, first = all(arg.alike for arg in args), args[0]
    x = [arg.name if alike else code.vector(arg) for arg in args]
    kind, real, flags = type_of(first.dtype, alike), first.dtype.kind == "f", first.dtype == bool
    signed = first.dtype.kind == "i"
    suffix = f"{'' if alike else f'v{WIDTH}'}{'f32' if real else 'i32'}"
    again = partial(_computed, code, dtype=dtype)

    def constant(number: Any) -> str:
        value = known(number, first.dtype)
        return value.name if alike else code.vector(value)

    def call(function: str, *others: tuple[str, str]) -> str:
        return code.call(kind, f"{function}.{suffix}", *((kind, each) for each in x), *others)

    if name in (operations := FLOATS if real else INTEGERS):
        found = code.value(f"{operations[name]} {kind} {x[0]}, {x[1]}")
    elif name in ("div", "rem") and args[1].name.isdecimal() and args[1].name != "0":
        # By any other integer: division by zero would end the process.
        found = code.value(f"{'s' if signed else 'u'}{name} {kind} {x[0]}, {x[1]}")
    elif name in COMPARISONS:
        prefix = ("u" if name == "ne" else "o") if real else "" if name in ("eq", "ne") else "s" if signed else "u"
        found = code.value(f"{'fcmp' if real else 'icmp'} {prefix}{name} {kind} {x[0]}, {x[1]}")
    elif name == "select_n" and len(args) == 3:
        other = type_of(args[1].dtype, alike)
        found = code.value(f"select {kind} {x[0]}, {other} {x[2]}, {other} {x[1]}")
    elif name == "not":
        found = code.value(f"xor {kind} {x[0]}, {constant(1 if flags else -1)}")
    elif name == "neg":
        found = code.value(f"fneg {kind} {x[0]}" if real else f"sub {kind} {constant(0)}, {x[0]}")
    elif name in ("max", "min") and not flags:
        found = call(f"{name}imum" if real else f"{'s' if signed else 'u'}{name}")
    elif name == "clamp":
        return again("min", params, [again("max", params, [args[1], args[0]]), args[2]])
    elif name == "abs":
        found = call("fabs") if real else call("abs", ("i1", "false"))
    elif name in FUNCTIONS and real:
        found = call(name)
    elif name == "rsqrt":
        found = code.value(f"fdiv contract {kind} {constant(1)}, {call('sqrt')}")
    elif name == "square":
        return again("mul", params, [first, first])
    elif name == "integer_pow" and params["y"] > 0:
        return reduce(lambda power, _: again("mul", params, [power, first]), range(params["y"] - 1), first)
    elif name == "sign" and real:
        one = code.call(kind, f"copysign.{suffix}", (kind, constant(1)), (kind, x[0]))
        moves = code.value(f"fcmp one {kind} {x[0]}, {constant(0)}")
        found = code.value(f"select {type_of(bool, alike)} {moves}, {kind} {one}, {kind} {x[0]}")
    elif name == "is_finite":
        found = code.value(f"fcmp olt {kind} {call('fabs')}, {constant(np.inf)}")
    elif name == "convert_element_type":
        return _converted(code, first, np.dtype(dtype), kind, constant(0), suffix)
    else:
        raise NotImplementedError(f"kernels of a CPU do no {name!r}")
    return Value(found, np.dtype(dtype), alike)


def _converted(code: Code, value: Value, dtype: np.dtype, kind: str, zero: str, suffix: str) -> Value:
    """A value as one of another type."""
    before, name, wanted = value.dtype.kind, value.name, type_of(dtype, value.alike)
    if value.dtype == dtype:
        return value
    if dtype.kind == "b":
        found = code.value(f"{'fcmp une' if before == 'f' else 'icmp ne'} {kind} {name}, {zero}")
    elif before == "f":
        width = "" if value.alike else f"v{WIDTH}"
        found = code.call(wanted, f"fptosi.sat.{width}i32.{suffix}", (kind, name))
    elif dtype.kind == "f":
        found = code.value(f"{'sitofp' if before == 'i' else 'uitofp'} {kind} {name} to {wanted}")
    else:
        found = code.value(f"zext {kind} {name} to {wanted}") if before == "b" else name
    return Value(found, dtype, value.alike)


def _read(code: Code, params: dict[str, Any], args: list[Value]) -> Value:
    return _loaded(code, _address(code, params, args[1:]), params["dtype"], WIDTH)


def _loaded(code: Code, address: Value, dtype: np.dtype, apart: int) -> Value:
    """What is at an address, or at one for each world; `apart`: numbers from one word to the next."""
    if address.alike:
        kind = type_of(dtype, apart == 1)
        return Value(code.value(f"load {kind}, ptr {address.name}, align {4 * apart}"), dtype, apart == 1)
    kind, pointers = type_of(dtype, False), f"<{WIDTH} x ptr>"
    name = f"masked.gather.v{WIDTH}{'f32' if dtype.kind == 'f' else 'i32'}.v{WIDTH}p0"
    all_of_them = (f"<{WIDTH} x i1>", "splat (i1 true)")
    return Value(
        code.call(kind, name, (pointers, address.name), ("i32", "4"), all_of_them, (kind, "poison")), dtype, False
    )


def _written(code: Code, params: dict[str, Any], args: list[Value]) -> Value:
    value, address = args[1], _address(code, params, args[2:])
    kind, vector = type_of(value.dtype, False), code.vector(value)
    if address.alike:
        code.add(f"store {kind} {vector}, ptr {address.name}, align {4 * WIDTH}")
    else:
        name = f"masked.scatter.v{WIDTH}{'f32' if value.dtype.kind == 'f' else 'i32'}.v{WIDTH}p0"
        pointers, all_of_them = (f"<{WIDTH} x ptr>", address.name), (f"<{WIDTH} x i1>", "splat (i1 true)")
        code.call("void", name, (kind, vector), pointers, ("i32", "4"), all_of_them)
    return known(0, np.int32)


def _filled(code: Code, params: dict[str, Any], args: list[Value]) -> Value:
    word = code.vector(known(params["bits"], np.int32))
    for each in range(params["count"]):
        address = _address(code, params | {"word": params["word"] + each}, [])
        code.add(f"store <{WIDTH} x i32> {word}, ptr {address.name}, align {4 * WIDTH}")
    return known(0, np.int32)


def _address(code: Code, params: dict[str, Any], place: list[Value]) -> Value:
    """Address of the vector of a word of memory, so many words from a place; or of each world's own word."""
    code.regions[params["region"]] = params["words"]
    lanes = f"<{', '.join(f'i32 {lane}' for lane in range(WIDTH))}>"
    return _beyond(code, f"%region{params['region']}", params["word"], place, WIDTH, lanes)


def _constant(code: Code, params: dict[str, Any], args: list[Value]) -> Value:
    table = code.tables.setdefault(params["table"], len(code.tables))
    return _loaded(
        code, _beyond(code, f"@table{table}", params["word"], args[1:], 1, "zeroinitializer"), params["dtype"], 1
    )


def _beyond(code: Code, base: str, word: int, place: list[Value], apart: int, lanes: str) -> Value:
    """The address of a word, so many words from a place, with words so many numbers apart."""
    pointer = np.dtype(np.int32)  # LLVM's pointers have no type
    if all(each.alike for each in place):
        index = f"add i32 {place[0].name if place else 0}, {word}"
        index = code.value(f"mul i32 {code.value(index)}, {apart}")
        return Value(code.value(f"getelementptr i32, ptr {base}, i32 {index}"), pointer, True)
    index, kind = place[0].name, f"<{WIDTH} x i32>"
    index = code.value(f"add {kind} {index}, splat (i32 {word})")
    index = code.value(f"mul {kind} {index}, splat (i32 {apart})")
    index = code.value(f"add {kind} {index}, {lanes}")
    return Value(code.value(f"getelementptr i32, ptr {base}, {kind} {index}"), pointer, False)


MEMORY: dict[str, Callable[..., Value]] = {
    "read_word": _read,
    "write_word": _written,
    "fill_words": _filled,
    "constant": _constant,
}


def _while(code: Code, eqn: Any, args: list[Value]) -> list[Value]:
    params, number = eqn.params, next(code.numbers)
    first, last = params["cond_nconsts"], params["cond_nconsts"] + params["body_nconsts"]
    alike, start, before = _alike_in_loop(eqn, [arg.alike for arg in args]), args[last:], code.label

    def names(values: Sequence[Value]) -> list[str]:
        return [value.name if same else code.vector(value) for value, same in zip(values, alike, strict=True)]

    begun = names(start)
    code.add(f"br label %head{number}")
    code.begin(f"head{number}")
    place = len(code.lines)
    carry = [Value(f"%c{next(code.numbers)}", x.dtype, same) for x, same in zip(start, alike, strict=True)]
    (more,) = lower(code, params["cond_jaxpr"], [*args[:first], *carry])
    code.add(f"br i1 {more.name}, label %body{number}, label %end{number}")
    code.begin(f"body{number}")
    ended = names(lower(code, params["body_jaxpr"], [*args[first:last], *carry]))
    code.lines[place:place] = [
        f"  {x.name} = phi {x.type} [ {one}, %{before} ], [ {two}, %{code.label} ]"
        for x, one, two in zip(carry, begun, ended, strict=True)
    ]
    code.add(f"br label %head{number}")
    code.begin(f"end{number}")
    return carry


def _cond(code: Code, eqn: Any, args: list[Value]) -> list[Value]:
    number, (index, *given), branches = next(code.numbers), args, eqn.params["branches"]
    flags = [arg.alike for arg in given]
    alike = [all(each) for each in zip(*(_alike(branch.jaxpr, flags) for branch in branches), strict=True)]
    chosen = _converted(code, index, np.dtype(bool), index.type, "0", "")
    code.add(f"br i1 {chosen.name}, label %yes{number}, label %no{number}")
    found = []
    for label, branch in zip((f"no{number}", f"yes{number}"), branches, strict=True):
        code.begin(label)
        values = lower(code, branch, given)
        names = [value.name if same else code.vector(value) for value, same in zip(values, alike, strict=True)]
        found.append([f"[ {name}, %{code.label} ]" for name in names])
        code.add(f"br label %join{number}")
    code.begin(f"join{number}")
    return [
        Value(code.value(f"phi {type_of(x.aval.dtype, same)} {one}, {two}"), np.dtype(x.aval.dtype), same)
        for x, same, one, two in zip(eqn.outvars, alike, *found, strict=True)
    ]


CONTROL: dict[str, Callable[..., list[Value]]] = {"while": _while, "cond": _cond}


def _alike(jaxpr: Any, given: Sequence[bool]) -> list[bool]:
    """Which results of a traced function are the same in all worlds, if these arguments are."""
    known = dict.fromkeys(jaxpr.constvars, True) | dict(zip(jaxpr.invars, given, strict=True))

    def alike(x: Any) -> bool:
        return isinstance(x, Literal) or known[x]

    for eqn in jaxpr.eqns:
        name, params, flags = eqn.primitive.name, eqn.params, [alike(x) for x in eqn.invars]
        if name in CALLS:
            found = _alike(params[CALLS[name]].jaxpr, flags)
        elif name == "while":
            found = _alike_in_loop(eqn, flags)
        elif name == "cond":
            each = (_alike(branch.jaxpr, flags[1:]) for branch in params["branches"])
            found = [all(same) for same in zip(*each, strict=True)]
        else:
            found = [name == "reduce_or" or (name != "read_word" and all(flags))]
        known |= zip(eqn.outvars, found, strict=True)
    return [alike(x) for x in jaxpr.outvars]


def _alike_in_loop(eqn: Any, given: Sequence[bool]) -> list[bool]:
    """The same of what a loop carries."""
    params = eqn.params
    first, last = params["cond_nconsts"], params["cond_nconsts"] + params["body_nconsts"]
    carry = list(given[last:])
    while (found := _alike(params["body_jaxpr"].jaxpr, [*given[first:last], *carry])) != carry:
        both = [one and two for one, two in zip(carry, found, strict=True)]
        if both == carry:
            break
        carry = both
    return carry
