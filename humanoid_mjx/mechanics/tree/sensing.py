"""Readings of a tree's state, as arrays: poses and velocities of bodies, forces, sensors.

Arrays count the bodies and degrees of freedom in the model's order, with `WORLD` behind.
"""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from humanoid_mjx.mechanics.scalars import ZERO, Scalar, Vector, add
from humanoid_mjx.mechanics.tree.algebra import (
    WORLD,
    Rotation,
    Spatial,
    compose,
    in_lane,
    known_axes,
    lane,
    resolve,
    stacked,
    subtract,
    unfolded,
    vector,
    velocity_at,
)
from humanoid_mjx.mechanics.tree.kinematics import Pose, motions_of, to_local
from humanoid_mjx.mechanics.tree.problem import Problem, Solution, ground_residuals
from humanoid_mjx.mechanics.tree.step import State
from humanoid_mjx.mechanics.tree.structure import Site, Tree


def sensed(tree: Tree, gravity: Any, state: State, problem: Problem, solution: Solution) -> tuple[Any, ...]:
    """Gyroscopes and accelerometers, poses and velocities of the bodies, forces of the ground on the feet."""
    gravity, acceleration = vector(gravity), solution.acceleration
    turning = [part for site in tree.gyroscopes for part in _gyroscope(state, site)]
    felt = [part for site in tree.accelerometers for part in _accelerometer(tree, state, acceleration, gravity, site)]
    pushes = _ground_forces(tree, problem, solution)
    readings = (stacked(part) for part in (turning, felt))
    forces = [sum((pushes[index] for index in rest), pushes[first]) for first, *rest in tree.feet]
    return *readings, *poses(tree, state), *_velocities(tree, state), stacked(forces)


def poses(tree: Tree, state: State) -> tuple[Any, Any]:
    """Positions and rotations of the bodies in the world."""
    at = state.kinematics
    own = unfolded([Pose(add(at.origin, pose.position), pose.axes) for pose in at.poses], tree.body_places)
    rotations = [jnp.stack([stacked([axis[i] for axis in pose.axes]) for i in range(3)]) for pose in own]
    return _rows([pose.position for pose in own]), jnp.stack(rotations)


def dynamics(tree: Tree, state: State) -> tuple[Any, Any]:
    """The whole mass matrix, and velocity terms and gravity less the joints' passive forces, for `qvel`."""
    where = {real: (dof, one) for dof, reals in enumerate(tree.dofs) for one, real in enumerate(reals)}

    def entry(i: int, j: int) -> Scalar:
        (row, a), (column, b) = max(where[i], where[j]), min(where[i], where[j])
        apart = a != b and tree.laned(row) and tree.laned(column)
        return ZERO if apart else lane(state.matrix[row][column], a)

    size, at = len(where), state.kinematics
    rows = [to_local(tree, at, [entry(i, j) for j in range(size)]) for i in range(size)]
    columns = [to_local(tree, at, [row[j] for row in rows]) for j in range(size)]
    matrix = jnp.stack([stacked([column[i] for column in columns]) for i in range(size)])
    bias = [b - p for b, p in zip(state.bias, state.passive, strict=True)]
    return matrix, stacked(unfolded(to_local(tree, at, bias), tree.dofs))


def moving(tree: Tree, state: State) -> tuple[Any, ...]:
    """Velocities, angular and linear, that a unit of each degree of freedom of `qvel` gives to its bodies, about the
    origin of the free body or the world; the drifts and the poses of the bodies."""
    motions, at = state.kinematics.motions, state.kinematics
    parts = [[m.angular[i] for m in motions] for i in range(3)] + [[m.linear[i] for m in motions] for i in range(3)]
    rows = [unfolded(to_local(tree, at, part), tree.dofs) for part in parts]
    motion = jnp.stack([stacked(row) for row in rows], axis=1)
    drifts = jnp.stack([_rows(list(drift)) for drift in unfolded(state.drifts, tree.body_places)])
    return motion, drifts, *poses(tree, state)


def _velocities(tree: Tree, state: State) -> tuple[Any, Any]:
    """Velocities of the origins of the bodies, m/s, and angular velocities, rad/s, in the world."""
    each = zip(state.motions, state.kinematics.poses, strict=True)
    moved = [Spatial(velocity_at(motion, pose.position), motion.angular) for motion, pose in each]
    own = unfolded(moved, tree.body_places)
    return _rows([motion.linear for motion in own]), _rows([motion.angular for motion in own])


def _ground_forces(tree: Tree, problem: Problem, solution: Solution) -> list[Scalar]:
    """Normal forces of the ground on the points that it can push, N, in the model's order."""
    at, found = problem.kinematics, {}
    residuals = ground_residuals(tree, at, problem.ground, solution.acceleration)
    for points, touch, v in zip(tree.ground, problem.ground, residuals, strict=True):
        lanes, force = (tree.lanes,) * tree.bodies[points.body].laned, touch.force(v).x.value
        shape = tree.points_each(points), *lanes
        whole = jnp.broadcast_to(force, (*shape, *WORLD))
        found |= {order: Scalar(whole[at]) for order, at in zip(points.order, np.ndindex(shape), strict=True)}
    return [found[index] for index in range(len(found))]


def _gyroscope(state: State, site: Site) -> Vector:
    """The angular velocity, rad/s, in the site's frame."""
    return resolve(_axes(state, site), in_lane(state.motions[site.body].angular, site.lane))


def _accelerometer(tree: Tree, state: State, acceleration: Sequence[Scalar], gravity: Vector, site: Site) -> Vector:
    """The acceleration less gravity's, m/s^2, in the site's frame: +9.81 upwards at rest."""
    place = state.kinematics.place(site.body, site.position)
    moved = velocity_at(motions_of(tree, state.kinematics, acceleration)[site.body], place)
    drift = state.drifts[site.body].at(subtract(place, state.kinematics.poses[site.body].position))
    felt = in_lane(add(moved, drift), site.lane)
    return resolve(_axes(state, site), subtract(felt, gravity))


def _axes(state: State, site: Site) -> Rotation:
    return compose(state.kinematics.of_lane(site.body, site.lane).axes, known_axes(site.axes))


def _rows(vectors: Sequence[Vector]) -> Any:
    return jnp.stack([stacked(v) for v in vectors]) if vectors else jnp.zeros((0, 3, *WORLD))
