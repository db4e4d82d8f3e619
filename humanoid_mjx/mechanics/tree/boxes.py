"""Contacts of boxes with each other, as MuJoCo 3.12 and newer find them, and with balls and capsules.

Of two boxes the separating axis test gives the normal: the axis along which the boxes overlap least, among the normals
of their faces and the cross products of their edges. Two edges touch at one point. A face is touched by that face of
the other box that lies against it; the vertices of the part within its sides are contacts.

A capsule touches a box as balls on its axis do: one where the axis is nearest to the box, and one as far from there as
the axis runs along that face or edge. Of places that are as near the first counts, in MuJoCo's order.
"""

import functools
import operator
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx.mechanics.tree.algebra import FEW_PAIRS, entry_at, numbers, stacked, turn
from humanoid_mjx.mechanics.tree.kinematics import Kinematics
from humanoid_mjx.mechanics.tree.segments import POINT, capsules
from humanoid_mjx.mechanics.tree.structure import Pairs

CONTACTS = 12
"""Candidates of a pair, of which at most 8 are contacts: both ends of the part of each edge within the sides, and the
corners between the sides."""

ALIGNED, SHALLOWER, BIAS = 0.99, 0.05, 1e-6
"""A cross product this near to the normal of the best face (cosine) counts only where the boxes overlap by such a share
less along it; any cross product only where by `BIAS` less."""

PLACES = 2
"""Candidates of a capsule and a box; a ball and a box have one."""

SIGNS = np.array([[1.0, -1.0, -1.0, 1.0], [1.0, 1.0, -1.0, -1.0]])
"""Corners of a rectangle in their order."""

Triple = Any
"""An array whose first axis is of three components, or of three vectors whose components have the second."""


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


def between_boxes(pairs: Pairs, kinematics: Kinematics) -> tuple[Any, Any, Any]:
    """Places against the origin, normals and distances, m, of all candidates, pair by pair."""
    one, two = (_placed(boxes[::CONTACTS], kinematics) for boxes in (pairs.ones, pairs.twos))
    place, normal, distance = box_contacts(one, two, pairs.surface.margin)
    both = place, jnp.broadcast_to(normal[:, None], place.shape)
    place, normal = (v.swapaxes(0, 2).reshape(-1, 3, 1, 1) for v in both)
    return place, normal, distance.swapaxes(0, 1).reshape(-1, 1, 1)


def _placed(boxes: Sequence[Any], kinematics: Kinematics) -> Placed:
    """Boxes with an axis that counts them, behind those of components."""
    middles, axes = [], []
    for box in boxes:
        pose = kinematics.of_lane(box.body, box.lane)
        middles.append(pose.position + turn(pose.axes, numbers(box.center)))
        axes.append(stacked([turn(pose.axes, numbers(axis)) for axis in box.axes]))
    half = np.stack([numbers(box.half) for box in boxes], axis=1)
    return Placed(stacked(middles).swapaxes(0, 1), jnp.moveaxis(stacked(axes), 0, 2), half)


def box_contacts(one: Placed, two: Placed, margin: float) -> tuple[Triple, Triple, Any]:
    """Places of the contacts in the world, normals from the first box to the second, and distances, m. Places and
    distances have an axis of `CONTACTS`. Candidates that are no contacts are further apart than `margin`, m.

    Most boxes are apart along the normal of a face."""
    between = two.middle - one.middle
    turned = jnp.stack([_along(two.axes, axis) for axis in one.axes])
    ahead, back = _along(one.axes, between), _along(two.axes, one.middle - two.middle)
    slack = SLACKS[ahead.dtype.itemsize]
    most = margin + slack.separation * (one.half.sum(axis=0) + two.half.sum(axis=0))
    faces = jnp.concatenate(
        [
            abs(ahead) - one.half - _along(abs(turned), two.half),
            abs(back) - two.half - _along(abs(turned).swapaxes(0, 1), one.half),
        ]
    )

    def near() -> tuple[Triple, Triple, Any]:
        code, face, apart, edges = _least_overlap(turned, ahead, faces, one.half, two.half, most, slack)
        own = face < 3
        spots, facing, depths, counts = _of_face(
            jnp.where(own, face, face - 3),
            *_where(own, (one, two, turned, ahead), (two, one, turned.swapaxes(0, 1), back)),
            margin=margin,
            slack=slack,
        )
        facing = jnp.where(own, facing, -1.0 * facing)
        place, normal, gap = _of_edges(*edges, turned, ahead, one.half, two.half, slack)
        outward = one.axes.swapaxes(0, 1)
        place, normal, crossed = one.middle + _along(outward, place), _along(outward, normal), code == 6
        counts = jnp.where(crossed, (_numbered(CONTACTS, gap) == 0) & (gap <= most), counts) & ~apart
        spots, facing = jnp.where(crossed, place[:, None], spots), jnp.where(crossed, normal, facing)
        return spots, facing, jnp.where(counts, jnp.where(crossed, gap, depths), margin + 1.0)

    return _if_near((faces <= most).all(axis=0), near, margin)


def _if_near(flags: Any, near: Callable[[], tuple[Triple, Triple, Any]], margin: float) -> tuple[Triple, Triple, Any]:
    """`near()` where any pair is near, else distances of more than `margin`, m: a kernel then computes no more."""

    def far() -> tuple[Triple, Triple, Any]:
        place, normal, distance = jax.tree.map(jnp.zeros_like, jax.eval_shape(near))
        return place, normal, distance + (margin + 1.0)

    return jax.lax.cond(flags.any(), near, far)


def _dot(a: Triple, b: Triple) -> Any:
    return (a * b).sum(axis=0)


def _along(axes: Triple, v: Triple) -> Triple:
    """A vector's components along axes."""
    return (axes * v).sum(axis=1)


def _numbered(count: int, like: Any) -> np.ndarray:
    """Numbers with a first axis that counts them, before those of an array."""
    return np.arange(count).reshape(-1, *(1,) * jnp.ndim(like))


def _where(flag: Any, a: Any, b: Any) -> Any:
    return jax.tree.map(lambda x, y: jnp.where(flag, x, y), a, b)


def _pick(index: Any, options: Any) -> Any:
    """In each world the option of its index."""
    found = options[0]
    for number, option in enumerate(options[1:], 1):
        found = _where(index == number, option, found)
    return found


def _rolled(index: Any, v: Triple) -> Triple:
    """The components in cyclic order, that of the index last."""
    return _pick(index, [jnp.roll(v, -1 - first, axis=0) for first in range(3)])


def _least_overlap(
    turned: Triple, ahead: Triple, faces: Any, one: Triple, two: Triple, most: Any, slack: Slack
) -> tuple[Any, Any, Any, tuple[Any, Any, Triple]]:
    """The separating axis test. Further apart than `most`, m, is apart.

    Returns:
      the axis along which the boxes overlap least, 0 to 2: a face of the first box, 3 to 5: of the second, 6: two
      edges; the best of the faces; whether some axis separates the boxes; the edges, of the first and of the second
      box, whose cross product is the best, and that in the first box's axes.
    """
    overlaps = jnp.unstack(faces)
    least, face, apart = overlaps[0], jnp.zeros(overlaps[0].shape, jnp.int32), overlaps[0] > most
    for number, overlap in enumerate(overlaps[1:], 1):
        face, least = _where(overlap > least, (number, overlap), (face, least))
        apart = apart | (overlap > most)
    code, depth, edges, edge = face, least, (0, 0), (0.0, 0.0, 0.0)
    rows, ways = [jnp.unstack(row) for row in turned], jnp.unstack(ahead)
    for i, j in np.ndindex(3, 3):
        after, last = (i + 1) % 3, (i + 2) % 3
        square = rows[last][j] ** 2 + rows[after][j] ** 2
        usable = square >= slack.square
        size = jnp.sqrt(jnp.where(usable, square, 1.0))
        x, y = -rows[last][j] / size, rows[after][j] / size
        width = one[after] * abs(x) + one[last] * abs(y)
        for k in {0, 1, 2} - {j}:
            width = width + two[k] * abs(x * rows[after][k] + y * rows[last][k])
        overlap = abs(x * ways[after] + y * ways[last]) - width
        apart = apart | (usable & (overlap > most))
        better = usable & (overlap - BIAS * abs(overlap) > least) & (overlap > depth)
        parts = {i: 0.0, after: x, last: y}
        new = 6, overlap, (i, j), (parts[0], parts[1], parts[2])
        code, least, edges, edge = _where(better, new, (code, least, edges, edge))
    edge = jnp.stack(edge)
    alike = abs(_pick(face, jnp.concatenate([edge, _along(turned.swapaxes(0, 1), edge)]))) > ALIGNED
    doubtful = (code == 6) & alike & (least < depth + SHALLOWER * abs(depth) + 1e-15)
    return jnp.where(doubtful, face, code), face, apart, (edges[0], edges[1], edge)


def _of_edges(
    i: Any, j: Any, edge: Triple, turned: Triple, ahead: Triple, one: Triple, two: Triple, slack: Slack
) -> tuple[Triple, Triple, Any]:
    """The place midway between edges i and j, and the normal along `edge`, in the first box's axes, and the distance,
    m."""
    axis = jnp.where(_dot(edge, ahead) < 0.0, -1.0, 1.0) * edge
    back = turned.swapaxes(0, 1)
    along = _pick(j, back)
    cosine, half = _pick(i, along), (_pick(i, one), _pick(j, two))
    sine = 1.0 - cosine * cosine
    parallel = sine < 1e-15
    least, place, gap = jnp.inf, 0.0, 0.0
    for corner in _edge_middles(axis, i, one, slack):
        for opposite in _edge_middles(-1.0 * _along(back, axis), j, two, slack):
            other = ahead + _along(turned, opposite)
            way = other - corner
            own, its = _pick(i, way), _dot(along, way)
            share = jnp.where(parallel, 0.0, (own - cosine * its) / jnp.where(parallel, 1.0, sine))
            second = jnp.clip(cosine * jnp.clip(share, -half[0], half[0]) - its, -half[1], half[1])
            share = jnp.clip(own + cosine * second, -half[0], half[0])
            start, end = jnp.where(_numbered(3, i) == i, share, corner), other + second * along
            way = end - start
            new = _dot(way, way), 0.5 * (start + end), _dot(way, axis)
            least, place, gap = _where(new[0] < least, new, (least, place, gap))
    return place, axis, gap


def _edge_middles(axis: Triple, edge: Any, half: Triple, slack: Slack) -> tuple[Triple, Triple]:
    """The middle of the edge, along one of a box's axes, that lies furthest along `axis`, in the box; and of the edge
    beside it that lies as far but for rounding, or the same."""
    first = jnp.where(_numbered(3, edge) == edge, 0.0, jnp.where(axis >= 0.0, half, -half))
    return first, jnp.where(abs(axis) < slack.part, -first, first)


def _of_face(
    index: Any, one: Placed, two: Placed, turned: Triple, ahead: Triple, *, margin: float, slack: Slack
) -> tuple[Triple, Triple, Any, Any]:
    """Places and the normal in the world, distances, and which of the candidates are contacts, of the first box's face
    across an axis."""
    rows, axes, middle = (_rolled(index, v) for v in (turned, one.axes, ahead))
    steep = jnp.unstack(abs(rows[2]))
    other = jnp.where(steep[2] > jnp.maximum(steep[0], steep[1]), 2, jnp.where(steep[1] > steep[0], 1, 0))
    u, v, n = _rolled(other, rows.swapaxes(0, 1))
    (width, length, height), reach = _rolled(index, one.half), _rolled(other, two.half)
    side = jnp.where(middle[2] >= 0.0, 1.0, -1.0)
    opposed = jnp.where(side * n[2] > 0.0, -reach[2], reach[2])
    # The face of the other box, its third component above this face.
    upwards = jnp.stack(jnp.broadcast_arrays(1.0, 1.0, side))
    x, y, z = upwards * (middle + opposed * n)
    face = jnp.stack([x, y, z - height])
    (x, y, z), counts = _clipped(face, upwards * (reach[0] * u), upwards * (reach[1] * v), (width, length))
    counts = counts & (z <= margin)
    near, order = slack.apart * (width * width + length * length), _numbered(CONTACTS, index)
    # One by one, as of a reduction over an axis of them XLA makes scalar code.
    again = (counts[i] & ((x - x[i]) ** 2 + (y - y[i]) ** 2 < near) & (order > i) for i in range(CONTACTS - 1))
    counts = counts & ~functools.reduce(operator.or_, again)
    local = _along(axes.swapaxes(0, 1)[:, :, None], jnp.stack([x, y, side * (height + 0.5 * z)]))
    return one.middle[:, None] + local, side * axes[2], z, counts


def _clipped(middle: Triple, u: Triple, v: Triple, half: tuple[Any, Any]) -> tuple[Triple, Any]:
    """Candidates for the vertices of a parallelogram `middle +- u +- v` within a rectangle of the first two components,
    and which of them are some; vertices may come twice."""
    eps, tiny = (getattr(jnp.finfo(u.dtype), name) for name in ("eps", "tiny"))
    right, up = SIGNS.reshape(2, 4, *(1,) * (u.ndim - 1))
    starts = middle[:, None] + right * u[:, None] + up * v[:, None]
    ways = jnp.stack([-2.0 * u, -2.0 * v, 2.0 * u, 2.0 * v], axis=1)
    enter, leave = 0.0, 1.0
    for start, way, most in zip(starts, ways, half, strict=False):
        way = jnp.where(way == 0.0, tiny, way)
        one, two = (-most - start) / way, (most - start) / way
        enter, leave = jnp.maximum(enter, jnp.minimum(one, two)), jnp.minimum(leave, jnp.maximum(one, two))
    meets = enter <= leave + 16.0 * eps
    enter, leave = jnp.clip(enter, 0.0, 1.0), jnp.clip(leave, 0.0, 1.0)
    x, y = right * half[0], up * half[1]
    across, upwards = x - middle[0], y - middle[1]
    area = u[0] * v[1] - u[1] * v[0]
    one, two = (across * v[1] - upwards * v[0]) / area, (upwards * u[0] - across * u[1]) / area
    within = (abs(one) <= 1.0 + 16.0 * eps) & (abs(two) <= 1.0 + 16.0 * eps)
    corners = jnp.stack([x, y, middle[2] + one * u[2] + two * v[2]])
    found = jnp.concatenate([starts + enter * ways, starts + leave * ways, corners], axis=1)
    return found, jnp.concatenate([meets, meets, within])


def with_boxes(pairs: Pairs, kinematics: Kinematics) -> Callable[[Any], tuple[Any, Any, Any]]:
    """From the number of a candidate of balls or capsules with boxes to its place against the origin, normal and
    distance, m. Those of many pairs are computed when asked for."""
    each, few = list(zip(pairs.ones, pairs.twos, strict=True)), len(pairs.ones) <= FEW_PAIRS
    which, seen = [], Counter[Any]()
    for two in each:
        which.append((1 + seen[two] % PLACES) * (two[0].half_length > 0.0))
        seen[two] += 1
    ones, twos = each_side = [side if few else tuple(dict.fromkeys(side)) for side in (pairs.ones, pairs.twos)]
    (middle, half), radius = capsules(ones, kinematics)
    shapes = (middle.swapaxes(0, 1), half.swapaxes(0, 1), radius), _placed(twos, kinematics)
    gap = functools.partial(place_gap, balls=not any(which), margin=pairs.surface.margin)
    if few:
        place, normal, distance = gap(*shapes, np.reshape(which, (-1, 1, 1)))
        gaps = place.swapaxes(0, 1), normal.swapaxes(0, 1), distance
        return lambda index: jax.tree.map(lambda v: entry_at(v, index), gaps)
    tables = jax.tree.map(lambda v: jnp.moveaxis(v, -3, 0), shapes)
    rows = [[*map(tuple.index, each_side, two), number] for two, number in zip(each, which, strict=True)]
    rows = np.array(rows, np.float32)[:, :, None]

    def at(index: Any) -> tuple[Any, Any, Any]:
        one, two, number = entry_at(rows, index)
        places = zip(tables, (one[0], two[0]), strict=True)
        shape, box = (jax.tree.map(lambda v, at=at: entry_at(v, at), table) for table, at in places)
        return gap(shape, box, number)

    return at


def place_gap(
    shape: tuple[Triple, Triple, Any], box: Placed, which: Any, *, balls: bool, margin: float
) -> tuple[Triple, Triple, Any]:
    """Place, normal and distance, m, of a candidate of a `shape`, its axis `middle +- way` and its radius, and a box: 0
    is a ball's, 1 a capsule's where it is nearest, 2 the other. Candidates that are no contacts are further apart than
    `margin`, m. `balls`: there are no capsules."""
    middle, way, radius = shape
    middle, way = _along(box.axes, middle - box.middle), _along(box.axes, way)
    outward, reach = box.axes.swapaxes(0, 1), jnp.sqrt(_dot(way, way)) + radius + margin
    beyond = middle - jnp.clip(middle, -box.half, box.half)

    def near() -> tuple[Triple, Triple, Any]:
        share, there = 0.0, True
        if not balls:
            first, second, one, two = _shares(middle, way, box.half, margin + radius)
            share = jnp.where(which == 0, 0.0, jnp.where(which == 1, first, second))
            there = (which == 0) | jnp.where(which == 1, one, two)
        place, normal, distance = _ball_gap(middle + share * way, radius, box.half)
        distance = jnp.where(there, distance, margin + 1.0)
        return box.middle + _along(outward, place), _along(outward, normal), distance

    # Beyond a hundredth more than its reach no rounding makes a contact.
    return _if_near(_dot(beyond, beyond) <= (1.01 * reach) ** 2, near, margin)


def _ball_gap(center: Triple, radius: Any, half: Triple) -> tuple[Triple, Triple, Any]:
    """The gap of a ball and a box, in the box's axes."""
    way = jnp.clip(center, -half, half) - center
    apart = jnp.sqrt(_dot(way, way))
    inside = apart <= POINT
    normal, depth = 0.0, jnp.inf
    for number, sides in enumerate(zip(half + center, half - center, strict=True)):
        for sign, side in zip((1.0, -1.0), sides, strict=True):
            inward = sign * (_numbered(3, side) == number)
            normal, depth = _where(side < depth, (inward, side), (normal, depth))
    normal = jnp.where(inside, normal, way / jnp.where(inside, 1.0, apart))
    apart = jnp.where(inside, -depth, apart)
    return center + 0.5 * (radius + apart) * normal, normal, apart - radius


def _shares(middle: Triple, way: Triple, half: Triple, reach: Any) -> tuple[Any, Any, Any, Any]:
    """Return the two places where a capsule's axis `middle +- way` touches a box, as shares of `way`, and their masks;
    in the box's axes. `reach`: the capsule's radius and the margin, m."""
    square = _dot(way, way)
    most = 2.0 * (reach + jnp.sqrt(square) + half.sum(axis=0))
    # Squared distance, share, place on the box, axis across its face or along its edge; if on a face, if a corner.
    best = most, 0.0, jnp.zeros_like(middle), 3, False, False
    for end in (-1.0, 1.0):
        tip = middle + end * way
        place, (x, y, z) = jnp.clip(tip, -half, half), abs(tip) > half
        new = _dot(tip - place, tip - place), end, place, jnp.where(z, 2, jnp.where(y, 1, jnp.where(x, 0, 3)))
        nearer = (new[0] < best[0]) & ~((x & y) | (y & z) | (x & z))
        best = _where(nearer, (*new, True, False), best)
    for axis in range(3):
        new, usable = _of_edges_along(axis, middle, way, half)
        for apart, share, place, corner in zip(*new, strict=True):
            nearer = usable & (apart < best[0] - POINT - SLACKS[middle.dtype.itemsize].separation * best[0])
            best = _where(nearer, (apart, share, place, axis, False, corner), best)
    least, share, place, axis, face, corner = best
    # At a corner the axis runs along the edge or the face of that component whose sign differs from the other two; on
    # an edge along it and the face that is less steep. It ends where the box does in the components that are `bounded`.
    rising, number = way > 0.0, _numbered(3, share)
    inward = rising != (place > 0.0)
    x, y, z = inward
    odd = jnp.stack([(x != y) & (x != z), (y != z) & (y != x), (z != x) & (z != y)])
    steep = jnp.where(odd, way * way, 0.0).sum(axis=0) > 0.5 * square
    (one, two, _), (a, b, _) = _rolled(axis, inward), _rolled(axis, abs(way))
    flat = jnp.where(a > b, axis + 1, axis + 2) % 3
    bounded = jnp.where(corner, odd == steep, (number == axis) | (number == flat))
    bounded, some = jnp.where(face, number != axis, bounded), jnp.where(corner, odd.any(axis=0), one != two)
    ahead = jnp.where(corner, (inward & odd).any(axis=0) == steep, jnp.where(a > b, one, two))
    ahead, some = jnp.where(face, share < 0.0, ahead), jnp.where(face, axis < 3, some)
    room = half - jnp.where(rising == ahead, place, -place)
    size = jnp.where(way == 0.0, jnp.finfo(way.dtype).tiny, abs(way))
    further = jnp.where(bounded & ~(face & (room <= 0.0)), room / size, jnp.inf).min(axis=0)
    sign, there = jnp.where(ahead, 1.0, -1.0), least < most
    return share, share + sign * jnp.minimum(1.0 - sign * share, further), there, some & there


def _of_edges_along(axis: int, middle: Triple, way: Triple, half: Triple) -> tuple[tuple[Any, ...], Any]:
    """The place of each of the four edges of a box along one of its axes that is nearest to a capsule's axis: squares
    of distances, shares of `way`, places, and whether they are corners. And false where the edges are parallel to the
    capsule: MuJoCo takes none of these."""
    behind, others = (1,) * (middle.ndim - 1), [number for number in range(3) if number != axis]
    signs = np.insert(np.array([[-1.0, 1.0, -1.0, 1.0], [-1.0, -1.0, 1.0, 1.0]]), axis, 0.0, axis=0)
    edge = signs.reshape(3, 4, *behind) * half[:, None]
    long, at, rise, across = half[axis], middle[axis], way[axis], sum(way[number] ** 2 for number in others)
    usable = long * long * across >= POINT
    off = edge - middle[:, None]
    here = _numbered(3, off[0]) == axis
    share = sum(way[number] * off[number] for number in others) / jnp.where(usable, across, 1.0)
    free = (at + rise * share) / long
    bound = jnp.clip(free, -1.0, 1.0)
    own = _dot(way[:, None], jnp.where(here, bound * long - at, off)) / _dot(way, way)
    share = jnp.where(abs(free) > 1.0, own, share)
    past, share = abs(share) > 1.0, jnp.clip(share, -1.0, 1.0)
    again = (at + rise * share) / long
    spot = jnp.where(past, jnp.clip(again, -1.0, 1.0), bound)
    # A place that was a corner before it moved along the edge counts as that corner.
    corner = jnp.where(past & (abs(again) > 1.0), jnp.sign(again), jnp.where(abs(free) > 1.0, bound, 0.0))
    apart = jnp.where(here, spot * long - at, off) - share * way[:, None]
    named = jnp.where(here, jnp.where(corner == 0.0, spot, corner) * long, edge)
    return (_dot(apart, apart), share, jnp.unstack(named, axis=1), corner != 0.0), usable
