"""Equations 4.8 to 4.12 as printed, and the lines of the MATLAB script that stand for them: inverse kinematics."""

from collections.abc import Callable
from itertools import product

import numpy as np

from humanoid_mjx.reproduction.printed.erratum import Erratum, Formula, States
from humanoid_mjx.reproduction.printed.kinematics import sines

SIGNS = (1.0, -1.0)


def columns(states: States) -> tuple[np.ndarray, ...]:
    """n, o, a and p of the toe's pose, (3, n) each."""
    return tuple(np.moveaxis(states.true["pose"][:, :3, i], 0, -1) for i in range(4))


def theta1(states: States) -> np.ndarray:
    n, _, _, p = columns(states)
    l5 = states.lengths[4]
    return np.arctan((p[1] - l5 * n[1]) / (p[0] - l5 * n[0]))


def theta4(states: States, sign: float) -> np.ndarray:
    n, _, _, p = columns(states)
    l1, *_, l5 = states.lengths
    w = p - l5 * n
    return np.arctan((w[2] - l1) / (sign * np.sqrt(w[0] ** 2 + w[1] ** 2)))


def theta2(states: States, theta45: np.ndarray, sign: float) -> np.ndarray:
    n, o, _, _ = columns(states)
    m = o * np.cos(theta45) + n * np.sin(theta45)
    return np.arctan(-m[2] / (sign * np.sqrt(m[0] ** 2 + m[1] ** 2)))


def theta3(states: States, theta45: np.ndarray) -> np.ndarray:
    n, o, a, _ = columns(states)
    return np.arctan((n[2] * np.cos(theta45) - o[2] * np.sin(theta45)) / -a[2])


def script_theta41(states: States) -> np.ndarray:
    n, _, _, p = columns(states)
    l1, *_, l5 = states.lengths
    w = p - l5 * n
    return np.arctan((w[2] - l1) / (np.sqrt(w[0] ** 2) + w[1] ** 2))


def script_theta5(states: States) -> np.ndarray:
    n, o, _, p = columns(states)
    l4, l5 = states.lengths[3:]
    w = p + l5 * n
    return np.arctan((w[1] * l4 * n[0] - w[0] * l4 * n[1]) / (w[0] * l4 * o[1] + w[1] * l4 * o[0]))


def script_theta31(states: States) -> np.ndarray:
    n, _, a, _ = columns(states)
    theta45 = states.q[3] + states.q[4]
    return np.arctan((n[2] * np.cos(theta45) + n[2] * np.sin(theta45)) / -a[2])


def path_1(states: States) -> np.ndarray:
    """Equation 4.8: the pose as A1 A4 A5, (4, 4, n)."""
    a1, a4, a5 = (states.true["links"][:, i] for i in (0, 3, 4))
    return np.moveaxis(a1 @ a4 @ a5, 0, -1)


def toe(states: States, q: np.ndarray) -> np.ndarray:
    """(3, n) Where the toe is at other angles, by the corrected equation 4.6."""
    c1, s1, c2, s2, c3, s3, c4, s4, _, _ = sines(states._replace(q=q))
    l1, l2, l3, l4, l5 = states.lengths
    c45, s45 = np.cos(q[3] + q[4]), np.sin(q[3] + q[4])
    along, across = l3 + l4 * c4 + l5 * c45, l4 * s4 + l5 * s45
    return np.array(
        [
            l2 * s1 + along * (c3 * s1 - c1 * s2 * s3) - across * c1 * c2,
            -l2 * c1 - along * (c1 * c3 + s1 * s2 * s3) - across * c2 * s1,
            l1 + along * c2 * s3 - across * s2,
        ]
    )


def solved(states: States) -> np.ndarray:
    """(3, n) Where the toe is at the printed solution with the signs that serve best, given the true theta 5."""
    target, best = columns(states)[3], np.full_like(columns(states)[3], np.inf)
    for sign4, sign2 in product(SIGNS, SIGNS):
        q4 = theta4(states, sign4)
        q45 = q4 + states.q[4]
        q = np.array([theta1(states), theta2(states, q45, sign2), theta3(states, q45), q4, states.q[4]])
        place = toe(states, q)
        nearer = np.linalg.norm(place - target, axis=0) < np.linalg.norm(best - target, axis=0)
        best = np.where(nearer, place, best)
    return best


def _nearest(branches: Callable[[States, float], np.ndarray], joint: int) -> Formula:
    """The angle nearest to the true one, over both signs."""

    def formula(states: States) -> np.ndarray:
        both = np.array([branches(states, sign) for sign in SIGNS])
        away = np.abs((both - states.q[joint - 1] + np.pi) % (2 * np.pi) - np.pi)
        return np.take_along_axis(both, away.argmin(axis=0)[None], axis=0)[0]

    return formula


def _true(joint: int) -> Formula:
    return lambda states: states.q[joint - 1]


def _theta45(states: States) -> np.ndarray:
    return states.q[3] + states.q[4]


def _row_3_of_4_9(states: States) -> np.ndarray:
    n, o, _, _ = columns(states)
    c5, s5 = np.cos(states.q[4]), np.sin(states.q[4])
    return np.array([n[2] * c5 - o[2] * s5, o[2] * c5 + n[2] * s5])


_DROPPED = "path 1 leaves out A2 A3, as if frames 1 and 3 were the same"
_CLOSED_FORM = "the closed form of kinematics.inverse"


def _angle(place: str, fault: str, fix: str, printed: Formula, right: Formula) -> Erratum:
    """An erratum of an angle, compared within the joints' ranges."""
    return Erratum(place, fault, fix, printed, right, "rad", angle=True, in_range=True)


ERRATA = (
    Erratum("(4.8)", _DROPPED, "A1 A2 A3 A4 A5", path_1, lambda states: np.moveaxis(states.true["pose"], 0, -1)),
    Erratum(
        "(4.9), left side, row 3",
        "S4 and C4",
        "n_z C5 - o_z S5 and o_z C5 + n_z S5",
        lambda states: np.array([np.sin(states.q[3]), np.cos(states.q[3])]),
        _row_3_of_4_9,
    ),
    Erratum(
        "(4.9), right side, row 2",
        "C4 S4",
        "S1 C4",
        lambda states: np.cos(states.q[3]) * np.sin(states.q[3]),
        lambda states: np.sin(states.q[0]) * np.cos(states.q[3]),
    ),
    _angle("(4.9), theta 1", _DROPPED, _CLOSED_FORM, theta1, _true(1)),
    _angle("(4.9), theta 4, the better sign", _DROPPED, _CLOSED_FORM, _nearest(theta4, 4), _true(4)),
    _angle(
        "(4.12), theta 2, given the true theta 4 + theta 5",
        "none",
        "",
        _nearest(lambda states, sign: theta2(states, _theta45(states), sign), 2),
        _true(2),
    ),
    _angle(
        "(4.12), theta 3, given the true theta 4 + theta 5",
        "none",
        "",
        lambda states: theta3(states, _theta45(states)),
        _true(3),
    ),
    Erratum(
        "(4.8) to (4.12), the toe of the solution, given the true theta 5",
        "theta 1 and theta 4 are wrong, so all are",
        _CLOSED_FORM,
        solved,
        lambda states: columns(states)[3],
        "m",
        in_range=True,
    ),
    _angle(
        "MATLAB script, theta41",
        "the root ends before the second square",
        "sqrt((px - l5 nx)^2 + (py - l5 ny)^2)",
        script_theta41,
        lambda states: theta4(states, 1.0),
    ),
    _angle(
        "MATLAB script, theta31, given the true theta 4 + theta 5",
        "n_z cos + n_z sin",
        "n_z cos - o_z sin",
        script_theta31,
        _true(3),
    ),
    _angle(
        "MATLAB script, theta5",
        "from path 1, with p + l5 n for p - l5 n; the text has no such formula",
        _CLOSED_FORM,
        script_theta5,
        _true(5),
    ),
)
