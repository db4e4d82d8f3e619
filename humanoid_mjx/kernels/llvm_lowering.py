"""Traced functions of vectors as LLVM's code. Loops and branches ask for scalars, which `Threads` provides."""

from collections.abc import Callable, Sequence
from functools import partial, reduce
from itertools import accumulate, compress
from typing import Any

import numpy as np
from jax.extend.core import ClosedJaxpr

from humanoid_mjx.kernels.llvm import Code, Value, known
from humanoid_mjx.kernels.llvm_memory import MEMORY
from humanoid_mjx.kernels.primitives import CALLS, FUNCTIONS, evaluated, uniform_carry, uniform_results

COMPARISONS = ("eq", "ne", "lt", "le", "gt", "ge")
WORDS = {name: name for name in ("add", "and", "mul", "or", "sub", "xor")}
WORDS |= {"shift_left": "shl", "shift_right_arithmetic": "ashr", "shift_right_logical": "lshr"}
WORDS |= {"eq": "icmp eq", "ne": "icmp ne"}
UNSIGNED = {name: f"icmp u{name}" for name in COMPARISONS[2:]} | WORDS
INSTRUCTIONS: dict[str, dict[str, str]] = {
    "b": UNSIGNED,
    "u": UNSIGNED,
    "i": {name: f"icmp s{name}" for name in COMPARISONS[2:]} | WORDS,
    "f": {name: f"fcmp o{name}" for name in COMPARISONS}
    | {name: f"f{name} contract" for name in ("add", "div", "mul", "sub")}
    | {"ne": "fcmp une", "neg": "fneg"},
}
"""By kind of number and primitive: an instruction of LLVM."""

INTRINSICS: dict[str, dict[str, str]] = {
    "b": {},
    "u": {"max": "umax", "min": "umin"},
    "i": {"max": "smax", "min": "smin"},
    "f": {name: name for name in FUNCTIONS} | {"abs": "fabs", "max": "maximum", "min": "minimum"},
}
"""Likewise: one of LLVM's intrinsics."""


def lower(code: Code, closed: ClosedJaxpr, args: Sequence[Value]) -> list[Value]:
    """Add the instructions of a traced function to the code; return its results.

    The function is of vectors of `THREADS`, which become such of `code.width`, and of scalars.

    Raises:
      NotImplementedError: it has an operation that is none of kernels'.
    """

    def constant(array: Any) -> Value:
        array = np.asarray(array)
        if (array != array.flat[0]).any():
            raise NotImplementedError("kernels know constants that are the same in all worlds")
        return known(array.flat[0], array.dtype)

    return evaluated(closed, args, constant, partial(_lowered, code))


def _lowered(code: Code, eqn: Any, args: list[Value]) -> list[Value]:
    """One operation."""
    name, params = eqn.primitive.name, eqn.params
    if name in CALLS:
        return lower(code, params[CALLS[name]], args)
    if name in CONTROL:
        return CONTROL[name](code, eqn, args)
    if name in MEMORY:
        return MEMORY[name](code, params, args)
    if name in ("broadcast_in_dim", "copy", "reshape", "squeeze"):  # scalars become vectors where they are used
        return args
    if name == "reduce_or":
        if code.width == 1:
            return args
        flags = code.type_of(bool), code.vector(args[0])
        return [Value(code.call("i1", f"vector.reduce.or.v{code.width}i1", flags), args[0].dtype, True)]
    return [_computed(code, name, params, args, eqn.outvars[0].aval.dtype)]


def _computed(code: Code, name: str, params: dict[str, Any], args: list[Value], dtype: Any) -> Value:
    """Arithmetic on each number."""
    uniform, first = code.width == 1 or all(arg.uniform for arg in args), args[0]
    before, after = first.dtype.kind, np.dtype(dtype).kind
    x = [code.vector(arg, uniform) for arg in args]
    kind, wanted, flags = (code.type_of(each, uniform) for each in (first.dtype, dtype, bool))
    suffix = f"{'' if uniform else f'v{code.width}'}{'f32' if before == 'f' else 'i32'}"
    again = partial(_computed, code, params=params, dtype=dtype)

    def constant(number: Any, dtype: Any = first.dtype) -> str:
        return code.vector(known(number, dtype), uniform)

    def call(function: str, *others: tuple[str, str]) -> str:
        return code.call(kind, f"{function}.{suffix}", *((kind, each) for each in x), *others)

    if name in INSTRUCTIONS[before]:
        found = code.value(f"{INSTRUCTIONS[before][name]} {kind} {', '.join(x)}")
    elif name in INTRINSICS[before]:
        found = call(INTRINSICS[before][name])
    elif name in ("div", "rem") and args[1].name.isdecimal() and args[1].name != "0":
        # By any other integer: division by zero would end the process.
        found = code.value(f"{'s' if before == 'i' else 'u'}{name} {kind} {x[0]}, {x[1]}")
    elif name == "select_n" and len(args) == 3:
        found = code.value(f"select {kind} {x[0]}, {wanted} {x[2]}, {wanted} {x[1]}")
    elif name == "not":
        found = code.value(f"xor {kind} {x[0]}, {constant(1 if before == 'b' else -1)}")
    elif name == "neg":
        found = code.value(f"sub {kind} {constant(0)}, {x[0]}")
    elif name == "clamp":
        return again("min", args=[again("max", args=[args[1], first]), args[2]])
    elif name == "abs":
        found = call("abs", ("i1", "false"))
    elif name == "rsqrt":
        found = code.value(f"fdiv contract {kind} {constant(1)}, {call('sqrt')}")
    elif name == "square":
        return again("mul", args=[first, first])
    elif name == "integer_pow" and params["y"] > 0:
        digits = [int(digit) for digit in f"{params['y']:b}"[::-1]]
        squares = accumulate(digits[1:], lambda x, _: again("mul", args=[x, x]), initial=first)
        return reduce(lambda one, two: again("mul", args=[one, two]), compress(squares, digits))  # in jax's order
    elif name == "sign" and before == "f":
        one = code.call(kind, f"copysign.{suffix}", (kind, constant(1)), (kind, x[0]))
        moves = code.value(f"fcmp one {kind} {x[0]}, {constant(0)}")
        found = code.value(f"select {flags} {moves}, {kind} {one}, {kind} {x[0]}")
    elif name == "sign":
        return again("min", args=[again("max", args=[first, known(-(before == "i"), dtype)]), known(1, dtype)])
    elif name == "bitcast_convert_type":
        found = code.value(f"bitcast {kind} {x[0]} to {wanted}")
    elif name == "is_finite":
        found = code.value(f"fcmp olt {kind} {call('fabs')}, {constant(np.inf)}")
    elif name != "convert_element_type":
        raise NotImplementedError(f"kernels of a CPU do no {name!r}")
    elif first.dtype == dtype:
        return first
    elif after == "b":
        found = code.value(f"{'fcmp une' if before == 'f' else 'icmp ne'} {kind} {x[0]}, {constant(0)}")
    elif before == "f":
        # The nearest integer towards zero that there is; 0 of NaN. LLVM's own, `fptosi.sat`, is no vector instruction.
        limits = np.iinfo(dtype)
        most = np.nextafter(np.float32(limits.max), np.float32(0))
        clamped = code.call(kind, f"maxnum.{suffix}", (kind, x[0]), (kind, constant(limits.min)))
        clamped = code.call(kind, f"minnum.{suffix}", (kind, clamped), (kind, constant(most)))
        found = code.value(f"fpto{'s' if limits.min else 'u'}i {kind} {clamped} to {wanted}")
        for test, other, number in ("oge", constant(limits.max), limits.max), ("uno", x[0], 0):
            flag = code.value(f"fcmp {test} {kind} {x[0]}, {other}")
            found = code.value(f"select {flags} {flag}, {wanted} {constant(number, dtype)}, {wanted} {found}")
    elif before == "b":
        found = code.value(f"select {kind} {x[0]}, {wanted} {constant(1, dtype)}, {wanted} {constant(0, dtype)}")
    elif after == "f":
        found = code.value(f"{'sitofp' if before == 'i' else 'uitofp'} {kind} {x[0]} to {wanted}")
    else:
        found = x[0]
    return Value(found, np.dtype(dtype), uniform)


def _while(code: Code, eqn: Any, args: list[Value]) -> list[Value]:
    params, number = eqn.params, next(code.numbers)
    first, last = params["cond_nconsts"], params["cond_nconsts"] + params["body_nconsts"]
    uniform, start, before = uniform_carry(eqn, [arg.uniform for arg in args]), args[last:], code.label
    begun = [*map(code.vector, start, uniform)]
    code.add(f"br label %head{number}")
    code.begin(f"head{number}")
    place = len(code.lines)
    carry = [Value(f"%c{next(code.numbers)}", x.dtype, same) for x, same in zip(start, uniform, strict=True)]
    (more,) = lower(code, params["cond_jaxpr"], [*args[:first], *carry])
    code.add(f"br i1 {more.name}, label %body{number}, label %end{number}")
    code.begin(f"body{number}")
    ended = map(code.vector, lower(code, params["body_jaxpr"], [*args[first:last], *carry]), uniform)
    code.lines[place:place] = [
        f"  {x.name} = phi {code.type_of(x.dtype, x.uniform)} [ {one}, %{before} ], [ {two}, %{code.label} ]"
        for x, one, two in zip(carry, begun, ended, strict=True)
    ]
    code.add(f"br label %head{number}")
    code.begin(f"end{number}")
    return carry


def _cond(code: Code, eqn: Any, args: list[Value]) -> list[Value]:
    number, (index, *given), branches = next(code.numbers), args, eqn.params["branches"]
    flags = [arg.uniform for arg in given]
    uniform = [all(each) for each in zip(*(uniform_results(branch, flags) for branch in branches), strict=True)]
    chosen = _computed(code, "convert_element_type", {}, [index], bool)
    code.add(f"br i1 {chosen.name}, label %yes{number}, label %no{number}")
    found = []
    for label, branch in zip((f"no{number}", f"yes{number}"), branches, strict=True):
        code.begin(label)
        names = [*map(code.vector, lower(code, branch, given), uniform)]
        found.append([f"[ {name}, %{code.label} ]" for name in names])
        code.add(f"br label %join{number}")
    code.begin(f"join{number}")
    return [
        Value(code.value(f"phi {code.type_of(x.aval.dtype, same)} {one}, {two}"), np.dtype(x.aval.dtype), same)
        for x, same, one, two in zip(eqn.outvars, uniform, *found, strict=True)
    ]


CONTROL: dict[str, Callable[..., list[Value]]] = {"while": _while, "cond": _cond}
