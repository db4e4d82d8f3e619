"""What a tree's state shows: poses and velocities of bodies, forces of the ground, readings of sensors."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx.mechanics.scalars import ZERO, Scalar, Vector, add
from humanoid_mjx.mechanics.tree.algebra import (
    Rotation,
    Spatial,
    compose,
    lane,
    resolve,
    subtract,
    vector,
    velocity_at,
)
from humanoid_mjx.mechanics.tree.bias import Drift
from humanoid_mjx.mechanics.tree.kinematics import Pose, motions_of, to_local
from humanoid_mjx.mechanics.tree.problem import Problem, Solution
from humanoid_mjx.mechanics.tree.pushing import ground_residuals
from humanoid_mjx.mechanics.tree.step import State, unfolded
from humanoid_mjx.mechanics.tree.structure import Site, Tree


def ground_forces(tree: Tree, problem: Problem, solution: Solution) -> list[Scalar]:
    """Normal forces of the ground on the points that it can push, N, in the model's order."""
    at, found = problem.kinematics, {}
    residuals = ground_residuals(tree, at, problem.ground, solution.acceleration)
    for points, touch, v in zip(tree.ground, problem.ground, residuals, strict=True):
        lanes, force = (tree.lanes,) * tree.bodies[points.body].laned, touch.force(v).x.value
        shape = len(points.order) // max([1, *lanes]), *lanes
        whole = jnp.broadcast_to(force, (*shape, force.shape[-1]))
        found |= {order: Scalar(whole[at]) for order, at in zip(points.order, np.ndindex(shape), strict=True)}
    return [found[index] for index in range(len(found))]


def poses_of(tree: Tree, state: State) -> list[Pose]:
    """Poses of the model's bodies in the world, in the model's order."""
    at = state.kinematics
    return _by_body(tree, [Pose(add(at.origin, pose.position), pose.axes) for pose in at.poses])


def velocities_of(tree: Tree, state: State) -> list[Spatial]:
    """Velocities of the origins of the model's bodies, m/s, and angular velocities, rad/s, in the world, in the model's
    order."""
    each = zip(state.motions, state.kinematics.poses, strict=True)
    return _by_body(tree, [Spatial(velocity_at(motion, pose.position), motion.angular) for motion, pose in each])


def drifts_of(tree: Tree, state: State) -> list[Drift]:
    """The drifts of the model's bodies in the world, in the model's order."""
    return _by_body(tree, state.drifts)


def _by_body(tree: Tree, things: Sequence[Any]) -> list[Any]:
    """What the tree's bodies have, body by body of the model."""
    found = {
        place: _in_lane(thing, one)
        for thing, places in zip(things, tree.body_places, strict=True)
        for one, place in enumerate(places)
    }
    return [found[index] for index in range(len(found))]


def motions_by_dof(tree: Tree, state: State) -> list[list[Scalar]]:
    """What a unit of each degree of freedom of `qvel` does to the bodies that it moves: the six rows of their angular
    motions and of the velocities of their points at the origin, which is the free body's or the world's."""
    motions, at = state.kinematics.motions, state.kinematics
    parts = [[m.angular[i] for m in motions] for i in range(3)] + [[m.linear[i] for m in motions] for i in range(3)]
    return [unfolded(to_local(tree, at, part), tree.dofs) for part in parts]


def gyroscope(state: State, site: Site) -> Vector:
    """The angular velocity, rad/s, in the site's frame."""
    return resolve(_axes(state, site), _in_lane(state.motions[site.body].angular, site.lane))


def accelerometer(tree: Tree, state: State, acceleration: Sequence[Scalar], gravity: Vector, site: Site) -> Vector:
    """The acceleration less gravity's, m/s^2, in the site's frame: +9.81 upwards at rest.

    Args:
      acceleration: of the degrees of freedom, as the solver has it.
    """
    place = state.kinematics.place(site.body, site.position)
    moved = velocity_at(motions_of(tree, state.kinematics, acceleration)[site.body], place)
    drift = state.drifts[site.body].at(subtract(place, state.kinematics.poses[site.body].position))
    felt = _in_lane(add(moved, drift), site.lane)
    return resolve(_axes(state, site), subtract(felt, gravity))


def full_matrix(tree: Tree, state: State) -> list[list[Scalar]]:
    """The mass matrix, all of it, for velocities as `qvel` has them."""
    where = {real: (dof, one) for dof, reals in enumerate(tree.dofs) for one, real in enumerate(reals)}

    def entry(i: int, j: int) -> Scalar:
        (row, a), (column, b) = max(where[i], where[j]), min(where[i], where[j])
        apart = a != b and tree.laned(row) and tree.laned(column)
        return ZERO if apart else lane(state.matrix[row][column], a)

    size, at = len(where), state.kinematics
    rows = [to_local(tree, at, [entry(i, j) for j in range(size)]) for i in range(size)]
    columns = [to_local(tree, at, [row[j] for row in rows]) for j in range(size)]
    return [[column[i] for column in columns] for i in range(size)]


def bias_of(tree: Tree, state: State) -> list[Scalar]:
    """Velocity terms and gravity less the joints' passive forces, for `qvel`."""
    bias = [b - p for b, p in zip(state.bias, state.passive, strict=True)]
    return unfolded(to_local(tree, state.kinematics, bias), tree.dofs)


def _in_lane(thing: Any, index: int) -> Any:
    """A pytree of scalars of a laned body in one lane."""
    return jax.tree.map(lambda part: lane(part, index), thing, is_leaf=lambda part: isinstance(part, Scalar))


def _axes(state: State, site: Site) -> Rotation:
    axes = state.kinematics.of_lane(site.body, site.lane).axes
    x, y, z = (vector(axis) for axis in site.axes)
    return compose(axes, (x, y, z))
