"""Contacts of a tree with the ground and with itself: places, directions and stiffness.

See "Computation" in MuJoCo's documentation. A contact's frame is its normal and two tangents; its pyramid of friction
has a facet along the normal plus and minus each tangent, weighted by the coefficient of friction. Elliptic: `cones`.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx.mechanics.tree import structure as st
from humanoid_mjx.mechanics.tree.algebra import (
    EYE,
    FEW_PAIRS,
    column,
    compose,
    cross,
    dot,
    entry_at,
    numbers,
    scale,
    symmetric,
    transposed,
    turn,
    velocity_at,
)
from humanoid_mjx.mechanics.tree.boxes import between_boxes, with_boxes
from humanoid_mjx.mechanics.tree.cones import Cone
from humanoid_mjx.mechanics.tree.kinematics import Kinematics
from humanoid_mjx.mechanics.tree.segments import Segment, capsules, nearest_shares

Friction = tuple[Any, Any] | Cone | None

SMALLEST_SQUARE = 1e-30
"""The square of MuJoCo's smallest length (mjMINVAL)."""


NEVER = 1e9
"""Less the reference acceleration, m/s^2, of a contact that never pushes."""


class Touch(NamedTuple):
    """A contact, or several alike. The second body's acceleration against the first's at its place decides on its
    force."""

    place: Any
    """Midway between the surfaces, against the origin, m."""
    frame: Any
    """Rows: the normal and two tangents."""
    distance: Any
    """Between the surfaces, m; negative where they overlap."""
    close: Any
    """True if it counts: the distance is within the margin."""
    weight: Any
    """1 / R of each facet: the force for a unit of acceleration that is missing, kg."""
    offset: Any
    """Less its reference acceleration, in its frame: what is added to the acceleration of its place."""
    friction: Friction

    def residual(self, motion: Any) -> Any:
        """The contact's acceleration less its reference where the body accelerates by `motion`, in its own frame."""
        return turn(self.frame, velocity_at(motion, self.place)) + self.offset

    def facets(self, v: Any) -> Any:
        """A vector of the contact's frame along each facet of the pyramid, or in the frame of an elliptic cone."""
        if isinstance(self.friction, Cone):
            return self.friction.stretched(v)
        x, y, z = (v[..., axis, :, :] for axis in range(3))
        if self.friction is None:
            return x[..., None, :, :]
        y, z = self.friction[0] * y, self.friction[1] * z
        return column([x + y, x - y, x + z, x - z])

    def active(self, residuals: Any) -> Any:
        """Mask of the facets that push, by their residuals; of an elliptic cone the residual itself, or one that does
        not push."""
        if isinstance(self.friction, Cone):
            return self.only(self.close[..., None, :, :], residuals)
        return self.close[..., None, :, :] & (residuals < 0.0)

    def only(self, there: Any, active: Any) -> Any:
        """`active` where the contact is there, and else what it is of one that does not push."""
        return jnp.where(there, active, EYE[0]) if isinstance(self.friction, Cone) else active & there

    def without_flag(self) -> "Touch":
        """The same contact, of which the reference acceleration says that no facet pushes where it is not close.

        A GPU's thread has few registers for flags.
        """
        normal = np.arange(3)[:, None, None] == 0
        offset = jnp.where(normal & ~self.close[..., None, :, :], NEVER, self.offset)
        return self._replace(offset=offset, close=np.ones((1, 1), bool))

    def force(self, v: Any) -> Any:
        """The force on the second body, N, at this residual; both in the contact's frame."""
        facets = self.facets(v)
        if isinstance(self.friction, Cone):
            return -turn(self.stiffness(self.active(facets)), v)
        pushes = jnp.where(self.active(facets), -scale(self.weight, facets), 0.0)
        if self.friction is None:
            return jnp.concatenate([pushes, jnp.zeros_like(pushes), jnp.zeros_like(pushes)], axis=-3)
        (mu, nu), (a, b, c, d) = self.friction, (pushes[..., facet, :, :] for facet in range(4))
        return column([a + b + c + d, mu * (a - b), nu * (c - d)])

    def root(self, active: Any) -> Any:
        """R, (..., 3, 3, lanes, 1), of which `R^T R` is the stiffness of a contact with an elliptic cone."""
        cone, weight = self.friction, jnp.sqrt(self.weight)[..., None, None, :, :]
        assert isinstance(cone, Cone)
        return weight * cone.root(active) * column([np.ones((1, 1)), cone.first, cone.second])[..., None, :, :, :]

    def stiffness(self, active: Any) -> Any:
        """Minus the derivative of the force by the residual while these facets push, in the contact's frame."""
        if isinstance(self.friction, Cone):
            rows = self.root(active)
            return symmetric(compose(transposed(rows), rows))
        on = jnp.where(active, self.weight[..., None, :, :], 0.0)
        if self.friction is None:
            return on[..., None, :, :] * np.diag([1.0, 0.0, 0.0])[..., None, None]
        (mu, nu), (a, b, c, d) = self.friction, (on[..., facet, :, :] for facet in range(4))
        first, second = a + b, c + d
        xy, xz, yz = mu * (a - b), nu * (c - d), np.zeros((1, 1))
        rows = (first + second, xy, xz), (xy, mu * mu * first, yz), (xz, yz, nu * nu * second)
        return jnp.stack([column(row) for row in rows], axis=-4)


class Gap(NamedTuple):
    """The nearest places of two shapes; of several pairs with an axis that counts them."""

    place: Any
    """Midway between the surfaces, against the origin, m."""
    normal: Any
    """From the first to the second."""
    distance: Any
    """Between the surfaces, m; negative where they overlap."""


GapAt = Callable[[Any], Gap]
"""The gap of a pair, from its number in a group of pairs."""


class Stop(NamedTuple):
    """The nearer end of a joint's range."""

    sign: Any
    """1 at the lower end, -1 at the upper."""
    close: Any
    weight: Any
    offset: Any

    def residual(self, rate: Any) -> Any:
        """The joint's acceleration into the range less its reference."""
        return self.sign * rate + self.offset


class Slip(NamedTuple):
    """Dry friction of a joint: a stiff damper up to its largest force, and that force beyond."""

    weight: Any
    offset: Any
    most: Any
    """N m"""

    def residual(self, rate: Any) -> Any:
        """The joint's acceleration less its reference."""
        return rate + self.offset

    def active(self, residual: Any) -> tuple[Any, Any]:
        """Masks of friction at its largest: against a positive residual, and against a negative one."""
        force = self.weight * residual
        return force >= self.most, force <= -self.most


def stop_of(limit: st.Limit, angle: Any, speed: Any) -> Stop:
    """The joint's range at an angle and speed."""
    above, below = angle - numbers(limit.lower), numbers(limit.upper) - angle
    sign = jnp.where(above < below, 1.0, -1.0).astype(above.dtype)
    distance, margin = jnp.minimum(above, below), numbers(limit.margin)
    close, weight, push = _soft(limit.softness, distance, margin, numbers(limit.inverse_weight))
    return Stop(sign, close, weight, limit.softness.damping * sign * speed + push)


def slip_of(dry: st.Dry, speed: Any) -> Slip:
    """A joint's dry friction at a speed."""
    impedance = _impedance(dry.softness, 0.0)
    weight = impedance / ((1.0 - impedance) * numbers(dry.inverse_weight))
    return Slip(weight, dry.softness.damping * speed, numbers(dry.most))


def ground_touch(
    tree: st.Tree,
    points: st.GroundPoints,
    kinematics: Kinematics,
    motions: Sequence[Any],
    friction: Friction,
    terrain: Any,
) -> Touch:
    """The contacts of points that a plane or a `Terrain` pushes, where the bodies move by `motions`; point by point."""
    laned, normal = tree.bodies[points.body].laned, numbers(points.normal)
    center, radius = ground_center(points, kinematics, laned), _by_point(points.radius, laned)
    height = dot(normal, center) + (dot(normal, kinematics.origin) - points.height)
    if terrain is not None and terrain.shaped:
        at = kinematics.origin + center
        at = jnp.concatenate([at[..., :2, :, :], height[..., None, :, :]], axis=-3)
        height, normal = terrain.nearest(at, points.upper)
    distance = height - radius
    place = center - scale(radius + 0.5 * distance, normal)
    along = None if points.along is None else kinematics.direction(points.body, points.along)
    velocity = velocity_at(motions[points.body], place)
    return touch_of(points.surface, Gap(place, normal, distance), velocity, friction, along)


def _by_point(what: Any, laned: bool) -> np.ndarray:
    """Numbers, or vectors, with a first axis of points."""
    found, of_vectors = numbers(what, (1,) if laned else (1, 1)), not isinstance(what, float | st.Table)
    found = np.moveaxis(found, 0, -3) if of_vectors else found
    return found if found.ndim > 2 + of_vectors else found[None]


def ground_center(points: st.GroundPoints, kinematics: Kinematics, laned: bool) -> Any:
    """The middles of the balls that the plane pushes, against the origin; points of other shapes have no radius."""
    shape, normal = points.shape, numbers(points.normal)
    middle = kinematics.place(points.body, _by_point(points.center, laned))
    if shape is None:
        return middle
    if isinstance(shape, st.Corner):
        return middle + _downwards(kinematics.direction(points.body, _by_point(shape.half, laned)), normal)
    if isinstance(shape, st.Lowest):
        axes = [kinematics.direction(points.body, axis) for axis in shape.axes]
        reach = [numbers(radius) * dot(axis, normal) for radius, axis in zip(shape.radii, axes, strict=True)]
        length = jnp.sqrt(dot(column(reach), column(reach)))
        arms = [numbers(r) * part / length * axis for r, part, axis in zip(shape.radii, reach, axes, strict=True)]
        return middle - sum(arms)
    axis = _downwards(kinematics.direction(points.body, shape.axis), normal)
    down = dot(axis, normal) * axis - normal
    square, half, radius = dot(down, down), numbers(shape.half_length) * axis, numbers(shape.radius)
    level = square < SMALLEST_SQUARE
    side = radius * kinematics.direction(points.body, shape.side)
    down = jnp.where(level, side, radius / jnp.sqrt(jnp.where(level, 1.0, square)) * down)
    if shape.which == "lowest":
        return middle + half + down
    if shape.which == "opposite":
        return middle - half + down
    across = (0.75**0.5 if shape.which == "left" else -(0.75**0.5)) * cross(down, axis)
    return middle + half + across - 0.5 * down


def _downwards(way: Any, normal: Any) -> Any:
    """The direction or its opposite, whichever leads down."""
    return scale(jnp.where(dot(way, normal) > 0.0, -1.0, 1.0), way)


def pair_gap_at(pairs: st.Pairs, kinematics: Kinematics) -> GapAt:
    """The gap of the pair of a number: that of many capsules is computed when asked for."""
    boxes, some = (isinstance(shapes[0], st.Box) for shapes in (pairs.ones, pairs.twos))
    if some and not boxes:
        found = with_boxes(pairs, kinematics)
        return lambda index: Gap(*found(index))
    if boxes or len(pairs.ones) <= FEW_PAIRS:
        each = () if boxes else (capsules(shapes, kinematics) for shapes in (pairs.ones, pairs.twos))
        gaps = Gap(*between_boxes(pairs, kinematics)) if boxes else _between(*each)
        return lambda index: jax.tree.map(lambda v: entry_at(v, index), gaps)
    every = list(dict.fromkeys([*pairs.ones, *pairs.twos]))
    table = capsules(every, kinematics)
    # Of type float: Triton takes equal numbers for one operand, and integers are those of addresses, too.
    places = [np.array([[every.index(shape)] for shape in shapes], np.float32) for shapes in (pairs.ones, pairs.twos)]

    def at(index: Any) -> Gap:
        each = (entry_at(numbers_, index)[0] for numbers_ in places)
        return _between(*(jax.tree.map(lambda v, place=place: entry_at(v, place), table) for place in each))

    return at


def _between(first: tuple[Segment, Any], second: tuple[Segment, Any]) -> Gap:
    """The gap of two capsules, each its segment and its radius."""
    ((one, along_one), radius), ((two, along_two), other) = first, second
    x, y = nearest_shares(along_one, along_two, one - two)
    one, two = one + scale(x, along_one), two + scale(y, along_two)
    between = two - one
    square = dot(between, between)
    # Centres that meet have no direction; MuJoCo takes one as well.
    meet = square <= 0.0
    length = jnp.sqrt(jnp.where(meet, 1.0, square))
    normal = scale(1.0 / length, between)
    normal = jnp.where(meet[..., None, :, :], EYE[0], normal)
    distance = jnp.where(meet, 0.0, length) - (radius + other)
    return Gap(one + scale(radius + 0.5 * distance, normal), normal, distance)


def touch_of(surface: st.Surface, gap: Gap, velocity: Any, friction: Friction, along: Any = None) -> Touch:
    """The contact of two shapes that part by `velocity`, m/s, at the place of their gap; the first tangent follows
    `along`, if given. Without friction no one reads the tangents, and a compiler leaves them out."""
    frame = _frame(gap.normal, along)
    inverse = surface.inverse_weight
    inverse = numbers(inverse) if isinstance(inverse, float | st.Table) else inverse
    if friction is not None and not isinstance(friction, Cone):
        square = friction[0] * friction[0]
        inverse = 2.0 * square * inverse * (1.0 + square) / surface.impratio
    close, weight, push = _soft(surface.softness, gap.distance, surface.margin, inverse)
    offset = surface.softness.damping * turn(frame, velocity) + scale(push, EYE[0])
    return Touch(gap.place, frame, gap.distance, close, weight, offset, friction)


def _soft(softness: st.Softness, distance: Any, margin: Any, inverse: Any) -> tuple[Any, Any, Any]:
    """Activity of a constraint, its weight 1 / R, and the part of its reference acceleration due to position."""
    violation = distance - margin
    impedance = _impedance(softness, violation)
    weight = impedance / ((1.0 - impedance) * inverse)
    return violation < 0.0, weight, softness.stiffness * impedance * violation


def _impedance(softness: st.Softness, violation: Any) -> Any:
    """`solimp`: from `dmin` to `dmax` over `width`, along two powers that meet at the midpoint."""
    low, high, middle, power = softness.dmin, softness.dmax, softness.midpoint, softness.power
    if low == high or softness.width <= 1e-15:
        return 0.5 * (low + high)
    if isinstance(violation, float):
        return low
    x = jnp.minimum(jnp.abs(violation) * (1.0 / softness.width), 1.0)
    if power == 1.0:
        y = x
    else:
        rise, fall = 1.0 / middle ** (power - 1.0), 1.0 / (1.0 - middle) ** (power - 1.0)
        power = int(power) if float(power).is_integer() else power  # in a kernel a square is one product, a power 70
        y = jnp.where(x <= middle, rise * x**power, 1.0 - fall * (1.0 - x) ** power)
    return low + (high - low) * y


def _frame(normal: Any, along: Any) -> Any:
    """MuJoCo's tangents: the first follows `along` where that is not too near the normal, else an axis of the world."""
    given, lib = along is not None, np if along is None and isinstance(normal, np.ndarray) else jnp
    if along is None:
        sideways = lib.where(abs(normal[..., 1:2, :, :]) < 0.5, 1.0, 0.0)
        along = sideways * EYE[1] + (1.0 - sideways) * EYE[2]
    tangent = along - dot(normal, along)[..., None, :, :] * normal
    square = dot(tangent, tangent)[..., None, :, :]
    tangent = 1.0 / lib.sqrt(lib.maximum(square, SMALLEST_SQUARE)) * tangent
    if given:
        # Along the normal itself there is no tangent; MuJoCo takes an axis of the world.
        tangent = jnp.where(square < SMALLEST_SQUARE, EYE[0], tangent)
    rows = lib.broadcast_arrays(normal, tangent, cross(normal, tangent))
    return lib.stack(rows, axis=-4)
