"""The links of a chain at one configuration, as scalars whose structural zeros are known."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from humanoid_mjx.mechanics.scalars import NULL, ZERO, Scalar, Symmetric, Turn, Vector, add, scale
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
