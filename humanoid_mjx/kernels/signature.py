"""Arrays that a kernel takes and gives, and a function between them, traced."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr
from jaxtyping import Array

from humanoid_mjx.kernels.arrangements import arranged
from humanoid_mjx.kernels.memory import THREADS, Region
from humanoid_mjx.kernels.threads import ENTRIES, SUM, Kept, Threads, looked_up


class Kind(NamedTuple):
    """Kind of an array that a kernel takes or gives."""

    shape: tuple[int, ...]
    """Shape of one world's array."""
    dtype: Any
    role: Literal["rows", "uniform", "memory", "record"] = "rows"
    """`rows`: (*shape, worlds). `uniform`: one array for all worlds. `memory`: (worlds, *shape), whose entries are
    looked up, and changed in their place. `record`: likewise, but entries are not looked up, only added to."""

    @property
    def size(self) -> int:
        return math.prod(self.shape)

    def of_all(self, worlds: int) -> tuple[int, ...]:
        """Return the shape for all worlds."""
        return (worlds, *self.shape) if self.in_memory else (*self.shape, worlds)

    @property
    def in_memory(self) -> bool:
        """True for an array that is not taken apart into numbers."""
        return self.role in ("memory", "record")


@dataclass(frozen=True, eq=False)
class Signature:
    """A traced function, and the kinds of its arrays."""

    traced: ClosedJaxpr
    given: tuple[Kind, ...]
    shapes: Any
    """Shapes and types of the results of a world, in their pytree."""
    single: bool
    """True for a function of one world, whose arrays have no axis of worlds."""

    def evaluate(
        self, threads: Threads, numbers: Sequence[Array], memory: Callable[[int, Kind], Region] | None = None
    ) -> tuple[list[Array], list[Kind], dict[int, int]]:
        """Evaluate the function.

        `numbers`: those of all arguments that are no memory. `memory`: from the number of an argument to its memory.

        Returns:
          the numbers of the results that are no memory, the kinds of all results, and the numbers of the arguments that
          changed in their place with those of the results that they became.
        """
        rest, args, rows, found, in_place = iter(numbers), [], [], [], {}
        for place, (kind, var) in enumerate(zip(self.given, self.traced.jaxpr.invars, strict=True)):
            shape = kind.shape if self.single else var.aval.shape  # pyright: ignore[reportAttributeAccessIssue]
            if memory and kind.in_memory:
                threads.regions.append(memory(place, kind))
                args.append(Kept(threads.regions[-1], 0, kind.shape, kind.dtype, argument=place))
            else:
                args.append(arranged([next(rest).astype(kind.dtype) for _ in range(kind.size)], shape))
        arrays = threads.evaluate(self.traced, args)
        for place, (array, like) in enumerate(zip(arrays, jax.tree.leaves(self.shapes), strict=True)):
            kind = _of_words(Kind(like.shape if self.single else like.shape[:-1], like.dtype))
            if isinstance(array, Kept) and array.argument is not None:
                array.check()
                in_place[array.argument], kind = place, kind._replace(role=self.given[array.argument].role)
            else:
                rows += threads.alike(array)
            found.append(kind)
        return rows, found, in_place

    @property
    def numbers(self) -> list[jax.ShapeDtypeStruct]:
        """Shapes of the numbers of all arguments that are no memory."""
        return [
            jax.ShapeDtypeStruct(() if kind.role == "uniform" else (THREADS,), kind.dtype)
            for kind in self.given
            for _ in range(0 if kind.in_memory else kind.size)
        ]


@lru_cache
def signature(function: Callable[..., Any], structure: Any, kinds: tuple[Kind, ...], single: bool) -> Signature:
    """Trace a function once, whatever the number of worlds; `kinds`: of the leaves of its arguments."""
    axis = () if single else (1,)
    like = [jax.ShapeDtypeStruct((*kind.shape, *axis), kind.dtype) for kind in kinds]
    traced, shapes = jax.make_jaxpr(function, return_shape=True)(*structure.unflatten(like))
    given = [_of_words(kind) for kind in kinds]
    if single:
        read, added = (looked_up(traced.jaxpr, names) for names in (ENTRIES.keys(), {SUM}))
        for place in read | added:
            if given[place].role == "rows":
                given[place] = given[place]._replace(role="memory" if place in read else "record")
    return Signature(traced, tuple(given), shapes, single)


def signature_of_one(function: Callable[..., Any], args: tuple[Any, ...], many: tuple[bool, ...]) -> Signature:
    """Return the signature of a function of one world; `many`: which leaves of `args` have a first axis of worlds."""
    leaves, structure = jax.tree.flatten(args)
    kinds = [
        Kind(leaf.shape[1:], leaf.dtype) if own else Kind(leaf.shape, leaf.dtype, "uniform")
        for leaf, own in zip(leaves, many, strict=True)
    ]
    return signature(function, structure, tuple(kinds), True)


def called(
    known: Signature, args: tuple[Any, ...], block: int, call: Callable[[Signature, list[Array], int], tuple[Any, Any]]
) -> Any:
    """`jax.vmap` of a function of one world by the `call` of a back end, which takes a multiple of `block` worlds."""
    leaves = jax.tree.leaves(args)
    worlds = next(len(leaf) for leaf, kind in zip(leaves, known.given, strict=True) if kind.role != "uniform")
    missing = -worlds % block  # the last world fills up the block

    def passed(leaf: Array, kind: Kind) -> Array:
        leaf = jax.random.key_data(leaf) if _is_key(leaf.dtype) else jnp.asarray(leaf)
        if kind.role != "uniform" and missing:
            leaf = jnp.concatenate([leaf, *[leaf[-1:]] * missing])
        return jnp.moveaxis(leaf, 0, -1) if kind.role == "rows" else leaf

    def result(array: Array, kind: Kind, like: Any) -> Array:
        array = (array if kind.in_memory else jnp.moveaxis(array, -1, 0))[:worlds]
        return jax.random.wrap_key_data(array, impl=like.dtype._impl) if _is_key(like.dtype) else array

    arrays, kinds = call(known, [*map(passed, leaves, known.given)], worlds + missing)
    shapes, structure = jax.tree.flatten(known.shapes)
    return structure.unflatten(map(result, arrays, kinds, shapes))


def _is_key(dtype: Any) -> bool:
    return jnp.issubdtype(dtype, jax.dtypes.prng_key)


def _of_words(kind: Kind) -> Kind:
    """The kind of an array; of random keys that of their words."""
    if _is_key(kind.dtype):
        return kind._replace(shape=(*kind.shape, *kind.dtype._impl.key_shape), dtype=np.dtype(np.uint32))
    return kind._replace(dtype=np.dtype(kind.dtype))
