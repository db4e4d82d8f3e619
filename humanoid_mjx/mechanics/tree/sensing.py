"""Readings of a tree's state, as arrays: poses and velocities of bodies, forces, sensors.

Arrays count the bodies and degrees of freedom in the model's order, with an axis of one world behind.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from humanoid_mjx.mechanics.tree.algebra import compose, in_lane, numbers, transposed, turn, unfolded, velocity_at
from humanoid_mjx.mechanics.tree.kinematics import motions_of, to_local
from humanoid_mjx.mechanics.tree.problem import Problem, Solution, ground_residuals
from humanoid_mjx.mechanics.tree.step import State
from humanoid_mjx.mechanics.tree.structure import Site, Tree


def sensed(tree: Tree, gravity: Any, state: State, problem: Problem, solution: Solution) -> tuple[Any, ...]:
    """Gyroscopes and accelerometers; poses of the bodies; velocities of their origins, m/s, and angular ones, rad/s, in
    the world; forces of the ground on the feet, N."""
    gravity = numbers(gravity) if isinstance(gravity, tuple) else gravity[:, None]
    motions = motions_of(tree, state.kinematics, solution.acceleration)
    turning = [_felt(state, site, state.motions[site.body][3:]) for site in tree.gyroscopes]
    felt = [_accelerometer(state, motions, gravity, site) for site in tree.accelerometers]
    pushes = _ground_forces(tree, problem, solution)
    readings = (jnp.concatenate(part) if part else jnp.zeros((0, 1)) for part in (turning, felt))
    forces = [sum((pushes[index] for index in rest), pushes[first]) for first, *rest in tree.feet]
    each = zip(state.motions, state.kinematics.poses, strict=True)
    moves = unfolded([(velocity_at(motion, pose.position), motion[3:]) for motion, pose in each], tree.body_places)
    velocities = (_stacked([move[part] for move in moves], (3,)) for part in range(2))
    return *readings, *poses(tree, state), *velocities, _stacked(forces, ())


def poses(tree: Tree, state: State) -> tuple[Any, Any]:
    """Positions and rotations of the bodies in the world."""
    at = state.kinematics
    own = unfolded([pose._replace(position=at.origin + pose.position) for pose in at.poses], tree.body_places)
    return _stacked([pose.position for pose in own], (3,)), _stacked([pose.axes for pose in own], (3, 3))


def dynamics(tree: Tree, state: State) -> tuple[Any, Any]:
    """The whole mass matrix, and velocity terms and gravity less the joints' passive forces, for `qvel`."""
    where = [(dof, index) for dof, lanes in enumerate(tree.dofs) for index, _ in enumerate(lanes)]
    places = [place for lanes in tree.dofs for place in lanes]
    rows: list[list[Any]] = [[np.zeros((1, 1))] * len(where) for _ in where]
    for place, (dof, index) in zip(places, where, strict=True):
        for other, entry in zip(tree.above(dof), state.matrix[dof], strict=True):
            column = tree.dofs[other][index if tree.laned(other) else 0]
            rows[place][column] = rows[column][place] = in_lane(entry, index)
    at, size = state.kinematics, range(len(where))
    rows = [to_local(tree, at, row) for row in rows]
    columns = [to_local(tree, at, [row[j] for row in rows]) for j in size]
    matrix = jnp.stack([_stacked([column[i] for column in columns], ()) for i in size])
    bias = [b - p for b, p in zip(state.bias, state.passive, strict=True)]
    return matrix, _stacked(unfolded(to_local(tree, at, bias), tree.dofs), ())


def moving(tree: Tree, state: State) -> tuple[Any, ...]:
    """Velocities, angular and linear, that a unit of each degree of freedom of `qvel` gives to its bodies, about the
    origin of the free body or the world; the drifts and the poses of the bodies."""
    motions, at = state.kinematics.motions, state.kinematics
    rows = [unfolded(to_local(tree, at, [m[i] for m in motions]), tree.dofs) for i in (3, 4, 5, 0, 1, 2)]
    motion = jnp.stack([_stacked(row, ()) for row in rows], axis=1)
    drifts = [_stacked(list(drift), (3,)) for drift in unfolded(state.drifts, tree.body_places)]
    return motion, jnp.stack(drifts), *poses(tree, state)


def _ground_forces(tree: Tree, problem: Problem, solution: Solution) -> list[Any]:
    """Normal forces of the ground on the points that it can push, N, in the model's order."""
    at, found = problem.kinematics, {}
    residuals = ground_residuals(tree, at, problem.ground, solution.acceleration)
    for points, touch, v in zip(tree.ground, problem.ground, residuals, strict=True):
        lanes, force = tree.lanes if tree.bodies[points.body].laned else 1, touch.force(v)[:, 0]
        each = jnp.broadcast_to(force, (len(points.order) // lanes, lanes, 1)).reshape(-1, 1, 1)
        found |= dict(zip(points.order, each, strict=True))
    return [found[index] for index in range(len(found))]


def _accelerometer(state: State, motions: list[Any], gravity: Any, site: Site) -> Any:
    """The acceleration less gravity's, m/s^2, in the site's frame: +9.81 upwards at rest."""
    place = state.kinematics.place(site.body, site.position)
    drift = state.drifts[site.body].at(place - state.kinematics.poses[site.body].position)
    return _felt(state, site, velocity_at(motions[site.body], place) + drift - gravity)


def _felt(state: State, site: Site, vector: Any) -> Any:
    """A vector of the world in the site's frame."""
    axes = compose(state.kinematics.of_lane(site.body, site.lane).axes, transposed(numbers(site.axes)))
    return turn(transposed(axes), in_lane(vector, site.lane))[:, 0]


def _stacked(parts: list[Any], shape: tuple[int, ...]) -> Any:
    """Arrays of one lane, of this shape, with a first axis that counts them, and without that of lanes."""
    return (
        jnp.stack([jnp.broadcast_to(part, (*shape, 1, 1)) for part in parts])[..., 0, :]
        if parts
        else jnp.zeros((0, *shape, 1))
    )
