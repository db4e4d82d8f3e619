"""MuJoCo's contact problem, solved exactly: the accelerations and forces of a tree with soft contacts and limits.

The accelerations x minimise the convex function (see "Computation" in MuJoCo's documentation)

    1/2 x^T M x - f^T x + sum over facets and limits 1/2 weight min(0, residual(x))^2.

It is quadratic as long as the same facets push. So a Newton step to the minimum for those that push now is exact once
they stay the same, and the search stops there: x is the minimum itself.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from humanoid_mjx.mechanics.scalars import Scalar
from humanoid_mjx.mechanics.tree.blocks import search_blocks
from humanoid_mjx.mechanics.tree.inertia import factor
from humanoid_mjx.mechanics.tree.pairs import active_pairs, joined, with_pairs
from humanoid_mjx.mechanics.tree.problem import Problem, active_at, normal_equations
from humanoid_mjx.mechanics.tree.structure import Tree


class Solution(NamedTuple):
    """The minimum."""

    acceleration: list[Scalar]
    settled: Any
    """Whether it was found."""


def solve(tree: Tree, problem: Problem, start: Sequence[Scalar]) -> Solution:
    """The minimum, searched from the facets that push at the accelerations `start`."""
    leaves, structure = jax.tree.flatten(problem)

    @jax.custom_jvp
    def search(leaves: list[Any], start: list[Any]) -> tuple[list[Any], Any]:
        return search_blocks(tree, structure.unflatten(leaves), start)

    @search.defjvp
    def _(primals: tuple[Any, Any], tangents: tuple[Any, Any]) -> tuple[Any, Any]:
        # The minimum for the facets that push at the minimum is itself, and its derivative, while they are the same.
        leaves, start = primals
        x, settled = search(leaves, start)
        problem, at = structure.unflatten(leaves), [Scalar(value) for value in x]
        active = active_at(tree, problem, at)
        if problem.pairs:
            touch = joined(tree, problem.pairs)
            active = active._replace(pairs=active_pairs(tree, problem.kinematics, touch, at))

        # Without branches, which have no transpose once their condition differs between worlds.
        def again(leaves: list[Any]) -> list[Any]:
            problem = structure.unflatten(leaves)
            matrix, right = normal_equations(tree, problem, active)
            factors = factor(tree, matrix)
            found = factors.solve(right)
            if problem.pairs:
                touch, where = joined(tree, problem.pairs), problem.kinematics
                found = with_pairs(tree, where, touch, active.pairs, factors, right, found, transposed=True)
            return [v.value for v in found]

        moved = jax.jvp(again, (leaves,), (tangents[0],))[1]
        moved = [jnp.broadcast_to(m, jnp.shape(v)) for m, v in zip(moved, x, strict=True)]
        return (x, settled), (moved, jnp.zeros(settled.shape, jax.dtypes.float0))

    x, settled = search(leaves, [value.value for value in start])
    return Solution([Scalar(value) for value in x], settled)
