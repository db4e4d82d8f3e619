"""Contacts of a tree with the ground and with itself: places, directions and stiffness.

See "Computation" in MuJoCo's documentation. A contact's frame is its normal and two tangents; its pyramid of friction
has a facet along the normal plus and minus each tangent, weighted by the coefficient of friction.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx.mechanics.scalars import HALF, NULL, ONE, TWO, ZERO, Scalar, Symmetric, Vector, add, cross, dot, scale
from humanoid_mjx.mechanics.tree import structure as st
from humanoid_mjx.mechanics.tree.algebra import (
    FEW_PAIRS,
    Rotation,
    Spatial,
    entry_at,
    known,
    number,
    resolve,
    root,
    subtract,
    vector,
    velocity_at,
)
from humanoid_mjx.mechanics.tree.boxes import between_boxes
from humanoid_mjx.mechanics.tree.kinematics import Kinematics
from humanoid_mjx.mechanics.tree.segments import Segment, nearest_points, segments

Friction = tuple[Scalar, Scalar] | None

SMALLEST_SQUARE = 1e-30
"""The square of MuJoCo's smallest length (mjMINVAL)."""


NEVER = 1e9
"""Less the reference acceleration, m/s^2, of a contact that never pushes."""


class Touch(NamedTuple):
    """A contact, or several alike. The second body's acceleration against the first's at its place decides on its
    force."""

    place: Vector
    """Midway between the surfaces, against the origin, m."""
    frame: Rotation
    distance: Scalar
    """Between the surfaces, m; negative where they overlap."""
    close: Any
    """True if it counts: the distance is within the margin."""
    weight: Scalar
    """1 / R of each facet: the force for a unit of acceleration that is missing, kg."""
    offset: Vector
    """Less its reference acceleration, in its frame: what is added to the acceleration of its place."""
    friction: Friction

    def residual(self, motion: Spatial) -> Vector:
        """The contact's acceleration less its reference where the body accelerates by `motion`, in its own frame."""
        return add(resolve(self.frame, velocity_at(motion, self.place)), self.offset)

    def facets(self, v: Vector) -> list[Scalar]:
        """A vector of the contact's frame along each facet of the pyramid."""
        if self.friction is None:
            return [v.x]
        slips = (self.friction[0] * v.y, self.friction[1] * v.z)
        return [sum_ for slip in slips for sum_ in (v.x + slip, v.x - slip)]

    def active(self, residuals: Sequence[Scalar]) -> list[Any]:
        """Mask of the facets that push, by their residuals."""
        return [self.close & (residual.value < 0.0) for residual in residuals]

    def without_flag(self) -> "Touch":
        """The same contact, of which the reference acceleration says that no facet pushes where it is not close.

        A GPU's thread has few registers for flags.
        """
        offset = self.offset._replace(x=Scalar(jnp.where(self.close, self.offset.x.value, NEVER)))
        return self._replace(offset=offset, close=True)

    def force(self, v: Vector) -> Vector:
        """The force on the second body, N, at this residual; both in the contact's frame."""
        pushes = [
            Scalar(jnp.where(self.close & (facet.value < 0.0), -self.weight.value * facet.value, 0.0))
            for facet in self.facets(v)
        ]
        if self.friction is None:
            return Vector(pushes[0], ZERO, ZERO)
        (mu, nu), (a, b, c, d) = self.friction, pushes
        return Vector(a + b + c + d, mu * (a - b), nu * (c - d))

    def stiffness(self, active: Sequence[Any]) -> Symmetric:
        """Minus the derivative of the force by the residual while these facets push, in the contact's frame."""
        on = [Scalar(jnp.where(flag, self.weight.value, 0.0)) for flag in active]
        if self.friction is None:
            return Symmetric(xx=on[0])
        (mu, nu), first, second = self.friction, on[0] + on[1], on[2] + on[3]
        return Symmetric(
            xx=first + second,
            xy=mu * (on[0] - on[1]),
            xz=nu * (on[2] - on[3]),
            yy=mu * mu * first,
            zz=nu * nu * second,
        )


class Gap(NamedTuple):
    """The nearest places of two shapes; of several pairs with an axis that counts them."""

    place: Vector
    """Midway between the surfaces, against the origin, m."""
    normal: Vector
    """From the first to the second."""
    distance: Scalar
    """Between the surfaces, m; negative where they overlap."""


GapAt = Callable[[Any], Gap]
"""The gap of a pair, from its number in a group of pairs."""


class Stop(NamedTuple):
    """The nearer end of a joint's range."""

    sign: Scalar
    """1 at the lower end, -1 at the upper."""
    close: Any
    weight: Scalar
    offset: Scalar

    def residual(self, rate: Scalar) -> Scalar:
        """The joint's acceleration into the range less its reference."""
        return self.sign * rate + self.offset


class Slip(NamedTuple):
    """Dry friction of a joint: a stiff damper up to its largest force, and that force beyond."""

    weight: Scalar
    offset: Scalar
    most: Scalar
    """N m"""

    def residual(self, rate: Scalar) -> Scalar:
        """The joint's acceleration less its reference."""
        return rate + self.offset

    def active(self, residual: Scalar) -> tuple[Any, Any]:
        """Masks of friction at its largest: against a positive residual, and against a negative one."""
        force = (self.weight * residual).value
        return force >= self.most.value, force <= -self.most.value


def stop_of(limit: st.Limit, angle: Scalar, speed: Scalar) -> Stop:
    """The joint's range at an angle and speed."""
    above, below = angle - number(limit.lower), number(limit.upper) - angle
    nearer = above.value < below.value
    sign = Scalar(jnp.where(nearer, 1.0, -1.0).astype(above.value.dtype))
    distance = Scalar(jnp.minimum(above.value, below.value))
    close, weight, push = _soft(limit.softness, distance, number(limit.margin), number(limit.inverse_weight))
    return Stop(sign, close, weight, Scalar(limit.softness.damping) * sign * speed + push)


def slip_of(dry: st.Dry, speed: Scalar) -> Slip:
    """A joint's dry friction at a speed."""
    impedance = _impedance(dry.softness, ZERO)
    weight = impedance / ((ONE - impedance) * number(dry.inverse_weight))
    return Slip(weight, Scalar(dry.softness.damping) * speed, number(dry.most))


def ground_touch(
    points: st.GroundPoints, kinematics: Kinematics, motions: Sequence[Spatial], friction: Friction, terrain: Any = None
) -> Touch:
    """The contacts of points that a plane or a `Terrain` pushes, where the bodies move by `motions`."""
    center, normal, radius = ground_center(points, kinematics), vector(points.normal), number(points.radius)
    height = dot(normal, center) + (dot(normal, kinematics.origin) - number(points.height))
    if terrain is not None and terrain.shaped:
        height, normal = terrain.nearest(add(kinematics.origin, center)._replace(z=height), points.upper)
    distance = height - radius
    place = subtract(center, scale(radius + HALF * distance, normal))
    along = None if points.along is None else kinematics.direction(points.body, points.along)
    frame, velocity = _frame(normal, along), velocity_at(motions[points.body], place)
    return _touch(points.surface, place, frame, distance, velocity, friction)


def ground_center(points: st.GroundPoints, kinematics: Kinematics) -> Vector:
    """The middles of the balls that the plane pushes, against the origin; points of other shapes have no radius."""
    middle, shape, normal = kinematics.place(points.body, points.center), points.shape, vector(points.normal)
    if shape is None:
        return middle
    if isinstance(shape, st.Corner):
        return add(middle, _downwards(kinematics.direction(points.body, shape.half), normal))
    if isinstance(shape, st.Lowest):
        arm = NULL
        axes = [kinematics.direction(points.body, axis) for axis in shape.axes]
        reach = [number(radius) * dot(axis, normal) for radius, axis in zip(shape.radii, axes, strict=True)]
        length = root(dot(reach, reach))
        for radius, axis, part in zip(shape.radii, axes, reach, strict=True):
            arm = add(arm, scale(number(radius) * part / length, axis))
        return subtract(middle, arm)
    axis = _downwards(kinematics.direction(points.body, shape.axis), normal)
    down = subtract(scale(dot(axis, normal), axis), normal)
    square = dot(down, down).value
    level = square < SMALLEST_SQUARE
    down = scale(number(shape.radius) / root(Scalar(jnp.where(level, 1.0, square))), down)
    side = scale(number(shape.radius), kinematics.direction(points.body, shape.side))
    down = Vector(*(Scalar(jnp.where(level, b.value, a.value)) for a, b in zip(down, side, strict=True)))
    end = add(middle, scale(number(shape.half_length), axis))
    if shape.which == "lowest":
        return add(end, down)
    if shape.which == "opposite":
        return add(subtract(middle, scale(number(shape.half_length), axis)), down)
    across = scale(Scalar(0.75**0.5 * (1.0 if shape.which == "left" else -1.0)), cross(down, axis))
    return add(end, subtract(across, scale(HALF, down)))


def _downwards(way: Vector, normal: Vector) -> Vector:
    """The direction or its opposite, whichever leads down."""
    return scale(Scalar(jnp.where(dot(way, normal).value > 0.0, -1.0, 1.0)), way)


def _gaps(pairs: st.Pairs, kinematics: Kinematics) -> Gap:
    """The gaps of pairs, with an axis that counts them."""
    if isinstance(pairs.ones[0], st.Box):
        return Gap(*between_boxes(pairs, kinematics))
    return Gap(*_between(*(_capsules(shapes, kinematics) for shapes in (pairs.ones, pairs.twos))))


def pair_gap_at(pairs: st.Pairs, kinematics: Kinematics) -> GapAt:
    """The gap of the pair of a number: that of many capsules is computed when asked for."""
    if len(pairs.ones) <= FEW_PAIRS or isinstance(pairs.ones[0], st.Box):
        gaps = jax.tree.map(lambda v: jnp.broadcast_to(v, (len(pairs.ones), 1)), _gaps(pairs, kinematics))
        return lambda index: jax.tree.map(lambda v: entry_at(v, index), gaps)
    every = list(dict.fromkeys([*pairs.ones, *pairs.twos]))
    table = jax.tree.map(lambda v: jnp.broadcast_to(v, (len(every), 1)), _capsules(every, kinematics))
    # Of type float: Triton takes equal numbers for one operand, and integers are those of addresses, too.
    numbers = [np.array([[every.index(shape)] for shape in shapes], np.float32) for shapes in (pairs.ones, pairs.twos)]

    def at(index: Any) -> Gap:
        each = (entry_at(column, index)[0] for column in numbers)
        return Gap(*_between(*(jax.tree.map(lambda v, number=number: entry_at(v, number), table) for number in each)))

    return at


def pair_touch(surface: st.Surface, gap: Gap, velocity: Vector, friction: Friction) -> Touch:
    """The contact of two shapes that part by `velocity`, m/s, at the place of their gap."""
    # Without friction no one reads the tangents, and a compiler leaves them out.
    return _touch(surface, gap.place, _frame(gap.normal, None), gap.distance, velocity, friction)


def _capsules(shapes: Sequence[st.Capsule], kinematics: Kinematics) -> tuple[Segment, Scalar]:
    """Segments and radii."""
    return segments(shapes, kinematics), known([shape.radius for shape in shapes])


def _between(first: tuple[Segment, Scalar], second: tuple[Segment, Scalar]) -> tuple[Vector, Vector, Scalar]:
    (one, radius), (two, other) = first, second
    one, two = nearest_points(one, two)
    between = subtract(two, one)
    square = dot(between, between)
    # Centres that meet have no direction; MuJoCo takes one as well.
    meet = square.value <= 0.0
    length = root(Scalar(jnp.where(meet, 1.0, square.value)))
    normal = scale(ONE / length, between)
    normal = normal._replace(x=Scalar(jnp.where(meet, 1.0, normal.x.value)))
    distance = Scalar(jnp.where(meet, 0.0, length.value)) - (radius + other)
    place = add(one, scale(radius + HALF * distance, normal))
    return place, normal, distance


def _touch(
    surface: st.Surface, place: Vector, frame: Rotation, distance: Scalar, velocity: Vector, friction: Friction
) -> Touch:
    inverse = number(surface.inverse_weight)
    if friction is not None:
        square = friction[0] * friction[0]
        inverse = TWO * square * inverse * (ONE + square) / Scalar(surface.impratio)
    close, weight, push = _soft(surface.softness, distance, number(surface.margin), inverse)
    offset = scale(Scalar(surface.softness.damping), resolve(frame, velocity))
    return Touch(place, frame, distance, close, weight, offset._replace(x=offset.x + push), friction)


def _soft(softness: st.Softness, distance: Scalar, margin: Scalar, inverse: Scalar) -> tuple[Any, Scalar, Scalar]:
    """Activity of a constraint, its weight 1 / R, and the part of its reference acceleration due to position."""
    violation = distance - margin
    close = violation.value < 0.0
    impedance = _impedance(softness, violation)
    weight = impedance / ((ONE - impedance) * inverse)
    return close, weight, Scalar(softness.stiffness) * impedance * violation


def _impedance(softness: st.Softness, violation: Scalar) -> Scalar:
    """`solimp`: from `dmin` to `dmax` over `width`, along two powers that meet at the midpoint."""
    low, high, middle, power = softness.dmin, softness.dmax, softness.midpoint, softness.power
    if low == high or softness.width <= 1e-15:
        return Scalar(0.5 * (low + high))
    if violation.is_known(0.0):
        return Scalar(low)
    x = jnp.minimum(jnp.abs(violation.value) * (1.0 / softness.width), 1.0)
    if power == 1.0:
        y = x
    else:
        rise, fall = 1.0 / middle ** (power - 1.0), 1.0 / (1.0 - middle) ** (power - 1.0)
        power = int(power) if float(power).is_integer() else power  # in a kernel a square is one product, a power 70
        y = jnp.where(x <= middle, rise * x**power, 1.0 - fall * (1.0 - x) ** power)
    return Scalar(low + (high - low) * y)


def _frame(normal: Vector, along: Vector | None) -> Rotation:
    """MuJoCo's tangents: the first follows `along` where that is not too near the normal, else an axis of the world."""
    given = along is not None
    if along is None and isinstance(normal.y.value, float):
        sideways = abs(normal.y.value) < 0.5
        along = Vector(ZERO, ONE if sideways else ZERO, ZERO if sideways else ONE)
    elif along is None:
        sideways = jnp.abs(normal.y.value) < 0.5
        y = sideways.astype(normal.y.value.dtype)
        along = Vector(ZERO, Scalar(y), Scalar(1.0 - y))
    tangent = subtract(along, scale(dot(normal, along), normal))
    square = dot(tangent, tangent)
    if isinstance(square.value, float):
        tangent = scale(Scalar(square.value**-0.5), tangent)
    else:
        tangent = scale(ONE / root(Scalar(jnp.maximum(square.value, SMALLEST_SQUARE))), tangent)
    if given:
        # Along the normal itself there is no tangent; MuJoCo takes an axis of the world.
        upright = square.value < SMALLEST_SQUARE
        tangent = Vector(
            *(Scalar(jnp.where(upright, x, t.value)) for x, t in zip((1.0, 0.0, 0.0), tangent, strict=True))
        )
    return normal, tangent, cross(normal, tangent)
