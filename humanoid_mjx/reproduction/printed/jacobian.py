"""Appendices C and D as printed: the Jacobian and the stall torques."""

import numpy as np

from humanoid_mjx.reproduction.printed.erratum import Erratum, Formula, States, formula

JACOBIAN = {
    (1, 1): "l2*c1 + l4*c4*Y + l3*c1*c3 + l5*c5*K - l5*s5*M + l4*c2*s1*s4 + l3*s1*s2*s3",
    (2, 1): "l2*s1 + l4*c4*X + l3*c3*s1 + l5*c5*(c4*X - c1*c2*s4) - l5*s5*(s4*X + c1*c2*c4)"
    " - l4*c1*c2*s4 - l3*c1*s2*s3",
    (3, 1): "0",
    (1, 2): "l5*c5*(c1*s2*s4 - c1*c2*c4*s3) + l5*s5*(c1*c4*s2 + c1*c2*s3*s4)"
    " - l3*c1*c2*s3 + l4*c1*s2*s4 - l4*c1*c2*c4*s3",
    (2, 2): "l5*s5*(c4*s1*s2 + c2*s1*s3*s4) + l5*c5*(s1*s2*s4 - c2*c4*s1*s3)"
    " - l3*c2*s1*s3 + l4*s1*s2*s4 - l4*c2*c4*s1*s3",
    (3, 2): "-l5*c5*(c2*s4 + c4*s2*s3) - l5*s5*(c2*c4 - s2*s3*s4) - l4*c2*s4 - l3*s2*s3 - l4*c4*s2*s3",
    (1, 3): "l5*s4*s5*U - l3*s1*s3 - l5*c1*c5*U - l4*c4*U - l3*c1*c3*s2",
    (2, 3): "l4*c4*V + l3*c1*s3 + l5*c4*c5*V - l5*s4*s5*V - l3*c3*s1*s2",
    (3, 3): "l3*c2*c3 + l4*c2*c3*c4 + l5*c2*c3*c4*c5 - l5*c2*c3*s4*s5",
    (1, 4): "-l4*s4*X - l5*c5*(s4*X + c1*c2*c4) - l5*s5*(c4*X - c1*c2*s4) - l4*c1*c2*c4",
    (2, 4): "l4*s4*Y + l5*c5*M + l5*s5*K - l4*c2*c4*s1",
    (3, 4): "l5*s5*W - l5*c5*Z - l4*c4*s2 - l4*c2*s3*s4",
    (1, 5): "-l5*c5*(s4*X + c1*c2*s4) - l5*s5*(c4*X - c1*c2*s4)",
    (2, 5): "l5*c5*M + l5*s5*K",
    (3, 5): "l5*s5*W - l5*c5*Z",
}
"""Rows 1 to 3 of the columns J1 to J5 of appendix C, by row and column.

Where the scan is damaged (J3, row 1: `l1 S3 A5`), appendix D, which repeats the entry, says l5 S4 S5.
"""

_LAST_AXES = ("s1*s3 + c1*c3*s2", "c3*s1*s2 - c1*s3", "-c2*c3")
AXES = {1: ("0", "0", "1"), 2: ("s1", "-c1", "0"), 3: ("-c1*c2", "-c2*s1", "-s2"), 4: _LAST_AXES, 5: _LAST_AXES}
"""Rows 4 to 6 of the columns of appendix C: the joints' axes."""

FORCE = {"fx": 1.0, "fy": 2.0, "fz": 3.0}
"""N: the force at which the stall torques of appendix D are compared."""

FIRST_TORQUE = (
    "l2*c1 + l4*c4*Y + l3*c1*c3 + l5*c5*(c4*Y + c2*s1*s4) - l5*s5*(s4*Y) - c2*c4*s1 + l4*c2*s1*s4 + l3*s1*s2*s3"
)
"""The factor of f_x in torque 1 of appendix D, m, its brackets paired as far as they are printed."""


def stall_torque(joint: int, factors: tuple[str, str, str]) -> Formula:
    """A row of appendix D, N m, with the components of the force that it multiplies rows 1 to 3 with."""
    return formula(" + ".join(f"{FORCE[f]}*({JACOBIAN[row, joint]})" for row, f in enumerate(factors, start=1)))


def _true_torque(joint: int) -> Formula:
    def torque(states: States) -> np.ndarray:
        return states.true["jacobian"][:, :3, joint - 1] @ np.array(list(FORCE.values()))

    return torque


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

ERRATA = (
    *(
        Erratum(
            f"appendix C, J{column}, row {row}",
            *_FAULTS.get((row, column), ("none", "")),
            formula(text),
            formula(f"J[{row - 1}, {column - 1}]"),
            "m",
        )
        for (row, column), text in JACOBIAN.items()
    ),
    *(
        Erratum(f"appendix C, J{joint}, rows 4 to 6", "none", "", formula(*axis), formula(f"J[3:, {joint - 1}]"))
        for joint, axis in AXES.items()
    ),
    Erratum(
        "appendix D, torque 1, factor of f_x",
        "the bracket of l5 S5 closes before - C2 C4 S1, and another that never opened after it",
        "l5 S5 (S4 (C1 C3 + S1 S2 S3) - C2 C4 S1) as in J1",
        formula(FIRST_TORQUE),
        formula("J[0, 0]"),
        "m",
    ),
    *(
        Erratum(f"appendix D, torque {joint}", fault, fix, stall_torque(joint, factors), _true_torque(joint), "N m")
        for joint, (factors, fault, fix) in _TORQUES.items()
    ),
)
