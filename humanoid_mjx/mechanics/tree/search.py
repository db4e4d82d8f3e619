"""Newton's search for the minimum of MuJoCo's contact problem, over the facets that push."""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from humanoid_mjx.mechanics.scalars import Scalar
from humanoid_mjx.mechanics.tree.contacts import Stop, Touch
from humanoid_mjx.mechanics.tree.inertia import Matrix, factor
from humanoid_mjx.mechanics.tree.kinematics import Kinematics
from humanoid_mjx.mechanics.tree.pairs import active_pairs, all_close, joined, with_pairs
from humanoid_mjx.mechanics.tree.pushing import add_ground, ground_residuals
from humanoid_mjx.mechanics.tree.structure import Tree

SAME = 200.0
"""Rounding errors by which two accelerations may differ, as shares of the largest, and count as the same. A facet whose
force is zero but for rounding may go on and off for ever, and moves nothing."""


class Problem(NamedTuple):
    """What the accelerations minimise."""

    matrix: Matrix
    force: list[Scalar]
    """On the degrees of freedom, all but contacts and limits."""
    kinematics: Kinematics
    ground: list[Touch]
    pairs: list[Touch]
    stops: dict[int, Stop]
    """By degree of freedom."""


class Active(NamedTuple):
    """Which facets of the contacts push, and which stops."""

    ground: list[list[Any]]
    pairs: list[Any]
    stops: dict[int, Any]


def worlds_of(problem: Problem, start: list[Any]) -> tuple[int, ...]:
    """The shape of a scalar of all worlds."""
    return jnp.broadcast_shapes(*(jnp.shape(leaf)[-1:] for leaf in jax.tree.leaves((problem, start))))


def search(tree: Tree, problem: Problem, start: list[Any], most: int) -> tuple[list[Any], Any]:
    """The accelerations after at most so many steps, and where they are settled, from which on they stay."""
    near = functools.reduce(jnp.logical_or, [touch.close.any() for touch in problem.pairs], jnp.bool_(False))

    def step(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        before, active, settled, count = carry
        x, pairs = _minimum(tree, problem, active, near)
        now = active_at(tree, problem, x)._replace(pairs=pairs)
        values = [jnp.where(settled, old, v.value) for old, v in zip(before, x, strict=True)]
        return values, now, settled | ~_differ(active, now) | _same(before, values), count + 1

    def going(carry: tuple[Any, ...]) -> Any:
        return ~carry[2].all() & (carry[3] < most)

    worlds = worlds_of(problem, start)
    start = [jnp.broadcast_to(value, (*jnp.shape(value)[:-1], *worlds)) for value in start]
    active = active_at(tree, problem, [Scalar(value) for value in start])
    if problem.pairs:
        active = active._replace(pairs=all_close(problem.pairs))  # a guess
    unsettled = jnp.zeros(worlds, bool)
    x, _, settled, _ = jax.lax.while_loop(going, step, (start, active, unsettled, jnp.int32(0)))
    return x, settled


def _differ(one: Active, two: Active) -> Any:
    """In which worlds they do."""
    found = jnp.zeros((), bool)
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(two), strict=True):
        changed = a != b
        for _ in range(changed.ndim - 1):
            changed = _any(changed)
        found = found | changed
    return found


def _same(one: Sequence[Any], two: Sequence[Any]) -> Any:
    """In which worlds two accelerations are the same but for rounding."""
    change, size = jnp.zeros((), two[0].dtype), jnp.zeros((), two[0].dtype)
    for a, b in zip(one, two, strict=True):
        for part, whole in zip(*(jnp.reshape(x, (-1, jnp.shape(x)[-1])) for x in (a - b, b)), strict=True):
            change, size = jnp.maximum(change, jnp.abs(part)), jnp.maximum(size, jnp.abs(whole))
    return change <= SAME * jnp.finfo(change.dtype).eps * size


def _any(flags: Any) -> Any:
    """Along the first axis, by slices."""
    found = flags[0]
    for flag in flags[1:]:
        found = found | flag
    return found


def active_at(tree: Tree, problem: Problem, x: Sequence[Scalar]) -> Active:
    """At these accelerations, but for the pairs."""
    ground = ground_residuals(tree, problem.kinematics, problem.ground, x)
    return Active(
        [touch.active(v) for touch, v in zip(problem.ground, ground, strict=True)],
        [],
        {dof: stop.close & (stop.residual(x[dof]).value < 0.0) for dof, stop in problem.stops.items()},
    )


def _minimum(tree: Tree, problem: Problem, active: Active, near: Any) -> tuple[list[Scalar], list[Any]]:
    """If these facets and stops push and no others, and which facets of pairs push there.

    Args:
      near: whether in any world the bodies of any pair are close; none are computed where they are not.
    """
    matrix, right = normal_equations(tree, problem, active)
    factors = factor(tree, matrix)
    x = factors.solve(right)
    if not problem.pairs:
        return x, active.pairs

    def together() -> tuple[list[Any], list[Any]]:
        at, touch = problem.kinematics, joined(tree, problem.pairs)
        found = with_pairs(tree, at, touch, active.pairs, factors, right, x)
        return [v.value for v in found], active_pairs(tree, at, touch, found)

    def alone() -> tuple[list[Any], list[Any]]:
        return [v.value for v in x], [jnp.zeros_like(flags) for flags in active.pairs]

    values, pairs = jax.lax.cond(near, together, alone)
    return [Scalar(value) for value in values], pairs


def normal_equations(tree: Tree, problem: Problem, active: Active) -> tuple[Matrix, list[Scalar]]:
    """All but the pairs: the second derivative, and what it times the minimum is."""
    matrix, right = [list(row) for row in problem.matrix], list(problem.force)
    add_ground(tree, problem.kinematics, problem.ground, active.ground, matrix, right)
    for dof, stop in problem.stops.items():
        on = Scalar(jnp.where(active.stops[dof], stop.weight.value, 0.0))
        matrix[dof][dof] = matrix[dof][dof] + on
        right[dof] = right[dof] - on * stop.sign * stop.offset
    return matrix, right
