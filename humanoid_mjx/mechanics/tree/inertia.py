"""The mass matrix of a tree by composite bodies, and equations that have its sparsity; bias forces, velocity terms and
gravity, by Newton and Euler's recursion.

See R. Featherstone, "Rigid Body Dynamics Algorithms" (2008): chapter 6 for the matrix, section 6.5 for the factors.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from humanoid_mjx.mechanics.tree.algebra import (
    EYE,
    block,
    cross,
    dot,
    force_at,
    joined,
    numbers,
    over_lanes,
    stacked,
    symmetric,
    transposed,
    turn,
)
from humanoid_mjx.mechanics.tree.kinematics import Kinematics
from humanoid_mjx.mechanics.tree.structure import Tree

Matrix = list[Any]
"""Rows of a symmetric matrix by degree of freedom: entries at those that move the same bodies, itself the last.
All others are 0, or stand in the rows of other degrees of freedom."""


class Mass(NamedTuple):
    """A body's mass in the world's axes."""

    mass: Any
    center: Any
    """Centre of mass against the origin, m."""
    arm: Any
    """From the body's own origin to the centre of mass."""
    inertia: Any
    """The inertia about the centre of mass."""

    def spatial(self) -> Any:
        """The 6x6 inertia about the origin, from motions to forces (Steiner's theorem)."""
        first = self.mass * self.center
        across = transposed(cross(first, EYE))
        shift = cross(cross(self.center, EYE), first)
        return block(self.mass * EYE, transposed(across), across, symmetric(self.inertia + shift))


def masses_of(tree: Tree, kinematics: Kinematics, factors: Sequence[Any]) -> list[Mass]:
    """The bodies' masses in one posture, their models' times `factors`, but for the world's."""
    found = []
    for index, (body, factor) in enumerate(zip(tree.bodies[1:], factors[1:], strict=True), 1):
        arm, inertia = kinematics.direction(index, body.center), factor * numbers(body.moment) * EYE
        for more, axis in body.extra:
            axis = kinematics.direction(index, axis)
            inertia = inertia + (factor * numbers(more) * axis)[:, None] * axis
        position, mass = kinematics.poses[index].position, factor * numbers(body.mass)
        found.append(Mass(mass, position + arm, arm, symmetric(inertia)))
    return found


def mass_matrix(tree: Tree, kinematics: Kinematics, masses: Sequence[Mass], armature: Sequence[Any]) -> Matrix:
    """The inertia that the degrees of freedom feel, the free body's in the world's axes."""
    rows = felt(tree, kinematics, {index: mass.spatial() for index, mass in enumerate(masses, 1)})
    return [with_diagonal(row, more) for row, more in zip(rows, armature, strict=True)]


def with_diagonal(row: Any, more: Any) -> Any:
    """A row with something added to its diagonal."""
    return jnp.concatenate([row[:-1], (row[-1] + more)[None]])


def felt(tree: Tree, kinematics: Kinematics, matrices: dict[int, Any]) -> Matrix:
    """Project 6x6 matrices of the bodies, from motions to forces, onto the degrees of freedom; see `inward`."""
    rows: Matrix = [np.zeros((len(tree.above(dof)), 1, 1)) for dof in range(tree.nv)]
    for index in inward(tree, matrices):
        for dof in tree.own(index):
            force = turn(matrices[index], kinematics.motions[dof])
            rows[dof] = dot(stacked([kinematics.motions[other] for other in tree.above(dof)]), force)
    return rows


def felt_forces(tree: Tree, kinematics: Kinematics, wrenches: dict[int, Any]) -> list[Any]:
    """Project forces on the bodies onto the degrees of freedom; see `inward`."""
    forces = [np.zeros((1, 1))] * tree.nv
    for index in inward(tree, wrenches):
        for dof in tree.own(index):
            forces[dof] = dot(kinematics.motions[dof], wrenches[index])
    return forces


def inward(tree: Tree, things: dict[int, Any]) -> Iterator[int]:
    """The bodies from the leaves to the root, whose arrays in `things` add to those of their parents."""
    for index in reversed(range(1, len(tree.bodies))):
        if index not in things:
            continue
        yield index
        body, thing = tree.bodies[index], things[index]
        if body.laned and not tree.bodies[body.parent].laned:
            thing = over_lanes(tree, thing)
        things[body.parent] = things[body.parent] + thing if body.parent in things else thing


class Factors(NamedTuple):
    """L and D of `A = L^T D L`, which have the sparsity of A."""

    lower: Matrix
    """Rows without the diagonal, which is 1."""
    inverse: list[Any]
    """1 / D"""
    tree: Tree

    def solve(self, right: Sequence[Any]) -> list[Any]:
        """x of `A x = right`."""
        x, lanes = list(right), _Lanes(self.tree, {}, {})
        for last in reversed(range(len(x))):
            x[last] = x[last] - lanes.sum_for(last)
            *above, _ = self.tree.above(last)
            for row, change in zip(above, jnp.unstack(self.lower[last] * x[last]), strict=True):
                x[row] = lanes.less(last, row, x[row], change)
        for row, inverse in enumerate(self.inverse):
            *above, _ = self.tree.above(row)
            felt = (self.lower[row] * stacked([x[other] for other in above])).sum(axis=0) if above else 0.0
            x[row] = x[row] * inverse - felt
        return x


def factor(tree: Tree, matrix: Matrix) -> Factors:
    """The factors of a symmetric, positive definite matrix, from the leaves of the tree to its root."""
    rows, lower, inverse, lanes = list(matrix), list(matrix), [None] * tree.nv, _Lanes(tree, {}, {})
    for last in reversed(range(tree.nv)):
        row = rows[last] - lanes.sum_for(last)
        inverse[last], below = 1.0 / row[-1], row[:-1]
        lower[last] = below * inverse[last]
        *above, _ = tree.above(last)
        for place, (other, share) in enumerate(zip(above, jnp.unstack(lower[last]), strict=True), 1):
            rows[other] = lanes.less(last, other, rows[other], share * below[:place])
    return Factors(lower, inverse, tree)


class _Lanes(NamedTuple):
    """Changes by lanes of rows of the stem, summed over the lanes once."""

    tree: Tree
    changes: dict[int, Any]
    sums: dict[int, Any]

    def less(self, last: int, row: int, value: Any, change: Any) -> Any:
        """A row's value less the change by a row beyond it; that of a lane is kept for later."""
        if not self.tree.laned(last) or self.tree.laned(row):
            return value - change
        self.changes[row] = self.changes[row] + change if row in self.changes else change
        return value

    def sum_for(self, row: int) -> Any:
        """The sum of the changes of all lanes. With the first, where no lane is left, come those of all rows: the
        threads of a GPU wait once for what they pass on."""
        if row in self.changes:
            some_left = any(map(self.tree.laned, range(row)))
            for other in [row] if some_left else list(self.changes):
                self.sums[other] = over_lanes(self.tree, self.changes.pop(other))
        return self.sums.get(row, 0.0)


def product(tree: Tree, matrix: Matrix, x: Sequence[Any]) -> list[Any]:
    """The matrix times a vector."""
    found = [np.zeros((1, 1))] * tree.nv
    for row, entries in enumerate(matrix):
        *above, _ = tree.above(row)
        for other, entry in zip(above, entries, strict=False):
            part = entry * x[row]
            found[other] = found[other] + (over_lanes(tree, part) if tree.laned(row) > tree.laned(other) else part)
        found[row] = found[row] + (entries * stacked([x[other] for other in (*above, row)])).sum(axis=0)
    return found


class Drift(NamedTuple):
    """Acceleration of a body while no degree of freedom accelerates."""

    angular: Any
    """Its angular velocity, rad/s."""
    rate: Any
    """Its angular acceleration."""
    linear: Any
    """The acceleration of its own origin."""

    def at(self, arm: Any) -> Any:
        """The acceleration of its point at `arm` from its origin."""
        return self.linear + (cross(self.rate, arm) + cross(self.angular, cross(self.angular, arm)))

    def moved(self, old: Any, new: Any) -> "Drift":
        """The drift about another origin."""
        return self if new is old else self._replace(linear=self.at(new - old))


def drifts_of(tree: Tree, kinematics: Kinematics, velocity: Sequence[Any]) -> list[Drift]:
    """The drift of each body. `velocity` has the free body's angular part in the world's axes."""
    still = Drift(*np.zeros((3, 3, 1, 1)))
    found = [still]
    for index, body in enumerate(tree.bodies[1:], 1):
        if index == tree.free:
            found.append(still._replace(angular=stacked(velocity[3:6])))
            continue
        now, place = found[body.parent], kinematics.poses[body.parent].position
        for joint in body.joints:
            anchor, turning = kinematics.anchors[joint.dof], velocity[joint.dof] * kinematics.motions[joint.dof]
            now = now.moved(place, anchor)
            if joint.slides:
                now = now._replace(linear=now.linear + 2.0 * cross(now.angular, turning[:3]))
            else:
                rate = now.rate + cross(now.angular, turning[3:])
                now = Drift(now.angular + turning[3:], rate, now.linear)
            place = anchor
        found.append(now.moved(place, kinematics.poses[index].position))
    return found


def bias_forces(
    tree: Tree, kinematics: Kinematics, masses: Sequence[Mass], drifts: Sequence[Drift], gravity: Any
) -> list[Any]:
    """Forces of the degrees of freedom with which none of them accelerates, N and N m."""
    each = enumerate(zip(masses, drifts[1:], strict=True), 1)
    return felt_forces(tree, kinematics, {index: _wrench(*both, gravity) for index, both in each})


def _wrench(mass: Mass, drift: Drift, gravity: Any) -> Any:
    """Force that a body's inertia and weight require, about the origin."""
    force = mass.mass * (drift.at(mass.arm) - gravity)
    moment = turn(mass.inertia, drift.rate) + cross(drift.angular, turn(mass.inertia, drift.angular))
    return force_at(force, mass.center) + joined(np.zeros((3, 1, 1)), moment)
