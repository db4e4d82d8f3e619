"""What contacts between bodies add to the equations of a tree. They join its branches, so the equations lose their
sparsity; as such contacts are rare, that is paid for only where some world of a batch has one."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from humanoid_mjx.mechanics.scalars import ZERO, Scalar, Vector, add
from humanoid_mjx.mechanics.tree.algebra import force_at, known, lane, over_lanes, power
from humanoid_mjx.mechanics.tree.contacts import Touch
from humanoid_mjx.mechanics.tree.inertia import Matrix
from humanoid_mjx.mechanics.tree.kinematics import Kinematics
from humanoid_mjx.mechanics.tree.structure import Pairs, Tree

Rows = list[dict[int, Scalar]]
"""For each direction of the contacts' frames that is felt: how the degrees of freedom move the second body against the
first, with an axis of pairs, and behind it one of lanes for those that have lanes."""


def pair_rows(tree: Tree, kinematics: Kinematics, touches: Sequence[Touch]) -> list[Rows]:
    """Of all groups of pairs."""
    return [_rows(tree, kinematics, *each) for each in zip(tree.pairs, touches, strict=True)]


def _rows(tree: Tree, kinematics: Kinematics, pairs: Pairs, touch: Touch) -> Rows:
    signs = {dof: sign for dof in range(tree.nv) if not (sign := _sign(tree, pairs, dof)).is_known(0.0)}
    found = []
    for axis in touch.frame[: 1 if touch.friction is None else 3]:
        force = force_at(axis, touch.place)
        laned = jax.tree.map(lambda part: part[:, None], force)
        found.append(
            {
                dof: sign * power(kinematics.motions[dof], laned if tree.laned(dof) else force)
                for dof, sign in signs.items()
            }
        )
    return found


def _sign(tree: Tree, pairs: Pairs, dof: int) -> Scalar:
    """1 where it moves a pair's second body alone, -1 where it moves the first alone."""

    def moves(shape: Any, index: int) -> bool:
        return dof in tree.moving(shape.body) and index in (shape.lane, None)

    each = list(zip(pairs.ones, pairs.twos, strict=True))
    if not tree.laned(dof):
        return known([float(moves(two, two.lane)) - float(moves(one, one.lane)) for one, two in each])
    lanes = range(tree.lanes)
    return known([[float(moves(two, index)) - float(moves(one, index)) for index in lanes] for one, two in each])


def residual(tree: Tree, touch: Touch, rows: Rows, x: Sequence[Scalar]) -> Vector:
    """By how much the bodies accelerate more than they should, in the contacts' frames."""
    moved = []
    for row in rows:
        plain = laned = ZERO
        for dof, part in row.items():
            if tree.laned(dof):
                laned = laned + part * x[dof]
            else:
                plain = plain + part * x[dof]
        moved.append(plain + (laned if laned is ZERO else over_lanes(laned, tree.lanes)))
    return add(Vector(*moved, *[ZERO] * (3 - len(moved))), touch.offset)


def with_pairs(
    tree: Tree,
    matrix: Matrix,
    right: Sequence[Scalar],
    touches: Sequence[Touch],
    rows: Sequence[Rows],
    active: Sequence[Sequence[Any]],
    without: Sequence[Scalar],
) -> list[Scalar]:
    """The solution of the equations with the pairs' contacts in them, from that `without`, where any facet pushes."""
    flags = [flag for group in active for flag in group]
    pushing = jnp.concatenate(flags).any(axis=0)
    leaves, structure = jax.tree.flatten((matrix, list(right), list(touches), list(rows), list(active)))
    plain = [x.value for x in without]

    def joined(leaves: list[Any], plain: list[Any]) -> list[Any]:
        matrix, right, touches, rows, active = structure.unflatten(leaves)
        x = _dense(tree, matrix, right, touches, rows, active)
        return [jnp.where(pushing, new, old) for new, old in zip(x, plain, strict=True)]

    found = jax.lax.cond(pushing.any(), joined, lambda leaves, plain: plain, leaves, plain)
    return [Scalar(value) for value in found]


def _dense(
    tree: Tree,
    matrix: Matrix,
    right: Sequence[Scalar],
    touches: Sequence[Touch],
    rows: Sequence[Rows],
    active: Sequence[Sequence[Any]],
) -> list[Any]:
    """By elimination of whole matrices, one column after another, with an axis of worlds behind."""
    places = [(dof, index) for dof in range(tree.nv) for index in range(len(tree.dofs[dof]))]
    like = jnp.broadcast_shapes(
        *(jnp.shape(x.value)[-1:] for row in matrix for x in row), *(jnp.shape(x.value)[-1:] for x in right)
    )

    def entry(row: tuple[int, int], column: tuple[int, int]) -> Any:
        (i, a), (j, b) = (row, column) if row[0] >= column[0] else (column, row)
        apart = a != b and tree.laned(i) and tree.laned(j)
        return ZERO.value if apart else lane(matrix[i][j], a).value

    def whole(values: Sequence[Any]) -> Any:
        return jnp.stack([jnp.broadcast_to(jnp.asarray(value, float), like) for value in values])

    size = len(places)
    equations = whole(
        [value for i in places for value in (*(entry(i, j) for j in places), lane(right[i[0]], i[1]).value)]
    ).reshape(size, size + 1, *like)
    for touch, group, flags in zip(touches, rows, active, strict=True):
        equations = _add_facets(tree, places, touch, group, flags, equations)

    def eliminate(k: Any, table: Any) -> Any:
        pivot = table[k] / table[k, k]
        return (table - table[:, k][:, None] * pivot[None]).at[k].set(pivot)

    solution = jax.lax.fori_loop(0, size, eliminate, equations)[:, -1]
    found = iter(solution)
    parts = [[next(found) for _ in tree.dofs[dof]] for dof in range(tree.nv)]
    return [jnp.stack(part) if len(part) > 1 else part[0] for part in parts]


def _add_facets(
    tree: Tree, places: Sequence[tuple[int, int]], touch: Touch, rows: Rows, flags: Sequence[Any], equations: Any
) -> Any:
    """Each facet of each pair that pushes adds `weight J J^T`, and `- weight offset J` to the right."""
    shape = (len(flags[0]), *equations.shape[-1:])

    def along(row: dict[int, Scalar], place: tuple[int, int]) -> Any:
        return jnp.broadcast_to(lane(row[place[0]], place[1]).value if place[0] in row else 0.0, shape)

    columns = [Vector(*(Scalar(along(row, place)) for row in rows), *[ZERO] * (3 - len(rows))) for place in places]
    by_place = [touch.facets(column) for column in columns]
    for facet, (offset, flag) in enumerate(zip(touch.facets(touch.offset), flags, strict=True)):
        jacobian = jnp.stack([values[facet].value for values in by_place], axis=1)
        felt = jnp.concatenate([jacobian, -jnp.broadcast_to(offset.value, shape)[:, None]], axis=1)
        weight = jnp.where(flag, touch.weight.value, 0.0)

        def add_pair(pair: Any, table: Any, parts: tuple[Any, ...] = (jacobian, felt, weight)) -> Any:
            left, felt, weight = (part[pair] for part in parts)
            return table + (weight * left)[:, None] * felt[None]

        equations = jax.lax.fori_loop(0, shape[0], add_pair, equations)
    return equations
