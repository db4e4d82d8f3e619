"""Appendix E as printed: the derivatives d_ij of the poses of the links, as far as the scan can be read.

Its d42 and d52 to d54 are damaged there beyond what tells a slip of the thesis from one of the scan.
"""

import numpy as np

from humanoid_mjx.reproduction.printed.erratum import Erratum, Formula, States
from humanoid_mjx.reproduction.printed.kinematics import sines

TURN = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]])
"""Q: the derivative of a rotation about z, after which the rotation comes."""


def d51(states: States) -> np.ndarray:
    """A to H."""
    c1, s1, c2, s2, c3, s3, c4, s4, c5, s5 = sines(states)
    _, l2, l3, l4, l5 = states.lengths
    x, y = c3 * s1 - c1 * s2 * s3, c1 * c3 + s1 * s2 * s3
    k, m, n = c4 * y + c2 * s1 * s4, s4 * y - c2 * c4 * s1, c4 * x - c1 * c2 * s4
    o, zero = s4 * x + c1 * c2 * c4, 0 * c1
    along_x = l2 * c1 + l4 * c4 * y + l3 * c1 * c3 + l5 * c5 * k - l5 * s5 * m + l4 * c2 * s1 * s4 + l3 * s1 * s2 * s3
    along_y = l2 * s1 + l4 * c4 * x + l3 * c3 * s1 + l5 * c5 * n - l5 * s5 * o - l4 * c1 * c2 * s4 - l3 * c1 * s2 * s3
    return np.array(
        [
            [c5 * k - s5 * m, -c5 * m - s5 * k, c1 * s3 - c3 * s1 * s2, along_x],
            [c5 * n - s5 * o, -c5 * o - s5 * n, s1 * s3 + c1 * c3 * s2, along_y],
            [zero] * 4,
            [zero] * 4,
        ]
    )


def d22(states: States) -> np.ndarray:
    c1, s1, c2, s2, *_ = sines(states)
    zero = 0 * c1
    return np.array(
        [
            [-c1 * c2, zero, c1 * s2, zero],
            [-c2 * s1, zero, s1 * s2, zero],
            [-s2, zero, -c2, zero],
            [zero] * 4,
        ]
    )


def d32(states: States) -> np.ndarray:
    c1, s1, c2, s2, c3, s3, *_ = sines(states)
    l3, zero = states.lengths[2], 0 * c1
    return np.array(
        [
            [-c1 * c2 * s3, c1 * s2, c1 * c1 * c3, -l3 * c1 * c2 * s3],
            [-c2 * s1 * s3, s1 * s2, c2 * c3 * s1, -l3 * c2 * s1 * s3],
            [-s2 * s3, -c2, c3 * s2, -l3 * s2 * s3],
            [zero] * 4,
        ]
    )


def d55(states: States) -> np.ndarray:
    """a1 to i1."""
    c1, s1, c2, s2, c3, s3, c4, s4, c5, s5 = sines(states)
    l5, zero = states.lengths[4], 0 * c1
    x, y = c3 * s1 - c1 * s2 * s3, c1 * c3 + s1 * s2 * s3
    k, m, n = c4 * y + c2 * s1 * s4, s4 * y - c2 * c4 * s1, c4 * x - c1 * c2 * s4
    o, w, z = s4 * x + c1 * c2 * c4, s2 * s4 - c2 * c4 * s3, c4 * s2 + c2 * s3 * s4
    return np.array(
        [
            [-c5 * o - s5 * n, s5 * o - c5 * n, zero, -l5 * c5 * o - l5 * s5 * n],
            [c5 * m + s5 * k, c5 * k - s5 * m, zero, l5 * c5 * m + l5 * s5 * k],
            [s5 * w - c5 * z, c5 * w + s5 * z, zero, l5 * s5 * w - l5 * c5 * z],
            [zero] * 4,
        ]
    )


def _true(i: int, j: int) -> Formula:
    """d_ij = A_1 .. A_(j-1) Q A_j .. A_i, (4, 4, n)."""

    def product(states: States) -> np.ndarray:
        links = states.true["links"]
        pose = np.broadcast_to(np.eye(4), links[:, 0].shape)
        for link in range(1, i + 1):
            pose = pose @ (TURN @ links[:, link - 1] if link == j else links[:, link - 1])
        return np.moveaxis(pose, 0, -1)

    return product


ERRATA = (
    Erratum("appendix E, d51", "none", "", d51, _true(5, 1), "m"),
    Erratum("appendix E, d22", "none", "", d22, _true(2, 2), "m"),
    Erratum("appendix E, d32", "C1 C1 C3 in row 1, column 3", "C1 C2 C3", d32, _true(3, 2), "m"),
    Erratum("appendix E, d55", "none", "", d55, _true(5, 5), "m"),
)
