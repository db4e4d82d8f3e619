"""Equations 4.1 to 4.8 and 4.22, 4.23 as printed: the pose of the toe and the singularity polynomials."""

import numpy as np

from humanoid_mjx.reproduction.printed.erratum import Erratum, States, formula

POSE = {
    "r11": "c5*(c4*X - c1*c2*s4) - s5*(s4*X + c1*c2*s4)",
    "r12": "-c5*(s4*X + c1*c2*s4) - s5*(c4*X - c1*c2*s4)",
    "r13": "s1*s3 + c1*c3*s2",
    "r14": "l2*s1 + l4*c4*X + l3*c3*s1 + l5*c5*(c4*(c1*s1 - c1*s2*s3) - c1*c2*s4)"
    " - l5*s5*(s4*X + c1*c2*c4) - l4*c1*c2*s4 - l3*c1*s2*s3",
    "r21": "s5*(s4*Y - c2*c4*s1) - c5*(c4*Y + c2*s1*s4)",
    "r22": "c5*(s4*Y - c2*c4*s1) + s5*(c4*Y + c2*s1*s4)",
    "r23": "c1*s1*s2 - c1*s3",
    "r24": "l5*s5*(s4*Y - c2*c4*s1) - l4*c4*Y - l3*c1*c3 - l5*c5*(c4*Y + c2*s1*s4) - l2*c1 - l4*c2*s1*s4 - l3*s1*s2*s3",
    "r31": "-c5*(s2*s4 - c2*c4*s3) - s5*(c4*s2 + c2*s3*s4)",
    "r32": "s5*(s2*s4 - c2*c4*s3) - c5*(c4*s2 + c2*s3*s4)",
    "r33": "-c2*c3",
    "r34": "l1 - l5*c5*(s2*s4 - c2*c4*s3) - l5*s5*(c4*s2 + c2*s3*s4) + l3*c2*s3 - l4*s2*s4 + l4*c2*c4*s3",
}
"""The twelve entries of equation 4.6."""

POLYNOMIAL = (
    "0.000353*s2*s5 - 0.000839*s2*s4 + 0.000353*c3*s5{third} + 0.000821*c4*s2*s5 + 0.000839*c5*c5*s2*s4"
    " + 0.000839*c2*c4*s3 - 0.000839*c2*c4*c5*c5*s3 + 0.000839*c4*c5*s2*s5"
    " + 0.000821*c2*s3*s4*s5 + 0.000833*c2*c5*s3*s4*s5"
)
"""Equation 4.22, which 4.23 repeats but for one factor of the third term."""

LEG, TORSO = POLYNOMIAL.format(third=""), POLYNOMIAL.format(third="*s2")


def _leg_determinant(states: States) -> np.ndarray:
    return np.linalg.det(states.true["jacobian"][:, :3][:, :, [0, 3, 4]])


_FAULTS = {
    "r11": ("C1 C2 S4 in the bracket of S5", "C1 C2 C4"),
    "r12": ("C1 C2 S4 in the bracket of C5", "C1 C2 C4"),
    "r14": ("C4 (C1 S1 - C1 S2 S3) in the term of l5", "C4 (C3 S1 - C1 S2 S3)"),
    "r23": ("C1 S1 S2", "C3 S1 S2"),
}

ERRATA = (
    *(
        Erratum(
            f"(4.{joint})",
            f"the length l{joint} is a translation along z, Trans(0, 0, l{joint})",
            f"along x, Trans(l{joint}, 0, 0)",
            formula("0", "0", f"l{joint}"),
            formula(f"A[{joint - 1}, :3, 3]"),
            "m",
        )
        for joint in (3, 4, 5)
    ),
    Erratum("A1, row 3", "0 0 0 l1", "0 1 0 l1", formula("0", "0", "0", "l1"), formula("A[0, 2]")),
    Erratum("A4, row 2", "l4 theta4", "l4 S4", formula("l4*theta4"), formula("A[3, 1, 3]"), "m"),
    *(
        Erratum(
            f"(4.6) {name}",
            *_FAULTS.get(name, ("none", "")),
            formula(text),
            formula(f"T[{name[1]} - 1, {name[2]} - 1]"),
            "m" if name.endswith("4") else "",
        )
        for name, text in POSE.items()
    ),
    Erratum(
        "(4.7), (4.8), (4.11), row 3", "n_z twice", "the second is o_z", formula(POSE["r31"]), formula(POSE["r32"])
    ),
    Erratum(
        "(4.22)",
        "the third term lacks S2, and .000833 stands for .000839",
        ".000353 C3 S2 S5 and .000839: the determinant of the velocities of joints 1, 4 and 5",
        formula(LEG),
        _leg_determinant,
        "m^3",
    ),
    Erratum(
        "(4.23)",
        "repeats the leg's polynomial",
        "-B S3 (B C2 S3 - K S2), B = l3 + l4 C4 + l5 C45, K = l4 S4 + l5 S45",
        formula(TORSO),
        lambda states: np.linalg.det(states.true["jacobian"][:, :2][:, :, [1, 2]]),
        "m^2",
    ),
    Erratum(
        "(4.23) read as the leg's determinant",
        ".000833 stands for .000839",
        ".000839",
        formula(TORSO),
        _leg_determinant,
        "m^3",
    ),
)
