"""The leg's kinematics in plain NumPy: products of the four elementary transformations of Table 4.1."""

import json
from pathlib import Path

import numpy as np

GOLDEN = json.loads((Path(__file__).parent / "data" / "golden.json").read_text())


def transform(theta, d, a, alpha):
    """Rz(theta) Tz(d) Tx(a) Rx(alpha)."""
    rz, tz, tx, rx = (np.eye(4) for _ in range(4))
    rz[:2, :2] = [[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]]
    tz[2, 3], tx[0, 3] = d, a
    rx[1:3, 1:3] = [[np.cos(alpha), -np.sin(alpha)], [np.sin(alpha), np.cos(alpha)]]
    return rz @ tz @ tx @ rx


def toe(lengths, q):
    """(4, 4) The toe's pose."""
    l1, l2, l3, l4, l5 = lengths
    square = np.pi / 2
    table = ((0, l1, 0, square), (square, l2, 0, -square), (-square, 0, l3, square), (0, 0, l4, 0), (0, 0, l5, 0))
    pose = np.eye(4)
    for angle, (offset, d, a, alpha) in zip(q, table, strict=True):
        pose = pose @ transform(angle + offset, d, a, alpha)
    return pose


def numeric_jacobian(lengths, q, step=1e-6):
    """(6, 5) By central differences of the toe's pose: velocity, then angular velocity from R'R^T."""
    columns = []
    for joint in range(5):
        shift = step * np.eye(5)[joint]
        ahead, behind = toe(lengths, q + shift), toe(lengths, q - shift)
        rate = (ahead - behind) / (2 * step)
        spin = rate[:3, :3] @ toe(lengths, q)[:3, :3].T
        columns.append([*rate[:3, 3], spin[2, 1], spin[0, 2], spin[1, 0]])
    return np.array(columns).T


def uniform(ranges_deg, n, seed):
    """(n, 5) Postures drawn from ranges in degrees."""
    low, high = np.radians(ranges_deg).T
    return np.random.default_rng(seed).uniform(low, high, (n, 5))


def turned(a, b):
    """The difference of angles, in [-pi, pi)."""
    return (np.asarray(a) - np.asarray(b) + np.pi) % (2 * np.pi) - np.pi
