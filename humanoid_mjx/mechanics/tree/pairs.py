"""Contacts between bodies in the equations of a tree.

They join branches of the tree, so with them the equations `H x = r` are no longer sparse. Each contact that pushes adds
`G^T K G` to H and `-G^T K offset` to r, where the rows of G are the accelerations along the directions of its frame for
a unit of that of each degree of freedom, and K is its stiffness. By Woodbury's identity the solution is then

    x - Z N (G x + offset),    Z = H^-1 G^T,    N = (K^-1 + G Z)^-1,

which takes a solution of the sparse equations for each row of G. Few bodies touch at a time: the contacts of each world
that are close are gathered first, and loops over these end with the world that has most.
"""

import functools
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from humanoid_mjx.mechanics.scalars import NULL, ONE, ZERO, Scalar, Vector, add, dot, scale, unstack
from humanoid_mjx.mechanics.tree.algebra import (
    FEW_PAIRS,
    Spatial,
    entry_at,
    folded,
    in_lane,
    in_turn,
    number,
    resolve,
    root,
    stacked,
    unfolded,
    velocity_at,
    with_entry,
)
from humanoid_mjx.mechanics.tree.contacts import Friction, Gap, GapAt, Touch, pair_touch
from humanoid_mjx.mechanics.tree.inertia import Factors
from humanoid_mjx.mechanics.tree.kinematics import Kinematics
from humanoid_mjx.mechanics.tree.problem import Problem
from humanoid_mjx.mechanics.tree.structure import Box, Capsule, Pairs, Tree

SLOTS = 8
"""Contacts between bodies that a world may have at a time, those of two boxes corner by corner."""

Flags = list[Bool[Array, "slots worlds"]]
"""Masks of the facets that push."""

Rows = list[list[Scalar]]
"""Vectors over the degrees of freedom, or a small matrix, row by row."""

Bodies = tuple[Scalar, Scalar]
"""Numbers of two bodies: see `_numbers`."""


class Way(NamedTuple):
    """Motion of bodies with a degree of freedom at unit speed."""

    first: int
    last: int
    """The first and the last number of the bodies that move."""
    motion: Spatial

    def between(self, bodies: Bodies) -> Scalar:
        """1 where the second body moves against the first, -1 where the first does, 0 where both move, or none."""
        one, two = ((self.first <= body.value) & (body.value <= self.last) for body in bodies)
        return Scalar(two.astype(float) - one.astype(float))


class Slots(NamedTuple):
    """Contacts that each world may have; arrays lead with an axis of these."""

    touch: Touch
    rows: dict[int, Vector]
    """The rows of G: by degree of freedom, those of all lanes one by one, but for those that part the bodies of no
    pair."""
    count: Any
    """The most contacts of any world."""

    def facets(self, tree: Tree, x: Sequence[Scalar]) -> list[Scalar]:
        """By how much the bodies part faster than they should, along each facet."""
        rates = unfolded(x, tree.dofs)

        def facets(touch: Touch, rows: dict[int, Vector]) -> list[Scalar]:
            residual = touch.offset
            for dof, row in rows.items():
                residual = add(residual, scale(rates[dof], row))
            return touch.facets(residual)

        if tree.threads:
            return in_turn(facets, self.touch, self.rows, count=self.count)
        return facets(self.touch, self.rows)

    def active(self, tree: Tree, x: Sequence[Scalar]) -> Flags:
        """Masks of the facets that push."""
        return self.touch.active(self.facets(tree, x))

    def all_close(self) -> Flags:
        """All facets of all contacts."""
        return [self.touch.close] * len(self.touch.facets(NULL))


def are_close(tree: Tree, gaps: Sequence[tuple[Gap, Friction]]) -> Bool[Array, "pairs worlds"]:
    """True where a contact counts: its distance is within the margin."""
    each = zip(tree.pairs, gaps, strict=True)
    return jnp.concatenate([gap.distance.value < pairs.surface.margin for pairs, (gap, _) in each])


def close_pairs(
    tree: Tree,
    problem: Problem,
    gaps: Sequence[tuple[Gap, Friction]],
    close: Bool[Array, "pairs whole"],
    worlds: Any = None,
) -> tuple[Slots, Bool[Array, " worlds"]]:
    """The contacts of the first `SLOTS` pairs that are close in each world, and where more are.

    Args:
      tree: and
      problem: of these worlds.
      gaps: those of all pairs, group by group, of all worlds, and their coefficients of friction.
      close: true where a pair counts, of all worlds.
      worlds: indices of these; None: all, without looking up any.
    """
    size, whole = close.shape
    contact, facts = _contacts(tree, problem, [friction for _, friction in gaps])
    every = _joined(tree, [gap for gap, _ in gaps]), *facts
    close = close if worlds is None else close[:, worlds]
    index, slots = jnp.arange(size, dtype=jnp.int32)[:, None], min(SLOTS, size)

    def after(last: Any) -> Any:
        return jnp.where(close & (index > last), index, size).min(axis=0)

    def pick(value: Any, pair: Any) -> Any:
        if jnp.ndim(value) < 2:
            return value if worlds is None else jnp.broadcast_to(value, whole)[worlds]
        if worlds is None:
            return jnp.where(index == pair, value, jnp.zeros((), value.dtype)).sum(axis=0)
        # Of indices that may be negative, each look-up would be traced at length.
        return jnp.broadcast_to(value, (size, whole))[pair.astype(jnp.uint32), worlds]

    def one(first: Any) -> tuple[Touch, dict[int, Vector]]:
        pair = jnp.minimum(first, size - 1)  # where none is left, the last: all its numbers are finite
        return contact(pair, first < size, *jax.tree.map(lambda v: pick(v, pair), every))

    def further(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        count, first, found = carry
        each = zip(found, jax.tree.leaves(one(first)), strict=True)
        return count + 1, after(first), [with_entry(array, count, new) for array, new in each]

    def going(carry: tuple[Any, ...]) -> Any:
        return (carry[1] < size).any() & (carry[0] < slots)

    first = after(jnp.full(close.shape[1:], -1, jnp.int32))
    leaves, structure = jax.tree.flatten(jax.eval_shape(one, first))
    nothing = [jnp.zeros((slots, *first.shape), leaf.dtype) for leaf in leaves]
    count, left, found = jax.lax.while_loop(going, further, (jnp.int32(0), first, nothing))
    touch, rows = structure.unflatten(found)
    return Slots(touch, rows, count), left < size


def close_pairs_in_turn(
    tree: Tree, problem: Problem, gaps: Sequence[tuple[GapAt, Friction]]
) -> tuple[Slots, Bool[Array, " worlds"]]:
    """The same for a GPU's thread, whose world has no axis: it looks at pair after pair, and keeps those that are
    close."""
    contact, facts = _contacts(tree, problem, [friction for _, friction in gaps])
    numbers, close = _close_numbers(tree, problem, [at for at, _ in gaps])
    slots = min(SLOTS, sum(len(pairs.ones) for pairs in tree.pairs))

    def one(index: Any) -> tuple[Touch, dict[int, Vector]]:
        pair, gap, first = entry_at(numbers, index)[0], None, 0
        for pairs, (at, _) in zip(tree.pairs, gaps, strict=True):
            found = at(pair - first)
            gap = found if gap is None else jax.tree.map(partial(jnp.where, pair < first), gap, found)
            first += len(pairs.ones)
        own = jax.tree.map(lambda v: v if jnp.ndim(v) < 2 else entry_at(v, pair), facts)
        return contact(pair, index < close, gap, *own)

    def further(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        each = zip(carry[1], jax.tree.leaves(one(carry[0])), strict=True)
        return carry[0] + 1, [with_entry(array, carry[0], new) for array, new in each]

    leaves, structure = jax.tree.flatten(jax.eval_shape(one, jnp.int32(0)))
    start = jnp.int32(0), [jnp.zeros((slots, *close.shape), leaf.dtype) for leaf in leaves]
    most = jnp.minimum(close, slots)[0]
    count, found = jax.lax.while_loop(lambda carry: carry[0] < most, further, start)
    touch, rows = structure.unflatten(found)
    return Slots(touch, rows, count), close > slots


ABREAST = 4
"""Pairs that a thread looks at together: while one waits for a number, it computes another."""


def _close_numbers(tree: Tree, problem: Problem, gaps: Sequence[GapAt]) -> tuple[Any, Any]:
    """The numbers of the first `SLOTS` pairs that are close in a thread's world, and how many are close."""
    first, found = 0, (jnp.zeros((SLOTS + 1, 1), jnp.int32), jnp.zeros(1, jnp.int32))
    for pairs, at in zip(tree.pairs, gaps, strict=True):
        found = _noted(pairs, problem, at, first, found)
        first += len(pairs.ones)
    return found


def _noted(pairs: Pairs, problem: Problem, at: GapAt, first: int, found: tuple[Any, Any]) -> tuple[Any, Any]:
    """`found` with a group's pairs that are close, of which the first has this number; many are taken in a loop."""
    size = len(pairs.ones)

    def further(index: Any, found: tuple[Any, Any], count: int) -> tuple[Any, Any]:
        each = [index + other for other in range(count)]
        for one, gap in zip(each, map(at, each), strict=True):
            numbers, close = found
            numbers = with_entry(numbers, jnp.minimum(close, SLOTS)[0], (first + one)[None])
            counts = (gap.distance.value < pairs.surface.margin) & (one < size) & ~jnp.asarray(problem.ended)
            found = numbers, close + counts
        return found

    if size <= FEW_PAIRS:
        return further(jnp.int32(0), found, size)
    return jax.lax.while_loop(
        lambda carry: carry[0] < size,
        lambda carry: (carry[0] + ABREAST, *further(carry[0], carry[1:], ABREAST)),
        (jnp.int32(0), *found),
    )[1:]


def _contacts(
    tree: Tree, problem: Problem, frictions: Sequence[Friction]
) -> tuple[Callable[..., tuple[Touch, dict[int, Vector]]], tuple[Any, ...]]:
    """What makes a contact of a pair's number, a flag where it counts, a gap, and what follows: facts of the pair, of
    which arrays lead with an axis of all pairs."""
    numbers, some = _numbers(tree), None
    pairs = [[numbers[shape.body, shape.lane * tree.bodies[shape.body].laned] for shape in two] for two in _each(tree)]
    bodies = tuple(Scalar(jnp.array(column, float)[:, None]) for column in zip(*pairs, strict=True))
    ways, rates = _ways(tree, problem.kinematics, numbers, pairs), unfolded(problem.velocity, tree.dofs)
    if any(frictions):
        some = _joined(tree, [friction or (ZERO, ZERO) for friction in frictions])
    inverse = _joined(tree, [number(group.surface.inverse_weight) for group in tree.pairs])

    def contact(
        pair: Any, there: Any, gap: Gap, bodies: Bodies, inverse: Scalar, friction: Friction
    ) -> tuple[Touch, dict[int, Vector]]:
        arms = {dof: scale(way.between(bodies), velocity_at(way.motion, gap.place)) for dof, way in ways.items()}
        velocity = functools.reduce(add, [scale(rates[dof], arm) for dof, arm in arms.items()], NULL)
        found: Any = None
        end = 0
        for group, own in zip(tree.pairs, frictions, strict=True):
            surface = group.surface._replace(inverse_weight=inverse.value)
            touch = pair_touch(surface, gap, velocity, own and friction)
            if friction and not own:  # four facets that are the same, each of a quarter of the weight
                touch = touch._replace(weight=Scalar(0.25) * touch.weight, friction=friction)
            found = touch if found is None else jax.tree.map(partial(jnp.where, pair < end), found, touch)
            end += len(group.ones)
        rows = {dof: resolve(found.frame, arm) for dof, arm in arms.items()}
        return found._replace(place=NULL, frame=(NULL, NULL, NULL), distance=ZERO, close=there), rows

    return contact, (bodies, inverse, some)


def with_pairs(tree: Tree, slots: Slots, active: Flags, factors: Factors, x: Sequence[Scalar]) -> list[Scalar]:
    """The solution of the equations with these facets in them, from that without, `x`."""
    worlds, size = active[0].shape[1:], sum(map(len, tree.dofs))
    axes = 1 if slots.touch.friction is None else 3
    most, own = len(active[0]), (slots.rows, slots.touch._replace(close=()), active)
    index = jnp.arange(most, dtype=jnp.int32)
    pushing = functools.reduce(jnp.logical_or, active).any(axis=1)

    def after(last: Any) -> Any:
        """The next contact that pushes in any world; a GPU's thread has one world."""
        return jnp.where(pushing & (index > last), index, most).min()

    def further(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        count, place, start, *pasts = carry
        along, touch, flags = jax.tree.map(lambda v: entry_at(v, place), own)
        flags = [flag & (place < most) for flag in flags]  # threads that have ended compute on with others
        rows = [[along[dof][axis] if dof in along else ZERO for dof in range(size)] for axis in range(axes)]
        columns = [unfolded(factors.solve(folded(row, tree.dofs)), tree.dofs) for row in rows]

        def with_another(other: Any, columns: Any) -> Any:
            others, inner = (_rows(entry_at(past, other), axes) for past in pasts)
            felt = [[dot(column, row) for column in others] for row in rows]
            shares = [[dot(line, part) for line in inner] for part in felt]
            each = zip(_rows(columns, axes), shares, strict=True)
            return stacked([v for column, share in each for v in _less(column, share, others)], worlds)

        columns = jax.lax.fori_loop(0, count, with_another, stacked([v for column in columns for v in column], worlds))
        whole, (x,), columns = columns, _rows(start, 1), _rows(columns, axes)
        inner = _inner(touch, flags, [[dot(row, column) for column in columns] for row in rows])
        residual = [dot(row, x) + offset for row, offset in zip(rows, touch.offset, strict=False)]
        x = _less(x, [dot(line, residual) for line in inner], columns)
        made = whole, stacked([entry for line in inner for entry in line], worlds)
        pasts = [with_entry(past, count, new) for past, new in zip(pasts, made, strict=True)]
        return count + 1, after(place), stacked(x, worlds), *pasts

    start = stacked(unfolded(x, tree.dofs), worlds)
    nothing = (jnp.zeros((most, axes * count, *worlds), start.dtype) for count in (size, axes))
    begin = jnp.int32(0), after(jnp.int32(-1)), start, *nothing
    found = jax.lax.while_loop(lambda carry: carry[1] < most, further, begin)[2]
    return folded(unstack(found), tree.dofs)


def _rows(array: Any, count: int) -> Rows:
    """So many vectors that stand one after another along the first axis."""
    flat = unstack(array)
    size = len(flat) // count
    return [flat[first : first + size] for first in range(0, len(flat), size)]


def _less(x: Sequence[Scalar], shares: Sequence[Scalar], columns: Rows) -> list[Scalar]:
    """A vector over the degrees of freedom without so much of each of the others."""
    return [value - dot(shares, entries) for value, *entries in zip(x, *columns, strict=True)]


def _inner(touch: Touch, flags: Sequence[Any], compliance: Rows) -> Rows:
    """N, with which these facets push: `R^T (1 + R C R^T)^-1 R`, where `K = R^T R` and C is the compliance G Z.

    K is not inverted: it is singular where not all facets push.
    """
    size, rows = len(compliance), _root(touch, flags)
    felt = [[dot(row, [line[axis] for line in compliance]) for axis in range(size)] for row in rows]
    lower: Rows = []
    scales: list[Scalar] = []
    reduced: Rows = []
    for index, row in enumerate(rows):
        # A row of the factors L D L^T, and one of L^-1 R.
        entries = [dot(felt[index], rows[other]) for other in range(index + 1)]
        line: list[Scalar] = []
        for other in range(index):
            done = [a * b for a, b in zip(line, scales, strict=False)]
            line.append((entries[other] - dot(done, lower[other])) / scales[other])
        scales.append(entries[index] + ONE - dot(line, [a * b for a, b in zip(line, scales, strict=True)]))
        lower.append(line)
        reduced.append([v - dot(line, [past[axis] for past in reduced]) for axis, v in enumerate(row)])
    inverse = [ONE / scale for scale in scales]

    def entry(one: int, two: int) -> Scalar:
        return dot(
            [row[one] * scale for row, scale in zip(reduced, inverse, strict=True)], [row[two] for row in reduced]
        )

    lines = [[entry(one, two) for two in range(one + 1)] for one in range(size)]
    return [[lines[max(one, two)][min(one, two)] for two in range(size)] for one in range(size)]


def _root(touch: Touch, flags: Sequence[Any]) -> Rows:
    """R, the root of the stiffness K that these facets have: upper triangular.

    It is that of the number of facets, scaled: the sum over facets loses what friction adds where there is little.
    """
    weight = root(touch.weight)
    one, *others = (Scalar(jnp.where(flag, jnp.ones_like(weight.value), 0.0)) for flag in flags)
    if touch.friction is None:
        return [[weight * one]]
    two, three, four = others
    first, over_first = _pivot(one + two + three + four)
    up, across = (one - two) * over_first, (three - four) * over_first
    second, over_second = _pivot(one + two - up * up)
    both = -(up * across) * over_second
    third = _pivot(three + four - across * across - both * both)[0]
    mu, nu = (weight * part for part in touch.friction)
    return [[weight * first, mu * up, nu * across], [ZERO, mu * second, nu * both], [ZERO, ZERO, nu * third]]


def _pivot(square: Scalar) -> tuple[Scalar, Scalar]:
    """A root and its inverse, both 0 where the square is 0 but for rounding; else it is a third or more."""
    some = square.value > 1e-3
    length = jnp.sqrt(jnp.where(some, square.value, 1.0))
    return Scalar(jnp.where(some, length, 0.0)), Scalar(jnp.where(some, 1.0 / length, 0.0))


def _ways(tree: Tree, kinematics: Kinematics, numbers: dict[tuple[int, int], int], pairs: Any) -> dict[int, Way]:
    """By degree of freedom, but for those that move both bodies of each pair, or none."""
    found: dict[int, Way] = {}
    for dof, lanes in enumerate(tree.dofs):
        for index, own in enumerate(lanes):
            places = (place for place in numbers if dof in tree.moving(place[0]))
            moved = [numbers[place] for place in places if place[1] == index or not tree.laned(dof)]
            way = Way(min(moved), max(moved), in_lane(kinematics.motions[dof], index))
            if any((way.first <= one <= way.last) != (way.first <= two <= way.last) for one, two in pairs):
                found[own] = way
    return found


def _numbers(tree: Tree) -> dict[tuple[int, int], int]:
    """Numbers of the bodies of all lanes, in which those that a degree of freedom moves are neighbours."""
    found: dict[tuple[int, int], int] = {}

    def visit(body: int, lane: int) -> None:
        found[body, lane] = len(found)
        for other, child in enumerate(tree.bodies):
            if other and child.parent == body:
                more = child.laned and not tree.bodies[body].laned
                for index in range(tree.lanes) if more else [lane]:
                    visit(other, index)

    visit(0, 0)
    return found


def _joined(tree: Tree, groups: Sequence[Any]) -> Any:
    """Pytrees of scalars, one of each group of pairs, as one."""
    sizes = [len(pairs.ones) for pairs in tree.pairs]

    def join(*parts: Scalar) -> Scalar:
        if len(parts) == 1 or all(part.is_known(parts[0].value) for part in parts):
            return parts[0]
        values = [jnp.asarray(part.value, float) for part in parts]
        worlds = jnp.broadcast_shapes(*(value.shape[-1:] for value in values), (1,))
        return Scalar(jnp.concatenate([jnp.broadcast_to(v, (n, *worlds)) for v, n in zip(values, sizes, strict=True)]))

    return jax.tree.map(join, *groups, is_leaf=lambda part: isinstance(part, Scalar))


def _each(tree: Tree) -> list[tuple[Capsule | Box, Capsule | Box]]:
    """All pairs."""
    return [pair for pairs in tree.pairs for pair in zip(pairs.ones, pairs.twos, strict=True)]
