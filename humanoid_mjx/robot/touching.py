# pyright: reportAttributeAccessIssue=false
"""The pairs of shapes of a MuJoCo model that may touch, with the parameters that MuJoCo gives their contacts."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import mujoco
import numpy as np

FLAGS = mujoco.mjtDisableBit
NO_CONTACTS = int(FLAGS.mjDSBL_CONSTRAINT | FLAGS.mjDSBL_CONTACT)


class Touching(NamedTuple):
    """Two shapes that may touch."""

    one: int
    two: int
    """Geoms, in the order in which MuJoCo's collision functions take them."""
    condim: int
    friction: Any
    """Along both tangents."""
    margin: float
    solref: Any
    solimp: Any
    surplus: bool
    """True if the model sets a gap, adhesion or a velocity of the surface."""


def touching(m: mujoco.MjModel) -> Iterator[Touching]:
    """Explicit pairs, then those by `contype` and `conaffinity` less those of one body, of parent and child, and those
    that are excluded; none where the model's contacts are disabled."""
    if m.opt.disableflags & NO_CONTACTS:
        return
    listed: set[frozenset[int]] = set()
    for i in range(m.npair):
        one, two = _ordered(m, int(m.pair_geom1[i]), int(m.pair_geom2[i]))
        listed.add(frozenset((one, two)))
        if m.body_weldid[m.geom_bodyid[one]] or m.body_weldid[m.geom_bodyid[two]]:
            surplus = _surplus(m, "pair", [i]) or _surplus(m, "geom", [one, two], "surfacevel")
            values = m.pair_margin[i], m.pair_solref[i], m.pair_solimp[i]
            yield Touching(one, two, int(m.pair_dim[i]), m.pair_friction[i, :2], *values, surplus)
    excluded = {int(signature) for signature in m.exclude_signature}
    for first in range(m.ngeom):
        for second in range(first + 1, m.ngeom):
            one, two = _ordered(m, first, second)
            if frozenset((one, two)) not in listed and _may_touch(m, one, two, excluded):
                yield _mixed(m, one, two)


def kinds_of(m: mujoco.MjModel, pair: Touching) -> tuple[str, str]:
    """The shapes of a pair: plane, sphere, capsule, box and so on."""
    return kind_of(m, pair.one), kind_of(m, pair.two)


def kind_of(m: mujoco.MjModel, geom: int) -> str:
    """The shape of a geom."""
    kind = mujoco.mjtGeom(int(m.geom_type[geom])).name.removeprefix("mjGEOM_").lower()
    return kind.replace("hfield", "height field")


def named(m: mujoco.MjModel, geom: int) -> str:
    """A geom by its own name, or by its body's."""
    body = int(m.geom_bodyid[geom])
    return repr(m.geom(geom).name or m.body(body).name or f"body {body}")


def _ordered(m: mujoco.MjModel, one: int, two: int) -> tuple[int, int]:
    return (one, two) if m.geom_type[one] <= m.geom_type[two] else (two, one)


def _may_touch(m: mujoco.MjModel, one: int, two: int, excluded: set[int]) -> bool:
    masks = (m.geom_contype[one] & m.geom_conaffinity[two]) or (m.geom_contype[two] & m.geom_conaffinity[one])
    bodies = sorted(int(m.geom_bodyid[geom]) for geom in (one, two))
    welds = [int(m.body_weldid[body]) for body in bodies]
    if not masks or welds[0] == welds[1] or (bodies[0] << 16) + bodies[1] in excluded:
        return False
    parents = [int(m.body_weldid[m.body_parentid[weld]]) for weld in welds]
    related = all(welds) and (parents[0] == welds[1] or parents[1] == welds[0])
    return not related or bool(m.opt.disableflags & FLAGS.mjDSBL_FILTERPARENT)


def _mixed(m: mujoco.MjModel, one: int, two: int) -> Touching:
    """Contact parameters of two shapes without an explicit pair: the higher priority's, or a mixture."""
    first, second = sorted((one, two), key=lambda geom: -m.geom_priority[geom])
    if m.geom_priority[first] > m.geom_priority[second]:
        values = m.geom_solref[first], m.geom_solimp[first]
        friction, condim = m.geom_friction[first, 0], m.geom_condim[first]
    else:
        weights = m.geom_solmix[[one, two]]
        share = (
            weights[0] / weights.sum() if (weights >= 1e-15).all() else float(np.sign(weights[0] - weights[1]) + 1) / 2
        )
        refs, imps = m.geom_solref[[one, two]], m.geom_solimp[[one, two]]
        solref = share * refs[0] + (1 - share) * refs[1] if (refs[:, 0] > 0).all() else refs.min(axis=0)
        values = solref, share * imps[0] + (1 - share) * imps[1]
        friction, condim = m.geom_friction[[one, two], 0].max(), m.geom_condim[[one, two]].max()
    margin = m.geom_margin[one] + m.geom_margin[two]
    return Touching(one, two, int(condim), np.full(2, friction), margin, *values, _surplus(m, "geom", [one, two]))


def _surplus(m: mujoco.MjModel, kind: str, rows: list[int], *names: str) -> bool:
    fields = (getattr(m, f"{kind}_{name}", None) for name in names or ("gap", "adhesion", "surfacevel"))
    return any(field is not None and np.any(field[rows]) for field in fields)
