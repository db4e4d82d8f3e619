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


def touching(m: mujoco.MjModel) -> list[Touching]:
    """The contact parameters of the pairs of `pairs_of`, in its order."""
    own, (one, two) = pairs_of(m)
    pairs = m.pair_dim, m.pair_friction[:, :2], m.pair_margin, m.pair_solref, m.pair_solimp, _any(m, "pair", *SURPLUS)
    mixed = _mixed(m, one[len(own) :], two[len(own) :])
    *columns, surplus = (np.concatenate([part[own], more]) for part, more in zip(pairs, mixed, strict=True))
    surplus |= _any(m, "geom", "surfacevel")[[one, two]].any(axis=0)
    return [Touching(*row) for row in zip(one.tolist(), two.tolist(), *columns, surplus, strict=True)]


def pairs_of(m: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """The explicit pairs of shapes that may touch, and the geoms of these and of all others, (2, pairs).

    The others are those by `contype` and `conaffinity` less those of one body, of parent and child, and those that are
    excluded. There are none where the model's contacts are disabled.
    """
    if m.opt.disableflags & NO_CONTACTS:
        return np.zeros(0, int), np.zeros((2, 0), int)
    body, listed = m.geom_bodyid, np.stack([m.pair_geom1, m.pair_geom2])
    weld, related = m.body_weldid[body], not m.opt.disableflags & FLAGS.mjDSBL_FILTERPARENT
    parent, found = m.body_weldid[m.body_parentid[weld]], [np.zeros((2, 0), int)]
    for one in range(m.ngeom):
        may = ((m.geom_contype[one] & m.geom_conaffinity) | (m.geom_contype & m.geom_conaffinity[one])) != 0
        may &= weld != weld[one]
        if related and weld[one]:
            may &= (weld == 0) | ((weld != parent[one]) & (parent != weld[one]))
        two = one + np.flatnonzero(may[one:])
        found.append(np.stack([np.full_like(two, one), two]))
    others = np.concatenate(found, axis=1)
    low, high = np.sort(body[others], axis=0)
    left_out = np.isin((low << 16) + high, m.exclude_signature)
    left_out |= np.isin(m.ngeom * others[0] + others[1], m.ngeom * listed.min(axis=0) + listed.max(axis=0))
    own = np.flatnonzero(weld[listed].any(axis=0))
    geoms = np.concatenate([listed[:, own], others[:, ~left_out]], axis=1)
    return own, np.where(m.geom_type[geoms[0]] <= m.geom_type[geoms[1]], geoms, geoms[::-1])


def kind_of(m: mujoco.MjModel, geom: int) -> str:
    """The shape of a geom: plane, sphere, capsule, box and so on."""
    return word(mujoco.mjtGeom, m.geom_type[geom]).replace("hfield", "height field")


def word(kind: Any, value: Any) -> str:
    """A value of one of MuJoCo's enumerations: `mjGEOM_SPHERE` is "sphere"."""
    return kind(int(value)).name.partition("_")[2].lower()


def named(m: mujoco.MjModel, geom: int) -> str:
    """A geom by its own name, or by its body's."""
    body = int(m.geom_bodyid[geom])
    return repr(m.geom(geom).name or m.body(body).name or f"body {body}")


def _mixed(m: mujoco.MjModel, one: np.ndarray, two: np.ndarray) -> Iterator[Any]:
    """Columns of `Touching` of pairs that are not explicit: the higher priority's, or mixtures."""
    margin, ahead = m.geom_margin[one] + m.geom_margin[two], m.geom_priority[one] - m.geom_priority[two]
    surplus = _any(m, "geom", *SURPLUS)[[one, two]].any(axis=0)
    both = np.stack([np.where(ahead < 0, two, one), np.where(ahead > 0, one, two)])
    weights = m.geom_solmix[both]
    share = np.sign(weights[0] - weights[1]) / 2.0 + 0.5
    np.divide(weights[0], weights.sum(axis=0), out=share, where=weights.min(axis=0) >= mujoco.mjMINVAL)
    refs, imps = m.geom_solref[both], m.geom_solimp[both]
    solref, solimp = (share[:, None] * first + (1.0 - share[:, None]) * second for first, second in (refs, imps))
    solref = np.where((refs[:, :, :1] <= 0).any(axis=0), refs.min(axis=0), solref)
    yield from (m.geom_condim[both].max(axis=0), m.geom_friction[both, :1].max(axis=0).repeat(2, axis=1))
    yield from (margin, solref, solimp, surplus)


SURPLUS = "gap", "adhesion"


def _any(m: mujoco.MjModel, kind: str, *names: str) -> np.ndarray:
    """True for elements where one of these fields is not 0. Older versions of MuJoCo lack some."""
    fields = [getattr(m, f"{kind}_{name}", np.zeros((len(getattr(m, f"{kind}_gap")), 1))) for name in names]
    return np.any([any_of_rows(field) for field in fields], axis=0)


def any_of_rows(values: Any) -> np.ndarray:
    """True for rows of the first axis in which something is not 0."""
    return np.any(values, axis=tuple(range(1, np.ndim(values))))
