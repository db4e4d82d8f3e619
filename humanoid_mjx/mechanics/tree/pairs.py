"""Contacts between bodies of a tree.

Few bodies touch at a time: contacts that are close are gathered, and loops over these are short.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from humanoid_mjx.mechanics.tree.algebra import (
    FEW_PAIRS,
    entry_at,
    filled,
    in_lane,
    numbers,
    stacked,
    turn,
    unfolded,
    velocity_at,
    with_entry,
)
from humanoid_mjx.mechanics.tree.cones import Cone
from humanoid_mjx.mechanics.tree.contacts import Friction, Gap, GapAt, Touch, touch_of
from humanoid_mjx.mechanics.tree.kinematics import Kinematics
from humanoid_mjx.mechanics.tree.problem import Problem
from humanoid_mjx.mechanics.tree.structure import Pairs, Tree

SLOTS = 8
"""Contacts between bodies that a world may have at a time, those of two boxes corner by corner. With room for 16,
humanoids that are thrown about are 13 to 15 % slower on a GPU, and no fewer of them are lost."""

Flags = Bool[Array, "slots facets 1 1"] | Float[Array, "slots 3 1 1"]
"""`Touch.active` of each contact."""


class Slots(NamedTuple):
    """Contacts that each world may have; arrays lead with an axis of these."""

    touch: Touch
    rows: Any
    """The rows of G, by contact and by degree of freedom of `dofs`: (slots, dofs, 3, 1, 1)."""
    dofs: list[int]
    count: Any
    """Number of contacts."""

    def facets(self, tree: Tree, x: Sequence[Any]) -> Any:
        """By how much the bodies part faster than they should, along each facet."""
        rates = unfolded(x, tree.dofs)
        rates = stacked([rates[dof] for dof in self.dofs])[:, None]

        def facets(index: Any) -> Any:
            touch, rows = jax.tree.map(lambda v: entry_at(v, index), (self.touch, self.rows))
            return touch.facets(touch.offset + (rates * rows).sum(axis=0))

        return filled(facets, len(self.rows), self.count)[1]

    def active(self, tree: Tree, x: Sequence[Any]) -> Flags:
        """Masks of the facets that push."""
        return self.touch.active(self.facets(tree, x))

    def guess(self, tree: Tree, x: Sequence[Any]) -> Flags:
        """First guess of `active`: all facets of all contacts; of elliptic cones those that push."""
        if isinstance(self.touch.friction, Cone):
            return self.active(tree, x)
        size = 1 if self.touch.friction is None else 4
        return jnp.broadcast_to(self.touch.close[:, None], (len(self.rows), size, 1, 1))


def close_pairs(tree: Tree, problem: Problem) -> tuple[Slots, Bool[Array, " 1"]]:
    """The contacts of the first `SLOTS` pairs that are close, and whether more are."""
    gaps = problem.pairs
    contact, dofs, facts = _contacts(tree, problem, [friction for _, friction in gaps])
    first, found = 0, (jnp.zeros((SLOTS + 1, 1), jnp.int32), jnp.zeros(1, jnp.int32))
    for pairs, (at, _) in zip(tree.pairs, gaps, strict=True):
        found = _find_close(pairs, problem, at, first, found)
        first += len(pairs.ones)
    (numbers, close), slots = found, min(SLOTS, first)

    def one(index: Any) -> tuple[Touch, Any]:
        pair, gap, first = entry_at(numbers, index)[0], None, 0
        for pairs, (at, _) in zip(tree.pairs, gaps, strict=True):
            found = at(pair - first)
            gap = found if gap is None else jax.tree.map(partial(jnp.where, pair < first), gap, found)
            first += len(pairs.ones)
        return contact(pair, (index < close)[None], gap, *jax.tree.map(lambda v: entry_at(v, pair), facts))

    # A counter that all worlds share ends the loop: with each world's own number the lower body was a tenth slower.
    count, (touch, rows) = filled(one, slots, jnp.minimum(close, slots)[0])
    return Slots(touch, rows, dofs, count), close > slots


ABREAST = 4
"""Pairs that are looked at together: while a thread waits for a number of one, it computes another."""


def _find_close(pairs: Pairs, problem: Problem, at: GapAt, first: int, found: tuple[Any, Any]) -> tuple[Any, Any]:
    """The numbers of the first `SLOTS` pairs that are close, and how many are close: `found`, and those of a group of
    which the first has this number; many are taken in a loop."""
    size = len(pairs.ones)

    def further(index: Any, found: tuple[Any, Any], count: int) -> tuple[Any, Any]:
        each = [index + other for other in range(count)]
        for one, gap in zip(each, map(at, each), strict=True):
            numbers, close = found
            numbers = with_entry(numbers, jnp.minimum(close, SLOTS)[0], (first + one)[None])
            counts = (gap.distance[0] < pairs.surface.margin) & (one < size) & ~jnp.asarray(problem.ended)
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
) -> tuple[Callable[..., tuple[Touch, Any]], list[int], tuple[Any, ...]]:
    """Return a function that builds one contact, the degrees of freedom of its rows, and facts of all pairs.

    `contact(pair, there, gap, *facts)` returns the `Touch` and the rows of the contact Jacobian; `facts`: those of the
    pair, of which arrays lead with an axis of all pairs.
    """
    numbered = _numbers(tree)
    shapes = [pair for pairs in tree.pairs for pair in zip(pairs.ones, pairs.twos, strict=True)]
    pairs = [[numbered[shape.body, shape.lane * tree.bodies[shape.body].laned] for shape in two] for two in shapes]
    bodies = tuple(jnp.array(bodies, float)[:, None, None] for bodies in zip(*pairs, strict=True))
    dofs, first, last, motions = _parting(tree, problem.kinematics, numbered, pairs)
    rates = unfolded(problem.velocity, tree.dofs)
    rates = stacked([rates[dof] for dof in dofs])[:, None]
    zero = np.zeros((1, 1))
    none = jax.tree.map(lambda _: zero, next(filter(None, frictions), None))
    some = _joined(tree, [friction or none for friction in frictions]) if any(frictions) else None
    inverse = _joined(tree, [numbers(group.surface.inverse_weight, (1, 1)) for group in tree.pairs])

    def contact(
        pair: Any, there: Any, gap: Gap, bodies: tuple[Any, Any], inverse: Any, friction: Friction
    ) -> tuple[Touch, Any]:
        two, one = (((first <= body) & (body <= last)).astype(float) for body in reversed(bodies))
        arms = (two - one)[..., None, :, :] * velocity_at(motions, gap.place)
        found: Any = None
        end = 0
        for group, own in zip(tree.pairs, frictions, strict=True):
            surface = group.surface._replace(inverse_weight=inverse)
            touch = touch_of(surface, gap, (rates * arms).sum(axis=0), own and friction)
            if friction and not own:  # a pyramid of four facets that are the same, each of a quarter of the weight
                weight = touch.weight if isinstance(friction, Cone) else 0.25 * touch.weight
                touch = touch._replace(weight=weight, friction=friction)
            found = touch if found is None else jax.tree.map(partial(jnp.where, pair < end), found, touch)
            end += len(group.ones)
        return found._replace(place=(), frame=(), distance=(), close=there), turn(found.frame, arms)

    return contact, dofs, (bodies, inverse, some)


def _parting(tree: Tree, kinematics: Kinematics, numbered: dict[tuple[int, int], int], pairs: Any) -> tuple[Any, ...]:
    """The degrees of freedom that part the bodies of some pair, those of all lanes one by one; the first and the last
    number, see `_numbers`, of the bodies that each moves; and their motions at unit speed."""
    found = []
    for dof, lanes in enumerate(tree.dofs):
        for index, own in enumerate(lanes):
            places = (place for place in numbered if dof in tree.moving(place[0]))
            moved = [numbered[place] for place in places if place[1] == index or not tree.laned(dof)]
            first, last = min(moved), max(moved)
            if any((first <= one <= last) != (first <= two <= last) for one, two in pairs):
                found.append((own, first, last, in_lane(kinematics.motions[dof], index)))
    dofs, first, last, motions = zip(*found, strict=True)
    first, last = (np.array(end, float)[:, None, None] for end in (first, last))
    return list(dofs), first, last, stacked(motions)


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
    """Pytrees of numbers, one of each group of pairs, with a first axis of all pairs."""
    sizes = [len(pairs.ones) for pairs in tree.pairs]

    def join(*parts: Any) -> Any:
        return jnp.concatenate([jnp.broadcast_to(part, (size, 1, 1)) for part, size in zip(parts, sizes, strict=True)])

    return jax.tree.map(join, *groups)
