"""Scalar functions taken apart, so that a kernel can run them on vectors of runs.

A learner and its task are written for one run. What they compute at each step from the state alone mixes with what is
the same at every step: hyper-parameters, words of a random key, the number of moves to the goal. `Elementwise` splits
a function into a part that is computed once before a loop, by XLA, and a part for each step, which may do no more than
arithmetic on scalars and look up constant tables.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Literal, Var
from jaxtyping import Array

from humanoid_mjx.kernels.primitives import CALLS, ELEMENTWISE

SHIFTS = {"shift_left", "shift_right_arithmetic", "shift_right_logical"}

ARITHMETIC = ELEMENTWISE | SHIFTS | {"bitcast_convert_type"}
"""Primitives that act on each element alone."""

RESHAPES = {"broadcast_in_dim", "reshape", "squeeze"}
"""Primitives that change nothing about a single element."""

LOOKUPS = {"gather", "dynamic_slice"}
"""Primitives that read an entry of a vector."""

Lookup = Callable[[np.ndarray, Array], Array]
"""From a constant vector and indices inside it to its entries."""


Truncate = Callable[[Array], Array]
"""From float32 to int32, towards zero, the nearest int32 where it is too large, 0 for NaN."""


class NotElementwise(Exception):
    """A function does more than arithmetic on scalars and look-ups in constant vectors; the message says what."""


class Equation(NamedTuple):
    """One operation of a function."""

    primitive: Any
    params: dict[str, Any]
    inputs: tuple[Any, ...]
    """Variables, or values that are known while tracing."""
    outputs: tuple[Var, ...]


class Elementwise:
    """The function `call(fixed, varying)` of two pytrees of scalars, in two parts.

    Raises:
      NotElementwise: the part for each step is no arithmetic.
    """

    def __init__(self, call: Callable[[Any, Any], Any], fixed: Any, varying: Any):
        traced, shape = jax.make_jaxpr(call, return_shape=True)(fixed, varying)
        self.out_tree = jax.tree.structure(shape)
        names, equations, self.outputs = _inlined(traced)
        self.fixed = names[: len(jax.tree.leaves(fixed))]
        self.varying = names[len(self.fixed) :]
        equations, self.outputs = _each_once(equations, self.outputs)
        equations = _needed(equations, self.outputs)
        known = set(self.fixed)
        self.before: list[Equation] = []
        self.each: list[Equation] = []
        for equation in equations:
            once = all(not isinstance(x, Var) or x in known for x in equation.inputs)
            (self.before if once else self.each).append(equation)
            known |= set(equation.outputs) if once else set()
        used = [x for equation in self.each for x in equation.inputs] + list(self.outputs)
        self.kept = list(dict.fromkeys(x for x in used if isinstance(x, Var) and x in known))
        """Values that the part for each step takes from the part before."""
        for equation in self.each:
            _check(equation)
        tables = [e.inputs[0] for e in self.each if e.primitive.name in LOOKUPS]
        self.tables: list[np.ndarray] = list({id(table): table for table in tables}.values())
        """The constant vectors that are looked up."""
        if any(_aval(var).shape for var in self.kept):
            raise NotElementwise("looks up tables that are not constants")

    def once(self, fixed: Any) -> list[Array]:
        """The part before the loop, of one run."""
        values: dict[Any, Any] = dict(zip(self.fixed, jax.tree.leaves(fixed), strict=True))
        for equation in self.before:
            inputs = [values[x] if isinstance(x, Var) else x for x in equation.inputs]
            found = equation.primitive.bind(*inputs, **equation.params)
            values |= zip(equation.outputs, found if equation.primitive.multiple_results else [found], strict=True)
        return [values[var] for var in self.kept]

    def step(self, kept: Sequence[Array], varying: Any, lookup: Lookup, truncate: Truncate) -> Any:
        """The part for each step, of a vector of runs."""
        values: dict[Any, Any] = dict(zip(self.kept, kept, strict=True))
        values |= zip(self.varying, jax.tree.leaves(varying), strict=True)
        shape = next(iter(values.values())).shape

        def value(x: Any) -> Array:
            return values[x] if isinstance(x, Var) else jnp.full(shape, np.asarray(x).item(), x.dtype)

        for equation in self.each:
            name = equation.primitive.name
            if name in RESHAPES:
                found = value(equation.inputs[0])
            elif name in LOOKUPS:
                found = lookup(equation.inputs[0], value(equation.inputs[1]))
            elif _truncates(equation):
                found = truncate(value(equation.inputs[0]))
            else:
                found = equation.primitive.bind(*map(value, equation.inputs), **equation.params)
            values[equation.outputs[0]] = found
        return jax.tree.unflatten(self.out_tree, [value(x) for x in self.outputs])


def _inlined(traced: ClosedJaxpr) -> tuple[list[Var], list[Equation], tuple[Any, ...]]:
    """Inputs, operations and outputs of a function, the calls in it replaced by what they do."""
    equations: list[Equation] = []

    def walk(closed: ClosedJaxpr, given: dict[Var, Any]) -> list[Any]:
        names = dict(zip(closed.jaxpr.constvars, closed.consts, strict=True)) | given

        def source(x: Any) -> Any:
            return np.asarray(x.val, _aval(x).dtype) if isinstance(x, Literal) else names.get(x, x)

        for eqn in closed.jaxpr.eqns:
            inputs = tuple(source(x) for x in eqn.invars)
            if eqn.primitive.name in CALLS:
                inner = eqn.params[CALLS[eqn.primitive.name]]
                names |= zip(eqn.outvars, walk(inner, dict(zip(inner.jaxpr.invars, inputs, strict=True))), strict=True)
                continue
            if eqn.primitive.name == "convert_element_type" and not isinstance(inputs[0], Var):
                names[eqn.outvars[0]] = inputs[0].astype(eqn.params["new_dtype"])
                continue
            outputs = tuple(Var(var.aval) for var in eqn.outvars)  # an inner function may be called twice
            names |= zip(eqn.outvars, outputs, strict=True)
            equations.append(Equation(eqn.primitive, eqn.params, inputs, outputs))
        return [source(x) for x in closed.jaxpr.outvars]

    outputs = walk(traced, {})
    return list(traced.jaxpr.invars), equations, tuple(outputs)


def kept_in_common(parts: Sequence[Elementwise]) -> list[list[int]]:
    """Number the values that each part keeps; all parts have one `fixed`, and equal numbers are equal values.

    A kernel that were given a value twice would compute everything that follows from it twice.
    """
    numbers: dict[Any, int] = {}
    found = []
    for part in parts:
        known = {var: numbers.setdefault(place, len(numbers)) for place, var in enumerate(part.fixed)}
        for equation in part.before:
            what = _what(equation, [known.get(x, x) if isinstance(x, Var) else x for x in equation.inputs])
            for place, var in enumerate(equation.outputs):
                known[var] = numbers.setdefault((what, place), len(numbers))
        found.append([known[var] for var in part.kept])
    return found


def _what(equation: Equation, inputs: Sequence[Any]) -> Any:
    """A key that is equal for operations that do the same with the same inputs."""
    same = [((x.dtype, x.item()) if x.size == 1 else id(x)) if isinstance(x, np.ndarray) else x for x in inputs]
    return equation.primitive, str(sorted(equation.params.items())), tuple(same)


def _each_once(equations: list[Equation], outputs: tuple[Any, ...]) -> tuple[list[Equation], tuple[Any, ...]]:
    """Common-subexpression elimination, which a compiler cannot do through inline assembly."""
    names: dict[Any, Any] = {}
    seen: dict[Any, tuple[Var, ...]] = {}
    kept = []
    for equation in equations:
        inputs = tuple(names.get(x, x) if isinstance(x, Var) else x for x in equation.inputs)
        what = _what(equation, inputs)
        if what in seen:
            names |= zip(equation.outputs, seen[what], strict=True)
        else:
            seen[what] = equation.outputs
            kept.append(equation._replace(inputs=inputs))
    return kept, tuple(names.get(x, x) if isinstance(x, Var) else x for x in outputs)


def _needed(equations: list[Equation], outputs: Sequence[Any]) -> list[Equation]:
    """Dead-code elimination: the operations that an output needs."""
    needed, kept = {x for x in outputs if isinstance(x, Var)}, []
    for equation in reversed(equations):
        if needed & set(equation.outputs):
            kept.append(equation)
            needed |= {x for x in equation.inputs if isinstance(x, Var)}
    return kept[::-1]


def _aval(x: Var | Literal) -> Any:
    return x.aval


def _truncates(equation: Equation) -> bool:
    source = equation.inputs[0]
    dtype = _aval(source).dtype if isinstance(source, Var) else source.dtype
    into = _aval(equation.outputs[0]).dtype
    return equation.primitive.name == "convert_element_type" and dtype == jnp.float32 and into == jnp.int32


def _check(equation: Equation) -> None:
    name = equation.primitive.name
    size = max(np.prod(_aval(var).shape, dtype=int) for var in equation.outputs)
    if name in LOOKUPS:
        table, *index = equation.inputs
        if isinstance(table, Var) or table.ndim != 1 or size != 1 or len(index) != 1 or not isinstance(index[0], Var):
            raise NotElementwise("looks up tables that are not constant vectors")
    elif name not in ARITHMETIC | RESHAPES or size != 1:
        raise NotElementwise(f"uses the operation {name!r}" + ("" if size == 1 else f" on {size} numbers"))
