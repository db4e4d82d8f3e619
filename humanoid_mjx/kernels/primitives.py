"""Reading of traced functions, and the primitives of jax that more than one reader knows."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
from jax.extend.core import ClosedJaxpr, Literal

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
        return known(np.asarray(x.val, x.aval.dtype)) if isinstance(x, Literal) else values[x]

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
