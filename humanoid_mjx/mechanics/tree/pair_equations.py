"""The equations of a tree with contacts between its bodies.

Such contacts join branches of the tree: the equations `H x = r` are no longer sparse. Each that pushes adds `G^T K G`
to H and `-G^T K offset` to r, where the rows of G are the accelerations along the directions of its frame for a unit of
that of each degree of freedom, and K is its stiffness. By Woodbury's identity the solution is then

    x - Z N (G x + offset),    Z = H^-1 G^T,    N = (K^-1 + G Z)^-1,

which takes a solution of the sparse equations for each row of G.
"""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from humanoid_mjx.mechanics.scalars import ONE, ZERO, Scalar, dot, unstack
from humanoid_mjx.mechanics.tree.algebra import WORLD, entry_at, folded, root, stacked, unfolded, with_entry
from humanoid_mjx.mechanics.tree.contacts import Touch
from humanoid_mjx.mechanics.tree.inertia import Factors
from humanoid_mjx.mechanics.tree.pairs import Flags, Slots
from humanoid_mjx.mechanics.tree.structure import Tree

Rows = list[list[Scalar]]
"""Vectors over the degrees of freedom, or a small matrix, row by row."""


def with_pairs(tree: Tree, slots: Slots, active: Flags, factors: Factors, x: Sequence[Scalar]) -> list[Scalar]:
    """The solution of the equations with these facets in them, from that without, `x`."""
    size = sum(map(len, tree.dofs))
    axes = 1 if slots.touch.friction is None else 3
    most, own = len(active[0]), (slots.rows, slots.touch._replace(close=()), active)
    index = jnp.arange(most, dtype=jnp.int32)
    pushing = functools.reduce(jnp.logical_or, active).any(axis=1)

    def after(last: Any) -> Any:
        """The next contact that pushes."""
        return jnp.where(pushing & (index > last), index, most).min()

    def further(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        count, place, start, *pasts = carry
        along, touch, flags = jax.tree.map(lambda v: entry_at(v, place), own)
        flags = [flag & (place < most) for flag in flags]  # a world that has ended computes on with others
        rows = [[along[dof][axis] if dof in along else ZERO for dof in range(size)] for axis in range(axes)]
        columns = [unfolded(factors.solve(folded(row, tree.dofs)), tree.dofs) for row in rows]

        def with_another(other: Any, columns: Any) -> Any:
            others, inner = (_rows(entry_at(past, other), axes) for past in pasts)
            felt = [[dot(column, row) for column in others] for row in rows]
            shares = [[dot(line, part) for line in inner] for part in felt]
            each = zip(_rows(columns, axes), shares, strict=True)
            return stacked([v for column, share in each for v in _less(column, share, others)])

        columns = jax.lax.fori_loop(0, count, with_another, stacked([v for column in columns for v in column]))
        whole, (x,), columns = columns, _rows(start, 1), _rows(columns, axes)
        inner = _inner(touch, flags, [[dot(row, column) for column in columns] for row in rows])
        residual = [dot(row, x) + offset for row, offset in zip(rows, touch.offset, strict=False)]
        x = _less(x, [dot(line, residual) for line in inner], columns)
        made = whole, stacked([entry for line in inner for entry in line])
        pasts = [with_entry(past, count, new) for past, new in zip(pasts, made, strict=True)]
        return count + 1, after(place), stacked(x), *pasts

    start = stacked(unfolded(x, tree.dofs))
    nothing = (jnp.zeros((most, axes * count, *WORLD), start.dtype) for count in (size, axes))
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
