"""A traced function of one world as arithmetic of threads: its arrays become variables.

The function is written for arrays. Here its operations are written out: an array becomes as many variables as it has
elements, indexing and reshaping disappear, loops of known length are unrolled, and sums and products with a known 0 or
1 fold away. What is left is arithmetic on vectors of threads, and loops and branches that the worlds of a block take
together. A variable that is known while tracing is a numpy scalar.

Neighbouring threads may share a world, one for each lane: an array whose last axis but that of worlds is as long as
there are lanes then has one variable for all lanes, and each thread computes its own. What has no such axis is computed
alike in all threads of the world.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import ClosedJaxpr, Literal
from jaxtyping import Array

from humanoid_mjx.compute.kernels.angles import ANGLES
from humanoid_mjx.compute.kernels.primitives import CALLS, ELEMENTWISE

ARITHMETIC = ELEMENTWISE | ANGLES.keys() | {"atan2", "pow", "rsqrt", "tan"}
"""Primitives that act on each element alone."""

THREADS = 32
"""Threads of a block: one warp."""


@dataclass(frozen=True, eq=False)
class Lane:
    """Element of an array: what the thread of one lane of a world holds."""

    vector: Any
    """An array of the block's threads."""
    index: int


Element = Any
"""An array of a block's threads, alike in those of one world; a numpy scalar; or a `Lane`."""


class Threads:
    """An interpreter of traced functions.

    Args:
      lanes: of a world; 1 where a world has one thread.
      shuffled: from a vector and a lane to the vector of what the thread of that lane of each world holds.
    """

    def __init__(self, lanes: int, shuffled: Callable[[Array, int], Array]):
        self.lanes, self.shuffled = lanes, shuffled
        self.control = {"while": self._while, "cond": self._cond, "scan": self._scan}

    def evaluate(self, closed: ClosedJaxpr, args: Sequence[np.ndarray]) -> list[np.ndarray]:
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
            found = self._apply(eqn, [value(x) for x in eqn.invars])
            values |= zip(eqn.outvars, found, strict=True)
        return [value(x) for x in closed.jaxpr.outvars]

    def vectors(self, array: np.ndarray) -> list[Array]:
        """The elements of an array as vectors, one for all lanes of a world where they have an axis."""
        if self._laned(array.shape):
            return [vector(self._joined(group)[0]) for group in self._groups(array)]
        return [vector(self._alike(element)) for element in array.flat]

    def alike(self, array: np.ndarray) -> list[Array]:
        """The elements of an array as vectors that are alike in all threads of a world."""
        return [vector(self._alike(element)) for element in array.flat]

    def _laned(self, shape: tuple[int, ...]) -> bool:
        return self.lanes > 1 and len(shape) > 1 and shape[-2:] == (self.lanes, 1)

    def _groups(self, array: np.ndarray) -> list[list[Element]]:
        return array.reshape(-1, self.lanes).tolist()

    def _alike(self, element: Element) -> Element:
        """An element as one that is alike in all threads of a world."""
        return self.shuffled(element.vector, element.index) if isinstance(element, Lane) else element

    def _joined(self, group: Sequence[Element]) -> tuple[Element, bool]:
        """The elements of all lanes as one, each thread with its own, and whether they are alike."""
        first = group[0]
        if all(each is first for each in group) or (_known(group) and all(each == first for each in group)):
            return self._alike(first), True
        if isinstance(first, Lane) and all(_is_lane(each, first.vector, index) for index, each in enumerate(group)):
            return first.vector, False

        def own(index: int) -> Array:
            each = group[index]
            return each.vector if isinstance(each, Lane) and each.index == index else vector(self._alike(each))

        lane = jnp.arange(THREADS, dtype=jnp.int32) & (power_of_two(self.lanes) - 1)
        last = self.lanes - 1  # also of threads that are left over
        return reduce(lambda found, index: jnp.where(lane == index, own(index), found), range(last), own(last)), False

    def _each(self, function: Callable[..., Element], args: Sequence[np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
        """An operation on the elements of arrays of this shape."""
        if not self._laned(shape):
            columns = ([self._alike(element) for element in arg.flat] for arg in args)
            return arranged([function(*elements) for elements in zip(*columns, strict=True)], shape)
        found: list[Element] = []
        for groups in zip(*map(self._groups, args), strict=True):
            if all(map(_known, groups)):
                found += [function(*elements) for elements in zip(*groups, strict=True)]
                continue
            joined, alike = zip(*map(self._joined, groups), strict=True)
            one = function(*joined)
            same = all(alike) or isinstance(one, np.generic)
            found += [one] * self.lanes if same else [Lane(one, index) for index in range(self.lanes)]
        return arranged(found, shape)

    def _apply(self, eqn: Any, args: list[np.ndarray]) -> list[np.ndarray]:
        """One operation."""
        name, params = eqn.primitive.name, eqn.params
        if name in CALLS:
            return self.evaluate(params[CALLS[name]], args)
        if name in ENTRIES and _is_entry(args[0], params.get("slice_sizes") or args[1].shape, args[-args[0].ndim :]):
            return [ENTRIES[name](self, *args)]
        if name in ARRANGEMENTS:
            return ARRANGEMENTS[name](params, *args)
        if name in REDUCTIONS:
            return [self._reduced(eqn, args[0])]
        if name in self.control:
            return self.control[name](eqn, *args)
        shape = eqn.outvars[0].aval.shape
        if name not in ARITHMETIC:
            raise NotImplementedError(f"threads do no {name!r}")
        args = [np.broadcast_to(arg, shape) for arg in args]
        return [self._each(lambda *elements: _element(eqn, elements), args, shape)]

    def _looked_up(self, array: np.ndarray, index: np.ndarray, *_: np.ndarray) -> np.ndarray:
        """The entry along the first axis at an index."""
        rows = [array[place : place + 1] for place in range(len(array))]
        return reduce(lambda found, place: self._where(index, place, rows[place], found), range(len(rows)), rows[0])

    def _with_entry(self, array: np.ndarray, entry: np.ndarray, index: np.ndarray, *_: np.ndarray) -> np.ndarray:
        """The array with another entry there."""
        rows = [self._where(index, place, entry, array[place : place + 1]) for place in range(len(array))]
        return np.concatenate(rows)

    def _where(self, index: np.ndarray, place: int, one: np.ndarray, two: np.ndarray) -> np.ndarray:
        here = vector(self._alike(index.item())) == place
        return self._each(lambda a, b: jnp.where(here, vector(a), vector(b)), [one, two], one.shape)

    def _reduced(self, eqn: Any, array: np.ndarray) -> np.ndarray:
        axes, (combine, of_nothing) = eqn.params["axes"], REDUCTIONS[eqn.primitive.name]
        kept = [axis for axis in range(array.ndim) if axis not in axes]
        shape = tuple(array.shape[axis] for axis in kept)
        rows = array.transpose(*axes, *kept).reshape(-1, *shape)
        if not len(rows):
            return _constant(np.full(shape, of_nothing, eqn.outvars[0].aval.dtype))

        def both(a: Element, b: Element) -> Element:
            return combine(vector(a), vector(b))

        return reduce(lambda a, b: self._each(both, [a, b], shape), (rows[row, ...] for row in range(len(rows))))

    def _while(self, eqn: Any, *args: np.ndarray) -> list[np.ndarray]:
        """Run a loop until all worlds of the block have ended; those that have ended compute on with the others.

        The condition is the last value carried. No one reads it after the loop, so that Triton's loop has one result
        less than arguments, and its pass `LayoutPropagation` looks up the result at each argument's index: with the
        condition first, the last index is beyond the results, and jaxlib 0.11.2 crashes now and then.
        """
        first, last = eqn.params["cond_nconsts"], eqn.params["cond_nconsts"] + eqn.params["body_nconsts"]
        cond_fixed, body_fixed, start = args[:first], args[first:last], args[last:]

        def going(state: Sequence[np.ndarray]) -> Array:
            (more,) = self.evaluate(eqn.params["cond_jaxpr"], [*cond_fixed, *state])
            return self._any(more.item())

        def step(carry: tuple[list[Array], Array]) -> tuple[list[Array], Array]:
            state = self.evaluate(eqn.params["body_jaxpr"], [*body_fixed, *self._unpacked(carry[0], start)])
            return self._packed(state), going(state)

        state, _ = lax.while_loop(lambda carry: carry[1], step, (self._packed(start), going(start)))
        return self._unpacked(state, start)

    def _cond(self, eqn: Any, index: np.ndarray, *args: np.ndarray) -> list[np.ndarray]:
        """Compute the first branch always, and the second where a world of the block takes it."""
        one, two = eqn.params["branches"]
        chosen = vector(self._alike(index.item())) != 0
        first = self.evaluate(one, args)

        def both() -> list[Array]:
            second = self._packed(self.evaluate(two, args))
            return [jnp.where(chosen, b, a) for a, b in zip(self._packed(first), second, strict=True)]

        return self._unpacked(lax.cond(self._any(chosen), both, lambda: self._packed(first)), first)

    def _scan(self, eqn: Any, *args: np.ndarray) -> list[np.ndarray]:
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
            found = self.evaluate(body, [*fixed, *carry, *(row[index, ...] for row in args[last:])])
            carry = found[:kept]
            seen.append(found[kept:])
        seen = seen[::-1] if eqn.params["reverse"] else seen
        return [*carry, *(np.stack(column) for column in zip(*seen, strict=True))]

    def _any(self, flag: Element) -> Array:
        return jnp.max(vector(self._alike(flag)).astype(jnp.int32)) > 0

    def _packed(self, arrays: Sequence[np.ndarray]) -> list[Array]:
        return [each for array in arrays for each in self.vectors(array)]

    def _unpacked(self, vectors: Sequence[Array], like: Sequence[np.ndarray]) -> list[np.ndarray]:
        found, rest = [], iter(vectors)
        for array in like:
            if self._laned(array.shape):
                groups = (next(rest) for _ in range(array.size // self.lanes))
                elements: list[Element] = [Lane(group, index) for group in groups for index in range(self.lanes)]
            else:
                elements = [next(rest) for _ in range(array.size)]
            found.append(arranged(elements, array.shape))
        return found


ENTRIES: dict[str, Callable[..., np.ndarray]] = {
    "dynamic_slice": Threads._looked_up,
    "dynamic_update_slice": Threads._with_entry,
}
"""Operations on one entry of an array at an index that is not known while tracing."""


def power_of_two(lanes: int) -> int:
    """The smallest that is no less: threads of a world."""
    return 1 << (lanes - 1).bit_length()


def _is_lane(element: Element, vector: Array, index: int) -> bool:
    return isinstance(element, Lane) and element.vector is vector and element.index == index


def _is_entry(array: np.ndarray, sizes: Sequence[int], starts: Sequence[np.ndarray]) -> bool:
    """True for one entry along the first axis, at an index that is not known while tracing."""
    return tuple(sizes) == (1, *array.shape[1:]) and not isinstance(starts[0].item(), np.generic)


def _known(elements: Sequence[Element]) -> bool:
    return all(isinstance(element, np.generic) for element in elements)


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
    """An operation on single elements that are no lanes."""
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
    if name in ANGLES:
        return ANGLES[name](vector(args[0]))
    return eqn.primitive.bind(*(vector(arg) for arg in args), **eqn.params)


def _is(element: Element, number: int) -> bool:
    return isinstance(element, np.generic) and bool(element == number)


def vector(element: Element) -> Array:
    """An element that is no lane as an array of the block's threads."""
    known = isinstance(element, np.generic)
    return jnp.full(THREADS, element.item(), element.dtype) if known else element


def arranged(elements: Sequence[Element], shape: tuple[int, ...]) -> np.ndarray:
    """A numpy array of elements."""
    found = np.empty(len(elements), object)
    for place, element in enumerate(elements):
        found[place] = element
    return found.reshape(shape)


def _constant(value: Any) -> np.ndarray:
    value = np.asarray(value)
    return arranged(list(value.reshape(-1)), value.shape)


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
    "reduce_min": (lax.min, 0),
    "reduce_or": (lax.bitwise_or, False),
    "reduce_sum": (lax.add, 0),
}
"""Reductions by primitive: the operation on two elements, and what is made of none; jax refuses a minimum of none."""
