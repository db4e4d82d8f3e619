"""Elements of the arrays of a kernel's threads, and operations on single ones."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from humanoid_mjx.kernels.angles import ANGLES
from humanoid_mjx.kernels.memory import THREADS
from humanoid_mjx.kernels.primitives import ELEMENTWISE

ARITHMETIC = ELEMENTWISE | ANGLES.keys() | {"atan2", "bitcast_convert_type", "pow", "rsqrt", "tan"}
"""Primitives that act on each element alone."""


@dataclass(frozen=True, eq=False)
class Lane:
    """Element of an array: what the thread of one lane of a world holds."""

    vector: Any
    """An array of the block's threads."""
    index: int


Element = Any
"""An array of a block's threads, alike in those of one world; a numpy scalar; or a `Lane`."""


def is_lane(element: Element, vector: Array, index: int) -> bool:
    """True for the element of this lane of a vector."""
    return isinstance(element, Lane) and element.vector is vector and element.index == index


def type_of(array: np.ndarray) -> Any:
    """The type of the elements of an array."""
    element = array.flat[0]
    return element.vector.dtype if isinstance(element, Lane) else element.dtype


def are_known(elements: Sequence[Element]) -> bool:
    """True for elements that are all known while tracing."""
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


def computed(eqn: Any, args: Sequence[Element], as_xla: bool = False) -> Element:
    """An operation on single elements that are no lanes; `as_xla`: a division by a known number is a product."""
    name = eqn.primitive.name
    if as_xla and name == "div" and are_known(args[1:]) and args[1].dtype == jnp.float32 and not are_known(args[:1]):
        return args[0] * (np.float32(1) / args[1])
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
    if name == "and":
        for one, two in (args, args[::-1]):
            if isinstance(one, np.bool_):
                return two if one else one
    if name == "round":
        return _rounded(eqn.params, vector(args[0]))
    if all(np.ndim(arg) == 0 for arg in args):  # the same in all worlds
        return eqn.primitive.bind(*map(jnp.asarray, args), **eqn.params)
    if name in ANGLES:
        return ANGLES[name](vector(args[0]))
    return eqn.primitive.bind(*(vector(arg) for arg in args), **eqn.params)


def _rounded(params: dict[str, Any], x: Array) -> Array:
    """The nearest integer, an even one of two that are as near. Triton has no operation for it."""
    if params["rounding_method"] != lax.RoundingMethod.TO_NEAREST_EVEN:
        raise NotImplementedError("threads round to even numbers")
    whole = 1.5 * 2**23  # floats of this size have no fraction
    return jnp.where(jnp.abs(x) < 2**22, (x + whole) - whole, x)


def _is(element: Element, number: int) -> bool:
    return isinstance(element, np.generic) and bool(element == number)


def vector(element: Element) -> Array:
    """An element that is no lane as an array of the block's threads."""
    if isinstance(element, np.generic):
        return jnp.full(THREADS, element.item(), element.dtype)
    return element if element.ndim else jnp.broadcast_to(element, THREADS)


REDUCTIONS: dict[str, tuple[Callable[[Any, Any], Any], Any]] = {
    "reduce_and": (lax.bitwise_and, True),
    "reduce_min": (lax.min, 0),
    "reduce_or": (lax.bitwise_or, False),
    "reduce_sum": (lax.add, 0),
}
"""Reductions by primitive: the operation on two elements, and what is made of none; jax refuses a minimum of none."""
