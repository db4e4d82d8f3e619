"""The links of a chain at one configuration, and recursions over them.

The recursions are linear in the links' inertias. Everything is expressed in the links' own frames and about their
origins, where the pseudo-inertias stand: integrals of r r^T dm, r = [x y z 1]. See R. Featherstone, "Rigid Body
Dynamics Algorithms" (2008), chapters 5 and 6.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from humanoid_mjx.robot.chain import Chain, quarter_turns

Vector = Float[Array, "3"]


class Link(NamedTuple):
    """Link i, whose frame is reached from frame i-1 by a turn about z, a move, and a turn about x."""

    rotation: Float[Array, "3 3"]
    """From the axes of frame i to those of frame i-1."""
    offset: Vector
    """From origin i-1 to origin i, in frame i: it does not depend on q."""
    inertia: Float[Array, "4 4"]
    """The pseudo-inertia."""

    def inward(self, force: Vector, moment: Vector) -> tuple[Vector, Vector]:
        """A force and a moment about origin i in frame i as those about origin i-1 in frame i-1."""
        return self.rotation @ force, self.rotation @ (moment + jnp.cross(self.offset, force))

    def inward_body(self, inertia: Float[Array, "4 4"]) -> Float[Array, "4 4"]:
        """A pseudo-inertia in frame i as one in frame i-1."""
        for move in _homogeneous(jnp.eye(3), self.offset), _homogeneous(self.rotation, jnp.zeros(3)):
            inertia = _symmetric(move @ inertia @ move.T)
        return inertia


def make_links(chain: Chain, qpos: Float[Array, " joints"]) -> list[Link]:
    """The links of a chain with its joints at `qpos`, rad."""
    structure, links = chain.structure, []
    d, a = jnp.where(np.array(structure.has_d), chain.d, 0.0), jnp.where(np.array(structure.has_a), chain.a, 0.0)
    inertias = jnp.where(np.array(structure.has_inertia), chain.pseudo_inertia, 0.0)
    for i in range(chain.num_joints):
        (cos, sin), (up, across) = (quarter_turns(s[i]) for s in (structure.theta_offset, structure.alpha))
        x, y = jnp.cos(qpos[i]), jnp.sin(qpos[i])
        x, y = cos * x - sin * y, sin * x + cos * y
        turn = jnp.stack([jnp.stack([x, -y, 0.0 * x]), jnp.stack([y, x, 0.0 * x]), jnp.eye(3, dtype=x.dtype)[2]])
        rotation = turn @ np.array([[1.0, 0.0, 0.0], [0.0, up, -across], [0.0, across, up]], x.dtype)
        links.append(Link(rotation, jnp.stack([a[i], d[i] * across, d[i] * up]), _symmetric(inertias[i])))
    return links


def gravity_vector(chain: Chain) -> Vector:
    """Gravity in frame 0, m/s^2."""
    return jnp.where(np.array(chain.structure.has_gravity), chain.gravity, 0.0)


def newton_euler(
    links: Sequence[Link],
    gravity: Vector,
    velocity: Float[Array, " joints"],
    acceleration: Float[Array, " joints"],
) -> Float[Array, " joints"]:
    """The joint torques of a motion, N m: outwards the accelerations, inwards the forces."""
    angular = rate = jnp.zeros_like(gravity)
    linear, about, wrenches = -gravity, jnp.eye(3, dtype=gravity.dtype)[2], []
    for link, qd, qdd in zip(links, velocity, acceleration, strict=True):
        rate = link.rotation.T @ (rate + jnp.cross(angular, qd * about) + qdd * about)
        angular = link.rotation.T @ (angular + qd * about)
        # A point r of the link is accelerated by `gradient r` against its origin.
        gradient = _skew(rate) + _skew(angular) @ _skew(angular)
        linear = link.rotation.T @ linear + gradient @ link.offset
        # The integrals of a r^T dm, a = gradient r + linear; the last column is the force.
        pushes = jnp.concatenate([gradient, linear[:, None]], axis=1) @ link.inertia
        turning = pushes[:, :3].T - pushes[:, :3]
        wrenches.append((pushes[:, 3], jnp.stack([turning[1, 2], turning[2, 0], turning[0, 1]])))
    torques = []
    force = moment = jnp.zeros_like(gravity)
    for link, (link_force, link_moment) in zip(reversed(links), reversed(wrenches), strict=True):
        force, moment = link.inward(force + link_force, moment + link_moment)
        torques.append(moment[2])
    return jnp.stack(torques[::-1])


def composite_inertia(links: Sequence[Link]) -> Float[Array, "joints joints"]:
    """The mass matrix: each joint carries all links beyond it as one composite body."""
    size, composite = len(links), jnp.zeros_like(links[0].inertia)
    rows: list[list[Any]] = [[None] * size for _ in links]
    for column in reversed(range(size)):
        composite = links[column].inward_body(composite + links[column].inertia)
        (xx, _, xz, x), (_, yy, yz, y), *_ = composite
        # What turning that body about z by 1 rad/s^2 takes: the acceleration of its point r is z x r.
        force, moment = jnp.stack([-y, x, 0.0 * x]), jnp.stack([-xz, -yz, xx + yy])
        rows[column][column] = moment[2]
        for row in reversed(range(column)):
            force, moment = links[row].inward(force, moment)
            rows[row][column] = rows[column][row] = moment[2]
    return jnp.stack([jnp.stack(row) for row in rows])


def solve(matrix: Float[Array, "n n"], vector: Float[Array, " n"]) -> Float[Array, " n"]:
    """x of `matrix x = vector` for a symmetric, positive definite matrix, without pivoting."""
    rows, inverse = [], []
    for _ in range(len(vector)):
        inverse.append(1.0 / matrix[0, 0])
        below = matrix[1:, 0] * inverse[-1]
        rows.append((below, vector[0]))
        vector = vector[1:] - below * vector[0]
        matrix = _symmetric(matrix[1:, 1:] - below[:, None] * matrix[1:, 0])
    x = vector
    for (below, value), scale in zip(reversed(rows), reversed(inverse), strict=True):
        x = jnp.concatenate([(value * scale - (below * x).sum())[None], x])
    return x


def _homogeneous(rotation: Float[Array, "3 3"], offset: Vector) -> Float[Array, "4 4"]:
    last = jnp.eye(4, dtype=offset.dtype)[3:]
    return jnp.concatenate([jnp.concatenate([rotation, (rotation @ offset)[:, None]], axis=1), last])


def _skew(v: Vector) -> Float[Array, "3 3"]:
    """The matrix of the vector product with `v`."""
    x, y, z = v
    return jnp.stack([jnp.stack([0.0 * x, -z, y]), jnp.stack([z, 0.0 * x, -x]), jnp.stack([-y, x, 0.0 * x])])


def _symmetric(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """The matrix of its lower triangle, of which the other is then no work."""
    return jnp.where(np.tri(len(matrix), dtype=bool), matrix, matrix.T)
