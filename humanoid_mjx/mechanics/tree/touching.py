# pyright: reportAttributeAccessIssue=false
"""The pairs of shapes of a MuJoCo model that may touch, and their contact parameters."""

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


def pairs_of(m: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Explicit pairs of shapes that may touch, (n,), and the geoms of these and of all others, (2, pairs).

    The others are those by `contype` and `conaffinity` less those of one body, of parent and child, and those that are
    excluded. There are none where the model's contacts are disabled.
    """
    if m.opt.disableflags & NO_CONTACTS:
        return np.zeros(0, int), np.zeros((2, 0), int)
    body, weld, listed = m.geom_bodyid, m.body_weldid[m.geom_bodyid], np.stack([m.pair_geom1, m.pair_geom2])
    parent, related = m.body_weldid[m.body_parentid[weld]], not m.opt.disableflags & FLAGS.mjDSBL_FILTERPARENT
    found = [np.zeros((2, 0), int)]
    for one in range(m.ngeom):
        apart = weld[one] != weld
        if related and weld[one]:
            apart &= (weld == 0) | ((parent[one] != weld) & (parent != weld[one]))
        masks = (m.geom_contype[one] & m.geom_conaffinity) | (m.geom_contype & m.geom_conaffinity[one])
        two = np.flatnonzero(apart[one:] & (masks[one:] != 0)) + one
        found.append(np.stack([np.full_like(two, one), two]))
    others = np.concatenate(found, axis=1)
    low, high = np.sort(body[others], axis=0)
    left_out = np.isin((low << 16) + high, m.exclude_signature)
    left_out |= np.isin(m.ngeom * others[0] + others[1], m.ngeom * listed.min(axis=0) + listed.max(axis=0))
    explicit = np.flatnonzero(weld[listed].any(axis=0))
    geoms = np.concatenate([listed[:, explicit], others[:, ~left_out]], axis=1)
    return explicit, np.where(m.geom_type[geoms[0]] <= m.geom_type[geoms[1]], geoms, geoms[::-1])


def touching(m: mujoco.MjModel) -> Iterator[Touching]:
    """The contact parameters of the pairs of `pairs_of`, in its order."""
    explicit, geoms = pairs_of(m)
    for i, (one, two) in zip(explicit, geoms.T[: len(explicit)].tolist(), strict=True):
        surplus = _surplus(m, "pair", i) or _surplus(m, "geom", [one, two], "surfacevel")
        values = m.pair_friction[i, :2], float(m.pair_margin[i]), m.pair_solref[i], m.pair_solimp[i]
        yield Touching(one, two, int(m.pair_dim[i]), *values, surplus)
    one, two = geoms[:, len(explicit) :]
    busy = np.array([_surplus(m, "geom", geom) for geom in range(m.ngeom)], bool)
    margins, surplus = m.geom_margin[one] + m.geom_margin[two], busy[one] | busy[two]
    for i, (condim, friction, solref, solimp) in enumerate(zip(*_mixed(m, one, two), strict=True)):
        values = int(condim), np.full(2, friction), float(margins[i]), solref, solimp, bool(surplus[i])
        yield Touching(int(one[i]), int(two[i]), *values)


def kind_of(m: mujoco.MjModel, geom: int) -> str:
    """The shape of a geom: plane, sphere, capsule, box and so on."""
    name = mujoco.mjtGeom(int(m.geom_type[geom])).name.removeprefix("mjGEOM_").lower()
    return name.replace("hfield", "height field")


def _mixed(m: mujoco.MjModel, one: np.ndarray, two: np.ndarray) -> Iterator[np.ndarray]:
    """`condim`, friction, `solref` and `solimp` of pairs that are not explicit: of the higher priority, or a mixture."""
    ahead, (first, second) = m.geom_priority[one] - m.geom_priority[two], m.geom_solmix[[one, two]]
    weighed = (first >= mujoco.mjMINVAL) & (second >= mujoco.mjMINVAL)
    share = np.where(weighed, first / np.where(weighed, first + second, 1.0), (np.sign(first - second) + 1.0) / 2.0)
    share = np.where(ahead == 0, share, ahead > 0)[:, None]
    for values in (m.geom_condim, m.geom_friction[:, 0]):
        yield np.where(ahead > 0, values[one], np.where(ahead < 0, values[two], np.maximum(values[one], values[two])))
    refs, (imp, other) = m.geom_solref[[one, two]], m.geom_solimp[[one, two]]
    least = (ahead == 0)[:, None] & (refs[:, :, :1] <= 0).any(axis=0)
    yield np.where(least, refs.min(axis=0), share * refs[0] + (1.0 - share) * refs[1])
    yield share * imp + (1.0 - share) * other


def _surplus(m: mujoco.MjModel, kind: str, rows: Any, *names: str) -> bool:
    fields = (getattr(m, f"{kind}_{name}", None) for name in names or ("gap", "adhesion", "surfacevel"))
    return any(field is not None and np.any(field[rows]) for field in fields)
