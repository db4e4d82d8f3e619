"""What a tree's state shows: poses and velocities of bodies, forces of contacts, readings of sensors."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp

from humanoid_mjx.mechanics.scalars import NULL, ZERO, Scalar, Vector, add, dot, scale
from humanoid_mjx.mechanics.tree.algebra import Spatial, resolve, subtract, velocity_at
from humanoid_mjx.mechanics.tree.bias import Drift
from humanoid_mjx.mechanics.tree.contacts import Touch
from humanoid_mjx.mechanics.tree.inertia import Matrix
from humanoid_mjx.mechanics.tree.kinematics import motions_of, to_local
from humanoid_mjx.mechanics.tree.solver import Problem, Solution, residuals
from humanoid_mjx.mechanics.tree.step import State
from humanoid_mjx.mechanics.tree.structure import Site, Tree


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
    bodies: tuple[int, int]


def pushes_of(tree: Tree, problem: Problem, solution: Solution) -> list[Push]:
    """All contacts: those of `tree.ground`, then those of `tree.pairs`."""
    ground, pairs = residuals(tree, problem, solution.acceleration)
    bodies = [(0, point.body) for point in tree.ground] + [(pair.one.body, pair.two.body) for pair in tree.pairs]
    touches = [*problem.ground, *problem.pairs]
    return [_push(problem, *each) for each in zip(touches, [*ground, *pairs], bodies, strict=True)]


def _push(problem: Problem, touch: Touch, residual: Vector, bodies: tuple[int, int]) -> Push:
    force, (normal, one, two) = touch.force(residual), touch.frame
    slip = add(scale(force.y, one), scale(force.z, two))
    return Push(add(problem.kinematics.origin, touch.place), normal, force.x, slip, bodies)


def velocities_of(tree: Tree, state: State) -> list[Spatial]:
    """Of each body: the velocity of its own origin and its angular velocity, in the world."""
    return [
        Spatial(velocity_at(motion, pose.position), motion.angular)
        for motion, pose in zip(state.motions, state.kinematics.poses, strict=True)
    ]


def gyroscope(state: State, site: Site) -> Vector:
    """The angular velocity, rad/s, in the site's frame."""
    return resolve(_axes(state, site), state.motions[site.body].angular)


def accelerometer(tree: Tree, state: State, acceleration: Sequence[Scalar], gravity: Vector, site: Site) -> Vector:
    """The acceleration less gravity's, m/s^2, in the site's frame: +9.81 upwards at rest.

    Args:
      acceleration: of the degrees of freedom, as the solver has it.
    """
    place = state.kinematics.place(site.body, site.position)
    arm = subtract(place, state.kinematics.poses[site.body].position)
    moved = velocity_at(motions_of(tree, state.kinematics, acceleration)[site.body], place)
    return resolve(_axes(state, site), subtract(add(moved, state.drifts[site.body].at(arm)), gravity))


def touch_sensor(state: State, pushes: Sequence[Push], site: Site) -> Scalar:
    """The sum of the normal forces, N, of the contacts of the site's body that point into the site's volume."""
    axes = _axes(state, site)
    center = add(state.kinematics.origin, state.kinematics.place(site.body, site.position))
    felt = ZERO
    for push in pushes:
        if site.body not in push.bodies:
            continue
        sign = Scalar(-1.0 if push.bodies[1] == site.body else 1.0)
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


def point_jacobian(tree: Tree, state: State, body: int, place: Vector) -> list[Vector]:
    """How a point of a body, against the origin, moves with each degree of freedom of `qvel`."""
    moving = tree.dofs(body)
    columns = [
        velocity_at(motion, place) if dof in moving else NULL for dof, motion in enumerate(state.kinematics.motions)
    ]
    rows = [to_local(tree, state.kinematics, [column[i] for column in columns]) for i in range(3)]
    return [Vector(*(row[dof] for row in rows)) for dof in range(tree.nv)]


def drift_at(state: State, body: int, place: Vector) -> Vector:
    """The acceleration of a body's point, against the origin, where no degree of freedom accelerates."""
    drift: Drift = state.drifts[body]
    return drift.at(subtract(place, state.kinematics.poses[body].position))


def full_matrix(tree: Tree, state: State) -> Matrix:
    """The mass matrix, all of it, for velocities as `qvel` has them."""
    size, at = tree.nv, state.kinematics
    rows = [[state.matrix[max(i, j)][min(i, j)] for j in range(size)] for i in range(size)]
    columns = [to_local(tree, at, row) for row in rows]
    turned = [to_local(tree, at, [row[j] for row in columns]) for j in range(size)]
    return [[turned[j][i] for j in range(size)] for i in range(size)]


def _axes(state: State, site: Site) -> tuple[Vector, Vector, Vector]:
    x, y, z = (state.kinematics.direction(site.body, axis) for axis in site.axes)
    return x, y, z
