"""Reading of traced functions, and the primitives of jax that more than one reader knows."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, jaxprs_in_params

T = TypeVar("T")


def evaluated(
    closed: ClosedJaxpr, args: Sequence[T], known: Callable[[Any], T], apply: Callable[[Any, list[T]], Sequence[T]]
) -> list[T]:
    """The results of a traced function.

    Args:
      closed: the function.
      args: values of its arguments, of any kind.
      known: from an array that is known while tracing to its value.
      apply: from an operation, and the values that it takes, to those that it gives.
    """
    values: dict[Any, T] = dict(zip(closed.jaxpr.constvars, map(known, closed.consts), strict=True))
    values |= zip(closed.jaxpr.invars, args, strict=True)

    def value(x: Any) -> T:
        kind: Any = x.aval
        return known(np.asarray(x.val, kind.dtype)) if isinstance(x, Literal) else values[x]

    for eqn in closed.jaxpr.eqns:
        values |= zip(eqn.outvars, apply(eqn, [value(x) for x in eqn.invars]), strict=True)
    return [value(x) for x in closed.jaxpr.outvars]


ELEMENTWISE = frozenset(
    (
        *("abs", "add", "and", "ceil", "clamp", "convert_element_type", "div", "eq", "exp", "floor", "ge", "gt"),
        *("integer_pow", "is_finite", "le", "log", "lt", "max", "min", "mul", "ne", "neg", "not", "or", "rem"),
        *("round", "select_n", "shift_left", "shift_right_arithmetic", "shift_right_logical", "sign", "sqrt", "square"),
        *("sub", "xor"),
    )
)
"""Primitives that act on each element alone; more than these are known to one reader or the other."""

FUNCTIONS = frozenset(("atan2", "ceil", "cos", "exp", "floor", "log", "pow", "sin", "sqrt", "tan"))
"""Likewise, of floats; LLVM has an intrinsic of each name."""

CALLS = {"jit": "jaxpr", "pjit": "jaxpr", "closed_call": "call_jaxpr", "custom_jvp_call": "call_jaxpr"}
CALLS |= {"custom_vmap_call": "call"}
"""Primitives that call a traced function, and the parameter that holds it."""


def operations(jaxpr: Jaxpr) -> int:
    """Count the operations of a traced function, those of calls, loops and branches among them."""
    return len(jaxpr.eqns) + sum(operations(part) for eqn in jaxpr.eqns for part in jaxprs_in_params(eqn.params))


def uniform_results(closed: ClosedJaxpr, given: Sequence[bool], of_one: bool = False) -> list[bool]:
    """Return which results of a traced function are uniform; `given`: which arguments are. `of_one`: the function is of
    one world, and its reductions are over a world's own numbers."""

    def uniform(eqn: Any, flags: list[bool]) -> Sequence[bool]:
        name, params = eqn.primitive.name, eqn.params
        if name in CALLS:
            return uniform_results(params[CALLS[name]], flags, of_one)
        if name == "while":
            return uniform_carry(eqn, flags, of_one)
        if name == "cond":
            each = (uniform_results(branch, flags[1:], of_one) for branch in params["branches"])
            return [flags[0] and all(same) for same in zip(*each, strict=True)]
        of_all = name == "reduce_or" and not of_one
        own = name == "read_words" and not isinstance(params["region"], tuple)  # those are words of all worlds
        return [of_all or (not own and all(flags))] * len(eqn.outvars)

    return evaluated(closed, given, lambda _: True, uniform)


def uniform_carry(eqn: Any, given: Sequence[bool], of_one: bool = False) -> list[bool]:
    """Return which values that a loop carries stay uniform; `given`: which arguments of the loop are."""
    params = eqn.params
    first, last = params["cond_nconsts"], params["cond_nconsts"] + params["body_nconsts"]
    carry = list(given[last:])
    while True:
        found = uniform_results(params["body_jaxpr"], [*given[first:last], *carry], of_one)
        both = [one and two for one, two in zip(carry, found, strict=True)]
        if both == carry:
            return carry
        carry = both
