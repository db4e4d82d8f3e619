"""What contacts between bodies add to the equations of a tree. They join its branches, so the equations lose their
sparsity; as such contacts are rare, that is paid for only where some world of a batch has one."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from humanoid_mjx.mechanics.scalars import ZERO, Scalar, Vector, add
from humanoid_mjx.mechanics.tree.algebra import force_at, known, over_lanes, power, stacked
from humanoid_mjx.mechanics.tree.contacts import Touch
from humanoid_mjx.mechanics.tree.inertia import Matrix
from humanoid_mjx.mechanics.tree.kinematics import Kinematics
from humanoid_mjx.mechanics.tree.structure import Pairs, Tree

Rows = list[dict[int, Scalar]]
"""For each direction of the contacts' frames that is felt: how the degrees of freedom move the second body against the
first, with an axis of pairs, and behind it one of lanes for those that have lanes."""


def pair_rows(tree: Tree, kinematics: Kinematics, touches: Sequence[Touch]) -> list[Rows]:
    """The rows of all groups of pairs."""
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
        moved.append(plain + (laned if laned is ZERO else over_lanes([laned], tree.lanes)[0]))
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
    """The solution of the equations with the pairs' contacts in them, or that `without` in worlds where none pushes.

    By elimination of whole matrices, one column after another, with an axis of worlds behind. Where loops are written
    out, what is multiplied by a zero here is not.
    """
    stem = next((dof for dof in range(tree.nv) if tree.laned(dof)), tree.nv)
    worlds = jnp.broadcast_shapes(*(jnp.shape(x.value)[-1:] for x in [*right, *(x for row in matrix for x in row)]))
    equations = _whole(tree, stem, matrix, right, worlds)
    size = len(equations)
    for touch, group, flags in zip(touches, rows, active, strict=True):
        equations = _add_facets(tree, stem, touch, group, flags, equations)

    rows_at, columns_at = np.arange(size)[:, None], np.arange(size + 1)[:, None]

    def eliminate(k: Any, table: Any) -> Any:
        pivot = table[k] / table[k, k]
        below, ahead = jnp.where(rows_at > k, table[:, k], 0.0), jnp.where(columns_at > k, pivot, 0.0)
        return jax.lax.dynamic_update_index_in_dim(table - below[:, None] * ahead[None], pivot, k, axis=0)

    triangle = jax.lax.fori_loop(0, size, eliminate, equations)

    def substitute(step: Any, found: Any) -> Any:
        k = size - 1 - step
        return found - jnp.where(rows_at < k, triangle[:, k], 0.0) * found[k]

    solution = jax.lax.fori_loop(0, size, substitute, triangle[:, -1])
    laned = solution[stem:].reshape(tree.nv - stem, tree.lanes, *worlds)
    pushing = jnp.concatenate([flag for group in active for flag in group]).any(axis=0)
    # A world's bits must not depend on whether another made its batch come here.
    found = zip([*solution[:stem], *laned], without, strict=True)
    return [Scalar(jnp.where(pushing, new, old.value)) for new, old in found]


def _whole(
    tree: Tree, stem: int, matrix: Matrix, right: Sequence[Scalar], worlds: tuple[int, ...]
) -> Float[Array, "size columns worlds"]:
    """The equations of all lanes: matrix and right side."""
    limb, lanes = tree.nv - stem, tree.lanes
    laned = (lanes, *worlds)
    rows, columns = range(stem), range(stem, tree.nv)
    base = stacked([matrix[max(i, j)][min(i, j)] for i in rows for j in rows], worlds)
    base = base.reshape(stem, stem, *worlds)
    base = jnp.concatenate([base, stacked(right[:stem], worlds)[:, None]], axis=1)
    if not limb:
        return base
    cross = stacked([matrix[i][j] for i in columns for j in rows], laned)
    cross = cross.reshape(limb, stem, lanes, *worlds).swapaxes(1, 2).reshape(limb * lanes, stem, *worlds)
    own = stacked([matrix[max(i, j)][min(i, j)] for i in columns for j in columns], laned)
    own = own.reshape(limb, 1, limb, lanes, *worlds) * jnp.eye(lanes)[None, :, None, :, None]
    own = own.reshape(limb * lanes, limb * lanes, *worlds)
    last = stacked(right[stem:], laned).reshape(limb * lanes, 1, *worlds)
    above = jnp.concatenate([base[:, :stem], cross.swapaxes(0, 1), base[:, stem:]], axis=1)
    return jnp.concatenate([above, jnp.concatenate([cross, own, last], axis=1)])


def _add_facets(
    tree: Tree, stem: int, touch: Touch, rows: Rows, flags: Sequence[Any], equations: Any
) -> Float[Array, "size columns worlds"]:
    """Each facet of each pair that pushes adds `weight J J^T`, and `- weight offset J` to the right."""
    pairs, worlds = len(flags[0]), equations.shape[-1:]

    def whole(row: dict[int, Scalar]) -> Scalar:
        plain = [jnp.broadcast_to(row[dof].value if dof in row else 0.0, (pairs, *worlds)) for dof in range(stem)]
        shape = (pairs, tree.lanes, *worlds)
        laned = [jnp.broadcast_to(row[dof].value if dof in row else 0.0, shape) for dof in range(stem, tree.nv)]
        parts = [jnp.stack(plain, axis=1)] if plain else []
        parts += [jnp.stack(laned, axis=1).reshape(pairs, -1, *worlds)] if laned else []
        return Scalar(jnp.concatenate(parts, axis=1))

    jacobians = Vector(*(whole(row) for row in rows), *[ZERO] * (3 - len(rows)))
    friction = touch.friction and tuple(Scalar(jnp.atleast_2d(mu.value)[..., None, :]) for mu in touch.friction)
    facets = touch._replace(friction=friction).facets(jacobians)
    for jacobian, offset, flag in zip(facets, touch.facets(touch.offset), flags, strict=True):
        pull = -jnp.broadcast_to(offset.value, (pairs, *worlds))[:, None]
        felt = jnp.concatenate([jacobian.value, pull], axis=1)
        weight = jnp.where(flag, touch.weight.value, 0.0)

        def add_pair(pair: Any, table: Any, parts: tuple[Any, ...] = (jacobian.value, felt, weight)) -> Any:
            left, felt, weight = (part[pair] for part in parts)
            return table + (weight * left)[:, None] * felt[None]

        equations = jax.lax.fori_loop(0, pairs, add_pair, equations)
    return equations
