"""Contacts between bodies of a tree.

Few bodies touch at a time: contacts that are close are gathered, and loops over these are short.
"""

import functools
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from humanoid_mjx.mechanics.scalars import NULL, ZERO, Scalar, Vector, add, scale
from humanoid_mjx.mechanics.tree.algebra import (
    FEW_PAIRS,
    WORLD,
    Spatial,
    entry_at,
    filled,
    in_lane,
    in_turn,
    number,
    resolve,
    unfolded,
    velocity_at,
    with_entry,
)
from humanoid_mjx.mechanics.tree.contacts import Friction, Gap, GapAt, Touch, pair_touch
from humanoid_mjx.mechanics.tree.kinematics import Kinematics
from humanoid_mjx.mechanics.tree.problem import Problem
from humanoid_mjx.mechanics.tree.structure import Box, Capsule, Pairs, Tree

SLOTS = 8
"""Contacts between bodies that a world may have at a time, those of two boxes corner by corner. With room for 16,
humanoids that are thrown about are 13 to 15 % slower on a GPU, and no fewer of them are lost."""

Flags = list[Bool[Array, "slots 1"]]
"""Masks of the facets that push."""

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
    """How many there are."""

    def facets(self, tree: Tree, x: Sequence[Scalar]) -> list[Scalar]:
        """By how much the bodies part faster than they should, along each facet."""
        rates = unfolded(x, tree.dofs)

        def facets(touch: Touch, rows: dict[int, Vector]) -> list[Scalar]:
            residual = touch.offset
            for dof, row in rows.items():
                residual = add(residual, scale(rates[dof], row))
            return touch.facets(residual)

        return in_turn(facets, self.touch, self.rows, count=self.count)

    def active(self, tree: Tree, x: Sequence[Scalar]) -> Flags:
        """Masks of the facets that push."""
        return self.touch.active(self.facets(tree, x))

    def all_close(self) -> Flags:
        """All facets of all contacts."""
        return [self.touch.close] * len(self.touch.facets(NULL))


def close_pairs(
    tree: Tree, problem: Problem, gaps: Sequence[tuple[GapAt, Friction]]
) -> tuple[Slots, Bool[Array, " 1"]]:
    """The contacts of the first `SLOTS` pairs that are close, and whether more are.

    `gaps`: those of all pairs, group by group, and their coefficients of friction.
    """
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

    # A counter that all worlds share ends the loop: with each world's own number the lower body was a tenth slower.
    count, (touch, rows) = filled(one, slots, jnp.minimum(close, slots)[0])
    return Slots(touch, rows, count), close > slots


ABREAST = 4
"""Pairs that are looked at together: while a thread waits for a number of one, it computes another."""


def _close_numbers(tree: Tree, problem: Problem, gaps: Sequence[GapAt]) -> tuple[Any, Any]:
    """The numbers of the first `SLOTS` pairs that are close, and how many are close."""
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
        return Scalar(jnp.concatenate([jnp.broadcast_to(v, (n, *WORLD)) for v, n in zip(values, sizes, strict=True)]))

    return jax.tree.map(join, *groups, is_leaf=lambda part: isinstance(part, Scalar))


def _each(tree: Tree) -> list[tuple[Capsule | Box, Capsule | Box]]:
    """All pairs."""
    return [pair for pairs in tree.pairs for pair in zip(pairs.ones, pairs.twos, strict=True)]
