"""The recursions over the links of a chain, all linear in the links' inertias.

Everything is expressed in the links' own frames and about their origins, so that masses, first and second moments enter
as they stand in the pseudo-inertias. See R. Featherstone, "Rigid Body Dynamics Algorithms" (2008), chapters 5 and 6.
"""

from collections.abc import Sequence

from humanoid_mjx.mechanics.links import Body, Link
from humanoid_mjx.mechanics.scalars import NULL, ZERO, Scalar, Vector, add, cross, dot, scale

Rows = tuple[Vector, Vector, Vector]
Wrench = tuple[Vector, Vector]
"""A force, and a moment about the origin of the frame."""


def newton_euler(
    links: Sequence[Link], gravity: Vector, velocity: Sequence[Scalar], acceleration: Sequence[Scalar]
) -> list[Scalar]:
    """The joint torques of a motion, N m: outwards the accelerations, inwards the forces."""
    angular = angular_rate = NULL
    linear = Vector(-gravity.x, -gravity.y, -gravity.z)
    wrenches = []
    for link, qd, qdd in zip(links, velocity, acceleration, strict=True):
        w = angular
        angular_rate = link.outward(add(angular_rate, Vector(w.y * qd, -(w.x * qd), qdd)))
        angular = link.outward(Vector(w.x, w.y, w.z + qd))
        gradient = acceleration_gradient(angular, angular_rate)
        linear = add(link.outward(linear), _product(gradient, link.offset))
        wrenches.append(_inertial_wrench(link.body, linear, gradient))
    torques = []
    force = moment = NULL
    for link, (link_force, link_moment) in zip(reversed(links), reversed(wrenches), strict=True):
        force, moment = _inward((add(force, link_force), add(moment, link_moment)), link)
        torques.append(moment.z)
    return torques[::-1]


def composite_inertia(links: Sequence[Link]) -> list[list[Scalar]]:
    """The mass matrix: each joint carries all links beyond it as one composite body."""
    size = len(links)
    matrix = [[ZERO] * size for _ in range(size)]
    composite = Body()
    for column in reversed(range(size)):
        composite = links[column].inward_body(composite.plus(links[column].body))
        # What turning that body about z by 1 rad/s^2 takes: the acceleration of its point r is z x r.
        force = Vector(-composite.first.y, composite.first.x, ZERO)
        second = composite.second
        moment = Vector(-second.xz, -second.yz, second.xx + second.yy)
        matrix[column][column] = moment.z
        for row in reversed(range(column)):
            force, moment = _inward((force, moment), links[row])
            matrix[row][column] = matrix[column][row] = moment.z
    return matrix


def acceleration_gradient(w: Vector, rate: Vector) -> Rows:
    """L of a turning body, whose point r is accelerated by L r against its origin: [rate]x + [w]x [w]x."""
    xx, yy, zz = w.x * w.x, w.y * w.y, w.z * w.z
    xy, xz, yz = w.x * w.y, w.x * w.z, w.y * w.z
    return (
        Vector(-(yy + zz), xy - rate.z, xz + rate.y),
        Vector(xy + rate.z, -(xx + zz), yz - rate.x),
        Vector(xz - rate.y, yz + rate.x, -(xx + yy)),
    )


def _inertial_wrench(body: Body, linear: Vector, gradient: Rows) -> Wrench:
    """The integrals of a dm and r x a dm, where a = linear + gradient r."""
    x, y, z = body.second.rows
    to_x, to_y, to_z = gradient
    turning = Vector(dot(y, to_z) - dot(z, to_y), dot(z, to_x) - dot(x, to_z), dot(x, to_y) - dot(y, to_x))
    force = add(scale(body.mass, linear), _product(gradient, body.first))
    return force, add(turning, cross(body.first, linear))


def _inward(wrench: Wrench, link: Link) -> Wrench:
    """A wrench about origin i in frame i as one about origin i-1 in frame i-1."""
    force, moment = wrench
    return link.inward(force), link.inward(add(moment, cross(link.offset, force)))


def _product(rows: Rows, v: Vector) -> Vector:
    return Vector(*(dot(row, v) for row in rows))
