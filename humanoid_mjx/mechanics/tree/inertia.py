"""The mass matrix of a tree by composite bodies, and equations that have its sparsity.

See R. Featherstone, "Rigid Body Dynamics Algorithms" (2008): chapter 6 for the matrix, section 6.5 for the factors.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

from humanoid_mjx.mechanics.scalars import NULL, ONE, ZERO, Scalar, Symmetric, Vector, add, cross, dot, scale
from humanoid_mjx.mechanics.tree.algebra import (
    Spatial,
    combine,
    isotropic,
    number,
    outer,
    over_lanes,
    power,
    summed,
    vector,
)
from humanoid_mjx.mechanics.tree.kinematics import Kinematics
from humanoid_mjx.mechanics.tree.structure import Tree

Matrix = list[list[Scalar]]
"""The lower triangle of a symmetric matrix, row by row."""


class Mass(NamedTuple):
    """A body's mass in the world's axes."""

    mass: Scalar
    center: Vector
    """Centre of mass against the origin, m."""
    arm: Vector
    """From the body's own origin to the centre of mass."""
    base: Scalar
    """The moment of inertia about the centre of mass across all principal axes in `extra`."""
    extra: tuple[tuple[Scalar, Vector], ...]
    """By how much more about which principal axes. Bodies of revolution have one, balls none."""

    def rotational(self) -> Symmetric:
        """The inertia about the centre of mass."""
        found = isotropic(self.base)
        for more, axis in self.extra:
            found = found.plus(outer(more, axis))
        return found


class Composite(NamedTuple):
    """Mass, first moment and rotational inertia about the origin."""

    mass: Scalar
    first: Vector
    second: Symmetric

    def plus(self, other: "Composite") -> "Composite":
        """Both together."""
        return Composite(self.mass + other.mass, add(self.first, other.first), self.second.plus(other.second))

    def apply(self, motion: Spatial) -> Spatial:
        """The force that accelerates it by `motion`."""
        force = add(scale(self.mass, motion.linear), cross(motion.angular, self.first))
        return Spatial(force, add(cross(self.first, motion.linear), self.second.apply(motion.angular)))


def masses_of(tree: Tree, kinematics: Kinematics, factors: Sequence[Scalar]) -> list[Mass]:
    """The bodies' masses in one posture, their models' times `factors`; the world has none."""
    found = [Mass(ZERO, NULL, NULL, ZERO, ())]
    for index, (body, factor) in enumerate(zip(tree.bodies[1:], factors[1:], strict=True), 1):
        pose = kinematics.poses[index]
        arm = combine(pose.axes, vector(body.center))
        extra = tuple((factor * number(more), kinematics.direction(index, axis)) for more, axis in body.extra)
        mass, moment = factor * number(body.mass), factor * number(body.moment)
        found.append(Mass(mass, add(pose.position, arm), arm, moment, extra))
    return found


def mass_matrix(tree: Tree, kinematics: Kinematics, masses: Sequence[Mass], armature: Sequence[Scalar]) -> Matrix:
    """The inertia that the degrees of freedom feel, the free body's in the world's axes."""
    matrix: Matrix = [[ZERO] * (row + 1) for row in range(tree.nv)]
    composites = [_composite(mass) for mass in masses]
    for index in reversed(range(1, len(tree.bodies))):
        body, composite, moving = tree.bodies[index], composites[index], tree.moving(index)
        for dof in tree.own(index):
            force = composite.apply(kinematics.motions[dof])
            for other in moving[: moving.index(dof) + 1]:
                matrix[dof][other] = power(kinematics.motions[other], force)
            matrix[dof][dof] = matrix[dof][dof] + armature[dof]
        if body.laned and not tree.bodies[body.parent].laned:
            composite = summed(composite, partial(over_lanes, tree))
        composites[body.parent] = composites[body.parent].plus(composite)
    return matrix


class Factors(NamedTuple):
    """L and D of `A = L^T D L`: what joins a degree of freedom to none of another branch stays known to be 0."""

    lower: Matrix
    inverse: list[Scalar]
    """1 / D"""
    stem: int
    """Number of degrees of freedom before those of lanes, which are the last."""
    tree: Tree

    def solve(self, right: Sequence[Scalar]) -> list[Scalar]:
        """x of `A x = right`."""
        x, size, stem = list(right), len(right), self.stem
        for row in reversed(range(stem, size)):
            for column in range(stem, row):
                x[column] = x[column] - self.lower[row][column] * x[row]
        if size > stem:
            felt = [dot([self.lower[row][column] for row in range(stem, size)], x[stem:]) for column in range(stem)]
            x[:stem] = [a - b for a, b in zip(x[:stem], over_lanes(self.tree, felt), strict=True)]
        for row in reversed(range(stem)):
            for column in range(row):
                x[column] = x[column] - self.lower[row][column] * x[row]
        for row in range(size):
            x[row] = x[row] * self.inverse[row] - dot(self.lower[row][:row], x[:row])
        return x


def factor(tree: Tree, matrix: Matrix) -> Factors:
    """The factors of a symmetric, positive definite matrix, from the leaves of the tree to its root."""
    rows, size = [list(row) for row in matrix], tree.nv
    stem = next((dof for dof in range(size) if tree.laned(dof)), size)
    inverse, passed = [ZERO] * size, [[ZERO] * (row + 1) for row in range(stem)]
    for last in reversed(range(size)):
        if last == stem - 1 < size - 1:
            changes = iter(over_lanes(tree, [change for row in passed for change in row]))
            for row in range(stem):
                rows[row] = [entry - next(changes) for entry in rows[row]]
        inverse[last] = ONE / rows[last][last]
        below = rows[last][:last]
        rows[last] = [entry * inverse[last] for entry in below]
        for row in range(last):
            for column in range(row + 1):
                change = rows[last][row] * below[column]
                if row < stem <= last:
                    passed[row][column] = passed[row][column] + change
                else:
                    rows[row][column] = rows[row][column] - change
    return Factors(rows, inverse, stem, tree)


def product(tree: Tree, matrix: Matrix, x: Sequence[Scalar]) -> list[Scalar]:
    """The matrix, given by its lower triangle, times a vector."""
    found = []
    for row in range(tree.nv):
        total = dot(matrix[row], x[: row + 1])
        for other in range(row + 1, tree.nv):
            part = matrix[other][row] * x[other]
            total = total + (over_lanes(tree, [part])[0] if tree.laned(other) > tree.laned(row) else part)
        found.append(total)
    return found


def _composite(mass: Mass) -> Composite:
    """About the origin (Steiner's theorem)."""
    first = scale(mass.mass, mass.center)
    c = mass.center
    xx, yy, zz = first.x * c.x, first.y * c.y, first.z * c.z
    shift = Symmetric(yy + zz, -(first.x * c.y), -(first.x * c.z), xx + zz, -(first.y * c.z), xx + yy)
    return Composite(mass.mass, first, mass.rotational().plus(shift))
