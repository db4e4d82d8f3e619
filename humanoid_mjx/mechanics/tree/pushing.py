"""What the ground's contacts add to the equations of a tree, body by body, as a composite inertia does."""

import functools
from collections.abc import Sequence
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
from humanoid_mjx.mechanics.tree.contacts import Touch
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


def add_ground(
    tree: Tree,
    kinematics: Kinematics,
    touches: Sequence[Touch],
    active: Sequence[Sequence[Any]],
    matrix: Matrix,
    right: list[Scalar],
) -> None:
    """Add the contacts of which these facets push to `matrix` and `right`."""
    motions = kinematics.motions
    stiffness: dict[int, Stiffness] = {}
    forces: dict[int, Spatial] = {}
    for points, touch, flags in zip(tree.ground, touches, active, strict=True):
        own, push = _of_points(tree, points, touch, flags)
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
            own, push = summed((own, push), partial(over_lanes, lanes=tree.lanes))
        stiffness[body.parent] = stiffness[body.parent].plus(own) if body.parent in stiffness else own
        forces[body.parent] = total([forces.get(body.parent, NOWHERE), push])


def _of_points(tree: Tree, points: GroundPoints, touch: Touch, flags: Sequence[Any]) -> tuple[Stiffness, Spatial]:
    """The stiffness of all points of a body together, and their force against an acceleration of 0."""
    laned = tree.bodies[points.body].laned
    count = len(points.order) // (tree.lanes if laned else 1)
    # Point by point, as sums over an axis of points would take them through memory.
    each = [_of_point(touch, flags, index if count > 1 else None, 3 if laned else 2) for index in range(count)]
    own = functools.reduce(Stiffness.plus, [stiffness for stiffness, _ in each])
    return own, total([push for _, push in each])


def _of_point(touch: Touch, flags: Sequence[Any], index: int | None, rank: int) -> tuple[Stiffness, Spatial]:
    """The same of the one point at `index` of the first of `rank` axes; of a single point where `index` is None."""
    if index is not None:
        touch, flags = jax.tree.map(
            lambda x: x[min(index, x.shape[0] - 1)] if jnp.ndim(x) == rank else x, (touch, list(flags))
        )
    local = touch.stiffness(flags)
    push = force_at(combine(touch.frame, local.apply(touch.offset)), touch.place)
    return _at(touch.place, _in_world(touch, local)), push


def _at(place: Vector, matrix: Symmetric) -> Stiffness:
    """The stiffness of a contact at `place`, where the force is `matrix` times the acceleration."""
    a, b, c = (cross(place, row) for row in matrix.rows)
    columns = [cross(place, Vector(a[j], b[j], c[j])) for j in range(3)]
    angular = Symmetric(columns[0].x, columns[1].x, columns[2].x, columns[1].y, columns[2].y, columns[2].z)
    return Stiffness(matrix, (a, b, c), angular)


def _in_world(touch: Touch, stiffness: Symmetric) -> Symmetric:
    """A matrix of the contact's frame in the world's."""
    columns = [combine(touch.frame, stiffness.apply(resolve(touch.frame, axis))) for axis in UNTURNED]
    return Symmetric(columns[0].x, columns[1].x, columns[2].x, columns[1].y, columns[2].y, columns[2].z)
