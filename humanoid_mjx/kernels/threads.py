"""A traced function of one world as arithmetic of threads: its arrays become variables.

The function is written for arrays. Here its operations are written out: an array becomes as many variables as it has
elements, indexing and reshaping disappear, loops of known length are unrolled, and sums and products with a known 0 or
1 fold away. What is left is arithmetic on vectors of threads, and loops and branches that the worlds of a block take
together. A variable that is known while tracing is a numpy scalar.

Neighbouring threads may share a world, one for each lane: an array whose last axis but that of worlds is as long as
there are lanes then has one variable for all lanes, and each thread computes its own. What has no such axis is computed
alike in all threads of the world.
"""

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial, reduce
from itertools import compress, count, groupby, repeat
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun
from jaxtyping import Array

from humanoid_mjx.kernels.arrangements import ARRANGEMENTS, arranged, constant
from humanoid_mjx.kernels.elements import (
    ADD,
    ARITHMETIC,
    MULTIPLY,
    REDUCTIONS,
    Element,
    Lane,
    Operation,
    are_known,
    computed,
    type_of,
    vector,
)
from humanoid_mjx.kernels.memory import THREADS, Region, bits
from humanoid_mjx.kernels.primitives import CALLS, evaluated, operations, uniform_carry, uniform_results


@dataclass(eq=False)
class Kept:
    """An array in memory, entry by entry along its first axis, each as its vectors."""

    region: Region
    word: int
    """Number of its first vector in the region."""
    shape: tuple[int, ...]
    dtype: Any
    fixed: bool = False
    """True if it must not change, since another has the same memory."""
    writes: list[int] = field(default_factory=lambda: [0])
    """Counter of the writes to this memory, shared by all arrays that have it."""
    seen: int = 0
    """Its value when this array was made; `check` refuses an array that is older than the last write."""
    argument: int | None = None
    """Number of the argument that it is, which changes in its place."""

    @property
    def at(self) -> tuple[Region, int]:
        """Its place."""
        return self.region, self.word

    def now(self) -> "Kept":
        """The array after all changes."""
        return replace(self, seen=self.writes[0])

    def changed(self) -> "Kept":
        """The array after one more change."""
        self.writes[0] += 1
        return self.now()

    def check(self) -> None:
        """Refuse what the array was before a change."""
        if self.seen != self.writes[0]:
            raise NotImplementedError("threads know no array any more after an entry of it has changed")


LONG = 16
"""Equal words that a loop writes instead of an instruction each, and steps of one world that are a loop."""

MANY = 1000
"""Operations of all steps together from which on fewer steps are a loop, too: to unroll them takes long to compile."""

Held = np.ndarray | Kept
"""An array of elements, or one in memory."""


def _none(*_: Any) -> Any:
    raise NotImplementedError("functions of single numbers look up no entries")


class Threads:
    """An interpreter of traced functions.

    Args:
      single: evaluate functions of one world, whose arrays have no axis of worlds, and keep the order of sums.
      region: from a number and a count to so many words of memory, `Region`.
      constants: from a number and known words to memory of these, `Constants`.
      any_of: from a vector of flags to whether any is true.
      lanes: of a world; 1 where a world has one thread.
      shuffled: from a vector and a lane to the vector of what the thread of that lane of each world holds.
      summed: from a vector of float32 to its sums over the threads of each world.
    """

    def __init__(
        self,
        single: bool = False,
        region: Callable[[int, int], Region] = _none,
        constants: Callable[[int, Sequence[np.generic]], Region] = _none,
        any_of: Callable[[Array], Array] = jnp.any,
        lanes: int = 1,
        shuffled: Callable[[Array, int], Array] = _none,
        summed: Callable[[Array], Array] = _none,
    ):
        self.lanes, self.shuffled, self.summed, self.any_of = lanes, shuffled, summed, any_of
        self.region, self.constants, self.single = region, constants, single
        self.control = {"while": self._while, "cond": self._cond}
        self.numbers = count()
        self.made: dict[Any, tuple[Element, Sequence[Element]]] = {}
        """Results of the part under trace, with their operands."""
        self.regions: list[Region] = []
        """Memory that the part under trace may use."""

    def evaluate(self, closed: ClosedJaxpr, args: Sequence[Held]) -> list[Held]:
        """Evaluate a traced function; arguments and results are numpy arrays of elements, or in memory.

        Raises:
          NotImplementedError: it does something else than arithmetic, or its indices are not known while tracing.
        """
        return evaluated(closed, args, constant, self._apply)

    def vectors(self, array: Held) -> list[Array]:
        """The elements of an array as vectors, one for all lanes of a world where they have an axis."""
        return [vector(element) for element in self._elements(self._loaded(array))]

    def _elements(self, array: np.ndarray) -> list[Element]:
        """The elements of an array, one for all lanes of a world where they have an axis."""
        if self._laned(array.shape):
            return [self._joined(group)[0] for group in self._groups(array)]
        return [self._alike(element) for element in array.flat]

    def alike(self, array: Held) -> list[Array]:
        """The elements of an array as vectors that are alike in all threads of a world."""
        return [vector(self._alike(element)) for element in self._loaded(array).flat]

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
        if all(each is first for each in group) or (are_known(group) and all(each == first for each in group)):
            return self._alike(first), True
        places = [(id(each.vector), each.index) for each in group if isinstance(each, Lane)]
        if isinstance(first, Lane) and places == [(id(first.vector), index) for index in range(self.lanes)]:
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
            if all(map(are_known, groups)):
                found += [function(*elements) for elements in zip(*groups, strict=True)]
                continue
            joined, alike = zip(*map(self._joined, groups), strict=True)
            one = function(*joined)
            same = all(alike) or isinstance(one, np.generic)
            found += [one] * self.lanes if same else [Lane(one, index) for index in range(self.lanes)]
        return arranged(found, shape)

    def _computed(self, operation: Operation, *elements: Element) -> Element:
        """An operation on single elements; a kernel computes the same once."""
        if self.single:
            return computed(operation, elements, vector, as_xla=True)
        names: Any = [(each.dtype, each.item()) if isinstance(each, np.generic) else id(each) for each in elements]
        names = frozenset(names) if operation.name in ("add", "mul") else tuple(names)
        key = operation.key, names
        if key not in self.made:
            self.made[key] = computed(operation, elements, self._vector), elements
        return self.made[key][0]

    def _vector(self, element: Element) -> Array:
        """An element that is no lane as an array of the block's threads; a known one is made once."""
        if not isinstance(element, np.generic):
            return vector(element)
        key = element.dtype, element.item()
        if key not in self.made:
            self.made[key] = vector(element), []
        return self.made[key][0]

    def _apply(self, eqn: Any, args: list[Any]) -> list[Any]:
        """One operation."""
        name, params = eqn.primitive.name, eqn.params
        if name in CALLS:
            return self.evaluate(params[CALLS[name]], args)
        if name in self.control:
            return self.control[name](eqn, *args)
        if name in ENTRIES and _is_entry(params, args):
            return [ENTRIES[name](self, *args)]
        if name == SUM:
            return [self._with_sum(params, *args)]
        if args and isinstance(args[0], Kept) and self._is_view(eqn, args[0]):
            fixed = args[0].fixed or name != "reshape" or args[0].argument is None
            return [replace(args[0], shape=eqn.outvars[0].aval.shape, fixed=fixed)]
        if name == "scan" and self.single and _is_long(eqn):
            return self.evaluate(_looped(eqn), args)
        args = [self._loaded(arg) for arg in args]
        if name == "scan":
            return self._scan(eqn, *args)
        if name in KEYS:
            return self.evaluate(_of_keys(eqn), args) if KEYS[name] else args
        if name in ARRANGEMENTS:
            return ARRANGEMENTS[name](params, *args)
        if name == "dot_general":
            return [self._products(params, *args)]
        if name in REDUCTIONS:
            return [self._reduced(eqn, args[0])]
        shape = eqn.outvars[0].aval.shape
        if name not in ARITHMETIC:
            raise NotImplementedError(f"threads do no {name!r}")
        args = [np.broadcast_to(arg, shape) for arg in args]
        return [self._each(partial(self._computed, Operation(name, eqn.primitive.bind, params)), args, shape)]

    def _looked_up(self, array: Held, index: np.ndarray, *_: np.ndarray) -> np.ndarray:
        """The entry along the first axis at an index."""
        kept = array if isinstance(array, Kept) else self._keep([array], fixed=True)[0]
        return self._row(kept, self._place(kept, index))

    def _with_entry(self, array: Held, entry: np.ndarray, index: np.ndarray, *_: np.ndarray) -> Kept:
        """The array with another entry there, in its place unless that is fixed."""
        kept = array if isinstance(array, Kept) and not array.fixed else self._keep([self._loaded(array)])[0]
        kept.check()
        place = self._place(kept, index)
        for word, values in enumerate(self.vectors(entry.reshape(kept.shape[1:])), kept.word):
            kept.region.write(word, place, values)
        return kept.changed()

    def _with_sum(self, params: dict[str, Any], array: Held, index: np.ndarray, change: np.ndarray) -> Held:
        """The array with something added to an entry, in its place."""
        numbers = params["dimension_numbers"]
        whole = numbers.inserted_window_dims == numbers.scatter_dims_to_operand_dims == (0,) and index.shape == (1,)
        if not (whole and isinstance(array, Kept) and not array.fixed) or "DROP" in str(params["mode"]):
            raise NotImplementedError("threads add to entries of arrays along the first axis alone")
        array.check()
        place = self._place(array, index)
        array.region.add(array.word, place, self.vectors(change.reshape(array.shape[1:])))
        return array.changed()

    def _is_view(self, eqn: Any, kept: Kept) -> bool:
        """True where an operation gives the first words of an array, in their order."""
        name, params, shape = eqn.primitive.name, eqn.params, eqn.outvars[0].aval.shape
        if not shape or self._laned(kept.shape[1:]) or self._laned(shape[1:]):
            return False
        first = name == "slice" and not any(params["start_indices"]) and params["strides"] is None
        return name == "reshape" or (first and shape[1:] == kept.shape[1:])

    def _keep(self, arrays: Sequence[np.ndarray], fixed: bool = False) -> list[Kept]:
        """Arrays in new memory; `fixed` ones must not change, and those of known numbers are in memory of constants."""
        known = [fixed and not self._laned(x.shape[1:]) and are_known(list(x.flat)) for x in arrays]
        others = [x for x, flag in zip(arrays, known, strict=True) if not flag]
        sizes = [len(x) * self._width(x.shape) for x in others]
        regions = [self.region(next(self.numbers), sum(sizes))] if others else []
        self.regions += regions
        places = iter(np.cumsum([0, *sizes]).tolist())
        kept = []
        for x, flag in zip(arrays, known, strict=True):
            region = self.constants(next(self.numbers), list(x.flat)) if flag else regions[0]
            kept.append(Kept(region, 0 if flag else next(places), x.shape, type_of(x), fixed))
        for region in regions:
            self._write_all(region, 0, others)
        return kept

    def _width(self, shape: tuple[int, ...]) -> int:
        """Words of an entry."""
        return math.prod(shape[1:]) // (self.lanes if self._laned(shape[1:]) else 1)

    def _place(self, kept: Kept, index: np.ndarray) -> Array:
        """The place of an entry."""
        entry = jnp.clip(vector(self._alike(index.item())), 0, kept.shape[0] - 1).astype(jnp.int32)
        return kept.region.place(entry * self._width(kept.shape))

    def _row(self, kept: Kept, place: Array | None, first: int = 0) -> np.ndarray:
        """The entry at a place, and so many words behind it."""
        kept.check()
        kind, word = jnp.int32 if kept.dtype == bool else kept.dtype, kept.word + first
        found = kept.region.row(word, place, kind, self._width(kept.shape))
        found = [values != 0 for values in found] if kept.dtype == bool else found
        return self._unpacked(found, [np.empty(kept.shape[1:], object)])[0][None]

    def _write_all(self, region: Region, word: int, arrays: Sequence[np.ndarray]) -> None:
        """Write whole arrays, one after another from a word on."""
        elements = [element for array in arrays for entry in array for element in self._elements(entry)]
        for same, group in groupby(elements, lambda element: bits(element) if are_known([element]) else None):
            run = list(group)
            if same is not None and len(run) >= LONG:
                region.fill(word, len(run), same)
            else:
                for place, values in enumerate(run, word):
                    region.write(place, None, vector(values))
            word += len(run)

    def _loaded(self, array: Held) -> np.ndarray:
        """An array that may be in memory as one of elements."""
        if not isinstance(array, Kept):
            return array
        words = range(0, array.shape[0] * self._width(array.shape), self._width(array.shape))
        return np.concatenate([self._row(array, None, first) for first in words])

    @contextmanager
    def _inside(self, tokens: Sequence[Array]) -> Iterator[Callable[[], list[Array]]]:
        """Trace a part of the program that begins with these tokens of all regions, and ends with those of a call."""
        outside = [(region.token, region.seen) for region in self.regions]
        self._begin(tokens)
        made, self.made = self.made, {}
        yield lambda: self._tokens()[: len(outside)]
        self.made = made
        del self.regions[len(outside) :]
        for region, (token, seen) in zip(self.regions, outside, strict=True):
            region.token, region.seen = token, seen

    def _begin(self, tokens: Sequence[Array]) -> None:
        for region, token in zip(self.regions, tokens, strict=True):
            region.token, region.seen = token, []

    def _tokens(self) -> list[Array]:
        return [region.settle() for region in self.regions]

    def _reduced(self, eqn: Any, array: np.ndarray) -> np.ndarray:
        axes, (operation, of_nothing) = eqn.params["axes"], REDUCTIONS[eqn.primitive.name]
        both, shape = partial(self._computed, operation), eqn.outvars[0].aval.shape
        if axes == (array.ndim - 2,) and self._laned(array.shape):
            return arranged([self._over_lanes(group, both) for group in self._groups(array)], shape)
        kept = [axis for axis in range(array.ndim) if axis not in axes]
        rows = array.transpose(*axes, *kept).reshape(-1, *shape)
        if not len(rows):
            return constant(np.full(shape, of_nothing, eqn.outvars[0].aval.dtype))
        return reduce(lambda a, b: self._each(both, [a, b], shape), (rows[row, ...] for row in range(len(rows))))

    def _products(self, params: dict[str, Any], a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Sums of products along one axis of each of two arrays."""
        (one, two), batch = params["dimension_numbers"]
        if len(one) != 1 or any(batch):
            raise NotImplementedError("threads multiply matrices alone")
        rows, columns = np.moveaxis(a, one[0], -1), np.moveaxis(b, two[0], -1)
        shape = *rows.shape[:-1], *columns.shape[:-1]
        times, plus = partial(self._computed, MULTIPLY), partial(self._computed, ADD)
        entries = [
            reduce(plus, map(times, map(self._alike, row), map(self._alike, column)))
            for row in rows.reshape(-1, a.shape[one[0]])
            for column in columns.reshape(-1, a.shape[one[0]])
        ]
        return arranged(entries, shape)

    def _over_lanes(self, group: Sequence[Element], both: partial[Element]) -> Element:
        """The elements of all lanes together; threads that hold their own sum it up with the others of the world."""
        first, whole = group[0], self.lanes == power_of_two(self.lanes)
        floats = isinstance(first, Lane) and first.vector.dtype == jnp.float32 and both.args[0] is ADD
        if not (whole and floats and self._joined(group)[0] is first.vector):
            return reduce(both, map(self._alike, group))
        key = "summed", id(first.vector)
        if key not in self.made:
            self.made[key] = self.summed(first.vector), [first.vector]
        return self.made[key][0]

    def _while(self, eqn: Any, *args: Held) -> list[Held]:
        """Run a loop until all worlds of the block have ended; those that have ended compute on with the others.

        The condition is the last value carried. No one reads it after the loop, so that Triton's loop has one result
        less than arguments, and its pass `LayoutPropagation` looks up the result at each argument's index: with the
        condition first, the last index is beyond the results, and jaxlib 0.11.2 crashes now and then.
        """
        first, last = eqn.params["cond_nconsts"], eqn.params["cond_nconsts"] + eqn.params["body_nconsts"]
        uniform = [False] * len(args[last:])
        if self.single:
            same = [not isinstance(arg, Kept) and all(np.ndim(x) == 0 for x in arg.flat) for arg in args]
            uniform = uniform_carry(eqn, same, of_one=True)
            if uniform_results(eqn.params["cond_jaxpr"], [*same[:first], *uniform], of_one=True) != [True]:
                raise NotImplementedError("threads know no loop that ends earlier in one world than in another")
        given = self._with_room(args, _looked_up_in_loop(eqn, {*ENTRIES, SUM}), last)
        cond_fixed, body_fixed, start = given[:first], given[first:last], given[last:]
        elsewhere = [not isinstance(array, Kept) for array in start]

        def going(state: Sequence[Any]) -> Array:
            (more,) = self.evaluate(eqn.params["cond_jaxpr"], [*cond_fixed, *state])
            flag = self._loaded(more).item()
            return jnp.asarray(flag) if self.single else self._any(flag)

        def packed(state: Sequence[Any]) -> list[Array]:
            return self._packed(compress(state, elsewhere), compress(uniform, elsewhere))

        def step(carry: tuple[Any, ...]) -> tuple[Any, ...]:
            with self._inside(carry[1]) as tokens:
                state = self.evaluate(eqn.params["body_jaxpr"], [*body_fixed, *self._unpacked(carry[0], start)])
                more, moved = going(state), packed(state)
                self._put_back(state, start)
                return moved, tokens(), more

        carry = packed(start), self._tokens(), going(start)
        state, tokens, _ = lax.while_loop(lambda carry: carry[2], step, carry)
        self._begin(tokens)
        return self._unpacked(state, start)

    def _with_room(self, args: Sequence[Any], places: set[int], first: int) -> list[Any]:
        """Arguments of a loop, those at these places in memory; fixed before `first`, where they are not carried."""
        there = [
            isinstance(arg, Kept) and (place < first or arg.argument is not None) for place, arg in enumerate(args)
        ]
        moved = [place for place in places if not there[place]]
        moved = [place for place in sorted(moved) if math.prod(args[place].shape)]
        found = dict(enumerate(args))
        for fixed in (True, False):
            own = [place for place in moved if (place < first) == fixed]
            found |= zip(own, self._keep([self._loaded(args[place]) for place in own], fixed), strict=True)
        return [replace(x, fixed=True) if isinstance(x, Kept) and i < first else x for i, x in found.items()]

    def _put_back(self, state: Sequence[Any], start: Sequence[Any]) -> None:
        """Write what a loop carries in memory there, unless it is there; all is read before, as loops may swap."""
        pairs = ((found, kept) for found, kept in zip(state, start, strict=True) if isinstance(kept, Kept))
        away = [(found, kept) for found, kept in pairs if not (isinstance(found, Kept) and found.at == kept.at)]
        for array, kept in [(self._loaded(found), kept) for found, kept in away]:
            self._write_all(kept.region, kept.word, [array])

    def _cond(self, eqn: Any, index: np.ndarray, *args: Held) -> list[np.ndarray]:
        """Compute the first branch always, and the second where a world of the block takes it."""
        chosen = vector(self._alike(index.item())) != 0
        given = [replace(arg, fixed=True) if isinstance(arg, Kept) else arg for arg in args]
        if len(eqn.params["branches"]) != 2:
            raise NotImplementedError("threads choose between two branches alone")
        one, two = eqn.params["branches"]
        first = [self._loaded(array) for array in self.evaluate(one, given)]
        tokens = self._tokens()

        def both() -> tuple[list[Array], list[Array]]:
            with self._inside(tokens) as after:
                each = zip(self._packed(first), self._packed(self.evaluate(two, given)), strict=True)
                return [jnp.where(chosen, b, a) for a, b in each], after()

        found, tokens = lax.cond(self._any(chosen), both, lambda: (self._packed(first), tokens))
        self._begin(tokens)
        return self._unpacked(found, first)

    def _scan(self, eqn: Any, *args: np.ndarray) -> list[np.ndarray]:
        """Unrolled."""
        body, (first, kept) = eqn.params["jaxpr"], _fixed_and_carried(eqn)
        last = first + kept
        fixed, carry = args[:first], args[first:last]
        seen: list[list[np.ndarray]] = []
        order = range(eqn.params["length"])
        for index in reversed(order) if eqn.params["reverse"] else order:
            found = self.evaluate(body, [*fixed, *carry, *(row[index, ...] for row in args[last:])])
            found = [self._loaded(array) for array in found]
            carry = found[:kept]
            seen.append(found[kept:])
        seen = seen[::-1] if eqn.params["reverse"] else seen
        nothing = (constant(np.zeros(x.aval.shape)) for x in eqn.outvars[kept:])  # of no steps
        return [*carry, *(map(np.stack, zip(*seen, strict=True)) if seen else nothing)]

    def _any(self, flag: Element) -> Array:
        return self.any_of(vector(self._alike(flag)))

    def _packed(self, arrays: Iterable[Held], uniform: Iterable[bool] = repeat(False)) -> list[Array]:
        """The elements of arrays as vectors, or as scalars of those that are uniform."""
        each = zip(arrays, uniform, strict=False)
        return [
            x
            for array, same in each
            for x in (map(jnp.asarray, self._loaded(array).flat) if same else self.vectors(array))
        ]

    def _unpacked(self, vectors: Sequence[Array], like: Sequence[Held]) -> list[Any]:
        found, rest = [], iter(vectors)
        for array in like:
            if isinstance(array, Kept):
                found.append(array.now())
                continue
            if self._laned(array.shape):
                groups = (next(rest) for _ in range(array.size // self.lanes))
                elements: list[Element] = [Lane(group, index) for group in groups for index in range(self.lanes)]
            else:
                elements = [next(rest) for _ in range(array.size)]
            found.append(arranged(elements, array.shape))
        return found


SUM = "scatter-add"

ENTRIES: dict[str, Callable[..., Any]] = {
    "dynamic_slice": Threads._looked_up,
    "dynamic_update_slice": Threads._with_entry,
}
"""Operations on one entry of an array at an index that is not known while tracing."""


KEYS = {"random_wrap": False, "random_unwrap": False, "random_fold_in": True, "random_bits": True, "random_split": True}
"""Operations on random keys, which are arrays of their words here; true for those that a generator defines."""


def _of_keys(eqn: Any) -> ClosedJaxpr:
    """The arithmetic of a key's generator."""
    (kind, *others), params = [x.aval for x in eqn.invars], eqn.params
    if kind.shape:
        raise NotImplementedError("threads draw from single keys")
    generator: Any = kind.dtype._impl
    function = {
        "random_fold_in": generator.fold_in,
        "random_split": lambda key: generator.split(key, tuple(params["shape"])),
        "random_bits": lambda key: generator.random_bits(key, params["bit_width"], params["shape"]),
    }[eqn.primitive.name]
    key = jax.ShapeDtypeStruct(generator.key_shape, jnp.uint32)
    return jax.make_jaxpr(function)(key, *(jax.ShapeDtypeStruct(x.shape, x.dtype) for x in others))


def _fixed_and_carried(eqn: Any) -> tuple[int, int]:
    """Count a scan's first arguments that are the same in each step, and the carried ones that follow.

    The rest of arguments and results have one axis more than in a step. The parameters say it otherwise in each jax.
    """
    body = eqn.params["jaxpr"].jaxpr

    def alike(whole: Sequence[Any], of_step: Sequence[Any]) -> int:
        return sum(a.aval.shape == b.aval.shape for a, b in zip(whole, of_step, strict=True))

    carried = alike(eqn.outvars, body.outvars)
    return alike(eqn.invars, body.invars) - carried, carried


def _is_long(eqn: Any) -> bool:
    """True for a loop of known length that is not unrolled."""
    length = eqn.params["length"]
    return length > LONG or (not _stacks(eqn) and length * operations(eqn.params["jaxpr"].jaxpr) > MANY)


def _stacks(eqn: Any) -> bool:
    """True for a scan that takes or gives something else in each step."""
    first, kept = _fixed_and_carried(eqn)
    return first + kept < len(eqn.invars) or kept < len(eqn.outvars)


def _looped(eqn: Any) -> ClosedJaxpr:
    """A loop of known length as a `while`."""
    params, (first, _) = eqn.params, _fixed_and_carried(eqn)
    if _stacks(eqn):
        raise NotImplementedError("threads stack nothing along a loop that changes arrays in memory")

    step = jaxpr_as_fun(params["jaxpr"])

    def run(*args: Any) -> Any:
        start, more = (jnp.int32(0), args[first:]), lambda carry: carry[0] < params["length"]
        return lax.while_loop(more, lambda carry: (carry[0] + 1, (*step(*args[:first], *carry[1]),)), start)[1]

    return jax.make_jaxpr(run)(*(jax.ShapeDtypeStruct(x.aval.shape, x.aval.dtype) for x in eqn.invars))


def _looked_up_in_loop(eqn: Any, names: Collection[str]) -> set[int]:
    """The places among a loop's arguments of such arrays, see `looked_up`."""
    first, params = eqn.params["cond_nconsts"], eqn.params
    last = first + params["body_nconsts"]
    inside = {
        place if place < first else last - first + place for place in looked_up(params["cond_jaxpr"].jaxpr, names)
    }
    return inside | {first + place for place in looked_up(params["body_jaxpr"].jaxpr, names)}


def looked_up(jaxpr: Any, names: Collection[str]) -> set[int]:
    """The places among a traced function's arguments of arrays that such operations take as their first argument."""
    found: set[Any] = set()
    for eqn in reversed(jaxpr.eqns):
        name, inside = eqn.primitive.name, partial(looked_up, names=names)
        if name in names or (name == "reshape" and eqn.outvars[0] in found):
            found.add(eqn.invars[0])
        elif name in CALLS or name == "scan":
            found |= {eqn.invars[place] for place in inside(eqn.params[CALLS.get(name, "jaxpr")].jaxpr)}
        elif name == "while":
            found |= {eqn.invars[place] for place in _looked_up_in_loop(eqn, names)}
        elif name == "cond":
            places = set().union(*(inside(branch.jaxpr) for branch in eqn.params["branches"]))
            found |= {eqn.invars[1 + place] for place in places}
    return {place for place, var in enumerate(jaxpr.invars) if var in found}


def power_of_two(lanes: int) -> int:
    """The smallest that is no less: threads of a world."""
    return 1 << (lanes - 1).bit_length()


def _is_entry(params: dict[str, Any], args: Sequence[Any]) -> bool:
    """True for one entry along the first axis of an array, at an index that is not known while tracing."""
    shape = args[0].shape
    sizes, start = params.get("slice_sizes") or args[1].shape, args[-len(shape)].item()
    return tuple(sizes) == (1, *shape[1:]) and not isinstance(start, np.generic)
