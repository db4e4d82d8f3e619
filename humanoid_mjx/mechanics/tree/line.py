"""The lowest point of the contact problem along a line, along which it is quadratic piece by piece."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from humanoid_mjx.mechanics.tree.algebra import dot, turn
from humanoid_mjx.mechanics.tree.cones import Cone
from humanoid_mjx.mechanics.tree.contacts import Stop, Touch
from humanoid_mjx.mechanics.tree.inertia import product
from humanoid_mjx.mechanics.tree.problem import Active, Problem, ground_residuals, rubbed
from humanoid_mjx.mechanics.tree.structure import Tree

MOST_ROUNDS, NEAR = 8, 1e-3
"""Newton steps along a line, and by which share the last may change its length. A step that ends early is still one
downhill. At this share a thousandth of a Go1's worlds did not settle with 4 steps, and all did with 6 and 8."""

ROUNDS_WITH_CONES, LOW = 10, 0.1
"""With elliptic cones, which bend the problem along a line: steps, and the share of the slope that may be left."""


def lowest_share(
    tree: Tree, problem: Problem, active: Active, now: Active, before: Sequence[Any], after: Sequence[Any], known: Any
) -> Any:
    """The share of the way from `before` to `after` at which the problem is lowest, in this world.

    The slope along the way is zero at `after` as long as the same facets push. So only facets that change add to it:
    no large forces cancel, and float32 finds a facet that changes even where little is gained. `active`: the facets
    that push in the equations that `after` solves, and `now`, at `after`. `known`: true where the share is of no use.
    """
    way = [two - one for one, two in zip(before, after, strict=True)]
    curve = _along(tree, way, product(tree, problem.matrix, way))
    # Residuals of constraints along the line are `start + share * slope`; the weight is 0 where one does not count.
    weight, push_start, push_slope, pushed = _pushing(tree, problem, active, before, after)
    bends = list(_bends(problem, active, now))
    stick, rub_start, rub_slope, most, up, down = _rubbing(tree, problem, active, before, after)
    push, rub = weight * push_slope, stick * rub_slope
    held = _sum(jnp.where(pushed, push * push_slope, 0.0))
    for bend in bends:
        held = held + _sum(bend.second)
    whole = curve + held + _sum(jnp.where(up | down, 0.0, rub * rub_slope))

    def derivatives(share: Any) -> tuple[Any, Any]:
        residual, force = push_start + share * push_slope, stick * (rub_start + share * rub_slope)
        pushes, sticks = residual < 0.0, jnp.abs(force) < most
        first = _sum(jnp.where(pushes == pushed, 0.0, jnp.where(pushes, push, -push) * residual))
        was = jnp.where(up, most, jnp.where(down, -most, force))
        first = first + _sum((jnp.clip(force, -most, most) - was) * rub_slope)
        second = curve + _sum(jnp.where(pushes, push * push_slope, 0.0))
        second = second + _sum(jnp.where(sticks, rub * rub_slope, 0.0))
        for bend in bends:
            change, own = bend.at(share)
            first, second = first + change, second + own
        return first + (share - 1.0) * whole, second

    def step(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        share, low, high, _, count = carry
        first, second = derivatives(share)
        low, high = jnp.where(first < 0.0, share, low), jnp.where(first < 0.0, high, share)
        new = share - first / jnp.where(second > 0.0, second, 1.0)
        halfway = jnp.where(jnp.isfinite(high), 0.5 * (low + high), 2.0 * share)
        found = first == 0.0
        low_enough = jnp.abs(first) <= LOW * whole if bends else found
        halfway = jnp.where(low_enough, share, halfway) if bends else halfway
        new = jnp.where(((new > low) & (new < high)) | found, new, halfway)
        near = jnp.abs(new - share) <= NEAR * share
        return new, low, high, near | low_enough | known, count + 1

    start = jnp.ones((1,), curve.dtype)
    carry = start, jnp.zeros_like(start), jnp.full_like(start, jnp.inf), jnp.zeros((1,), bool), jnp.int32(0)
    rounds = ROUNDS_WITH_CONES if bends else MOST_ROUNDS
    return jax.lax.while_loop(lambda carry: ~carry[3].all() & (carry[4] < rounds), step, carry)[0]


class Bends(NamedTuple):
    """Contacts with elliptic cones along a line, in the frames of these: their residuals are `start + share * way`."""

    weight: Any
    cone: Cone
    start: Any
    way: Any
    first: Any
    second: Any
    """Derivatives of their cost along the way in the equations, at the start."""

    def at(self, share: Any) -> tuple[Any, Any]:
        """By how much the first derivative of their cost exceeds that in the equations, and the second."""
        first, second = (self.weight * part for part in self.cone.along(self.start + share * self.way, self.way))
        return _sum(first - (self.first + share * self.second)), _sum(second)


def _bends(problem: Problem, active: Active, now: Active) -> Iterator[Bends]:
    touches = [*problem.ground, *([problem.slots.touch] if problem.slots else ())]
    for touch, start, end in zip(touches, (*active.ground, active.pairs), (*now.ground, now.pairs), strict=False):
        if isinstance(touch.friction, Cone):
            weight, way = jnp.where(touch.close, touch.weight, 0.0), end - start
            pull, rate = (turn(touch.friction.root(start), v) for v in (start, way))
            yield Bends(weight, touch.friction, start, way, weight * dot(pull, rate), weight * dot(rate, rate))


def _along(tree: Tree, way: Sequence[Any], force: Sequence[Any]) -> Any:
    """The scalar product over the degrees of freedom of all lanes."""
    total: Any = 0.0
    lanes: Any = jnp.zeros((tree.lanes, 1))
    for dof, (one, two) in enumerate(zip(way, force, strict=True)):
        if tree.laned(dof):
            lanes = lanes + one * two
        else:
            total = total + (one * two)[0]
    return total + lanes.sum(axis=0)


def _pushing(tree: Tree, problem: Problem, active: Active, before: Sequence[Any], after: Sequence[Any]) -> list[Any]:
    """One-sided constraints, facets of contacts and ends of ranges: weights, starts and slopes, (rows, lanes, 1), and
    which of them `active` has."""
    found, slots = list[tuple[Any, ...]](), problem.slots
    grounds = (ground_residuals(tree, problem.kinematics, problem.ground, x) for x in (before, after))
    for touch, flags, one, two in zip(problem.ground, active.ground, *grounds, strict=True):
        if not isinstance(touch.friction, Cone):
            found.append(_row(touch, touch.facets(one), touch.facets(two), flags))
    if slots and not isinstance(slots.touch.friction, Cone):
        found.append(_row(slots.touch, slots.facets(tree, before), slots.facets(tree, after), active.pairs))
    for dof, stop in problem.stops.items():
        found.append(_row(stop, stop.residual(before[dof]), stop.residual(after[dof]), active.stops[dof]))
    return _together(found, (float, float, float, bool), tree)


def _rubbing(tree: Tree, problem: Problem, active: Active, before: Sequence[Any], after: Sequence[Any]) -> list[Any]:
    """Dry friction: weights, starts, slopes, largest forces, and where `active` has these, by sign of the residual."""
    found = []
    before, after = rubbed(tree, problem, before), rubbed(tree, problem, after)
    for dof, slip in problem.slips.items():
        one, two = slip.residual(before[dof]), slip.residual(after[dof])
        found.append((slip.weight, one, two - one, slip.most, *active.slips[dof]))
    return _together(found, (float, float, float, float, bool, bool), tree)


def _row(one_sided: Touch | Stop, one: Any, two: Any, flag: Any) -> tuple[Any, ...]:
    weight = jnp.where(one_sided.close, one_sided.weight, 0.0)
    return weight if weight.ndim == one.ndim else weight[..., None, :, :], one, two - one, flag


def _together(found: Sequence[tuple[Any, ...]], types: Sequence[type], tree: Tree) -> list[Any]:
    """The parts of all rows, one below the other; of each type even where there are no rows.

    Constraints of which each lane has its own keep the axis, and the others are spread over the lanes.
    """
    lanes = tree.lanes
    whole = [jnp.broadcast_arrays(*row) for row in found]

    def rows(parts: Sequence[Any], kind: type) -> Any:
        own = [part.reshape(-1, lanes, 1) for part in parts if part.shape[-2] == lanes]
        others = [part.reshape(-1, 1) for part in parts if part.shape[-2] != lanes]
        lack = -sum(len(part) for part in others) % lanes
        others = jnp.concatenate([*others, jnp.zeros((lack, 1), kind)])
        return jnp.concatenate([*own, others.reshape(-1, lanes, 1)])

    parts = zip(*whole, strict=True) if whole else [()] * len(types)
    return [rows(part, kind) for part, kind in zip(parts, types, strict=True)]


def _sum(rows: Float[Array, "... lanes 1"]) -> Float[Array, " 1"]:
    return rows.reshape(-1, *rows.shape[-2:]).sum(axis=0).sum(axis=0)
