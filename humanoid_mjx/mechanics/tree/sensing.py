"""What a tree's state shows: poses and velocities of bodies, forces of contacts, readings of sensors."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from humanoid_mjx.mechanics.scalars import NULL, ZERO, Scalar, Vector, add, dot, scale
from humanoid_mjx.mechanics.tree.algebra import (
    Rotation,
    Spatial,
    compose,
    lane,
    number,
    resolve,
    subtract,
    times,
    total,
    vector,
    velocity_at,
)
from humanoid_mjx.mechanics.tree.bias import Drift
from humanoid_mjx.mechanics.tree.contacts import ground_center
from humanoid_mjx.mechanics.tree.kinematics import Pose, motions_of, to_local
from humanoid_mjx.mechanics.tree.problem import Problem
from humanoid_mjx.mechanics.tree.pushing import ground_residuals
from humanoid_mjx.mechanics.tree.solver import Solution
from humanoid_mjx.mechanics.tree.step import State, unfolded
from humanoid_mjx.mechanics.tree.structure import Site, Tree

Place = tuple[int, int]
"""A body of a tree, and its lane."""


class Push(NamedTuple):
    """A contact and what it does."""

    place: Vector
    """In the world, m."""
    normal: Vector
    """From the first body, or the ground, to the second."""
    pressure: Scalar
    """Along the normal, N; 0 where the contact does not push."""
    friction: Vector
    """On the second body, in the world, N."""
    bodies: tuple[Place, Place]


def pushes_of(tree: Tree, problem: Problem, solution: Solution, sensors: Sequence[Site]) -> list[Push]:
    """All contacts of the ground in the model's order, then those of bodies with these sensors."""
    at, x = problem.kinematics, solution.acceleration
    ground: dict[int, Push] = {}
    for points, touch, v in zip(
        tree.ground, problem.ground, ground_residuals(tree, at, problem.ground, x), strict=True
    ):
        lanes = tree.lanes if tree.bodies[points.body].laned else 1
        several = len(points.order) > lanes
        for index, order in enumerate(points.order):
            point, one = divmod(index, lanes)
            picked = _picked((touch.place, touch.frame, touch.force(v)), [point] * several, [one] * (lanes > 1))
            ground[order] = _push(at.origin, picked, ((0, 0), (points.body, one)))
    pairs: list[Push] = []
    motions, sensed = motions_of(tree, at, x), {(site.body, site.lane) for site in sensors}
    for group, touch in zip(tree.pairs, problem.pairs, strict=True):
        for index, (one, two) in enumerate(zip(group.ones, group.twos, strict=True)):
            bodies = (one.body, one.lane), (two.body, two.lane)
            if not sensed.intersection(bodies):
                continue
            own = jax.tree.map(lambda v, index=index: v[min(index, len(v) - 1)] if jnp.ndim(v) > 1 else v, touch)
            of_one, of_two = (_in_lane(motions[body], one) for body, one in bodies)
            v = own.residual(total([of_two, times(Scalar(-1.0), of_one)]))
            pairs.append(_push(at.origin, (own.place, own.frame, own.force(v)), bodies))
    return [*(ground[index] for index in range(len(ground))), *pairs]


def _picked(things: Any, point: Sequence[int], one: Sequence[int]) -> Any:
    """One contact's of a pytree of scalars with axes of points and of lanes, if any."""
    rank = len(point) + len(one) + 1

    def pick(scalar: Scalar) -> Scalar:
        value = scalar.value
        if jnp.ndim(value) == rank and point:
            value = value[point[0] if value.shape[0] > 1 else 0]
        return lane(Scalar(value), one[0]) if one and jnp.ndim(value) > 1 else Scalar(value)

    return jax.tree.map(pick, things, is_leaf=lambda part: isinstance(part, Scalar))


def _push(origin: Vector, contact: tuple[Vector, Rotation, Vector], bodies: tuple[Place, Place]) -> Push:
    place, (normal, one, two), force = contact
    slip = add(scale(force.y, one), scale(force.z, two))
    return Push(add(origin, place), normal, force.x, slip, bodies)


def poses_of(tree: Tree, state: State) -> list[Pose]:
    """Poses of the model's bodies in the world, in the model's order."""
    found: dict[int, Pose] = {}
    for index, places in enumerate(tree.body_places):
        for one, place in enumerate(places):
            position, axes = state.kinematics.of_lane(index, one)
            found[place] = Pose(add(state.kinematics.origin, position), axes)
    return [found[index] for index in range(len(found))]


def velocities_of(tree: Tree, state: State) -> list[Spatial]:
    """Velocities of the origins of the model's bodies, m/s, and angular velocities, rad/s, in the world, in the model's
    order."""
    found: dict[int, Spatial] = {}
    for index, places in enumerate(tree.body_places):
        motion = state.motions[index]
        own = Spatial(velocity_at(motion, state.kinematics.poses[index].position), motion.angular)
        for one, place in enumerate(places):
            found[place] = _picked(own, [], [one] * (len(places) > 1))
    return [found[index] for index in range(len(found))]


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
    felt = _in_lane(add(moved, drift_at(state, site.body, place)), site.lane)
    return resolve(_axes(state, site), subtract(felt, gravity))


def touch_sensor(state: State, pushes: Sequence[Push], site: Site) -> Scalar:
    """The sum of the normal forces, N, of the contacts of the site's body that point into the site's volume."""
    axes, own = _axes(state, site), (site.body, site.lane)
    center = add(state.kinematics.origin, _in_lane(state.kinematics.place(site.body, site.position), site.lane))
    felt = ZERO
    for push in pushes:
        if own not in push.bodies:
            continue
        sign = Scalar(-1.0 if push.bodies[1] == own else 1.0)
        ray, start = resolve(axes, scale(sign, push.normal)), resolve(axes, subtract(push.place, center))
        hit = _hits_box(start, ray, site) if site.box else _hits_ball(start, ray, site)
        felt = felt + Scalar(jnp.where(hit, push.pressure.value, 0.0))
    return felt


def _hits_box(start: Vector, ray: Vector, site: Site) -> Any:
    """Whether a ray meets a box about the origin: whether it is between all its faces at one time from 0 on."""
    enter, leave = jnp.zeros(()), jnp.full((), jnp.inf)
    for s, r, half in zip(start, ray, site.size, strict=True):
        # A ray along a face is between it and the opposite one always or never.
        place, rate = jnp.asarray(s.value), jnp.asarray(r.value)
        along = jnp.abs(rate) < 1e-12
        safe = jnp.where(along, 1.0, rate)
        one, two = (-half - place) / safe, (half - place) / safe
        inside = jnp.abs(place) <= half
        enter = jnp.maximum(enter, jnp.where(along, jnp.where(inside, 0.0, jnp.inf), jnp.minimum(one, two)))
        leave = jnp.minimum(leave, jnp.where(along, jnp.where(inside, jnp.inf, -1.0), jnp.maximum(one, two)))
    return enter <= leave


def _hits_ball(start: Vector, ray: Vector, site: Site) -> Any:
    """Whether a ray meets a ball about the origin: whether its nearest point from the start on lies within."""
    nearest = Scalar(jnp.maximum(-dot(start, ray).value, 0.0))
    point = add(start, scale(nearest, ray))
    return dot(point, point).value <= site.size[0] ** 2


class PointMotion(NamedTuple):
    """How a point of a body moves."""

    place: Vector
    """In the world, m."""
    columns: list[Vector]
    """Its velocity for a unit of each degree of freedom of `qvel`."""
    drift: Vector
    """Its acceleration where none of them accelerates, m/s^2."""


def lowest_points(tree: Tree, state: State) -> list[PointMotion]:
    """The lowest points of the shapes that the ground can push, and how they move, in the model's order."""
    at = state.kinematics
    found: dict[int, PointMotion] = {}
    for points in tree.ground:
        lanes = tree.lanes if tree.bodies[points.body].laned else 1
        several = len(points.order) > lanes
        below = scale(number(points.radius), vector(points.normal))
        place = subtract(ground_center(points, at), below)
        moving = tree.moving(points.body)
        motions = [velocity_at(at.motions[dof], place) for dof in moving]
        drift = drift_at(state, points.body, place)
        for index, order in enumerate(points.order):
            point, one = divmod(index, lanes)
            where = [point] * several, [one] * (lanes > 1)
            own = dict(zip(moving, _picked(motions, *where), strict=True))
            columns = {
                real: own[dof] if dof in own and lanes_of in (one, 0 if not tree.laned(dof) else one) else NULL
                for dof, reals in enumerate(tree.dofs)
                for lanes_of, real in enumerate(reals)
            }
            rows = [to_local(tree, at, [columns[real][i] for real in range(len(columns))]) for i in range(3)]
            turned = [Vector(*(row[real] for row in rows)) for real in range(len(columns))]
            found[order] = PointMotion(add(at.origin, _picked(place, *where)), turned, _picked(drift, *where))
    return [found[index] for index in range(len(found))]


def drift_at(state: State, body: int, place: Vector) -> Vector:
    """The acceleration of a body's point, against the origin, where no degree of freedom accelerates."""
    drift: Drift = state.drifts[body]
    return drift.at(subtract(place, state.kinematics.poses[body].position))


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
