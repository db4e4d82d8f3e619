"""Appendix E as printed: the derivatives d_ij of the poses of the links, as far as the scan can be read.

Its d42 and d52 to d54 are damaged there beyond what tells a slip of the thesis from one of the scan. The last rows, all
0, are left out.
"""

import numpy as np

from humanoid_mjx.reproduction.printed.dynamics import Q
from humanoid_mjx.reproduction.printed.erratum import Erratum, Formula, States, formula

D51 = (
    *("c5*K - s5*M", "-c5*M - s5*K", "c1*s3 - c3*s1*s2"),
    "l2*c1 + l4*c4*Y + l3*c1*c3 + l5*c5*K - l5*s5*M + l4*c2*s1*s4 + l3*s1*s2*s3",
    *("c5*N - s5*O", "-c5*O - s5*N", "s1*s3 + c1*c3*s2"),
    "l2*s1 + l4*c4*X + l3*c3*s1 + l5*c5*N - l5*s5*O - l4*c1*c2*s4 - l3*c1*s2*s3",
    *("0", "0", "0", "0"),
)
"""A to H."""

D22 = (*("-c1*c2", "0", "c1*s2", "0"), *("-c2*s1", "0", "s1*s2", "0"), *("-s2", "0", "-c2", "0"))
D32 = (
    *("-c1*c2*s3", "c1*s2", "c1*c1*c3", "-l3*c1*c2*s3"),
    *("-c2*s1*s3", "s1*s2", "c2*c3*s1", "-l3*c2*s1*s3"),
    *("-s2*s3", "-c2", "c3*s2", "-l3*s2*s3"),
)
D55 = (
    *("-c5*O - s5*N", "s5*O - c5*N", "0", "-l5*c5*O - l5*s5*N"),
    *("c5*M + s5*K", "c5*K - s5*M", "0", "l5*c5*M + l5*s5*K"),
    *("s5*W - c5*Z", "c5*W + s5*Z", "0", "l5*s5*W - l5*c5*Z"),
)
"""a1 to i1."""


def _true(i: int, j: int) -> Formula:
    """d_ij = A_1 .. A_(j-1) Q A_j .. A_i without its last row, (12, n)."""

    def product(states: States) -> np.ndarray:
        links = states.true["links"]
        pose = np.broadcast_to(np.eye(4), links[:, 0].shape)
        for link in range(1, i + 1):
            pose = pose @ (Q @ links[:, link - 1] if link == j else links[:, link - 1])
        return pose[:, :3].reshape(len(pose), 12).T

    return product


ERRATA = (
    Erratum("appendix E, d51", "none", "", formula(*D51), _true(5, 1), "m"),
    Erratum("appendix E, d22", "none", "", formula(*D22), _true(2, 2), "m"),
    Erratum("appendix E, d32", "C1 C1 C3 in row 1, column 3", "C1 C2 C3", formula(*D32), _true(3, 2), "m"),
    Erratum("appendix E, d55", "none", "", formula(*D55), _true(5, 5), "m"),
)
