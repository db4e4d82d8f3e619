"""MuJoCo's contact problem, and its equations while the same constraints push.

The accelerations x minimise the convex function (see "Computation" in MuJoCo's documentation)

    1/2 x^T M x - f^T x + sum over facets and limits 1/2 weight min(0, residual(x))^2.

The ground's contacts add to the equations of a tree body by body, as a composite inertia does.
"""

import functools
from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from humanoid_mjx.mechanics.scalars import Scalar, Symmetric, Vector, add, cross, dot
from humanoid_mjx.mechanics.tree.algebra import (
    NOWHERE,
    UNTURNED,
    Spatial,
    combine,
    force_at,
    over_lanes,
    power,
    resolve,
    summed,
    total,
)
from humanoid_mjx.mechanics.tree.contacts import Friction, GapAt, Slip, Stop, Touch
from humanoid_mjx.mechanics.tree.inertia import Matrix
from humanoid_mjx.mechanics.tree.kinematics import Kinematics, motions_of
from humanoid_mjx.mechanics.tree.structure import GroundPoints, Tree


class Stiffness(NamedTuple):
    """Minus the derivative of the force of a body's contacts with the ground by its acceleration, about the origin."""

    linear: Symmetric
    mixed: tuple[Vector, Vector, Vector]
    """Rows: from the angular motion to the force."""
    angular: Symmetric

    def plus(self, other: "Stiffness") -> "Stiffness":
        """The sum of two."""
        a, b, c = (add(one, two) for one, two in zip(self.mixed, other.mixed, strict=True))
        return Stiffness(self.linear.plus(other.linear), (a, b, c), self.angular.plus(other.angular))

    def apply(self, motion: Spatial) -> Spatial:
        """The force that opposes a motion."""
        force = add(self.linear.apply(motion.linear), Vector(*(dot(row, motion.angular) for row in self.mixed)))
        turned = Vector(*(dot([row[j] for row in self.mixed], motion.linear) for j in range(3)))
        return Spatial(force, add(turned, self.angular.apply(motion.angular)))


def ground_residuals(tree: Tree, kinematics: Kinematics, touches: Sequence[Touch], x: Sequence[Scalar]) -> list[Vector]:
    """By how much the bodies accelerate more than they should, in the contacts' frames."""
    motions = motions_of(tree, kinematics, x)
    return [touch.residual(motions[points.body]) for points, touch in zip(tree.ground, touches, strict=True)]


def one_by_one(tree: Tree, touches: Sequence[Touch]) -> list[list[Touch]]:
    """The touches of each point of each body: XLA:CPU would take them apart in each Newton step."""
    each = zip(tree.ground, touches, strict=True)
    return [[_entry(tree, points, index, touch) for index in range(tree.points_each(points))] for points, touch in each]


def _entry(tree: Tree, points: GroundPoints, index: int, thing: Any) -> Any:
    """The one point at `index` of arrays of a body's points."""
    if tree.points_each(points) == 1:
        return thing
    rank = 3 if tree.bodies[points.body].laned else 2
    return jax.tree.map(lambda x: x[min(index, x.shape[0] - 1)] if jnp.ndim(x) == rank else x, thing)


def add_ground(
    tree: Tree,
    kinematics: Kinematics,
    touches: Sequence[Sequence[Touch]],
    active: Sequence[Sequence[Any]],
    matrix: Matrix,
    right: list[Scalar],
) -> None:
    """Add the contacts of which these facets push to `matrix` and `right`."""
    motions = kinematics.motions
    stiffness: dict[int, Stiffness] = {}
    forces: dict[int, Spatial] = {}
    for points, some, flags in zip(tree.ground, touches, active, strict=True):
        own, push = _of_points(tree, points, some, flags)
        stiffness[points.body] = stiffness[points.body].plus(own) if points.body in stiffness else own
        forces[points.body] = total([forces.get(points.body, NOWHERE), push])
    for index in reversed(range(1, len(tree.bodies))):
        if index not in stiffness:
            continue
        body, moving, own, push = tree.bodies[index], tree.moving(index), stiffness[index], forces[index]
        for dof in tree.own(index):
            force = own.apply(motions[dof])
            for other in moving[: moving.index(dof) + 1]:
                matrix[dof][other] = matrix[dof][other] + power(motions[other], force)
            right[dof] = right[dof] - power(motions[dof], push)
        if body.laned and not tree.bodies[body.parent].laned:
            own, push = summed((own, push), partial(over_lanes, tree))
        stiffness[body.parent] = stiffness[body.parent].plus(own) if body.parent in stiffness else own
        forces[body.parent] = total([forces.get(body.parent, NOWHERE), push])


def _of_points(
    tree: Tree, points: GroundPoints, touches: Sequence[Touch], flags: Sequence[Any]
) -> tuple[Stiffness, Spatial]:
    """The stiffness of all points of a body together, and their force against an acceleration of 0."""
    # Point by point, as sums over an axis of points would take them through memory.
    each = [_of_point(touch, _entry(tree, points, index, list(flags))) for index, touch in enumerate(touches)]
    own = functools.reduce(Stiffness.plus, [stiffness for stiffness, _ in each])
    return own, total([push for _, push in each])


def _of_point(touch: Touch, flags: Sequence[Any]) -> tuple[Stiffness, Spatial]:
    """The same of one point."""
    local, place = touch.stiffness(flags), touch.place
    push = force_at(combine(touch.frame, local.apply(touch.offset)), place)
    linear = _symmetric(combine(touch.frame, local.apply(resolve(touch.frame, axis))) for axis in UNTURNED)
    a, b, c = (cross(place, row) for row in linear.rows)
    angular = _symmetric(cross(place, Vector(a[j], b[j], c[j])) for j in range(3))
    return Stiffness(linear, (a, b, c), angular), push


def _symmetric(columns: Iterable[Vector]) -> Symmetric:
    """A matrix by its columns, of which the lower triangle is read."""
    one, two, three = columns
    return Symmetric(one.x, two.x, three.x, two.y, three.y, three.z)


class Problem(NamedTuple):
    """Cost that the accelerations minimise."""

    matrix: Matrix
    force: list[Scalar]
    """On the degrees of freedom, all but contacts and limits."""
    kinematics: Kinematics
    velocity: list[Scalar]
    """Of the degrees of freedom, in the axes of `State.velocity`."""
    ground: list[Touch]
    pairs: list[tuple[GapAt, Friction]]
    """Gaps of the pairs of bodies, and their coefficients of friction, group by group."""
    stops: dict[int, Stop]
    slips: dict[int, Slip]
    """By degree of freedom."""
    ended: Any = False
    """True where the solution is of no use, so that other worlds of a kernel do not wait for it."""


class Solution(NamedTuple):
    """The minimum."""

    acceleration: list[Scalar]
    settled: Any
    """True if it was found."""


class Active(NamedTuple):
    """Masks of the facets and of the stops that push."""

    ground: list[list[Any]]
    pairs: list[Any]
    stops: dict[int, Any]
    slips: dict[int, tuple[Any, Any]]


def active_at(tree: Tree, problem: Problem, x: Sequence[Scalar]) -> Active:
    """At these accelerations, but for the pairs."""
    ground = ground_residuals(tree, problem.kinematics, problem.ground, x)
    return Active(
        [touch.active(touch.facets(v)) for touch, v in zip(problem.ground, ground, strict=True)],
        [],
        {dof: stop.close & (stop.residual(x[dof]).value < 0.0) for dof, stop in problem.stops.items()},
        {dof: slip.active(slip.residual(x[dof])) for dof, slip in problem.slips.items()},
    )


def normal_equations(
    tree: Tree, problem: Problem, points: Sequence[Sequence[Touch]], active: Active
) -> tuple[Matrix, list[Scalar]]:
    """All but the pairs: the second derivative, and what it times the minimum is."""
    matrix, right = [list(row) for row in problem.matrix], list(problem.force)
    add_ground(tree, problem.kinematics, points, active.ground, matrix, right)
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
