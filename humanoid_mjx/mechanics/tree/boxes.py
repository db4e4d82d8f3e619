"""Contacts of two boxes, as MuJoCo 3.12 and newer find them.

The separating axis test gives the normal: the axis along which the boxes overlap least, among the normals of their
faces and the cross products of their edges. Two edges touch at one point. A face is touched by that face of the other
box that lies against it; the vertices of the part within its sides are contacts.
"""

import functools
import operator
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx.mechanics.tree.algebra import numbers, stacked, turn
from humanoid_mjx.mechanics.tree.kinematics import Kinematics
from humanoid_mjx.mechanics.tree.structure import Pairs

CONTACTS = 12
"""Candidates of a pair, of which at most 8 are contacts: both ends of the part of each edge within the sides, and the
corners between the sides."""

ALIGNED, SHALLOWER, BIAS = 0.99, 0.05, 1e-6
"""A cross product this near to the normal of the best face (cosine) counts only where the boxes overlap by such a share
less along it; any cross product only where by `BIAS` less."""

SIGNS = np.array([[1.0, -1.0, -1.0, 1.0], [1.0, 1.0, -1.0, -1.0]])
"""Corners of a rectangle in their order."""

Triple = Sequence[Any]
"""A tuple of three components, or of three vectors; arrays of worlds, or numbers."""


class Placed(NamedTuple):
    """A box in the world: its middle, its axes, and half of its edges, m."""

    middle: Triple
    axes: Triple
    half: Triple


class Slack(NamedTuple):
    """Threshold of rounding."""

    separation: float
    """Of a distance, by the boxes' size."""
    square: float
    """Of the square of a sine."""
    part: float
    """Of a component of a unit vector."""
    apart: float
    """Of the square of a distance of two vertices, by the face's size."""


SLACKS = {4: Slack(1e-6, 1e-7, 1e-5, 1e-10), 8: Slack(1e-13, 1e-16, 1e-9, 1e-14)}
"""MuJoCo's, by bytes of a number."""


class _Best(NamedTuple):
    """The axis along which the boxes overlap least."""

    code: Any
    """0 to 2: a face of the first box; 3 to 5: of the second; 6: two edges."""
    face: Any
    """The best of the faces."""
    edges: tuple[Any, Any]
    """Whose cross product is the best: of the first and of the second box."""
    edge: Triple
    """Cross product of the edges, in the first box's axes."""
    apart: Any
    """True if some axis separates the boxes."""


def between_boxes(pairs: Pairs, kinematics: Kinematics) -> tuple[Any, Any, Any]:
    """Places against the origin, normals and distances, m, of all candidates, pair by pair."""
    one, two = (_placed(boxes[::CONTACTS], kinematics) for boxes in (pairs.ones, pairs.twos))
    place, normal, distance = box_contacts(one, two, pairs.surface.margin)

    def in_turn(value: Any) -> Any:
        return jnp.moveaxis(jnp.broadcast_to(value, distance.shape), 0, 1).reshape(-1, 1, 1)

    return jnp.stack([*map(in_turn, place)], axis=1), jnp.stack([*map(in_turn, normal)], axis=1), in_turn(distance)


def _placed(boxes: Sequence[Any], kinematics: Kinematics) -> Placed:
    """Boxes with an axis that counts them."""
    middles, axes = [], []
    for box in boxes:
        pose = kinematics.of_lane(box.body, box.lane)
        middles.append(pose.position + turn(pose.axes, numbers(box.center)))
        axes.append([turn(pose.axes, numbers(axis)) for axis in box.axes])
    middle = tuple(jnp.moveaxis(stacked(middles), 1, 0))
    each = [tuple(jnp.moveaxis(stacked(axis), 1, 0)) for axis in zip(*axes, strict=True)]
    return Placed(middle, tuple(each), tuple(np.stack([numbers(box.half) for box in boxes], axis=1)))


def box_contacts(one: Placed, two: Placed, margin: float) -> tuple[Triple, Triple, Any]:
    """Places of the contacts in the world, normals from the first box to the second, and distances, m, each with a
    first axis of `CONTACTS`. Candidates that are no contacts are further apart than `margin`, m."""
    between = _minus(two.middle, one.middle)
    turn = tuple(_along(two.axes, axis) for axis in one.axes)
    ahead, back = _along(one.axes, between), _along(two.axes, _minus(one.middle, two.middle))
    slack = SLACKS[jnp.result_type(*ahead).itemsize]
    most = margin + slack.separation * (sum(one.half) + sum(two.half))
    best = _least_overlap(turn, ahead, back, one.half, two.half, most, slack)
    own = best.face < 3
    spots, facing, depths, counts = _of_face(
        jnp.where(own, best.face, best.face - 3),
        *_where(own, (one, two, turn, ahead), (two, one, _transposed(turn), back)),
        margin=margin,
        slack=slack,
    )
    facing = _where(own, facing, _times(-1.0, facing))
    place, normal, gap = _of_edges(best, turn, ahead, one.half, two.half, slack)
    place = tuple(a + b for a, b in zip(one.middle, _combined(one.axes, place), strict=True))
    crossed = best.code == 6
    first = np.arange(CONTACTS).reshape(-1, *(1,) * jnp.ndim(gap)) == 0
    counts = jnp.where(crossed, first & (gap <= most), counts) & ~best.apart
    spots, facing = _where(crossed, (place, _combined(one.axes, normal)), (spots, facing))
    return spots, facing, jnp.where(counts, jnp.where(crossed, gap, depths), margin + 1.0)


def _dot(a: Triple, b: Triple) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _minus(a: Triple, b: Triple) -> Triple:
    return tuple(one - two for one, two in zip(a, b, strict=True))


def _times(factor: Any, v: Triple) -> Triple:
    return tuple(factor * part for part in v)


def _along(axes: Triple, v: Triple) -> Triple:
    """A vector's components along axes."""
    return tuple(_dot(axis, v) for axis in axes)


def _transposed(rows: Triple) -> Triple:
    return tuple(zip(*rows, strict=True))


def _combined(axes: Triple, v: Triple) -> Triple:
    """The sum of axes times components."""
    return _along(_transposed(axes), v)


def _where(flag: Any, a: Any, b: Any) -> Any:
    return jax.tree.map(lambda x, y: jnp.where(flag, x, y), a, b)


def _pick(index: Any, options: Sequence[Any]) -> Any:
    """In each world the option of its index."""
    found = options[0]
    for number, option in enumerate(options[1:], 1):
        found = _where(index == number, option, found)
    return found


def _rolled(index: Any, v: Triple) -> Triple:
    """The components in cyclic order, that of the index last."""
    return tuple(_pick(index, [v[(first + k) % 3] for first in range(3)]) for k in (1, 2, 0))


def _least_overlap(
    turn: Triple, ahead: Triple, back: Triple, one: Triple, two: Triple, most: Any, slack: Slack
) -> _Best:
    """The separating axis test. Further apart than `most`, m, is apart."""
    overlaps = [abs(ahead[i]) - one[i] - _dot([abs(x) for x in turn[i]], two) for i in range(3)]
    overlaps += [abs(back[j]) - two[j] - _dot([abs(row[j]) for row in turn], one) for j in range(3)]
    least, face, apart = overlaps[0], jnp.zeros(jnp.shape(overlaps[0]), jnp.int32), overlaps[0] > most
    for number, overlap in enumerate(overlaps[1:], 1):
        face, least = _where(overlap > least, (number, overlap), (face, least))
        apart = apart | (overlap > most)
    code, depth, edges, edge = face, least, (0, 0), (0.0, 0.0, 0.0)
    for i, j in np.ndindex(3, 3):
        after, last = (i + 1) % 3, (i + 2) % 3
        square = turn[last][j] ** 2 + turn[after][j] ** 2
        usable = square >= slack.square
        size = jnp.sqrt(jnp.where(usable, square, 1.0))
        x, y = -turn[last][j] / size, turn[after][j] / size
        width = one[after] * abs(x) + one[last] * abs(y)
        for k in {0, 1, 2} - {j}:
            width = width + two[k] * abs(x * turn[after][k] + y * turn[last][k])
        overlap = abs(x * ahead[after] + y * ahead[last]) - width
        apart = apart | (usable & (overlap > most))
        better = usable & (overlap - BIAS * abs(overlap) > least) & (overlap > depth)
        parts = {i: 0.0, after: x, last: y}
        new = 6, overlap, (i, j), (parts[0], parts[1], parts[2])
        code, least, edges, edge = _where(better, new, (code, least, edges, edge))
    alike = abs(_pick(face, [*edge, *_along(_transposed(turn), edge)])) > ALIGNED
    doubtful = (code == 6) & alike & (least < depth + SHALLOWER * abs(depth) + 1e-15)
    return _Best(jnp.where(doubtful, face, code), face, edges, edge, apart)


def _of_edges(
    best: _Best, turn: Triple, ahead: Triple, one: Triple, two: Triple, slack: Slack
) -> tuple[Triple, Triple, Any]:
    """The place midway between two edges, and the normal, in the first box's axes, and the distance, m."""
    forward = jnp.where(_dot(best.edge, ahead) < 0.0, -1.0, 1.0)
    axis = _times(forward, best.edge)
    i, j = best.edges
    along = tuple(_pick(j, row) for row in turn)
    cosine, half = _pick(i, along), (_pick(i, one), _pick(j, two))
    sine = 1.0 - cosine * cosine
    parallel = sine < 1e-15
    least, place, gap = jnp.inf, (0.0, 0.0, 0.0), 0.0
    across = _along(_transposed(turn), axis)
    for corner in _edge_middles(axis, i, one, slack):
        for opposite in _edge_middles(_times(-1.0, across), j, two, slack):
            other = tuple(a + _dot(row, opposite) for a, row in zip(ahead, turn, strict=True))
            way = _minus(other, corner)
            own, its = _pick(i, way), _dot(along, way)
            share = jnp.where(parallel, 0.0, (own - cosine * its) / jnp.where(parallel, 1.0, sine))
            second = jnp.clip(cosine * jnp.clip(share, -half[0], half[0]) - its, -half[1], half[1])
            share = jnp.clip(own + cosine * second, -half[0], half[0])
            start = [jnp.where(i == k, share, part) for k, part in enumerate(corner)]
            end = [part + second * step for part, step in zip(other, along, strict=True)]
            way = _minus(tuple(end), tuple(start))
            middle = tuple(0.5 * (a + b) for a, b in zip(start, end, strict=True))
            new = _dot(way, way), middle, _dot(way, axis)
            least, place, gap = _where(new[0] < least, new, (least, place, gap))
    return place, axis, gap


def _edge_middles(axis: Triple, edge: Any, half: Triple, slack: Slack) -> tuple[Triple, Triple]:
    """The middle of the edge, along one of a box's axes, that lies furthest along `axis`, in the box; and of the edge
    beside it that lies as far but for rounding, or the same."""
    first = [jnp.where(edge == k, 0.0, jnp.where(axis[k] >= 0.0, half[k], -half[k])) for k in range(3)]
    second = [jnp.where(abs(axis[k]) < slack.part, -first[k], first[k]) for k in range(3)]
    return tuple(first), tuple(second)


def _of_face(
    index: Any, one: Placed, two: Placed, turn: Triple, ahead: Triple, *, margin: float, slack: Slack
) -> tuple[Triple, Triple, Any, Any]:
    """Places and the normal in the world, distances, and which of the candidates are contacts, of the first box's face
    across an axis."""
    x, y, z = _rolled(index, turn)
    steep = [abs(part) for part in z]
    other = jnp.where(steep[2] > jnp.maximum(steep[0], steep[1]), 2, jnp.where(steep[1] > steep[0], 1, 0))
    u, v, n = _transposed(tuple(_rolled(other, row) for row in (x, y, z)))
    width, length, height = _rolled(index, one.half)
    reach = _rolled(other, two.half)
    middle = _rolled(index, ahead)
    side = jnp.where(middle[2] >= 0.0, 1.0, -1.0)
    opposed = jnp.where(side * n[2] > 0.0, -reach[2], reach[2])
    # The face of the other box, its third component above this face.
    (a, b, c), (d, e, f) = _times(reach[0], u), _times(reach[1], v)
    u, v = (a, b, side * c), (d, e, side * f)
    x, y, z = (m + opposed * part for m, part in zip(middle, n, strict=True))
    x, y, z, counts = _clipped((x, y, side * z - height), u, v, (width, length))
    counts = counts & (z <= margin)
    near, order = slack.apart * (width * width + length * length), np.arange(CONTACTS).reshape(-1, *(1,) * (x.ndim - 1))
    # One by one, as of a reduction over an axis of them XLA makes scalar code.
    again = (counts[i] & ((x - x[i]) ** 2 + (y - y[i]) ** 2 < near) & (order > i) for i in range(CONTACTS - 1))
    counts = counts & ~functools.reduce(operator.or_, again)
    axes = _rolled(index, one.axes)
    local = _combined(axes, (x, y, side * (height + 0.5 * z)))
    place = tuple(m + part for m, part in zip(one.middle, local, strict=True))
    return place, _times(side, axes[2]), z, counts


def _clipped(middle: Triple, u: Triple, v: Triple, half: tuple[Any, Any]) -> tuple[Any, Any, Any, Any]:
    """Candidates for the vertices of a parallelogram `middle +- u +- v` within a rectangle of the first two components,
    and which of them are some; vertices may come twice."""
    eps, tiny = (getattr(jnp.finfo(u[0].dtype), name) for name in ("eps", "tiny"))
    starts = [jnp.stack([m + s * a + t * b for s, t in SIGNS.T]) for m, a, b in zip(middle, u, v, strict=True)]
    ways = [jnp.stack([-2.0 * a, -2.0 * b, 2.0 * a, 2.0 * b]) for a, b in zip(u, v, strict=True)]
    enter, leave = 0.0, 1.0
    for start, way, most in zip(starts, ways, half, strict=False):
        way = jnp.where(way == 0.0, tiny, way)
        one, two = (-most - start) / way, (most - start) / way
        enter, leave = jnp.maximum(enter, jnp.minimum(one, two)), jnp.minimum(leave, jnp.maximum(one, two))
    meets = enter <= leave + 16.0 * eps
    enter, leave = jnp.clip(enter, 0.0, 1.0), jnp.clip(leave, 0.0, 1.0)
    x, y = (jnp.stack([sign * most for sign in signs]) for signs, most in zip(SIGNS, half, strict=True))
    across, upwards = x - middle[0], y - middle[1]
    area = u[0] * v[1] - u[1] * v[0]
    one, two = (across * v[1] - upwards * v[0]) / area, (upwards * u[0] - across * u[1]) / area
    within = (abs(one) <= 1.0 + 16.0 * eps) & (abs(two) <= 1.0 + 16.0 * eps)
    corners = [jnp.broadcast_to(part, within.shape) for part in (x, y, middle[2] + one * u[2] + two * v[2])]
    found = (
        jnp.concatenate([start + enter * way, start + leave * way, corner])
        for start, way, corner in zip(starts, ways, corners, strict=True)
    )
    x, y, z = found
    return x, y, z, jnp.concatenate([meets, meets, within])
