"""The links of a chain at one configuration, as scalars whose structural zeros are known, and recursions over them.

The recursions are linear in the links' inertias. Everything is expressed in the links' own frames and about their
origins, so that masses, first and second moments enter as they stand in the pseudo-inertias. See R. Featherstone,
"Rigid Body Dynamics Algorithms" (2008), chapters 5 and 6.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from humanoid_mjx.mechanics.scalars import NULL, ZERO, Scalar, Symmetric, Turn, Vector, add, cross, dot, scale
from humanoid_mjx.robot.chain import Chain, quarter_turns


class Body(NamedTuple):
    """Mass, first moment and second moments of a distribution of mass about the origin of a frame."""

    mass: Scalar = ZERO
    first: Vector = NULL
    second: Symmetric = Symmetric()

    def plus(self, other: "Body") -> "Body":
        """Both together."""
        return Body(self.mass + other.mass, add(self.first, other.first), self.second.plus(other.second))

    def moved(self, by: Vector) -> "Body":
        """The body about an origin that lies at -`by` in its frame."""
        h, old = self.first, self.second
        first = add(h, scale(self.mass, by))
        second = Symmetric(
            xx=old.xx + by.x * (h.x + first.x),
            xy=old.xy + by.x * first.y + by.y * h.x,
            xz=old.xz + by.x * first.z + by.z * h.x,
            yy=old.yy + by.y * (h.y + first.y),
            yz=old.yz + by.y * first.z + by.z * h.y,
            zz=old.zz + by.z * (h.z + first.z),
        )
        return Body(self.mass, first, second)


class Link(NamedTuple):
    """Link i: its frame is reached from frame i-1 by `turn` about z, a move by `offset`, `twist` about x."""

    turn: Turn
    twist: Turn
    offset: Vector
    """From origin i-1 to origin i, in frame i: it does not depend on q."""
    body: Body

    def inward(self, v: Vector) -> Vector:
        """A vector of frame i in the axes of frame i-1."""
        y, z = self.twist.apply(v.y, v.z)
        return Vector(*self.turn.apply(v.x, y), z)

    def outward(self, v: Vector) -> Vector:
        """A vector of frame i-1 in the axes of frame i."""
        x, y = self.turn.undo(v.x, v.y)
        return Vector(x, *self.twist.undo(y, v.z))

    def inward_body(self, body: Body) -> Body:
        """A body of frame i in frame i-1."""
        body = body.moved(self.offset)
        second = body.second
        xy, xz = self.twist.apply(second.xy, second.xz)
        yy, yz, zz = self.twist.apply_symmetric(second.yy, second.yz, second.zz)
        xz, yz = self.turn.apply(xz, yz)
        xx, xy, yy = self.turn.apply_symmetric(second.xx, xy, yy)
        return Body(body.mass, self.inward(body.first), Symmetric(xx, xy, xz, yy, yz, zz))


def make_links(chain: Chain, qpos: Float[Array, " joints"]) -> list[Link]:
    """The links of a chain with its joints at `qpos`, rad."""
    structure = chain.structure
    d, a = _scalars(chain.d, structure.has_d), _scalars(chain.a, structure.has_a)
    inertias = _scalars(chain.pseudo_inertia, structure.has_inertia)
    links = []
    for i in range(chain.num_joints):
        start, twist = (Turn(*map(Scalar, quarter_turns(s[i]))) for s in (structure.theta_offset, structure.alpha))
        turn = Turn(*start.apply(Scalar(jnp.cos(qpos[i])), Scalar(jnp.sin(qpos[i]))))
        (xx, xy, xz, x), (_, yy, yz, y), (_, _, zz, z), (*_, mass) = inertias[i]
        body = Body(mass, Vector(x, y, z), Symmetric(xx, xy, xz, yy, yz, zz))
        links.append(Link(turn, twist, Vector(a[i], d[i] * twist.sin, d[i] * twist.cos), body))
    return links


def gravity_vector(chain: Chain) -> Vector:
    """Gravity in frame 0, m/s^2."""
    return Vector(*_scalars(chain.gravity, chain.structure.has_gravity))


def _scalars(array: Any, present: tuple[Any, ...]) -> list[Any]:
    """The elements of an array, nested as `present` is: zero where it is false, known where the array is."""
    if not isinstance(array, Tracer):
        array = np.asarray(array, np.float64)

    def pick(index: tuple[int, ...], here: Any) -> Any:
        if isinstance(here, tuple):
            return [pick((*index, i), inner) for i, inner in enumerate(here)]
        if not here:
            return ZERO
        return Scalar(float(array[index]) if isinstance(array, np.ndarray) else array[index])

    return pick((), present)


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
