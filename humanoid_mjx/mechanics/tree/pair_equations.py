"""The equations of a tree with contacts between its bodies.

Such contacts join branches of the tree: the equations `H x = r` are no longer sparse. Each that pushes adds `G^T K G`
to H and `-G^T K offset` to r, where the rows of G are the accelerations along the directions of its frame for a unit of
that of each degree of freedom, and K is its stiffness. By Woodbury's identity the solution is then

    x - Z N (G x + offset),    Z = H^-1 G^T,    N = (K^-1 + G Z)^-1,

which takes a solution of the sparse equations for each row of G.
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx.mechanics.tree.algebra import (
    compose,
    entry_at,
    folded,
    stacked,
    symmetric,
    transposed,
    turn,
    unfolded,
    with_entry,
)
from humanoid_mjx.mechanics.tree.cones import Cone
from humanoid_mjx.mechanics.tree.contacts import Touch
from humanoid_mjx.mechanics.tree.inertia import Factors
from humanoid_mjx.mechanics.tree.pairs import Flags, Slots
from humanoid_mjx.mechanics.tree.structure import Tree


def with_pairs(tree: Tree, slots: Slots, active: Flags, factors: Factors, x: Sequence[Any]) -> list[Any]:
    """The solution of the equations with these facets in them, from that without, `x`."""
    size, most = sum(map(len, tree.dofs)), len(active)
    axes = 1 if slots.touch.friction is None else 3
    own = slots.rows, slots.touch._replace(close=()), active
    index = jnp.arange(most, dtype=jnp.int32)
    pushing = (slots.touch.close if isinstance(slots.touch.friction, Cone) else active.any(axis=1))[:, 0, 0]
    none = jnp.zeros((axes, 1, 1))

    def after(last: Any) -> Any:
        """The next contact that pushes."""
        return jnp.where(pushing & (index > last), index, most).min()

    def further(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        count, place, x, *pasts = carry
        along, touch, flags = jax.tree.map(lambda v: entry_at(v, place), own)
        flags = touch.only(place < most, flags)  # a world that has ended computes on with others
        each = dict(zip(slots.dofs, along[:, :axes], strict=True))
        rows = jnp.stack([each.get(dof, none) for dof in range(size)], axis=1)
        columns = stacked([stacked(unfolded(factors.solve(folded(row, tree.dofs)), tree.dofs)) for row in rows])

        def with_another(other: Any, columns: Any) -> Any:
            others, inner = (entry_at(past, other) for past in pasts)
            return columns - compose(compose(compose(rows, transposed(others)), inner), others)

        columns = jax.lax.fori_loop(0, count, with_another, columns)
        inner = _inner(touch, flags, compose(rows, transposed(columns)))
        x = x - turn(transposed(columns), turn(inner, turn(rows, x) + touch.offset[:axes]))
        pasts = [with_entry(past, count, new) for past, new in zip(pasts, (columns, inner), strict=True)]
        return count + 1, after(place), x, *pasts

    start = stacked(unfolded(x, tree.dofs))
    nothing = (jnp.zeros((most, axes, count, 1, 1), start.dtype) for count in (size, axes))
    begin = jnp.int32(0), after(jnp.int32(-1)), start, *nothing
    return folded(jax.lax.while_loop(lambda carry: carry[1] < most, further, begin)[2], tree.dofs)


def _inner(touch: Touch, flags: Any, compliance: Any) -> Any:
    """N, with which these facets push: `R^T (1 + R C R^T)^-1 R`, where `K = R^T R` and C is the compliance G Z.

    K is not inverted: it is singular where not all facets push.
    """
    rows = _root(touch, flags)
    felt = compose(compose(rows, compliance), transposed(rows))
    lower, scales, reduced = list[Any](), list[Any](), list[Any]()
    for index, row in enumerate(rows):
        # A row of the factors L D L^T of 1 + R C R^T, and one of L^-1 R.
        line: list[Any] = []
        for other in range(index):
            done = sum(a * b * c for a, b, c in zip(line, lower[other], scales, strict=False))
            line.append((felt[index, other] - done) / scales[other])
        scales.append(felt[index, index] + 1.0 - sum(a * a * b for a, b in zip(line, scales, strict=True)))
        lower.append(line)
        reduced.append(row - sum(a * past for a, past in zip(line, reduced, strict=True)))
    whole = stacked(reduced)
    return symmetric(compose(transposed(whole * (1.0 / stacked(scales))[:, None]), whole))


def _root(touch: Touch, flags: Any) -> Any:
    """R, the root of the stiffness K that these facets have: of a pyramid's upper triangular.

    It is that of the number of facets, scaled: the sum over facets loses what friction adds where there is little.
    """
    if isinstance(touch.friction, Cone):
        return touch.root(flags)
    weight = jnp.sqrt(touch.weight)
    one, *others = jnp.where(flags, jnp.ones_like(weight), 0.0)
    if touch.friction is None:
        return (weight * one)[None, None]
    two, three, four = others
    first, over_first = _pivot(one + two + three + four)
    up, across = (one - two) * over_first, (three - four) * over_first
    second, over_second = _pivot(one + two - up * up)
    both = -(up * across) * over_second
    third = _pivot(three + four - across * across - both * both)[0]
    (mu, nu), zero = (weight * part for part in touch.friction), np.zeros((1, 1))
    rows = (weight * first, mu * up, nu * across), (zero, mu * second, nu * both), (zero, zero, nu * third)
    return stacked([stacked(row) for row in rows])


def _pivot(square: Any) -> tuple[Any, Any]:
    """A root and its inverse, both 0 where the square is 0 but for rounding; else it is a third or more."""
    some = square > 1e-3
    length = jnp.sqrt(jnp.where(some, square, 1.0))
    return jnp.where(some, length, 0.0), jnp.where(some, 1.0 / length, 0.0)
