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

from humanoid_mjx.mechanics.scalars import ZERO, Scalar, Vector, add, cross, dot
from humanoid_mjx.mechanics.tree.algebra import (
    NOWHERE,
    UNTURNED,
    Spatial,
    Symmetric,
    combine,
    force_at,
    power,
    resolve,
    total,
)
from humanoid_mjx.mechanics.tree.contacts import Stop, Touch
from humanoid_mjx.mechanics.tree.inertia import Matrix, factor, product
from humanoid_mjx.mechanics.tree.kinematics import Kinematics, motions_of
from humanoid_mjx.mechanics.tree.structure import Tree

MOST_STEPS = 20
"""Newton steps before a world is given up. Of random states the worst need about 10, of motions 2."""


class Problem(NamedTuple):
    """What the accelerations minimise."""

    matrix: Matrix
    force: list[Scalar]
    """On the degrees of freedom, all but contacts and limits."""
    kinematics: Kinematics
    ground: list[Touch]
    pairs: list[Touch]
    rows: list[list[dict[int, Scalar]]]
    """For each pair the directions of its frame that it feels, by degree of freedom."""
    stops: dict[int, Stop]
    """By degree of freedom."""


class Solution(NamedTuple):
    """The minimum."""

    acceleration: list[Scalar]
    settled: Any
    """Whether it was found."""


def pair_rows(tree: Tree, kinematics: Kinematics, touches: Sequence[Touch]) -> list[list[dict[int, Scalar]]]:
    """How the degrees of freedom move the second body of each pair against the first, in the contact's frame."""
    found = []
    for pair, touch in zip(tree.pairs, touches, strict=True):
        one, two = tree.dofs(pair.one.body), tree.dofs(pair.two.body)
        signs = {dof: 1.0 if dof in two else -1.0 for dof in sorted(set(one) ^ set(two))}
        forces = [force_at(axis, touch.place) for axis in touch.frame[: 1 if touch.friction is None else 3]]
        found.append(
            [{dof: Scalar(s) * power(kinematics.motions[dof], force) for dof, s in signs.items()} for force in forces]
        )
    return found


def solve(tree: Tree, problem: Problem, start: Sequence[Scalar]) -> Solution:
    """The minimum, searched from the facets that push at the accelerations `start`."""
    leaves, structure = jax.tree.flatten(problem)

    @jax.custom_jvp
    def search(leaves: list[Any], start: list[Any]) -> tuple[list[Any], Any]:
        return _search(tree, structure.unflatten(leaves), start)

    @search.defjvp
    def _(primals: tuple[Any, Any], tangents: tuple[Any, Any]) -> tuple[Any, Any]:
        # At the minimum the gradient is zero and stays so: H dx = -d(gradient), while the same facets push.
        leaves, start = primals
        x, settled = search(leaves, start)
        scalars = [Scalar(value) for value in x]
        known = structure.unflatten(leaves)
        active = _active(tree, known, scalars)

        def gradient(leaves: list[Any]) -> list[Any]:
            return [g.value for g in _gradient(tree, structure.unflatten(leaves), active, scalars)]

        change = jax.jvp(gradient, (leaves,), (tangents[0],))[1]
        hessian, _ = _normal_equations(tree, known, active)
        moved = factor(hessian).solve([Scalar(-c) for c in change])
        return (x, settled), ([m.value for m in moved], jnp.zeros(settled.shape, jax.dtypes.float0))

    x, settled = search(leaves, [value.value for value in start])
    return Solution([Scalar(value) for value in x], settled)


def _search(tree: Tree, problem: Problem, start: list[Any]) -> tuple[list[Any], Any]:
    def step(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        _, active, _, count = carry
        x = factor_and_solve(tree, problem, active)
        now = _active(tree, problem, x)
        changed = jnp.zeros((), bool)
        for one, two in zip(jax.tree.leaves(active), jax.tree.leaves(now), strict=True):
            changed = changed | (one != two)
        return [v.value for v in x], now, ~changed, count + 1

    def going(carry: tuple[Any, ...]) -> Any:
        return ~carry[2] & (carry[3] < MOST_STEPS)

    active = _active(tree, problem, [Scalar(value) for value in start])
    x, _, settled, _ = jax.lax.while_loop(going, step, (start, active, jnp.bool_(False), jnp.int32(0)))
    return x, settled


def residuals(tree: Tree, problem: Problem, x: Sequence[Scalar]) -> tuple[list[Vector], list[Vector]]:
    """Of the ground's contacts and the pairs', in their frames: where the bodies accelerate more than they should."""
    motions = motions_of(tree, problem.kinematics, x)
    ground = [
        touch.residual(NOWHERE, motions[point.body]) for point, touch in zip(tree.ground, problem.ground, strict=True)
    ]
    pairs = [_pair_residual(touch, rows, x) for touch, rows in zip(problem.pairs, problem.rows, strict=True)]
    return ground, pairs


def factor_and_solve(tree: Tree, problem: Problem, active: Any) -> list[Scalar]:
    """The minimum if these facets and stops push and no others."""
    hessian, right = _normal_equations(tree, problem, active)
    return factor(hessian).solve(right)


def _active(tree: Tree, problem: Problem, x: Sequence[Scalar]) -> Any:
    """Which facets of the ground's contacts, of the pairs' and which stops push at these accelerations."""
    ground, pairs = residuals(tree, problem, x)
    ground = [touch.active(v) for touch, v in zip(problem.ground, ground, strict=True)]
    pairs = [touch.active(v) for touch, v in zip(problem.pairs, pairs, strict=True)]
    stops = {dof: stop.close & (stop.residual(x[dof]).value < 0.0) for dof, stop in problem.stops.items()}
    return ground, pairs, stops


def _pair_residual(touch: Touch, rows: list[dict[int, Scalar]], x: Sequence[Scalar]) -> Vector:
    moved = [dot(list(row.values()), [x[dof] for dof in row]) for row in rows]
    return add(Vector(*moved, *[ZERO] * (3 - len(moved))), touch.offset)


def _normal_equations(tree: Tree, problem: Problem, active: Any) -> tuple[Matrix, list[Scalar]]:
    """The second derivative, and what it times the minimum is, while these facets and stops push."""
    ground, pairs, stops = active
    matrix, right = [list(row) for row in problem.matrix], list(problem.force)
    _add_ground(tree, problem, ground, matrix, right)
    for touch, rows, flags in zip(problem.pairs, problem.rows, pairs, strict=True):
        stiffness = touch.stiffness(flags).rows
        weighted = [
            {dof: dot(line[: len(rows)], [row[dof] for row in rows]) for dof in rows[0]}
            for line in stiffness[: len(rows)]
        ]
        for row, moved in zip(rows, weighted, strict=True):
            for i, left in row.items():
                for j in (dof for dof in moved if dof <= i):
                    matrix[i][j] = matrix[i][j] + left * moved[j]
        offset = touch.offset[: len(rows)]
        for dof in rows[0]:
            right[dof] = right[dof] - dot([moved[dof] for moved in weighted], offset)
    for dof, stop in problem.stops.items():
        on = Scalar(jnp.where(stops[dof], stop.weight.value, 0.0))
        matrix[dof][dof] = matrix[dof][dof] + on
        right[dof] = right[dof] - on * stop.sign * stop.offset
    return matrix, right


class _Stiffness(NamedTuple):
    """From a body's motion to less the force of its contacts with the ground, about the origin."""

    linear: Symmetric
    mixed: tuple[Vector, Vector, Vector]
    """Rows: from the angular motion to the force."""
    angular: Symmetric

    def plus(self, other: "_Stiffness") -> "_Stiffness":
        a, b, c = (add(one, two) for one, two in zip(self.mixed, other.mixed, strict=True))
        return _Stiffness(self.linear.plus(other.linear), (a, b, c), self.angular.plus(other.angular))

    def apply(self, motion: Spatial) -> Spatial:
        force = add(self.linear.apply(motion.linear), Vector(*(dot(row, motion.angular) for row in self.mixed)))
        turned = Vector(*(dot([row[j] for row in self.mixed], motion.linear) for j in range(3)))
        return Spatial(force, add(turned, self.angular.apply(motion.angular)))


def _stiffness_at(place: Vector, matrix: Symmetric) -> _Stiffness:
    """Of a contact at `place`: the force there is the matrix times the acceleration there."""
    a, b, c = (cross(place, row) for row in matrix.rows)
    columns = [cross(place, Vector(a[j], b[j], c[j])) for j in range(3)]
    angular = Symmetric(columns[0].x, columns[1].x, columns[2].x, columns[1].y, columns[2].y, columns[2].z)
    return _Stiffness(matrix, (a, b, c), angular)


def _in_world(touch: Touch, stiffness: Symmetric) -> Symmetric:
    """A matrix of the contact's frame in the world's."""
    columns = [combine(touch.frame, stiffness.apply(resolve(touch.frame, axis))) for axis in UNTURNED]
    return Symmetric(columns[0].x, columns[1].x, columns[2].x, columns[1].y, columns[2].y, columns[2].z)


def _add_ground(tree: Tree, problem: Problem, flags: Sequence[Any], matrix: Matrix, right: list[Scalar]) -> None:
    """The ground's contacts body by body, each body's with those of what hangs on it, as a composite inertia."""
    motions = problem.kinematics.motions
    stiffness: dict[int, _Stiffness] = {}
    forces: dict[int, Spatial] = {}
    for point, touch, active in zip(tree.ground, problem.ground, flags, strict=True):
        local = touch.stiffness(active)
        own = _stiffness_at(touch.place, _in_world(touch, local))
        push = force_at(combine(touch.frame, local.apply(touch.offset)), touch.place)
        stiffness[point.body] = stiffness[point.body].plus(own) if point.body in stiffness else own
        forces[point.body] = total([forces.get(point.body, NOWHERE), push])
    for index in reversed(range(1, len(tree.bodies))):
        if index not in stiffness:
            continue
        body, moving = tree.bodies[index], tree.dofs(index)
        for dof in range(6) if index == tree.free else [hinge.dof for hinge in body.hinges]:
            force = stiffness[index].apply(motions[dof])
            for other in moving[: moving.index(dof) + 1]:
                matrix[dof][other] = matrix[dof][other] + power(motions[other], force)
            right[dof] = right[dof] - power(motions[dof], forces[index])
        parent, own = body.parent, stiffness[index]
        stiffness[parent] = stiffness[parent].plus(own) if parent in stiffness else own
        forces[parent] = total([forces.get(parent, NOWHERE), forces[index]])


def _gradient(tree: Tree, problem: Problem, active: Any, x: Sequence[Scalar]) -> list[Scalar]:
    """The first derivative while these facets and stops push."""
    hessian, right = _normal_equations(tree, problem, active)
    return [a - b for a, b in zip(product(hessian, x), right, strict=True)]
