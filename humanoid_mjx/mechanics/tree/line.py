"""The lowest point of the contact problem along a line, along which it is quadratic piece by piece."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from humanoid_mjx.mechanics.scalars import Scalar
from humanoid_mjx.mechanics.tree.inertia import product
from humanoid_mjx.mechanics.tree.pairs import pair_residuals
from humanoid_mjx.mechanics.tree.problem import Problem, ground_residuals
from humanoid_mjx.mechanics.tree.structure import Tree

MOST_ROUNDS = 30
"""Newton steps along a line. A step that ends early is still one downhill."""


class Rows(NamedTuple):
    """Constraints along a line: their residuals are `start + share * slope`."""

    weight: Float[Array, "rows worlds"]
    """0 where a constraint does not count."""
    start: Float[Array, "rows worlds"]
    slope: Float[Array, "rows worlds"]

    def at(self, share: Any) -> Float[Array, "rows worlds"]:
        """The residuals."""
        return self.start + share * self.slope


def lowest_share(tree: Tree, problem: Problem, pairs: Any, before: Sequence[Scalar], after: Sequence[Scalar]) -> Any:
    """The share of the way from `before` to `after` at which the problem is lowest, by world.

    Args:
      tree: and
      problem: what the accelerations minimise.
      pairs: the contacts of all pairs (`pairs.joined`); None where there are none.
      before: accelerations from which the way leads downhill.
      after: accelerations that are 1 along it.
    """
    worlds = jnp.broadcast_shapes(*(jnp.shape(v.value)[-1:] for v in after))
    way = [two - one for one, two in zip(before, after, strict=True)]
    weighed = product(tree, problem.matrix, before), product(tree, problem.matrix, way)
    slope = _along(tree, way, [a - f for a, f in zip(weighed[0], problem.force, strict=True)])
    curve = _along(tree, way, weighed[1])
    pushing = _pushing(tree, problem, pairs, before, after, worlds)
    rubbing, most = _rubbing(tree, problem, before, after, worlds)

    def derivatives(share: Any) -> tuple[Any, Any]:
        residual, (force, on) = pushing.at(share), (rubbing.weight * rubbing.at(share), rubbing.weight)
        active = jnp.where(residual < 0.0, pushing.weight, 0.0)
        first = slope + share * curve + (active * residual * pushing.slope).sum(axis=0)
        second = curve + (active * pushing.slope * pushing.slope).sum(axis=0)
        first = first + (jnp.clip(force, -most, most) * rubbing.slope).sum(axis=0)
        sticks = jnp.where(jnp.abs(force) < most, on, 0.0)
        return first, second + (sticks * rubbing.slope * rubbing.slope).sum(axis=0)

    def step(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        share, low, high, _, count = carry
        first, second = derivatives(share)
        low, high = jnp.where(first < 0.0, share, low), jnp.where(first < 0.0, high, share)
        new = share - first / jnp.where(second > 0.0, second, 1.0)
        halfway = jnp.where(jnp.isfinite(high), 0.5 * (low + high), 2.0 * share)
        new = jnp.where((new > low) & (new < high), new, halfway)
        near = jnp.abs(new - share) <= 4.0 * jnp.finfo(new.dtype).eps * share
        return new, low, high, near | (first == 0.0), count + 1

    start = jnp.ones(worlds, curve.dtype)
    carry = start, jnp.zeros_like(start), jnp.full_like(start, jnp.inf), jnp.zeros(worlds, bool), jnp.int32(0)
    return jax.lax.while_loop(lambda carry: ~carry[3].all() & (carry[4] < MOST_ROUNDS), step, carry)[0]


def _along(tree: Tree, way: Sequence[Scalar], force: Sequence[Scalar]) -> Any:
    """The scalar product over the degrees of freedom of all lanes."""
    total: Any = 0.0
    for dof, (one, two) in enumerate(zip(way, force, strict=True)):
        part = (one * two).value
        if tree.laned(dof):
            part = jnp.broadcast_to(part, (tree.lanes, *jnp.shape(part)[-1:])).sum(axis=0)
        total = total + part
    return total


def _pushing(
    tree: Tree, problem: Problem, pairs: Any, before: Sequence[Scalar], after: Sequence[Scalar], worlds: tuple[int, ...]
) -> Rows:
    """One-sided constraints: facets of contacts, and ends of ranges."""
    found: list[tuple[Any, ...]] = []
    grounds = (ground_residuals(tree, problem.kinematics, problem.ground, x) for x in (before, after))
    for points, touch, one, two in zip(tree.ground, problem.ground, *grounds, strict=True):
        lanes = (tree.lanes,) * tree.bodies[points.body].laned
        count = len(points.order) // max([1, *lanes])
        shape = (*(count,) * (count > 1), *lanes, *worlds)
        for a, b in zip(touch.facets(one), touch.facets(two), strict=True):
            found.append(_row(touch.close, touch.weight, a, b, shape))
    if pairs is not None:
        shape = sum(len(group.ones) for group in tree.pairs), *worlds
        residuals = (pairs.facets(pair_residuals(tree, problem.kinematics, pairs, x)) for x in (before, after))
        found += [_row(pairs.close, pairs.weight, a, b, shape) for a, b in zip(*residuals, strict=True)]
    for dof, stop in problem.stops.items():
        shape = (*(tree.lanes,) * tree.laned(dof), *worlds)
        found.append(_row(stop.close, stop.weight, stop.residual(before[dof]), stop.residual(after[dof]), shape))
    return _rows(found, worlds)


def _rubbing(
    tree: Tree, problem: Problem, before: Sequence[Scalar], after: Sequence[Scalar], worlds: tuple[int, ...]
) -> tuple[Rows, Any]:
    """Dry friction, and its largest forces."""
    found, most = [], []
    for dof, slip in problem.slips.items():
        shape = (*(tree.lanes,) * tree.laned(dof), *worlds)
        found.append(_row(True, slip.weight, slip.residual(before[dof]), slip.residual(after[dof]), shape))
        most.append(jnp.broadcast_to(jnp.asarray(slip.most.value, float), shape).reshape(-1, *worlds))
    return _rows(found, worlds), jnp.concatenate(most) if most else jnp.zeros((0, *worlds))


def _row(close: Any, weight: Scalar, one: Scalar, two: Scalar, shape: tuple[int, ...]) -> tuple[Any, ...]:
    parts = jnp.where(close, weight.value, 0.0), one.value, (two - one).value
    return tuple(jnp.broadcast_to(jnp.asarray(part, float), shape).reshape(-1, shape[-1]) for part in parts)


def _rows(found: Sequence[tuple[Any, ...]], worlds: tuple[int, ...]) -> Rows:
    if not found:
        return Rows(*(jnp.zeros((0, *worlds)) for _ in range(3)))
    return Rows(*(jnp.concatenate(parts) for parts in zip(*found, strict=True)))
