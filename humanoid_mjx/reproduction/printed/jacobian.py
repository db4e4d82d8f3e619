"""Appendices C and D as printed: the Jacobian and the stall torques."""

import numpy as np

from humanoid_mjx.reproduction.printed.erratum import Erratum, Formula, States
from humanoid_mjx.reproduction.printed.kinematics import sines


def jacobian_entries(states: States) -> dict[tuple[int, int], np.ndarray]:
    """Rows 1 to 3 of the columns J1 to J5 of appendix C, by row and column, letter by letter.

    Where the scan is damaged (J3, row 1: `l1 S3 A5`), appendix D, which repeats the entry, says l5 S4 S5.
    """
    c1, s1, c2, s2, c3, s3, c4, s4, c5, s5 = sines(states)
    _, l2, l3, l4, l5 = states.lengths
    x, y = c3 * s1 - c1 * s2 * s3, c1 * c3 + s1 * s2 * s3
    u, v, w = s1 * s3 + c1 * c3 * s2, c1 * s3 - c3 * s1 * s2, s2 * s4 - c2 * c4 * s3
    k, m = c4 * s2 + c2 * s3 * s4, c4 * y + c2 * s1 * s4
    n = s4 * y - c2 * c4 * s1
    return {
        (1, 1): l2 * c1
        + l4 * c4 * y
        + l3 * c1 * c3
        + l5 * c5 * m
        - l5 * s5 * n
        + l4 * c2 * s1 * s4
        + l3 * s1 * s2 * s3,
        (2, 1): l2 * s1
        + l4 * c4 * x
        + l3 * c3 * s1
        + l5 * c5 * (c4 * x - c1 * c2 * s4)
        - l5 * s5 * (s4 * x + c1 * c2 * c4)
        - l4 * c1 * c2 * s4
        - l3 * c1 * s2 * s3,
        (3, 1): 0 * c1,
        (1, 2): l5 * c5 * (c1 * s2 * s4 - c1 * c2 * c4 * s3)
        + l5 * s5 * (c1 * c4 * s2 + c1 * c2 * s3 * s4)
        - l3 * c1 * c2 * s3
        + l4 * c1 * s2 * s4
        - l4 * c1 * c2 * c4 * s3,
        (2, 2): l5 * s5 * (c4 * s1 * s2 + c2 * s1 * s3 * s4)
        + l5 * c5 * (s1 * s2 * s4 - c2 * c4 * s1 * s3)
        - l3 * c2 * s1 * s3
        + l4 * s1 * s2 * s4
        - l4 * c2 * c4 * s1 * s3,
        (3, 2): -l5 * c5 * (c2 * s4 + c4 * s2 * s3)
        - l5 * s5 * (c2 * c4 - s2 * s3 * s4)
        - l4 * c2 * s4
        - l3 * s2 * s3
        - l4 * c4 * s2 * s3,
        (1, 3): l5 * s4 * s5 * u - l3 * s1 * s3 - l5 * c1 * c5 * u - l4 * c4 * u - l3 * c1 * c3 * s2,
        (2, 3): l4 * c4 * v + l3 * c1 * s3 + l5 * c4 * c5 * v - l5 * s4 * s5 * v - l3 * c3 * s1 * s2,
        (3, 3): l3 * c2 * c3 + l4 * c2 * c3 * c4 + l5 * c2 * c3 * c4 * c5 - l5 * c2 * c3 * s4 * s5,
        (1, 4): -l4 * s4 * x
        - l5 * c5 * (s4 * x + c1 * c2 * c4)
        - l5 * s5 * (c4 * x - c1 * c2 * s4)
        - l4 * c1 * c2 * c4,
        (2, 4): l4 * s4 * y + l5 * c5 * n + l5 * s5 * m - l4 * c2 * c4 * s1,
        (3, 4): l5 * s5 * w - l5 * c5 * k - l4 * c4 * s2 - l4 * c2 * s3 * s4,
        (1, 5): -l5 * c5 * (s4 * x + c1 * c2 * s4) - l5 * s5 * (c4 * x - c1 * c2 * s4),
        (2, 5): l5 * c5 * n + l5 * s5 * m,
        (3, 5): l5 * s5 * w - l5 * c5 * k,
    }


def axis(joint: int) -> Formula:
    """Rows 4 to 6 of a column of appendix C: the joint's axis, (3, n)."""

    def rows(states: States) -> np.ndarray:
        c1, s1, c2, s2, c3, s3, *_ = sines(states)
        zero = 0 * c1
        return np.array(
            {
                1: (zero, zero, zero + 1),
                2: (s1, -c1, zero),
                3: (-c1 * c2, -c2 * s1, -s2),
            }.get(joint, (s1 * s3 + c1 * c3 * s2, c3 * s1 * s2 - c1 * s3, -c2 * c3))
        )

    return rows


FORCE = {"fx": 1.0, "fy": 2.0, "fz": 3.0}
"""N: the force at which the stall torques of appendix D are compared."""


def stall_torque(joint: int, factors: tuple[str, str, str]) -> Formula:
    """A row of appendix D, N m, with the components of the force that it multiplies rows 1 to 3 with."""

    def torque(states: States) -> np.ndarray:
        entries = jacobian_entries(states)
        return np.sum([entries[row, joint] * FORCE[f] for row, f in enumerate(factors, start=1)], axis=0)

    return torque


def _true_torque(joint: int) -> Formula:
    return lambda states: states.true["jacobian"][:, :3, joint - 1] @ np.array(list(FORCE.values()))


_FAULTS = {
    (1, 3): ("l5 C1 C5 (S1 S3 + C1 C3 S2)", "l5 C4 C5 (...)"),
    (1, 5): ("C1 C2 S4 in the first bracket", "C1 C2 C4"),
}
_TORQUES = {
    2: (("fx", "fy", "fz"), "none", ""),
    3: (("fx", "fy", "fz"), "l5 C1 C5 as in J3", "l5 C4 C5"),
    4: (("fx", "fx", "fz"), "the second f_x", "f_y"),
    5: (("fx", "fy", "fz"), "C1 C2 S4 as in J5", "C1 C2 C4"),
}
"""Torque 1 has a place of its own below."""


def first_torque(states: States) -> np.ndarray:
    """The factor of f_x in torque 1 of appendix D, its brackets paired as far as they are printed, m."""
    c1, s1, c2, s2, c3, s3, c4, s4, c5, s5 = sines(states)
    _, l2, l3, l4, l5 = states.lengths
    y = c1 * c3 + s1 * s2 * s3
    before = l2 * c1 + l4 * c4 * y + l3 * c1 * c3 + l5 * c5 * (c4 * y + c2 * s1 * s4)
    return before - l5 * s5 * (s4 * y) - c2 * c4 * s1 + l4 * c2 * s1 * s4 + l3 * s1 * s2 * s3


ERRATA = (
    *(
        Erratum(
            f"appendix C, J{column}, row {row}",
            *_FAULTS.get((row, column), ("none", "")),
            lambda states, row=row, column=column: jacobian_entries(states)[row, column],
            lambda states, row=row, column=column: states.true["jacobian"][:, row - 1, column - 1],
            "m",
        )
        for column in range(1, 6)
        for row in range(1, 4)
    ),
    *(
        Erratum(
            f"appendix C, J{joint}, rows 4 to 6",
            "none",
            "",
            axis(joint),
            lambda states, joint=joint: states.true["jacobian"][:, 3:, joint - 1].T,
        )
        for joint in range(1, 6)
    ),
    Erratum(
        "appendix D, torque 1, factor of f_x",
        "the bracket of l5 S5 closes before - C2 C4 S1, and another that never opened after it",
        "l5 S5 (S4 (C1 C3 + S1 S2 S3) - C2 C4 S1) as in J1",
        first_torque,
        lambda states: states.true["jacobian"][:, 0, 0],
        "m",
    ),
    *(
        Erratum(f"appendix D, torque {joint}", fault, fix, stall_torque(joint, factors), _true_torque(joint), "N m")
        for joint, (factors, fault, fix) in _TORQUES.items()
    ),
)
