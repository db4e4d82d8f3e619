"""The mass matrix of a tree by composite bodies, and equations that have its sparsity.

See R. Featherstone, "Rigid Body Dynamics Algorithms" (2008): chapter 6 for the matrix, section 6.5 for the factors.
"""

from collections.abc import Sequence
from typing import NamedTuple

from humanoid_mjx.mechanics.scalars import NULL, ONE, ZERO, Scalar, Vector, add, cross, dot, scale
from humanoid_mjx.mechanics.tree.algebra import Spatial, Symmetric, combine, isotropic, outer, power, vector
from humanoid_mjx.mechanics.tree.kinematics import Kinematics
from humanoid_mjx.mechanics.tree.structure import Body, Tree

Matrix = list[list[Scalar]]
"""The lower triangle of a symmetric matrix, row by row."""


class Mass(NamedTuple):
    """A body's mass in the world's axes."""

    mass: Scalar
    center: Vector
    """Of mass, against the origin."""
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
        base, extra = _principal(body)
        axes = tuple((factor * Scalar(more), kinematics.direction(index, body.principal[axis])) for axis, more in extra)
        found.append(Mass(factor * Scalar(body.mass), add(pose.position, arm), arm, factor * Scalar(base), axes))
    return found


def mass_matrix(tree: Tree, kinematics: Kinematics, masses: Sequence[Mass], armature: Sequence[Scalar]) -> Matrix:
    """The inertia that the degrees of freedom feel, the free body's in the world's axes."""
    matrix: Matrix = [[ZERO] * (row + 1) for row in range(tree.nv)]
    composites = [_composite(mass) for mass in masses]
    for index in reversed(range(1, len(tree.bodies))):
        body, composite = tree.bodies[index], composites[index]
        moving = tree.dofs(index)
        own = [hinge.dof for hinge in body.hinges] if index != tree.free else list(range(6))
        for dof in own:
            force = composite.apply(kinematics.motions[dof])
            for other in moving[: moving.index(dof) + 1]:
                matrix[dof][other] = power(kinematics.motions[other], force)
        for hinge in body.hinges:
            matrix[hinge.dof][hinge.dof] = matrix[hinge.dof][hinge.dof] + armature[hinge.dof]
        composites[body.parent] = composites[body.parent].plus(composite)
    return matrix


class Factors(NamedTuple):
    """L and D of `A = L^T D L`: what joins a degree of freedom to none of another branch stays known to be 0."""

    lower: Matrix
    inverse: list[Scalar]
    """1 / D"""

    def solve(self, right: Sequence[Scalar]) -> list[Scalar]:
        """x of `A x = right`."""
        x, size = list(right), len(right)
        for row in reversed(range(size)):
            for column in range(row):
                x[column] = x[column] - self.lower[row][column] * x[row]
        for row in range(size):
            x[row] = x[row] * self.inverse[row] - dot(self.lower[row][:row], x[:row])
        return x


def factor(matrix: Matrix) -> Factors:
    """The factors of a symmetric, positive definite matrix, from the leaves of the tree to its root."""
    rows, size = [list(row) for row in matrix], len(matrix)
    inverse = [ZERO] * size
    for last in reversed(range(size)):
        inverse[last] = ONE / rows[last][last]
        below = rows[last][:last]
        rows[last] = [entry * inverse[last] for entry in below]
        for row in range(last):
            for column in range(row + 1):
                rows[row][column] = rows[row][column] - rows[last][row] * below[column]
    return Factors(rows, inverse)


def product(matrix: Matrix, x: Sequence[Scalar]) -> list[Scalar]:
    """The matrix, given by its lower triangle, times a vector."""
    size = len(x)
    return [
        dot(matrix[row], x[: row + 1]) + dot([matrix[k][row] for k in range(row + 1, size)], x[row + 1 :])
        for row in range(size)
    ]


def _composite(mass: Mass) -> Composite:
    """About the origin (Steiner's theorem)."""
    first = scale(mass.mass, mass.center)
    c = mass.center
    xx, yy, zz = first.x * c.x, first.y * c.y, first.z * c.z
    shift = Symmetric(yy + zz, -(first.x * c.y), -(first.x * c.z), xx + zz, -(first.y * c.z), xx + yy)
    return Composite(mass.mass, first, mass.rotational().plus(shift))


def _principal(body: Body) -> tuple[float, list[tuple[int, float]]]:
    """The moment of inertia that most principal axes share, and by how much those of the others exceed it."""
    alike = [[abs(one - two) <= 1e-12 * max(body.moments) for two in body.moments].count(True) for one in body.moments]
    base = body.moments[alike.index(max(alike))]
    rest = [(axis, moment - base) for axis, moment in enumerate(body.moments)]
    return base, [(axis, more) for axis, more in rest if abs(more) > 1e-12 * max(body.moments)]
