"""MuJoCo's contact problem, and its equations while the same constraints push.

The accelerations x minimise the convex function (see "Computation" in MuJoCo's documentation)

    1/2 x^T M x - f^T x + sum over facets and limits 1/2 weight min(0, residual(x))^2.

The ground's contacts add to the equations of a tree body by body, as a composite inertia does.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp

from humanoid_mjx.mechanics.tree.algebra import block, column, compose, cross, force_at, symmetric, transposed, turn
from humanoid_mjx.mechanics.tree.contacts import Friction, GapAt, Slip, Stop, Touch
from humanoid_mjx.mechanics.tree.inertia import Matrix, felt, felt_forces, with_diagonal
from humanoid_mjx.mechanics.tree.kinematics import Kinematics, motions_of, to_local
from humanoid_mjx.mechanics.tree.structure import Tree


def ground_residuals(tree: Tree, kinematics: Kinematics, touches: Sequence[Touch], x: Sequence[Any]) -> list[Any]:
    """By how much the bodies accelerate more than they should, in the contacts' frames."""
    motions = motions_of(tree, kinematics, x)
    return [touch.residual(motions[points.body]) for points, touch in zip(tree.ground, touches, strict=True)]


def _of_points(touch: Touch, active: Any) -> tuple[Any, Any]:
    """The stiffness of all points of a body together, minus the derivative of their force by its acceleration, and
    their force against an acceleration of 0; about the origin."""
    local, frame, place = touch.stiffness(active), touch.frame, touch.place[..., None, :, :, :]
    push = force_at(turn(transposed(frame), turn(local, touch.offset)), touch.place)
    linear = symmetric(compose(transposed(frame), compose(local, frame)))
    mixed = cross(place, linear)
    angular = symmetric(cross(place, transposed(mixed)))
    return block(linear, mixed, transposed(mixed), angular).sum(axis=0), push.sum(axis=0)


class Problem(NamedTuple):
    """Cost that the accelerations minimise."""

    matrix: Matrix
    force: list[Any]
    """On the degrees of freedom, all but contacts and limits."""
    kinematics: Kinematics
    velocity: list[Any]
    """Of the degrees of freedom, in the axes of `State.velocity`."""
    ground: list[Touch]
    pairs: list[tuple[GapAt, Friction]]
    """Gaps of the pairs of bodies, and their coefficients of friction, group by group."""
    stops: dict[int, Stop]
    slips: dict[int, Slip]
    """By degree of freedom."""
    ended: Any = False
    """True where the solution is of no use, so that other worlds of a kernel do not wait for it."""
    slots: Any = None
    """Contacts of the pairs that are close, `pairs.Slots`, where there are pairs; the search finds them."""


class Solution(NamedTuple):
    """The minimum."""

    acceleration: list[Any]
    settled: Any
    """True if it was found."""


class Active(NamedTuple):
    """Masks of the constraints that push: facets of contacts, ends of ranges, dry friction."""

    ground: list[Any]
    pairs: Any
    stops: dict[int, Any]
    slips: dict[int, tuple[Any, Any]]


def rubbed(tree: Tree, problem: Problem, x: Sequence[Any]) -> list[Any]:
    """The accelerations that dry friction feels, in the axes of `qvel`."""
    return to_local(tree, problem.kinematics, x) if tree.drag and tree.drag.dry else list(x)


def active_at(tree: Tree, problem: Problem, x: Sequence[Any]) -> Active:
    """The constraints that push at these accelerations, without those of pairs."""
    slid = rubbed(tree, problem, x)
    ground = ground_residuals(tree, problem.kinematics, problem.ground, x)
    return Active(
        [touch.active(touch.facets(v)) for touch, v in zip(problem.ground, ground, strict=True)],
        None,
        {dof: stop.close & (stop.residual(x[dof]) < 0.0) for dof, stop in problem.stops.items()},
        {dof: slip.active(slip.residual(slid[dof])) for dof, slip in problem.slips.items()},
    )


def normal_equations(tree: Tree, problem: Problem, active: Active) -> tuple[Matrix, list[Any]]:
    """Matrix and right side of the equations of the minimum while these constraints push, without the pairs."""
    stiffness: dict[int, Any] = {}
    pushes: dict[int, Any] = {}
    for points, touch, flags in zip(tree.ground, problem.ground, active.ground, strict=True):
        for sums, own in zip((stiffness, pushes), _of_points(touch, flags), strict=True):
            sums[points.body] = sums[points.body] + own if points.body in sums else own
    more, less = felt(tree, problem.kinematics, stiffness), felt_forces(tree, problem.kinematics, pushes)
    matrix = [one + other for one, other in zip(problem.matrix, more, strict=True)]
    right = [one - other for one, other in zip(problem.force, less, strict=True)]
    for dof, stop in problem.stops.items():
        on = jnp.where(active.stops[dof], stop.weight, 0.0)
        matrix[dof] = with_diagonal(matrix[dof], on)
        right[dof] = right[dof] - on * stop.sign * stop.offset
    turning: list[tuple[Any, Any]] = []
    for dof, slip in problem.slips.items():
        up, down = active.slips[dof]
        on = jnp.where(up | down, 0.0, slip.weight)
        most = jnp.where(up, slip.most, jnp.where(down, -slip.most, 0.0))
        if tree.drag and dof in range(3, 6):
            turning.append((on, on * slip.offset + most))
            continue
        matrix[dof] = with_diagonal(matrix[dof], on)
        right[dof] = right[dof] - (on * slip.offset + most)
    if turning:  # about the free body's own axes; its equations are in the world's
        assert tree.free is not None
        axes = problem.kinematics.poses[tree.free].axes
        on, push = (column(part) for part in zip(*turning, strict=True))
        more, less = compose(axes, on[:, None] * transposed(axes)), turn(axes, push)
        for row in range(3):
            start, end = matrix[3 + row][:3], matrix[3 + row][3:]
            matrix[3 + row] = jnp.concatenate([start, end + more[row, : row + 1]])
            right[3 + row] = right[3 + row] - less[row]
    return matrix, right
