"""A traced function of one world as arithmetic of threads: its arrays become variables.

The function is written for arrays. Here its operations are written out: an array becomes as many variables as it has
elements, indexing and reshaping disappear, loops of known length are unrolled, and sums and products with a known 0 or
1 fold away. What is left is arithmetic on vectors of worlds, and loops and branches that worlds of a block take
together. A variable that is known while tracing is a numpy scalar.
"""

import math
from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import ClosedJaxpr, Literal
from jaxtyping import Array

from humanoid_mjx.compute.kernels.primitives import CALLS, ELEMENTWISE

ARITHMETIC = ELEMENTWISE | {"atan2", "cos", "pow", "rsqrt", "sin", "tan"}
"""Primitives that act on each element alone."""

WORLDS = 32
"""Worlds in a block: the threads of a warp."""

Element = Any
"""An array of a block's worlds, or a numpy scalar."""


def evaluate(closed: ClosedJaxpr, args: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Evaluate a traced function; arguments and results are numpy arrays of elements.

    Raises:
      NotImplementedError: it does something else than arithmetic, or its indices are not known while tracing.
    """
    values: dict[Any, np.ndarray] = dict(zip(closed.jaxpr.constvars, map(_constant, closed.consts), strict=True))
    values |= zip(closed.jaxpr.invars, args, strict=True)

    def value(x: Any) -> np.ndarray:
        kind: Any = x.aval
        return _constant(np.asarray(x.val, kind.dtype)) if isinstance(x, Literal) else values[x]

    for eqn in closed.jaxpr.eqns:
        found = _apply(eqn, [value(x) for x in eqn.invars])
        values |= zip(eqn.outvars, found, strict=True)
    return [value(x) for x in closed.jaxpr.outvars]


def _apply(eqn: Any, args: list[np.ndarray]) -> list[np.ndarray]:
    """One operation."""
    name, params = eqn.primitive.name, eqn.params
    if name in CALLS:
        return evaluate(params[CALLS[name]], args)
    if name in ARRANGEMENTS:
        return ARRANGEMENTS[name](params, *args)
    if name in REDUCTIONS:
        return [_reduced(eqn, args[0])]
    if name in CONTROL:
        return CONTROL[name](eqn, *args)
    shape = eqn.outvars[0].aval.shape
    if name not in ARITHMETIC:
        raise NotImplementedError(f"threads do no {name!r}")
    columns = [np.broadcast_to(arg, shape).flat for arg in args]
    return [arranged([_element(eqn, elements) for elements in zip(*columns, strict=True)], shape)]


KNOWN: dict[str, Callable[..., np.generic]] = {
    "add": np.add,
    "and": np.bitwise_and,
    "eq": np.equal,
    "gt": np.greater,
    "lt": np.less,
    "mul": np.multiply,
    "sub": np.subtract,
}
"""Operations on numbers known while tracing that are so frequent that a GPU must not be asked for each."""


def _element(eqn: Any, args: Sequence[Element]) -> Element:
    """An operation on single elements."""
    name = eqn.primitive.name
    if name == "select_n" and isinstance(args[0], np.generic):
        return args[1 + int(args[0])]
    if all(isinstance(arg, np.generic) for arg in args):
        if name == "convert_element_type":
            return args[0].astype(eqn.params["new_dtype"])
        if name in KNOWN:
            return KNOWN[name](*args)
        with jax.ensure_compile_time_eval():
            return np.asarray(eqn.primitive.bind(*map(jnp.asarray, args), **eqn.params))[()]
    if name in ("add", "mul"):
        for one, two in (args, args[::-1]):
            if _is(one, 0):  # times what is not finite, too: `Scalar` has it so
                return two if name == "add" else one
            if name == "mul" and _is(one, 1):
                return two
    if name == "sub" and _is(args[1], 0):
        return args[0]
    return eqn.primitive.bind(*(vector(arg) for arg in args), **eqn.params)


def _is(element: Element, number: int) -> bool:
    return isinstance(element, np.generic) and bool(element == number)


def vector(element: Element) -> Array:
    """An element as an array of the block's worlds."""
    known = isinstance(element, np.generic)
    return jnp.full(WORLDS, element.item(), element.dtype) if known else element


def arranged(elements: Sequence[Element], shape: tuple[int, ...]) -> np.ndarray:
    """A numpy array of elements."""
    found = np.empty(len(elements), object)
    for place, element in enumerate(elements):
        found[place] = element
    return found.reshape(shape)


def _constant(value: Any) -> np.ndarray:
    value = np.asarray(value)
    return arranged(list(value.reshape(-1)), value.shape)


def _reduced(eqn: Any, array: np.ndarray) -> np.ndarray:
    axes, (combine, of_nothing) = eqn.params["axes"], REDUCTIONS[eqn.primitive.name]
    kept = [axis for axis in range(array.ndim) if axis not in axes]
    moved = array.transpose(*axes, *kept)
    shape = [array.shape[axis] for axis in kept]
    rows = moved.reshape(-1, math.prod(shape))
    if not len(rows):
        return _constant(np.full(shape, of_nothing, eqn.outvars[0].aval.dtype))
    return arranged([reduce(combine, map(vector, column)) for column in rows.T], tuple(shape))


def _broadcast_in_dim(params: dict[str, Any], array: np.ndarray) -> list[np.ndarray]:
    shape, places = params["shape"], params["broadcast_dimensions"]
    inner = [1] * len(shape)
    for place, size in zip(places, array.shape, strict=True):
        inner[place] = size
    return [np.broadcast_to(array.reshape(inner), shape)]


def _slice(params: dict[str, Any], array: np.ndarray) -> list[np.ndarray]:
    steps = params["strides"] or [1] * array.ndim
    places = zip(params["start_indices"], params["limit_indices"], steps, strict=True)
    return [array[tuple(slice(*place) for place in places)]]


def _place(array: np.ndarray, sizes: Sequence[int], starts: Sequence[np.ndarray]) -> tuple[slice, ...]:
    """The place in an array of a part of these sizes; starts beyond the ends are clamped, as jax does."""
    if not all(isinstance(start.item(), np.generic) for start in starts):
        raise NotImplementedError("threads index only by what is known while tracing")
    limits = [full - size for full, size in zip(array.shape, sizes, strict=True)]
    firsts = [min(max(int(start.item()), 0), limit) for start, limit in zip(starts, limits, strict=True)]
    return tuple(slice(first, first + size) for first, size in zip(firsts, sizes, strict=True))


def _dynamic_slice(params: dict[str, Any], array: np.ndarray, *starts: np.ndarray) -> list[np.ndarray]:
    return [array[_place(array, params["slice_sizes"], starts)]]


def _dynamic_update_slice(
    params: dict[str, Any], array: np.ndarray, part: np.ndarray, *starts: np.ndarray
) -> list[np.ndarray]:
    found = array.copy()
    found[_place(array, part.shape, starts)] = part
    return [found]


def _iota(params: dict[str, Any]) -> list[np.ndarray]:
    shape, axis = params["shape"], params["dimension"]
    along = np.arange(shape[axis], dtype=params["dtype"]).reshape([-1 if i == axis else 1 for i in range(len(shape))])
    return [_constant(np.broadcast_to(along, shape))]


ARRANGEMENTS: dict[str, Callable[..., list[np.ndarray]]] = {
    "broadcast_in_dim": _broadcast_in_dim,
    "concatenate": lambda params, *arrays: [np.concatenate(arrays, axis=params["dimension"])],
    "dynamic_slice": _dynamic_slice,
    "dynamic_update_slice": _dynamic_update_slice,
    "iota": _iota,
    "reshape": lambda params, array: [array.reshape(params["new_sizes"])],
    "slice": _slice,
    "squeeze": lambda params, array: [array.squeeze(tuple(params["dimensions"]))],
    "stack": lambda params, *arrays: [np.stack(arrays, axis=params["axis"])],
    "transpose": lambda params, array: [array.transpose(params["permutation"])],
    "unstack": lambda params, array: list(np.moveaxis(array, params["axis"], 0)),
}
"""Operations that move elements and make none."""

REDUCTIONS: dict[str, tuple[Callable[[Any, Any], Any], Any]] = {
    "reduce_and": (lax.bitwise_and, True),
    "reduce_or": (lax.bitwise_or, False),
    "reduce_sum": (lax.add, 0),
}
"""Reductions by primitive: the operation on two elements, and its identity."""


def _while(eqn: Any, *args: np.ndarray) -> list[np.ndarray]:
    """Run a loop until all worlds of the block have ended; those that have ended compute on with the others.

    The condition is the last value carried. No one reads it after the loop, so that Triton's loop has one result less
    than arguments, and its pass `LayoutPropagation` looks up the result at each argument's index: with the condition
    first, the last index is beyond the results, and jaxlib 0.11.2 crashes now and then.
    """
    first, last = eqn.params["cond_nconsts"], eqn.params["cond_nconsts"] + eqn.params["body_nconsts"]
    cond_fixed, body_fixed, start = args[:first], args[first:last], args[last:]

    def going(state: Sequence[np.ndarray]) -> Array:
        (more,) = evaluate(eqn.params["cond_jaxpr"], [*cond_fixed, *state])
        return _any(more.item())

    def step(carry: tuple[list[Array], Array]) -> tuple[list[Array], Array]:
        state = evaluate(eqn.params["body_jaxpr"], [*body_fixed, *_unpacked(carry[0], start)])
        return _packed(state), going(state)

    state, _ = lax.while_loop(lambda carry: carry[1], step, (_packed(start), going(start)))
    return _unpacked(state, start)


def _cond(eqn: Any, index: np.ndarray, *args: np.ndarray) -> list[np.ndarray]:
    """Compute the first branch always, and the second where a world of the block takes it."""
    one, two = eqn.params["branches"]
    chosen = vector(index.item()) != 0
    first = evaluate(one, args)

    def both() -> list[Array]:
        second = _packed(evaluate(two, args))
        return [jnp.where(chosen, b, a) for a, b in zip(_packed(first), second, strict=True)]

    return _unpacked(lax.cond(_any(chosen), both, lambda: _packed(first)), first)


def _scan(eqn: Any, *args: np.ndarray) -> list[np.ndarray]:
    """Unrolled."""
    body = eqn.params["jaxpr"]
    inner = body.jaxpr.invars
    rows = sum(len(x.aval.shape) < arg.ndim for x, arg in zip(inner, args, strict=True))
    kept = sum(x.aval.shape == y.aval.shape for x, y in zip(body.jaxpr.outvars, eqn.outvars, strict=True))
    first, last = len(args) - rows - kept, len(args) - rows
    fixed, carry = args[:first], args[first:last]
    seen: list[list[np.ndarray]] = []
    order = range(eqn.params["length"])
    for index in reversed(order) if eqn.params["reverse"] else order:
        found = evaluate(body, [*fixed, *carry, *(row[index, ...] for row in args[last:])])
        carry = found[:kept]
        seen.append(found[kept:])
    seen = seen[::-1] if eqn.params["reverse"] else seen
    return [*carry, *(np.stack(column) for column in zip(*seen, strict=True))]


CONTROL = {"while": _while, "cond": _cond, "scan": _scan}


def _any(flag: Element) -> Array:
    return jnp.max(vector(flag).astype(jnp.int32)) > 0


def _packed(arrays: Sequence[np.ndarray]) -> list[Array]:
    return [vector(element) for array in arrays for element in array.flat]


def _unpacked(vectors: Sequence[Array], like: Sequence[np.ndarray]) -> list[np.ndarray]:
    found, first = [], 0
    for array in like:
        found.append(arranged(vectors[first : first + array.size], array.shape))
        first += array.size
    return found
