"""The errata of section 4.6, appendices F to H and the MATLAB script's dynamics, for the leg of section 4.6."""

from collections.abc import Callable

import numpy as np

from humanoid_mjx.reproduction.printed.dynamics import (
    ALL,
    JOINTS,
    SLIPS,
    Factors,
    Model,
    coriolis,
    gravity,
    mass_matrix,
    script_centroids,
    velocity_coefficients,
)
from humanoid_mjx.reproduction.printed.erratum import Erratum, Formula, States
from humanoid_mjx.thesis import leg as thesis


def _model(states: States) -> Model:
    """The leg of the states with its true centroids."""
    return Model(states.lengths, states.inertia, states.inertia[:, :3, 3] / states.inertia[:, 3, 3, None])


def _true(name: str) -> Formula:
    """A verified quantity, states last."""
    return lambda states: np.moveaxis(states.true[name], 0, -1)


def _coefficients(*faults: str) -> Formula:
    return lambda states: velocity_coefficients(_model(states), states.q, faults)


def _velocity_term(*faults: str) -> Formula:
    return lambda states: coriolis(_model(states), states.q, states.qd, faults)


def _one_coefficient(of: Callable[[States], np.ndarray], i: int, j: int, k: int) -> Formula:
    return lambda states: of(states)[i - 1, j - 1, k - 1]


def _kinetic_energy(states: States) -> np.ndarray:
    """The first term of (4.27): j runs from i to i."""
    factors = Factors(_model(states), states.q)
    pairs = ((i, k) for i in JOINTS for k in range(1, i + 1))
    terms = [factors.inner(i, (i,), (k,)) * states.qd[i - 1] * states.qd[k - 1] for i, k in pairs]
    return np.sum(terms, axis=0) / 2


def _inertial(motion: Callable[[States], np.ndarray]) -> Formula:
    """The mass matrix times a motion, N m."""
    return lambda states: np.einsum("nij,jn->in", states.true["mass_matrix"], motion(states))


def _acceleration(power: int) -> Formula:
    """The planned accelerations, degrees/s^2, with this power of time in the last term; times in place of states."""

    def formula(states: States) -> np.ndarray:
        t = np.linspace(0, thesis.QUINTIC_S, states.q.shape[1])
        a3, a4, a5 = np.array(thesis.QUINTIC_COEFFICIENTS)[:, 1:, None].swapaxes(0, 1)
        return 6 * a3 * t + 12 * a4 * t**2 + 20 * a5 * t**power

    return formula


def _constant(value: float) -> Formula:
    return lambda states: np.full(states.q.shape[1], value)


ERRATA = (
    *(
        Erratum(
            f"section 4.6, I{link} ({row}, {column})",
            f"{thesis.PSEUDO_INERTIAS[link - 1][row - 1][column - 1]:g}",
            f"{value:g}: {reason}",
            _constant(thesis.PSEUDO_INERTIAS[link - 1][row - 1][column - 1]),
            _constant(value),
            "kg m^2",
        )
        for link, (row, column), value, reason in thesis.INERTIA_CORRECTIONS
    ),
    Erratum(
        "(4.27), kinetic energy",
        "the sum over j runs from i to i",
        "from 1 to i",
        _kinetic_energy,
        lambda states: np.einsum("nij,in,jn->n", states.true["mass_matrix"], states.qd, states.qd) / 2,
        "J",
    ),
    Erratum(
        "(4.29) and (5.15), M times",
        "the joints' velocities",
        "their accelerations",
        _inertial(lambda states: states.qd),
        _inertial(lambda states: states.qdd),
        "N m",
    ),
    Erratum(
        "(4.29), (4.32) and appendix G, h_ijk",
        "d(d_pk)/dq_p, in which j does not occur",
        "d(d_pj)/dq_k",
        _coefficients("rule"),
        _true("velocity_coefficients"),
        "kg m^2",
    ),
    Erratum("appendix F, M", "none", "", lambda s: mass_matrix(_model(s), s.q, ()), _true("mass_matrix"), "kg m^2"),
    Erratum(
        "MATLAB script, M33",
        "d55 I5 d53' in the last term",
        "d53 I5 d53'",
        lambda states: mass_matrix(_model(states), states.q)[2, 2],
        lambda states: states.true["mass_matrix"][:, 2, 2],
        "kg m^2",
    ),
    Erratum(
        "MATLAB script, the least eigenvalue of M",
        "negative in places through M33, so that no motion belongs to M",
        "positive everywhere",
        lambda states: np.linalg.eigvalsh(np.moveaxis(mass_matrix(_model(states), states.q), -1, 0))[:, 0],
        lambda states: np.linalg.eigvalsh(states.true["mass_matrix"])[:, 0],
        "kg m^2",
        in_range=True,
    ),
    *(
        Erratum(
            f"MATLAB script, h{i}{j}{k} against its own rule",
            slip.fault,
            "the rule's factors",
            _one_coefficient(_coefficients("rule", "slips"), i, j, k),
            _one_coefficient(_coefficients("rule"), i, j, k),
            "kg m^2",
        )
        for (i, j, k), slip in SLIPS.items()
    ),
    Erratum(
        "MATLAB script, H1 to H5 against its own rule",
        "h_i31 times the square of speed 1",
        "times speed 3 and speed 1",
        _velocity_term("rule", "speeds"),
        _velocity_term("rule"),
        "N m",
    ),
    Erratum(
        "MATLAB script, H1 to H5 with all faults",
        "the rule, the slips and the speeds",
        "as above",
        _velocity_term(*ALL),
        lambda s: np.einsum("nijk,jn,kn->in", s.true["velocity_coefficients"], s.qd, s.qd),
        "N m",
    ),
    Erratum(
        "appendix H, G with g = [0 0 -9.81 1] (the 1 meets a row of zeros)",
        "none",
        "",
        lambda states: gravity(_model(states), states.q),
        _true("sideways_gravity"),
        "N m",
    ),
    Erratum(
        "appendix H, r1 to r5",
        "half a link's length along y of frame 1 and z of the others",
        "the centroids that belong to the pseudo-inertias",
        lambda s: gravity(_model(s)._replace(centroids=script_centroids(s.lengths)), s.q),
        _true("sideways_gravity"),
        "N m",
    ),
    Erratum(
        "appendix H, the direction of gravity",
        "along z0, which points sideways in the frames of Table 4.1",
        "along -y0, where the leg hangs",
        lambda states: gravity(_model(states), states.q),
        _true("gravity"),
        "N m",
    ),
    Erratum("section 4.7, accelerations", "20 a5 t^4", "20 a5 t^3", _acceleration(4), _acceleration(3), "degrees/s^2"),
)
