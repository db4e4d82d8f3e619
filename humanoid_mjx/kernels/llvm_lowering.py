"""Traced functions of vectors as LLVM's code. Loops and branches ask for scalars, which `Threads` provides."""

from collections.abc import Callable, Sequence
from functools import partial, reduce
from itertools import accumulate, compress
from typing import Any

import numpy as np
from jax.extend.core import ClosedJaxpr

from humanoid_mjx.kernels.llvm import WIDTH, Code, Value, known, type_of
from humanoid_mjx.kernels.llvm_memory import MEMORY
from humanoid_mjx.kernels.primitives import CALLS, evaluated
from humanoid_mjx.kernels.uniform import uniform_carry, uniform_results

FLOATS = {"add": "fadd contract", "sub": "fsub contract", "mul": "fmul contract", "div": "fdiv contract"}
INTEGERS = {name: name for name in ("add", "and", "mul", "or", "sub", "xor")}
"""LLVM's operations on two numbers."""

SHIFTS = {"shift_left": "shl", "shift_right_arithmetic": "ashr", "shift_right_logical": "lshr"}
COMPARISONS = ("eq", "ne", "lt", "le", "gt", "ge")
FUNCTIONS = ("atan2", "ceil", "cos", "exp", "floor", "log", "pow", "sin", "sqrt", "tan")
"""Those that are one of LLVM's intrinsics, by the same name."""


def lower(code: Code, closed: ClosedJaxpr, args: Sequence[Value]) -> list[Value]:
    """Add a traced function to the code.

    Args:
      code: it gets the instructions.
      closed: function of vectors of `THREADS` and of scalars, of which the vectors become such of `WIDTH`.
      args: what the function is given.

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
        kind = (f"<{WIDTH} x i1>", code.vector(args[0]))
        return [Value(code.call("i1", f"vector.reduce.or.v{WIDTH}i1", kind), args[0].dtype, True)]
    return [_computed(code, name, params, args, eqn.outvars[0].aval.dtype)]


def _computed(code: Code, name: str, params: dict[str, Any], args: list[Value], dtype: Any) -> Value:
    """Arithmetic on each number."""
    uniform, first = all(arg.uniform for arg in args), args[0]
    x = [arg.name if uniform else code.vector(arg) for arg in args]
    kind, real, flags = type_of(first.dtype, uniform), first.dtype.kind == "f", first.dtype == bool
    signed = first.dtype.kind == "i"
    suffix = f"{'' if uniform else f'v{WIDTH}'}{'f32' if real else 'i32'}"
    again = partial(_computed, code, dtype=dtype)

    def constant(number: Any) -> str:
        value = known(number, first.dtype)
        return value.name if uniform else code.vector(value)

    def call(function: str, *others: tuple[str, str]) -> str:
        return code.call(kind, f"{function}.{suffix}", *((kind, each) for each in x), *others)

    if name in (operations := FLOATS if real else INTEGERS):
        found = code.value(f"{operations[name]} {kind} {x[0]}, {x[1]}")
    elif name in ("div", "rem") and args[1].name.isdecimal() and args[1].name != "0":
        # By any other integer: division by zero would end the process.
        found = code.value(f"{'s' if signed else 'u'}{name} {kind} {x[0]}, {x[1]}")
    elif name in SHIFTS:
        found = code.value(f"{SHIFTS[name]} {kind} {x[0]}, {x[1]}")
    elif name in COMPARISONS:
        prefix = ("u" if name == "ne" else "o") if real else "" if name in ("eq", "ne") else "s" if signed else "u"
        found = code.value(f"{'fcmp' if real else 'icmp'} {prefix}{name} {kind} {x[0]}, {x[1]}")
    elif name == "select_n" and len(args) == 3:
        other = type_of(args[1].dtype, uniform)
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
        digits = [int(digit) for digit in f"{params['y']:b}"[::-1]]
        squares = accumulate(digits[1:], lambda x, _: again("mul", params, [x, x]), initial=first)
        return reduce(lambda one, two: again("mul", params, [one, two]), compress(squares, digits))  # in jax's order
    elif name == "sign" and real:
        one = code.call(kind, f"copysign.{suffix}", (kind, constant(1)), (kind, x[0]))
        moves = code.value(f"fcmp one {kind} {x[0]}, {constant(0)}")
        found = code.value(f"select {type_of(bool, uniform)} {moves}, {kind} {one}, {kind} {x[0]}")
    elif name == "sign":
        return again("min", params, [again("max", params, [first, known(-signed, dtype)]), known(1, dtype)])
    elif name == "bitcast_convert_type":
        found = code.value(f"bitcast {kind} {x[0]} to {type_of(dtype, uniform)}")
    elif name == "is_finite":
        found = code.value(f"fcmp olt {kind} {call('fabs')}, {constant(np.inf)}")
    elif name == "convert_element_type":
        return _converted(code, first, np.dtype(dtype), kind, constant(0), suffix)
    else:
        raise NotImplementedError(f"kernels of a CPU do no {name!r}")
    return Value(found, np.dtype(dtype), uniform)


def _converted(code: Code, value: Value, dtype: np.dtype, kind: str, zero: str, suffix: str) -> Value:
    """A value as one of another type."""
    before, name, wanted = value.dtype.kind, value.name, type_of(dtype, value.uniform)
    if value.dtype == dtype:
        return value
    if dtype.kind == "b":
        found = code.value(f"{'fcmp une' if before == 'f' else 'icmp ne'} {kind} {name}, {zero}")
    elif before == "f":
        found = _to_integer(code, value, dtype, suffix)
    elif before == "b":
        one, none = (known(x, dtype) for x in (1, 0))
        one, none = (x.name if value.uniform else code.vector(x) for x in (one, none))
        found = code.value(f"select {kind} {name}, {wanted} {one}, {wanted} {none}")
    elif dtype.kind == "f":
        found = code.value(f"{'sitofp' if before == 'i' else 'uitofp'} {kind} {name} to {wanted}")
    else:
        found = name
    return Value(found, dtype, value.uniform)


def _to_integer(code: Code, value: Value, dtype: np.dtype, suffix: str) -> str:
    """The nearest integer towards zero that there is; 0 of NaN. LLVM's own, `fptosi.sat`, is no vector instruction."""
    kind, wanted, limits = value.type, type_of(dtype, value.uniform), np.iinfo(dtype)

    def constant(number: Any, dtype: Any = np.float32) -> str:
        x = known(number, dtype)
        return x.name if value.uniform else code.vector(x)

    most = np.nextafter(np.float32(limits.max), np.float32(0))
    clamped = code.call(kind, f"maxnum.{suffix}", (kind, value.name), (kind, constant(limits.min)))
    clamped = code.call(kind, f"minnum.{suffix}", (kind, clamped), (kind, constant(most)))
    found = code.value(f"fpto{dtype.kind.replace('i', 's')}i {kind} {clamped} to {wanted}")
    flags = type_of(bool, value.uniform)
    for test, other, number in ("oge", constant(limits.max), limits.max), ("uno", value.name, 0):
        flag = code.value(f"fcmp {test} {kind} {value.name}, {other}")
        found = code.value(f"select {flags} {flag}, {wanted} {constant(number, dtype)}, {wanted} {found}")
    return found


def _while(code: Code, eqn: Any, args: list[Value]) -> list[Value]:
    params, number = eqn.params, next(code.numbers)
    first, last = params["cond_nconsts"], params["cond_nconsts"] + params["body_nconsts"]
    uniform, start, before = uniform_carry(eqn, [arg.uniform for arg in args]), args[last:], code.label

    def names(values: Sequence[Value]) -> list[str]:
        return [value.name if same else code.vector(value) for value, same in zip(values, uniform, strict=True)]

    begun = names(start)
    code.add(f"br label %head{number}")
    code.begin(f"head{number}")
    place = len(code.lines)
    carry = [Value(f"%c{next(code.numbers)}", x.dtype, same) for x, same in zip(start, uniform, strict=True)]
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
    flags = [arg.uniform for arg in given]
    uniform = [all(each) for each in zip(*(uniform_results(branch, flags) for branch in branches), strict=True)]
    chosen = _converted(code, index, np.dtype(bool), index.type, "0", "")
    code.add(f"br i1 {chosen.name}, label %yes{number}, label %no{number}")
    found = []
    for label, branch in zip((f"no{number}", f"yes{number}"), branches, strict=True):
        code.begin(label)
        values = lower(code, branch, given)
        names = [value.name if same else code.vector(value) for value, same in zip(values, uniform, strict=True)]
        found.append([f"[ {name}, %{code.label} ]" for name in names])
        code.add(f"br label %join{number}")
    code.begin(f"join{number}")
    return [
        Value(code.value(f"phi {type_of(x.aval.dtype, same)} {one}, {two}"), np.dtype(x.aval.dtype), same)
        for x, same, one, two in zip(eqn.outvars, uniform, *found, strict=True)
    ]


CONTROL: dict[str, Callable[..., list[Value]]] = {"while": _while, "cond": _cond}
