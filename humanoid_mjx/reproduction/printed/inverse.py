"""Equations 4.8 to 4.12 as printed, and the lines of the MATLAB script that stand for them: inverse kinematics."""

from itertools import product

import numpy as np

from humanoid_mjx.reproduction.printed.erratum import Erratum, Formula, States, evaluate, formula

SIGNS = (1.0, -1.0)

THETA1 = "arctan((p[1] - l5*n[1]) / (p[0] - l5*n[0]))"
THETA4 = "arctan((p[2] - l5*n[2] - l1) / (sign*sqrt((p[0] - l5*n[0])**2 + (p[1] - l5*n[1])**2)))"
THETA2 = (
    "arctan(-(o[2]*cos(theta45) + n[2]*sin(theta45))"
    " / (sign*sqrt((o[0]*cos(theta45) + n[0]*sin(theta45))**2 + (o[1]*cos(theta45) + n[1]*sin(theta45))**2)))"
)
THETA3 = "arctan((n[2]*cos(theta45) - o[2]*sin(theta45)) / -a[2])"
"""Equations 4.9 and 4.12. Theta 2 and 3 follow from the sum of theta 4 and 5."""

SCRIPT_THETA41 = "arctan((p[2] - l5*n[2] - l1) / (sqrt((p[0] - l5*n[0])**2) + (p[1] - l5*n[1])**2))"
SCRIPT_THETA5 = (
    "arctan(((p[1] + l5*n[1])*l4*n[0] - (p[0] + l5*n[0])*l4*n[1])"
    " / ((p[0] + l5*n[0])*l4*o[1] + (p[1] + l5*n[1])*l4*o[0]))"
)
SCRIPT_THETA31 = "arctan((n[2]*cos(theta4 + theta5) + n[2]*sin(theta4 + theta5)) / -a[2])"

TOE = ("l2*s1 + along*X - across*c1*c2", "-l2*c1 - along*Y - across*c2*s1", "l1 + along*c2*s3 - across*s2")
"""The position of the corrected equation 4.6, m, from the leg's extent along the roll link and across it."""


def path_1(states: States) -> np.ndarray:
    """Equation 4.8: the pose as A1 A4 A5, (4, 4, n)."""
    a1, a4, a5 = (states.true["links"][:, i] for i in (0, 3, 4))
    return np.moveaxis(a1 @ a4 @ a5, 0, -1)


def toe(states: States, q: np.ndarray) -> np.ndarray:
    """(3, n) Position of the toe, m, at other angles."""
    _, _, l3, l4, l5 = states.lengths
    along = l3 + l4 * np.cos(q[3]) + l5 * np.cos(q[3] + q[4])
    across = l4 * np.sin(q[3]) + l5 * np.sin(q[3] + q[4])
    return np.stack([evaluate(text, states._replace(q=q), along=along, across=across) for text in TOE])


def solved(states: States) -> np.ndarray:
    """(3, n) Where the toe is at the printed solution with the signs that serve best, given the true theta 5."""
    target = evaluate("p", states)
    best = np.full_like(target, np.inf)
    for sign4, sign2 in product(SIGNS, SIGNS):
        q4 = evaluate(THETA4, states, sign=sign4)
        given = {"theta45": q4 + states.q[4], "sign": sign2}
        q1, q2, q3 = (evaluate(text, states, **given) for text in (THETA1, THETA2, THETA3))
        place = toe(states, np.array([q1, q2, q3, q4, states.q[4]]))
        nearer = np.linalg.norm(place - target, axis=0) < np.linalg.norm(best - target, axis=0)
        best = np.where(nearer, place, best)
    return best


def _nearest(text: str, joint: int) -> Formula:
    """The angle nearest to the true one, over both signs, given the true sum of theta 4 and 5."""

    def angle(states: States) -> np.ndarray:
        theta45 = states.q[3] + states.q[4]
        both = np.array([evaluate(text, states, theta45=theta45, sign=sign) for sign in SIGNS])
        away = np.abs((both - states.q[joint - 1] + np.pi) % (2 * np.pi) - np.pi)
        return np.take_along_axis(both, away.argmin(axis=0)[None], axis=0)[0]

    return angle


_DROPPED = "path 1 leaves out A2 A3, as if frames 1 and 3 were the same"
_CLOSED_FORM = "the closed form of kinematics.inverse"


def _angle(place: str, fault: str, fix: str, printed: Formula, right: str) -> Erratum:
    """An erratum of an angle, compared within the joints' ranges."""
    return Erratum(place, fault, fix, printed, formula(right), "rad", angle=True, in_range=True)


ERRATA = (
    Erratum("(4.8)", _DROPPED, "A1 A2 A3 A4 A5", path_1, formula("T")),
    Erratum(
        "(4.9), left side, row 3",
        "S4 and C4",
        "n_z C5 - o_z S5 and o_z C5 + n_z S5",
        formula("s4", "c4"),
        formula("n[2]*c5 - o[2]*s5", "o[2]*c5 + n[2]*s5"),
    ),
    Erratum("(4.9), right side, row 2", "C4 S4", "S1 C4", formula("c4*s4"), formula("s1*c4")),
    _angle("(4.9), theta 1", _DROPPED, _CLOSED_FORM, formula(THETA1), "theta1"),
    _angle("(4.9), theta 4, the better sign", _DROPPED, _CLOSED_FORM, _nearest(THETA4, 4), "theta4"),
    _angle("(4.12), theta 2, given the true theta 4 + theta 5", "none", "", _nearest(THETA2, 2), "theta2"),
    _angle("(4.12), theta 3, given the true theta 4 + theta 5", "none", "", _nearest(THETA3, 3), "theta3"),
    Erratum(
        "(4.8) to (4.12), the toe of the solution, given the true theta 5",
        "theta 1 and theta 4 are wrong, so all are",
        _CLOSED_FORM,
        solved,
        formula("p"),
        "m",
        in_range=True,
    ),
    _angle(
        "MATLAB script, theta41",
        "the root ends before the second square",
        "sqrt((px - l5 nx)^2 + (py - l5 ny)^2)",
        formula(SCRIPT_THETA41),
        THETA4.replace("sign*", ""),
    ),
    _angle(
        "MATLAB script, theta31, given the true theta 4 + theta 5",
        "n_z cos + n_z sin",
        "n_z cos - o_z sin",
        formula(SCRIPT_THETA31),
        "theta3",
    ),
    _angle(
        "MATLAB script, theta5",
        "from path 1, with p + l5 n for p - l5 n; the text has no such formula",
        _CLOSED_FORM,
        formula(SCRIPT_THETA5),
        "theta5",
    ),
)
