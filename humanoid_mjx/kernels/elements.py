"""Elements of the arrays of a kernel's threads, and operations on single ones."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from humanoid_mjx.kernels.memory import THREADS
from humanoid_mjx.kernels.primitives import ELEMENTWISE, FUNCTIONS

ARITHMETIC = ELEMENTWISE | FUNCTIONS | {"bitcast_convert_type", "erf_inv", "rsqrt"}
"""Primitives that act on each element alone."""


@dataclass(frozen=True, eq=False)
class Lane:
    """Element of an array: what the thread of one lane of a world holds."""

    vector: Any
    """An array of the block's threads."""
    index: int


Element = Any
"""An array of a block's threads, alike in those of one world; a numpy scalar; or a `Lane`."""


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


class Operation(NamedTuple):
    """An operation on single elements."""

    name: str
    """Name of the primitive."""
    bind: Callable[..., Array]
    params: dict[str, Any]

    @property
    def key(self) -> str:
        return self.name + str(self.params or "")


ADD, MULTIPLY = Operation("add", lax.add, {}), Operation("mul", lax.mul, {})


def computed(
    operation: Operation,
    args: Sequence[Element],
    vector: Callable[[Element], Array],
    as_xla: bool = False,
) -> Element:
    """An operation on single elements that are no lanes.

    `vector`: from an element to an array of the block's threads. `as_xla`: round as XLA does, a division by a known
    number is a product.
    """
    name, bind, params = operation
    if as_xla and name == "div" and are_known(args[1:]) and args[1].dtype == jnp.float32 and not are_known(args[:1]):
        return args[0] * (np.float32(1) / args[1])
    if name == "select_n" and isinstance(args[0], np.generic):
        return args[1 + int(args[0])]
    if all(isinstance(arg, np.generic) for arg in args):
        if name == "convert_element_type":
            return args[0].astype(params["new_dtype"])
        if name in KNOWN:
            return KNOWN[name](*args)
        with jax.ensure_compile_time_eval():
            return np.asarray(bind(*map(jnp.asarray, args), **params))[()]
    if name in ("add", "and", "div", "mul", "sub") and (found := _folded(name, args[0], args[1], as_xla)) is not None:
        return found
    if name == "round":
        return _rounded(params, vector(args[0]))
    if name == "erf_inv":
        return inverse_of_erf(vector(args[0]))
    if name.startswith("shift") and not (are_known(args[1:]) and 0 <= args[1] < 32):
        return _shifted(operation, *map(vector, args))
    if all(np.ndim(arg) == 0 for arg in args):  # the same in all worlds
        return bind(*map(jnp.asarray, args), **params)
    if name in ANGLES:
        return ANGLES[name](vector(args[0]))
    return bind(*(vector(arg) for arg in args), **params)


def _folded(name: str, a: Element, b: Element, as_xla: bool) -> Element | None:
    """The result where known numbers make an operation superfluous, or None; a product of 0 is 0, also with what is
    not finite. `as_xla`: no result whose sign of a 0, or what is not finite, may be another than XLA's."""
    for one, two in ((a, b), (b, a)):
        if (name == "add" and _is(one, 0)) or (name == "mul" and _is(one, 1)):
            return two
        if name == "mul" and _is(one, 0):
            return one
        if name == "mul" and _is(one, -1) and not as_xla:
            return lax.neg(two)
        if name == "and" and isinstance(one, np.bool_):
            return two if one else one
    if (name == "sub" and _is(b, 0)) or (name == "div" and _is(a, 0)):
        return a
    return lax.neg(b) if name == "sub" and _is(a, 0) and not as_xla else None


def _rounded(params: dict[str, Any], x: Array) -> Array:
    """The nearest integer, an even one of two that are as near. Triton has no operation for it."""
    if params["rounding_method"] != lax.RoundingMethod.TO_NEAREST_EVEN:
        raise NotImplementedError("threads round to even numbers")
    whole = 1.5 * 2**23  # floats of this size have no fraction
    return jnp.where(jnp.abs(x) < 2**22, (x + whole) - whole, x)


def _shifted(operation: Operation, x: Array, by: Array) -> Array:
    """Shift as XLA does by 32 or more, of which the compilers of kernels may make anything."""
    inside, fill = (by >= 0) & (by < 32), jnp.zeros_like(x)
    if operation.name == "shift_right_arithmetic":
        fill = jnp.where(x < 0, -1, fill)
    return jnp.where(inside, operation.bind(x, by & 31), fill)


NEAR_ERF = 2.81022636e-8, 3.43273939e-7, -3.5233877e-6, -4.39150654e-6, 2.1858087e-4, -1.25372503e-3, -4.17768164e-3
NEAR_ERF += 0.246640727, 1.50140941
FAR_ERF = -2.00214257e-4, 1.00950558e-4, 1.34934322e-3, -3.67342844e-3, 5.73950773e-3, -7.6224613e-3, 9.43887047e-3
FAR_ERF += 1.00167406, 2.83297682
"""Coefficients of M. Giles, "Approximating the erfinv function" (2011), for single precision."""


def inverse_of_erf(x: Array) -> Array:
    """The inverse of the error function, from which `jax.random.normal` makes its numbers."""
    way = -jnp.log((1.0 - x) * (1.0 + x))
    near = reduce(lambda found, term: found * (way - 2.5) + term, NEAR_ERF, jnp.zeros_like(x))
    far = reduce(lambda found, term: found * (jnp.sqrt(way) - 3.0) + term, FAR_ERF, jnp.zeros_like(x))
    return x * jnp.where(jnp.abs(x) == 1.0, jnp.inf, jnp.where(way < 5.0, near, far))


HALF_PI = 1.5703125, 4.837512969970703125e-4, 7.54978995489188216e-8
"""Parts of pi / 2: multiples of the first two by up to 2^12 are exact in float32."""

SINE = -1.6666654611e-1, 8.3321608736e-3, -1.9515295891e-4
COSINE = 4.166664568298827e-2, -1.388731625493765e-3, 2.443315711809948e-5
"""Coefficients of S. L. Moshier's Cephes library, for angles of up to pi / 4."""


def sine(angle: Float[Array, " threads"], turned: bool = False) -> Float[Array, " threads"]:
    """Sine of an angle in rad; the error is below 1.2e-7 up to 6,000 rad, and grows with larger angles.

    Those of CUDA's library are each some seventy instructions with branches, for angles of any size. Sine and cosine
    here share what they have in common, and have no branch. `turned`: of an angle larger by a quarter turn, which is
    the cosine.
    """
    turns = jnp.floor(angle * (2.0 / jnp.pi) + 0.5)  # the nearest quarter turn, and the angle from there
    for part in HALF_PI:
        angle = angle - turns * part
    quarter, square = turns.astype(jnp.int32), angle * angle
    quarter = quarter + 1 if turned else quarter
    odd = angle + angle * square * (SINE[0] + square * (SINE[1] + square * SINE[2]))
    even = 1.0 - 0.5 * square + square * square * (COSINE[0] + square * (COSINE[1] + square * COSINE[2]))
    found = jnp.where(quarter & 1 == 0, odd, even)
    return jnp.where(quarter & 2 == 0, found, -found)


cosine = partial(sine, turned=True)

ANGLES = {"sin": sine, "cos": cosine}
"""By primitive."""


def _is(element: Element, number: int) -> bool:
    return isinstance(element, np.generic) and bool(element == number)


def vector(element: Element) -> Array:
    """An element that is no lane as an array of the block's threads."""
    if isinstance(element, np.generic):
        return jnp.full(THREADS, element.item(), element.dtype)
    return element if element.ndim else jnp.broadcast_to(element, THREADS)


REDUCTIONS: dict[str, tuple[Operation, Any]] = {
    "reduce_and": (Operation("and", lax.bitwise_and, {}), True),
    "reduce_max": (Operation("max", lax.max, {}), 0),
    "reduce_min": (Operation("min", lax.min, {}), 0),
    "reduce_or": (Operation("or", lax.bitwise_or, {}), False),
    "reduce_sum": (ADD, 0),
}
"""Reductions by primitive: the operation on two elements, and what is made of none; jax refuses a minimum of none."""
