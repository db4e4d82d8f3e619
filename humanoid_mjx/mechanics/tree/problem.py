"""MuJoCo's contact problem, and its equations while the same constraints push.

The accelerations x minimise the convex function (see "Computation" in MuJoCo's documentation)

    1/2 x^T M x - f^T x + sum over facets and limits 1/2 weight min(0, residual(x))^2.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from humanoid_mjx.mechanics.scalars import Scalar
from humanoid_mjx.mechanics.tree.contacts import Slip, Stop, Touch
from humanoid_mjx.mechanics.tree.inertia import Matrix
from humanoid_mjx.mechanics.tree.kinematics import Kinematics
from humanoid_mjx.mechanics.tree.pushing import add_ground, ground_residuals
from humanoid_mjx.mechanics.tree.structure import Tree


class Problem(NamedTuple):
    """What the accelerations minimise."""

    matrix: Matrix
    force: list[Scalar]
    """On the degrees of freedom, all but contacts and limits."""
    kinematics: Kinematics
    ground: list[Touch]
    pairs: list[Touch]
    stops: dict[int, Stop]
    slips: dict[int, Slip]
    """By degree of freedom."""


class Solution(NamedTuple):
    """The minimum."""

    acceleration: list[Scalar]
    settled: Any
    """Whether it was found."""


class Active(NamedTuple):
    """Which facets of the contacts push, and which stops."""

    ground: list[list[Any]]
    pairs: list[Any]
    stops: dict[int, Any]
    slips: dict[int, tuple[Any, Any]]


def worlds_of(problem: Problem, start: list[Any]) -> tuple[int, ...]:
    """The shape of a scalar of all worlds."""
    return jnp.broadcast_shapes(*(jnp.shape(leaf)[-1:] for leaf in jax.tree.leaves((problem, start))))


def active_at(tree: Tree, problem: Problem, x: Sequence[Scalar]) -> Active:
    """At these accelerations, but for the pairs."""
    ground = ground_residuals(tree, problem.kinematics, problem.ground, x)
    return Active(
        [touch.active(v) for touch, v in zip(problem.ground, ground, strict=True)],
        [],
        {dof: stop.close & (stop.residual(x[dof]).value < 0.0) for dof, stop in problem.stops.items()},
        {dof: slip.active(slip.residual(x[dof])) for dof, slip in problem.slips.items()},
    )


def normal_equations(tree: Tree, problem: Problem, active: Active) -> tuple[Matrix, list[Scalar]]:
    """All but the pairs: the second derivative, and what it times the minimum is."""
    matrix, right = [list(row) for row in problem.matrix], list(problem.force)
    add_ground(tree, problem.kinematics, problem.ground, active.ground, matrix, right)
    for dof, stop in problem.stops.items():
        on = Scalar(jnp.where(active.stops[dof], stop.weight.value, 0.0))
        matrix[dof][dof] = matrix[dof][dof] + on
        right[dof] = right[dof] - on * stop.sign * stop.offset
    for dof, slip in problem.slips.items():
        up, down = active.slips[dof]
        on = Scalar(jnp.where(up | down, 0.0, slip.weight.value))
        most = Scalar(jnp.where(up, slip.most.value, jnp.where(down, -slip.most.value, 0.0)))
        matrix[dof][dof] = matrix[dof][dof] + on
        right[dof] = right[dof] - (on * slip.offset + most)
    return matrix, right
