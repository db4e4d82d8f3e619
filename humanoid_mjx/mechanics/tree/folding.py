"""Limbs of one build computed as one: half the program for two legs, a quarter for four."""

from collections.abc import Sequence
from functools import partial
from typing import Any

from humanoid_mjx.mechanics.tree.structure import Corner, GroundPoints, Pairs, Softness, Surface, Table, Tree


class _Unlike(Exception):
    """Two things cannot be told apart by numbers alone."""


def fold(tree: Tree) -> Tree:
    """The tree with its alike limbs as lanes, as many as its largest set on one body has, and with alike contacts as
    tables."""
    sets: list[list[tuple[int, ...]]] = []
    for parent in range(len(tree.bodies)):
        sets += _alike(tree, [i for i, body in enumerate(tree.bodies) if i and body.parent == parent])
    # Fingers of hands that are lanes are none of their own.
    lanes = len(max(sets, key=lambda limbs: (len(limbs) - 1) * len(limbs[0]), default=()))
    chosen = [limbs for limbs in sets if len(limbs) == lanes > 1]
    outer = [limbs for limbs in chosen if not any(set(limbs[0]) < set(limb) for other in chosen for limb in other)]
    limbs = [sum(parts, ()) for parts in zip(*outer, strict=True)]
    folded = _with_lanes(tree, limbs) if limbs else tree
    ground, pairs = _groups(folded.ground, partial(_join_points, folded)), _groups(folded.pairs, _join_pairs)
    joined = tuple(_join_points(folded, points) for points in ground)
    return folded._replace(ground=joined, pairs=tuple(map(_join_pairs, pairs)))


def _alike(tree: Tree, roots: Sequence[int]) -> list[list[tuple[int, ...]]]:
    """The limbs at these bodies, those of one build together; a limb is the numbers of its bodies."""
    limbs = [limb for limb in (_limb(tree, root) for root in roots) if tree.free not in limb]
    moving = [limb for limb in limbs if any(tree.bodies[index].joints for index in limb)]
    return _groups(moving, lambda limbs: _merge([_described(tree, limb) for limb in limbs]))


def _limb(tree: Tree, root: int) -> tuple[int, ...]:
    found = [root]
    for index in range(root + 1, len(tree.bodies)):
        if tree.bodies[index].parent in found:
            found.append(index)
    return tuple(found)


def _described(tree: Tree, limb: tuple[int, ...]) -> Any:
    """Its bodies and points, with numbers of bodies, coordinates and degrees of freedom that count its own; parents
    that it lacks keep theirs, less the number of all bodies."""
    bodies, count = [], 0
    for index in limb:
        body = tree.bodies[index]
        joints = tuple(h._replace(dof=count + i, coordinate=count + i) for i, h in enumerate(body.joints))
        parent = limb.index(body.parent) if body.parent in limb else body.parent - len(tree.bodies)
        bodies.append(body._replace(parent=parent, joints=joints))
        count += len(joints)
    points = [p._replace(body=i, order=()) for i, index in enumerate(limb) for p in tree.ground if p.body == index]
    return tuple(bodies), tuple(points)


ONE: Any = {Softness: Softness._fields, Surface: ("margin",), GroundPoints: ("height",)}
"""Numbers of which no table is made."""


def _merge(things: Sequence[Any], laned: bool = False) -> Any:
    """Nested tuples of numbers as one: a table where they differ; if `laned`, with an axis of lanes behind."""
    first = things[0]
    if all(thing == first for thing in things):
        return first
    if all(isinstance(thing, float | Table) for thing in things):
        lanes = max(len(thing.values) if isinstance(thing, Table) else 1 for thing in things)
        rows = [thing.values if isinstance(thing, Table) else (thing,) * lanes for thing in things]
        return Table((len(things), lanes) if laned else (len(things),), sum(rows, ()))
    if not isinstance(first, tuple):
        raise _Unlike
    if any(type(thing) is not type(first) or len(thing) != len(first) for thing in things):
        raise _Unlike
    if any(getattr(thing, name) != getattr(first, name) for thing in things for name in ONE.get(type(first), ())):
        raise _Unlike
    parts = [_merge(part, laned) for part in zip(*things, strict=True)]
    return type(first)(*parts) if hasattr(first, "_fields") else tuple(parts)


def _with_lanes(tree: Tree, limbs: Sequence[tuple[int, ...]]) -> Tree:
    """Return the tree with these limbs as the last branch."""
    inside = {body for limb in limbs for body in limb}
    kept = [index for index in range(len(tree.bodies)) if index not in inside]
    new = {old: index for index, old in enumerate(kept)}
    lane = {body: number for number, limb in enumerate(limbs) for body in limb}
    new |= {body: len(kept) + place for limb in limbs for place, body in enumerate(limb)}
    taken = [joint for body in inside for joint in tree.bodies[body].joints]
    old_dofs = sorted(set(range(tree.nv)) - {joint.dof for joint in taken})
    old_coordinates = sorted(set(range(len(tree.coordinates))) - {joint.coordinate for joint in taken})

    bodies = []
    for body in (tree.bodies[old] for old in kept):
        joints = tuple(
            h._replace(dof=old_dofs.index(h.dof), coordinate=old_coordinates.index(h.coordinate)) for h in body.joints
        )
        bodies.append(body._replace(parent=body.parent and new[body.parent], joints=joints))
    merged, points = _merge([_described(tree, limb) for limb in limbs])
    first = len(kept)
    for body in merged:
        joints = tuple(
            h._replace(dof=h.dof + len(old_dofs), coordinate=h.coordinate + len(old_coordinates)) for h in body.joints
        )
        parent = new[body.parent + len(tree.bodies)] if body.parent < 0 else first + body.parent
        bodies.append(body._replace(parent=parent, joints=joints, laned=True))
    orders = zip(*([p.order[0] for i in limb for p in tree.ground if p.body == i] for limb in limbs), strict=True)
    ground = [p._replace(body=new[p.body]) for p in tree.ground if p.body not in inside]
    ground += [p._replace(body=first + p.body, order=order) for p, order in zip(points, orders, strict=True)]

    def moved(things: Sequence[Any]) -> tuple[Any, ...]:
        return tuple(thing._replace(body=new[thing.body], lane=lane.get(thing.body, 0)) for thing in things)

    each = [[joint for body in limb for joint in tree.bodies[body].joints] for limb in limbs]
    angles = zip(*([joint.coordinate for joint in joints] for joints in each), strict=True)
    speeds = zip(*([joint.dof for joint in joints] for joints in each), strict=True)
    return tree._replace(
        bodies=tuple(bodies),
        free=None if tree.free is None else new[tree.free],
        coordinates=(*((place,) for place in old_coordinates), *angles),
        dofs=(*((dof,) for dof in old_dofs), *speeds),
        lanes=len(limbs),
        body_places=(*((old,) for old in kept), *zip(*limbs, strict=True)),
        ground=tuple(ground),
        pairs=tuple(pair._replace(ones=moved(pair.ones), twos=moved(pair.twos)) for pair in tree.pairs),
        gyroscopes=moved(tree.gyroscopes),
        accelerometers=moved(tree.accelerometers),
    )


def _groups(things: Sequence[Any], join: Any) -> list[list[Any]]:
    """Those that can be joined, together."""
    groups: list[list[Any]] = []
    for thing in things:
        for group in groups:
            try:
                join([*group, thing])
                group.append(thing)
                break
            except _Unlike:
                continue
        else:
            groups.append([thing])
    return groups


def _join_points(tree: Tree, points: Sequence[GroundPoints]) -> GroundPoints:
    """Points of one body that a plane pushes in one way: tables by point, then by lane where there are lanes."""
    first, corners = points[0], all(isinstance(p.shape, Corner) for p in points)
    rest = [p._replace(center=None, radius=None, order=(), shape=None if corners else p.shape) for p in points]
    if any(one != rest[0] for one in rest):
        raise _Unlike
    if len(points) == 1:
        return first
    parts = [(p.center, p.radius, p.shape) for p in points]
    center, radius, shape = _merge(parts, tree.bodies[first.body].laned)
    order = tuple(place for p in points for place in p.order)
    return first._replace(center=center, radius=radius, order=order, shape=shape)


def _join_pairs(pairs: Sequence[Pairs]) -> Pairs:
    """Pairs of like shapes that feel each other in one way."""
    first = pairs[0]
    ones = tuple(shape for p in pairs for shape in p.ones)
    twos = tuple(shape for p in pairs for shape in p.twos)
    if len(set(map(type, ones))) > 1 or len(set(map(type, twos))) > 1:
        raise _Unlike
    surfaces = [p.surface for p in pairs for _ in p.ones] if len(pairs) > 1 else [first.surface]
    surface: Surface = _merge(surfaces)
    return Pairs(ones, twos, surface)
