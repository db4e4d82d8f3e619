"""MuJoCo's contact problem, solved exactly: the accelerations and forces of a tree with soft contacts and limits.

The accelerations x minimise the convex function (see "Computation" in MuJoCo's documentation)

    1/2 x^T M x - f^T x + sum over facets and limits 1/2 weight min(0, residual(x))^2.

It is quadratic as long as the same facets push. So a Newton step to the minimum for those that push now is exact once
they stay the same, and the search stops there: x is the minimum itself.
"""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from humanoid_mjx.mechanics.scalars import Scalar
from humanoid_mjx.mechanics.tree.contacts import Stop, Touch
from humanoid_mjx.mechanics.tree.inertia import Matrix, factor
from humanoid_mjx.mechanics.tree.kinematics import Kinematics
from humanoid_mjx.mechanics.tree.pairs import Rows, pair_rows, residual, with_pairs
from humanoid_mjx.mechanics.tree.pushing import add_ground, ground_residuals
from humanoid_mjx.mechanics.tree.structure import Tree

MOST_STEPS = 20
"""Newton steps before a world is given up. From cold the worst of 10,000 random states of the lower body needs 8."""

BLOCK = 128
"""Worlds that are searched together on a CPU."""

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


class Solution(NamedTuple):
    """The minimum."""

    acceleration: list[Scalar]
    settled: Any
    """Whether it was found."""


class _Active(NamedTuple):
    """Which facets of the contacts push, and which stops."""

    ground: list[list[Any]]
    pairs: list[list[Any]]
    stops: dict[int, Any]


def solve(tree: Tree, problem: Problem, start: Sequence[Scalar]) -> Solution:
    """The minimum, searched from the facets that push at the accelerations `start`."""
    leaves, structure = jax.tree.flatten(problem)

    @jax.custom_jvp
    def search(leaves: list[Any], start: list[Any]) -> tuple[list[Any], Any]:
        return _search_blocks(tree, structure.unflatten(leaves), start)

    @search.defjvp
    def _(primals: tuple[Any, Any], tangents: tuple[Any, Any]) -> tuple[Any, Any]:
        # The minimum for the facets that push at the minimum is itself, and its derivative, while they are the same.
        leaves, start = primals
        x, settled = search(leaves, start)
        problem, at = structure.unflatten(leaves), [Scalar(value) for value in x]
        rows = pair_rows(tree, problem.kinematics, problem.pairs)
        active = _active(tree, problem, at)._replace(pairs=_active_pairs(tree, problem, rows, at))

        # Without branches, which have no transpose once their condition differs between worlds.
        def again(leaves: list[Any]) -> list[Any]:
            problem = structure.unflatten(leaves)
            matrix, right = _normal_equations(tree, problem, active)
            found = factor(tree, matrix).solve(right)
            if problem.pairs:
                rows = pair_rows(tree, problem.kinematics, problem.pairs)
                found = with_pairs(tree, matrix, right, problem.pairs, rows, active.pairs, found)
            return [v.value for v in found]

        moved = jax.jvp(again, (leaves,), (tangents[0],))[1]
        moved = [jnp.broadcast_to(m, jnp.shape(v)) for m, v in zip(moved, x, strict=True)]
        return (x, settled), (moved, jnp.zeros(settled.shape, jax.dtypes.float0))

    x, settled = search(leaves, [value.value for value in start])
    return Solution([Scalar(value) for value in x], settled)


def _search_blocks(tree: Tree, problem: Problem, start: list[Any]) -> tuple[list[Any], Any]:
    """`_search`; of more worlds than a block holds, on a CPU, block by block, those where bodies are close the last.

    Worlds of a block wait for the slowest of them and for no others, and only the last blocks compute pairs.
    """
    worlds = _worlds(problem, start)
    if not problem.pairs or worlds <= (BLOCK,) or jax.default_backend() != "cpu":
        return _search(tree, problem, start)
    near = functools.reduce(jnp.logical_or, [_any(touch.close) for touch in problem.pairs])
    order = jnp.argsort(near).astype(jnp.uint32)  # of what may be negative, each look-up would be traced at length

    def block(at: Any) -> tuple[list[Any], Any]:
        part = jax.tree.map(lambda v: v[..., at] if jnp.shape(v)[-1:] == worlds else v, (problem, start))
        return _search(tree, *part)

    found = jax.lax.map(block, jnp.pad(order, (0, -worlds[0] % BLOCK), mode="edge").reshape(-1, BLOCK))
    back = jnp.argsort(order)
    return jax.tree.map(lambda v: jnp.moveaxis(v, 0, -2).reshape(*v.shape[1:-1], -1)[..., back], found)


def _worlds(problem: Problem, start: list[Any]) -> tuple[int, ...]:
    """The shape of a scalar of all worlds."""
    return jnp.broadcast_shapes(*(jnp.shape(leaf)[-1:] for leaf in jax.tree.leaves((problem, start))))


def _search(tree: Tree, problem: Problem, start: list[Any]) -> tuple[list[Any], Any]:
    near = functools.reduce(jnp.logical_or, [touch.close.any() for touch in problem.pairs], jnp.bool_(False))

    def step(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        before, active, _, count = carry
        x, pairs = _minimum(tree, problem, active, near)
        now = _active(tree, problem, x)._replace(pairs=pairs)
        values = [v.value for v in x]
        return values, now, ~_differ(active, now) | _same(before, values), count + 1

    def going(carry: tuple[Any, ...]) -> Any:
        return ~carry[2].all() & (carry[3] < MOST_STEPS)

    worlds = _worlds(problem, start)
    start = [jnp.broadcast_to(value, (*jnp.shape(value)[:-1], *worlds)) for value in start]
    active = _active(tree, problem, [Scalar(value) for value in start])
    unsettled = jnp.zeros(worlds, bool)
    x, _, settled, _ = jax.lax.while_loop(going, step, (start, active, unsettled, jnp.int32(0)))
    return x, settled


def _differ(one: _Active, two: _Active) -> Any:
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


def _active(tree: Tree, problem: Problem, x: Sequence[Scalar]) -> _Active:
    """At these accelerations; of pairs all that are close, which is a guess."""
    ground = ground_residuals(tree, problem.kinematics, problem.ground, x)
    return _Active(
        [touch.active(v) for touch, v in zip(problem.ground, ground, strict=True)],
        [[touch.close] * (1 if touch.friction is None else 4) for touch in problem.pairs],
        {dof: stop.close & (stop.residual(x[dof]).value < 0.0) for dof, stop in problem.stops.items()},
    )


def _active_pairs(tree: Tree, problem: Problem, rows: Sequence[Rows], x: Sequence[Scalar]) -> list[list[Any]]:
    """Which facets of pairs push at these accelerations."""
    return [t.active(residual(tree, t, r, x)) for t, r in zip(problem.pairs, rows, strict=True)]


def _minimum(tree: Tree, problem: Problem, active: _Active, near: Any) -> tuple[list[Scalar], list[list[Any]]]:
    """If these facets and stops push and no others, and which facets of pairs push there.

    Args:
      near: whether in any world the bodies of any pair are close; none are computed where they are not.
    """
    matrix, right = _normal_equations(tree, problem, active)
    x = factor(tree, matrix).solve(right)
    if not problem.pairs:
        return x, []

    def joined() -> tuple[list[Any], list[list[Any]]]:
        rows = pair_rows(tree, problem.kinematics, problem.pairs)
        found = with_pairs(tree, matrix, right, problem.pairs, rows, active.pairs, x)
        return [v.value for v in found], _active_pairs(tree, problem, rows, found)

    def alone() -> tuple[list[Any], list[list[Any]]]:
        return [v.value for v in x], jax.tree.map(jnp.zeros_like, active.pairs)

    values, pairs = jax.lax.cond(near, joined, alone)
    return [Scalar(value) for value in values], pairs


def _normal_equations(tree: Tree, problem: Problem, active: _Active) -> tuple[Matrix, list[Scalar]]:
    """All but the pairs: the second derivative, and what it times the minimum is."""
    matrix, right = [list(row) for row in problem.matrix], list(problem.force)
    add_ground(tree, problem.kinematics, problem.ground, active.ground, matrix, right)
    for dof, stop in problem.stops.items():
        on = Scalar(jnp.where(active.stops[dof], stop.weight.value, 0.0))
        matrix[dof][dof] = matrix[dof][dof] + on
        right[dof] = right[dof] - on * stop.sign * stop.offset
    return matrix, right
