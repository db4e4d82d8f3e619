"""Contacts between bodies in the equations of a tree: updates of the solution, contact by contact.

They join branches of the tree, so with them the equations `H x = r` are no longer sparse. But few bodies touch at a
time. Each contact that pushes adds `G^T K G` to H and `-G^T K offset` to r, where the rows of G are the accelerations
along the directions of its frame and K is its stiffness. By Woodbury's identity the solution is then

    x - Z N (G x + offset),    Z = H^-1 G^T,    N = (K^-1 + G Z)^-1,

which takes a solution of the sparse equations for each row of G.
"""

import functools
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from humanoid_mjx.mechanics.scalars import NULL, ONE, ZERO, Scalar, Vector, cross, dot
from humanoid_mjx.mechanics.tree.algebra import known, over_lanes, resolve, root, velocity_at
from humanoid_mjx.mechanics.tree.contacts import Touch
from humanoid_mjx.mechanics.tree.inertia import Factors
from humanoid_mjx.mechanics.tree.kinematics import Kinematics
from humanoid_mjx.mechanics.tree.structure import Box, Capsule, Tree

SLOTS = 8
"""Contacts between bodies that a world may have at a time, those of two boxes corner by corner."""

Flags = list[list[Bool[Array, " worlds"]]]
"""Masks of the facets that push, slot by slot."""

Ends = list[tuple[int, int]]
"""The first and the last number of the bodies that a degree of freedom moves, lane by lane."""

Block = list[list[Scalar]]
"""A small matrix, or vectors over the degrees of freedom, row by row."""


class Slot(NamedTuple):
    """A contact that each world may have."""

    touch: Touch
    rows: Block
    """By direction of its frame and degree of freedom, the acceleration along the direction for a unit of that of the
    degree of freedom. Without friction there is but the normal."""

    def residual(self, tree: Tree, x: Sequence[Scalar]) -> list[Scalar]:
        """By how much the bodies part faster than they should, along the directions."""
        moved = _products(tree, self.rows, [x])
        return [part + offset for (part,), offset in zip(moved, self.touch.offset, strict=False)]

    def facets(self, tree: Tree, x: Sequence[Scalar]) -> list[Scalar]:
        """The same along each facet."""
        return self.touch.facets(Vector(*self.residual(tree, x), *NULL[len(self.rows) :]))

    def active(self, tree: Tree, x: Sequence[Scalar]) -> list[Any]:
        """Mask of the facets that push."""
        return self.touch.active(self.facets(tree, x))


def all_close(slots: Sequence[Slot]) -> Flags:
    """The facets of all bodies that are close."""
    return [[slot.touch.close] * len(slot.touch.facets(NULL)) for slot in slots]


def close_pairs(
    tree: Tree, kinematics: Kinematics, touches: Sequence[Touch], worlds: Any = None
) -> tuple[list[Slot], Bool[Array, " worlds"]]:
    """The contacts of the first `SLOTS` pairs that are close in each world, and where more are.

    Args:
      tree: and
      kinematics: of these worlds.
      touches: the contacts of all pairs, group by group, of all worlds.
      worlds: indices of these; None: all, without looking up any.
    """
    touch = _joined(tree, touches)
    size, numbers = len(touch.close), _numbers(tree)
    ranges = _ranges(tree, numbers)
    bodies = [
        [numbers[shape.body, shape.lane * tree.bodies[shape.body].laned] for shape in pair] for pair in _each(tree)
    ]
    least = touch._replace(frame=touch.frame[:2], distance=ZERO)
    left = touch.close if worlds is None else touch.close[:, worlds]
    index, slots = jnp.arange(size, dtype=jnp.uint32)[:, None], []

    def slot_of(pick: Callable[[Any], Any], two: Sequence[Any]) -> Slot:
        found = jax.tree.map(lambda v: pick(jnp.broadcast_to(v, touch.close.shape)), least)
        normal, tangent = found.frame
        found = found._replace(frame=(normal, tangent, cross(normal, tangent)))
        return Slot(found, _rows(kinematics, found, two, ranges))

    def of(pair: Any) -> Callable[[Any], Any]:
        return lambda v: v[pair] if worlds is None else v[pair, worlds]

    if size <= SLOTS:
        return [slot_of(of(pair), bodies[pair]) for pair in range(size)], jnp.zeros(left.shape[1:], bool)
    table = jnp.array(bodies, float).T[..., None]
    for _ in range(SLOTS):
        first = jnp.where(left, index, size).min(axis=0)
        chosen = index == first
        if worlds is None:
            slot = slot_of(partial(_picked, chosen), [_picked(chosen, column) for column in table])
        else:
            pair = jnp.minimum(first, size - 1)
            slot = slot_of(of(pair), [column[:, 0][pair] for column in table])
        slots.append(slot._replace(touch=slot.touch._replace(close=first < size)))
        left = left & ~chosen
    return slots, left.any(axis=0)


def with_pairs(tree: Tree, slots: Sequence[Slot], active: Flags, factors: Factors, x: Sequence[Scalar]) -> list[Scalar]:
    """The solution of the equations with these facets in them, from that without, `x`."""
    before: list[tuple[Block, Block]] = []
    worlds = slots[0].touch.close.shape
    shapes = [(tree.lanes, *worlds) if tree.laned(dof) else worlds for dof in range(tree.nv)]

    def arrays(scalars: Sequence[Scalar]) -> list[Any]:
        return [jnp.broadcast_to(jnp.asarray(s.value, float), shape) for s, shape in zip(scalars, shapes, strict=True)]

    def update(slot: Slot, flags: Sequence[Any], x: Sequence[Scalar]) -> tuple[Any, Any, Any]:
        columns = [factors.solve(row) for row in slot.rows]
        for others, inner in before:
            felt = _products(tree, others, slot.rows)
            for place, column in enumerate(columns):
                share = [dot(row, [line[place] for line in felt]) for row in inner]
                columns[place] = _less(column, share, others)
        inner = _inner(slot.touch, flags, _products(tree, slot.rows, columns))
        residual = slot.residual(tree, x)
        x = _less(x, [dot(row, residual) for row in inner], columns)
        inner = [[jnp.broadcast_to(entry.value, worlds) for entry in row] for row in inner]
        return arrays(x), [arrays(column) for column in columns], inner

    for slot, flags in zip(slots, active, strict=True):
        pushes = functools.reduce(jnp.logical_or, flags)
        made = partial(update, slot, flags, x)
        nothing = jax.tree.map(lambda v: jnp.zeros(v.shape, v.dtype), jax.eval_shape(made))
        found = jax.lax.cond(pushes.any(), made, lambda same=x, nothing=nothing: (arrays(same), *nothing[1:]))
        # A world's bits must not depend on whether another made its batch come here.
        after, *rest = jax.tree.map(Scalar, found)
        x = [Scalar(jnp.where(pushes, new.value, old.value)) for new, old in zip(after, x, strict=True)]
        before.append(tuple(rest))
    return list(x)


def _less(x: Sequence[Scalar], shares: Sequence[Scalar], columns: Block) -> list[Scalar]:
    """A vector over the degrees of freedom without so much of each of the others."""
    return [value - dot(shares, entries) for value, *entries in zip(x, *columns, strict=True)]


def _inner(touch: Touch, flags: Sequence[Any], compliance: Block) -> Block:
    """N, with which these facets push: `R^T (1 + R C R^T)^-1 R`, where `K = R^T R` and C is the compliance G Z.

    K is not inverted: it is singular where not all facets push.
    """
    size, rows = len(compliance), _root(touch, flags)
    felt = [[dot(row, [line[axis] for line in compliance]) for axis in range(size)] for row in rows]
    lower: Block = []
    scales: list[Scalar] = []
    reduced: Block = []
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


def _root(touch: Touch, flags: Sequence[Any]) -> Block:
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


def _products(tree: Tree, rows: Block, columns: Sequence[Sequence[Scalar]]) -> Block:
    """The scalar products of vectors over the degrees of freedom, those of all lanes."""
    stem = sum(not tree.laned(dof) for dof in range(tree.nv))
    alone = [dot(row[:stem], column[:stem]) for row in rows for column in columns]
    laned = [dot(row[stem:], column[stem:]) for row in rows for column in columns]
    both = [a + b for a, b in zip(alone, over_lanes(laned, tree.lanes), strict=True)]
    return [both[first : first + len(columns)] for first in range(0, len(both), len(columns))]


def _rows(kinematics: Kinematics, touch: Touch, bodies: Sequence[Any], ranges: Sequence[Ends]) -> Block:
    """The rows of a contact of two bodies, which are numbers that are known while tracing or of each world."""
    found: Block = []
    for dof, ends in enumerate(ranges):
        one, two = (_within(number, ends) for number in bodies)
        moved = resolve(touch.frame, velocity_at(kinematics.motions[dof], touch.place))
        found.append([(two - one) * part for part in moved[: 1 if touch.friction is None else 3]])
    return list(map(list, zip(*found, strict=True)))


def _within(number: Any, ends: Ends) -> Scalar:
    """1 where the number of a body lies between the ends, with an axis of lanes where there are several ends."""
    if isinstance(number, int):
        inside = [float(first <= number <= last) for first, last in ends]
        return known(inside if len(ends) > 1 else inside[0])
    lower, upper = (np.array(end, float)[:, None] for end in zip(*ends, strict=True))
    inside = ((number >= lower) & (number <= upper)).astype(float)
    return Scalar(inside if len(ends) > 1 else inside[0])


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


def _ranges(tree: Tree, numbers: dict[tuple[int, int], int]) -> list[Ends]:
    """By degree of freedom."""

    def moved(dof: int, index: int) -> list[int]:
        places = (place for place in numbers if dof in tree.moving(place[0]))
        return [numbers[place] for place in places if place[1] == index or not tree.laned(dof)]

    each = [[moved(dof, index) for index in range(len(tree.dofs[dof]))] for dof in range(tree.nv)]
    return [[(min(part), max(part)) for part in lanes] for lanes in each]


def _joined(tree: Tree, touches: Sequence[Touch]) -> Touch:
    """The contacts of all groups as one. Where only some have friction, the others have four facets that are the same,
    each of a quarter of the weight."""
    if len(touches) == 1:
        return touches[0]
    worlds = touches[0].close.shape[1:]
    if any(touch.friction for touch in touches):
        touches = [
            touch if touch.friction else touch._replace(weight=Scalar(0.25) * touch.weight, friction=(ZERO, ZERO))
            for touch in touches
        ]

    def join(*parts: Any) -> Any:
        if isinstance(parts[0], Scalar) and all(part.is_known(parts[0].value) for part in parts):
            return parts[0]
        values = [part.value if isinstance(part, Scalar) else part for part in parts]
        pairs = zip(values, tree.pairs, strict=True)
        whole = jnp.concatenate([jnp.broadcast_to(jnp.asarray(v), (len(p.ones), *worlds)) for v, p in pairs])
        return Scalar(whole) if isinstance(parts[0], Scalar) else whole

    return jax.tree.map(join, *touches, is_leaf=lambda part: isinstance(part, Scalar))


def _each(tree: Tree) -> list[tuple[Capsule | Box, Capsule | Box]]:
    """All pairs."""
    return [pair for pairs in tree.pairs for pair in zip(pairs.ones, pairs.twos, strict=True)]


def _picked(flags: Bool[Array, "pairs worlds"], value: Any) -> Any:
    """Select in each world the entry whose flag is set, along the first axis."""
    return jnp.where(flags, value, jnp.zeros((), value.dtype)).sum(axis=0).astype(value.dtype)
