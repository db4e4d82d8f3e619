"""Contacts between bodies in the equations of a tree: updates of the factors, facet by facet.

They join branches of the tree, so the factors are no longer sparse. But few bodies touch at a time, and each facet that
pushes is an update of rank one (P. Gill et al., "Methods for Modifying Matrix Factorizations", 1974, method C1).
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from humanoid_mjx.mechanics.scalars import ZERO, Scalar, Vector, add, dot
from humanoid_mjx.mechanics.tree.algebra import (
    force_at,
    known,
    lane,
    over_lanes,
    power,
    resolve,
    stacked,
    velocity_at,
)
from humanoid_mjx.mechanics.tree.contacts import Touch, apart
from humanoid_mjx.mechanics.tree.inertia import Factors
from humanoid_mjx.mechanics.tree.kinematics import Kinematics, motions_of
from humanoid_mjx.mechanics.tree.structure import Box, Capsule, Tree

SLOTS = 16
"""Contacts that a world may have at a time of pairs that `few_close` picks."""

Flags = list[Bool[Array, "pairs worlds"]]
"""Mask of the facets that push, of the contacts of all pairs."""

Dense = tuple[list[Any], Any, Any]
"""Of the equations of all lanes the rows of L to the left of its diagonal, 1 / D, and the right side."""


def joined(tree: Tree, touches: Sequence[Touch]) -> Touch:
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
        values = [part.value if isinstance(part, Scalar) else part for part in parts]
        pairs = zip(values, tree.pairs, strict=True)
        whole = jnp.concatenate([jnp.broadcast_to(jnp.asarray(v), (len(p.ones), *worlds)) for v, p in pairs])
        return Scalar(whole) if isinstance(parts[0], Scalar) else whole

    return jax.tree.map(join, *touches, is_leaf=lambda part: isinstance(part, Scalar))


def few_close(tree: Tree, kinematics: Kinematics, touch: Touch, worlds: Any) -> tuple[Touch, Bool[Array, " worlds"]]:
    """The contacts of the first `SLOTS` pairs that are close in each of these worlds, and where more are.

    Args:
      tree: and
      kinematics: of these worlds.
      touch: the contacts of all pairs (`joined`) of all worlds.
      worlds: indices of these.
    """
    left, size = touch.close[:, worlds], len(touch.close)
    index, slots = jnp.arange(size, dtype=jnp.uint32)[:, None], []
    for _ in range(SLOTS + 1):
        slots.append(jnp.where(left, index, size).min(axis=0))
        left = left & (index > slots[-1])
    more, slot = slots.pop() < size, jnp.stack(slots)
    pair = jnp.minimum(slot, size - 1)
    found = jax.tree.map(lambda v: jnp.broadcast_to(v, touch.close.shape)[pair, worlds], touch)
    table = jnp.array([_alone(tree, *place) for place in _places(tree)], float)
    wide, rows = jax.tree.map(lambda v: v[:, None], found), []
    for dof, sign in enumerate(_folded(tree, list(table[:, pair]))):
        at, sign = (wide, jnp.moveaxis(sign, 0, 1)) if tree.laned(dof) else (found, sign)
        moved = at.facets(resolve(at.frame, velocity_at(kinematics.motions[dof], at.place)))
        rows.append([Scalar(sign) * facet for facet in moved])
    return found._replace(close=slot < size, rows=list(map(list, zip(*rows, strict=True)))), more


def all_close(touches: Sequence[Touch]) -> Flags:
    """The facets of all bodies that are close."""
    close = jnp.concatenate([touch.close for touch in touches])
    return [close] * (4 if any(touch.friction for touch in touches) else 1)


def pair_residuals(tree: Tree, kinematics: Kinematics, touch: Touch, x: Sequence[Scalar]) -> list[Scalar]:
    """By how much the bodies of pairs part faster than they should, along each facet; `touch`: the contacts of all
    pairs (`joined`)."""
    if touch.rows is None:
        ones, twos = zip(*_each(tree), strict=True)
        moved = apart(ones, twos, motions_of(tree, kinematics, x), touch.place)
        return touch.facets(add(resolve(touch.frame, moved), touch.offset))
    stem = sum(not tree.laned(dof) for dof in range(tree.nv))
    laned = over_lanes([dot(row[stem:], x[stem:]) for row in touch.rows], tree.lanes)
    each = zip(touch.rows, laned, touch.facets(touch.offset), strict=True)
    return [dot(row[:stem], x[:stem]) + part + offset for row, part, offset in each]


def with_pairs(
    tree: Tree,
    kinematics: Kinematics,
    touch: Touch,
    active: Flags,
    factors: Factors,
    right: Sequence[Scalar],
    without: Sequence[Scalar],
) -> list[Scalar]:
    """The solution of the equations with these facets in them, or that `without` in worlds where none pushes."""
    flags = jnp.concatenate(active)
    pairs, worlds = active[0].shape[0], flags.shape[1:]
    counts = [jnp.zeros(worlds, jnp.int32)]
    for flag in flags:
        counts.append(counts[-1] + flag.astype(jnp.int32))
    rank, count = jnp.stack(counts[:-1]), counts[-1]
    signs = [_sign(tree, dof) for dof in range(tree.nv)]
    vectors = [*(Vector(*parts) for parts in zip(*touch.frame, strict=True)), touch.offset]
    x, y, z, offset = (stacked(touch.facets(v), (pairs, *worlds)).reshape(-1, *worlds) for v in vectors)

    def add_facet(index: Any, dense: Dense) -> Dense:
        """Add to each world its next active facet."""
        mine = flags & (rank == index)
        pair = mine.reshape(len(active), pairs, *worlds).any(axis=0)
        if touch.rows is None:
            place, sign = jax.tree.map(lambda v: _picked(pair, v), (touch.place, signs))
            force = force_at(Vector(*(Scalar(_picked(mine, part)) for part in (x, y, z))), place)
            row = [s * power(motion, force) for s, motion in zip(sign, kinematics.motions, strict=True)]
        else:
            each = (jnp.concatenate([facet.value for facet in facets]) for facets in zip(*touch.rows, strict=True))
            row = [Scalar(_picked(mine, part)) for part in each]
        on = jnp.where(index < count, _picked(pair, touch.weight.value), 0.0)
        return _updated(dense, _unfolded(tree, row, worlds), on, _picked(mine, offset))

    dense = _dense(tree, factors, worlds), _unfolded(tree, factors.inverse, worlds), _unfolded(tree, right, worlds)
    dense = jax.lax.while_loop(
        lambda carry: (carry[0] < count).any(),
        lambda carry: (carry[0] + 1, add_facet(*carry)),
        (jnp.int32(0), dense),
    )[1]
    # A world's bits must not depend on whether another made its batch come here.
    found = zip(_folded(tree, _solved(dense)), without, strict=True)
    return [Scalar(jnp.where(count > 0, new, old.value)) for new, old in found]


def _picked(flags: Bool[Array, "pairs worlds"], value: Any) -> Any:
    """Select in each world the entry whose flag is set, along the first axis if there is one."""
    if jnp.ndim(value) < 2:
        return value
    return jnp.where(flags[:, None] if jnp.ndim(value) > 2 else flags, value, 0.0).sum(axis=0)


def _each(tree: Tree) -> list[tuple[Capsule | Box, Capsule | Box]]:
    """All pairs."""
    return [pair for pairs in tree.pairs for pair in zip(pairs.ones, pairs.twos, strict=True)]


def _sign(tree: Tree, dof: int) -> Scalar:
    """`_alone`, with an axis of lanes behind where the degree of freedom has one."""
    each = [_alone(tree, dof, index) for index in range(len(tree.dofs[dof]))]
    return known(np.stack(each, axis=-1) if tree.laned(dof) else each[0])


def _alone(tree: Tree, dof: int, index: int) -> list[float]:
    """1 where a degree of freedom of a lane moves a pair's second body alone, -1 where it moves the first alone, by
    pair."""

    def moves(shape: Capsule | Box) -> bool:
        return dof in tree.moving(shape.body) and (index == shape.lane or not tree.laned(dof))

    return [float(moves(two)) - float(moves(one)) for one, two in _each(tree)]


def _places(tree: Tree) -> list[tuple[int, int]]:
    """The degrees of freedom of all lanes with their lanes, lane by lane."""
    laned = [dof for dof in range(tree.nv) if tree.laned(dof)]
    stem = [(dof, 0) for dof in range(tree.nv) if not tree.laned(dof)]
    return stem + [(dof, index) for index in range(tree.lanes) for dof in laned]


def _unfolded(tree: Tree, scalars: Sequence[Scalar], worlds: tuple[int, ...]) -> Float[Array, "size worlds"]:
    """Scalars of the degrees of freedom of all lanes."""
    return stacked([lane(scalars[dof], index) for dof, index in _places(tree)], worlds)


def _folded(tree: Tree, x: Sequence[Any]) -> list[Any]:
    """The inverse of `_unfolded`."""
    found = dict(zip(_places(tree), x, strict=True))
    lanes = [range(tree.lanes) if tree.laned(dof) else range(1) for dof in range(tree.nv)]
    each = [[found[dof, index] for index in several] for dof, several in enumerate(lanes)]
    return [jnp.stack(several) if tree.laned(dof) else several[0] for dof, several in enumerate(each)]


def _dense(tree: Tree, factors: Factors, worlds: tuple[int, ...]) -> list[Float[Array, "columns worlds"]]:
    """The rows of L, of all lanes."""
    places, rows = _places(tree), []
    for row, (dof, index) in enumerate(places):
        joint = [not tree.laned(other) or index == own for other, own in places[:row]]
        lower = zip(joint, places[:row], strict=True)
        rows.append(stacked([lane(factors.lower[dof][o], index) if same else ZERO for same, (o, _) in lower], worlds))
    return rows


def _updated(dense: Dense, row: Any, weight: Any, offset: Any) -> Dense:
    """The equations with one more facet, of this row and weight; a weight of 0 changes nothing."""
    lower, inverse, right = dense
    lower, scales, right = list(lower), [], right - weight * offset * row
    for last in reversed(range(len(lower))):
        one, row = row[last], row[:last]
        slope = one * inverse[last]
        scale = 1.0 / (1.0 + weight * one * slope)
        row = row - one * lower[last]
        lower[last] = lower[last] + weight * slope * scale * row
        weight = weight * scale
        scales.append(scale)
    return lower, inverse * jnp.stack(scales[::-1]), right


def _solved(dense: Dense) -> list[Any]:
    """The solution of the equations."""
    lower, inverse, right = dense
    half, x = [], []
    for row in reversed(lower):
        half.append(right[-1])
        right = right[:-1] - right[-1] * row
    for row, scale, value in zip(lower, inverse, reversed(half), strict=True):
        x.append(value * scale - sum(part * other for part, other in zip(row, x, strict=True)))
    return x
