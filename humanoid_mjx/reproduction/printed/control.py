"""Chapter 5's formulas as printed: responses of second order, the geared joint, the rate of the servo error.

No values are printed for most of their symbols. Each is compared at values that are drawn with the postures.
"""

from typing import Any

import numpy as np

from humanoid_mjx.reproduction.printed.erratum import Erratum, Formula, States, evaluate
from humanoid_mjx.thesis import leg as thesis

RANGES = (
    {"t": (0.0, 1.0), "omega": np.sqrt((min(thesis.KP), max(thesis.KP))), "zeta": (0.1, 0.9), "b0": (1.0, 10.0)},
    {
        "eta": (1.0, 100.0),
        "rotor": (1e-8, 1e-6),
        "link": (1e-4, 1e-2),
        "bearing": (1e-8, 1e-6),
        "friction": (1e-4, 1e-2),
    },
)
"""Symbols of sections 5.2 and 5.3, s and rad/s, kg m^2 and N m s/rad: the ranges that the joints' angles stretch over.
The natural frequencies are those of Table 5.1's gains."""


def _formula(text: str) -> Formula:
    """A formula of these symbols; `over` is a damping ratio above 1; `q`, `rate` and `qacc` are the joints'."""

    def values(states: States) -> np.ndarray:
        names: dict[str, Any] = {"q": states.q, "rate": states.qd, "qacc": states.qdd}
        for ranges in RANGES:
            for (name, (low, high)), angles in zip(ranges.items(), states.q, strict=False):
                names[name] = low + (high - low) * (angles + np.pi) / (2 * np.pi)
        over = 1.0 + names["zeta"]
        roots = {"root": np.sqrt(1 - names["zeta"] ** 2), "over_root": np.sqrt(over**2 - 1)}
        return evaluate(text, states, **names, **roots, over=over)

    return values


BRACKET = "1 - exp(-omega*t) - omega*t*exp(-omega*t)"
FIRST, SECOND = (f"(-over*omega {sign} omega*over_root)" for sign in "+-")
"""The roots of (5.3)."""

UNDERDAMPED = "1 - exp(-zeta*omega*t) / ({}*root) * sin(omega*root*t + arctan2(root, zeta))"

ERRATA = (
    Erratum(
        "(5.1), what a set-point of 1 becomes in the end",
        "b0 / (1 + b0); (5.2) and (5.4) to (5.6) have no b0",
        "omega_n^2 over s^2 + 2 zeta omega_n s + omega_n^2, whose end is 1",
        _formula("b0 / (1 + b0)"),
        _formula("1"),
    ),
    Erratum(
        "(5.4), overdamped",
        "none",
        "",
        _formula(
            "1 - ((over_root - over)*exp(-(over + over_root)*omega*t)"
            " + (over_root + over)*exp(-(over - over_root)*omega*t)) / (2*over_root)"
        ),
        _formula(f"1 - ({SECOND}*exp({FIRST}*t) - {FIRST}*exp({SECOND}*t)) / ({SECOND} - {FIRST})"),
    ),
    Erratum(
        "(5.5), critically damped",
        "the bracket is subtracted from 1: it falls from 1 to 0",
        "the bracket alone",
        _formula(f"1 - ({BRACKET})"),
        _formula(BRACKET),
    ),
    Erratum(
        "(5.6), underdamped",
        "1 / (2 sqrt(zeta^2 - 1)), an imaginary number; here its modulus",
        "1 / sqrt(1 - zeta^2)",
        _formula(UNDERDAMPED.format(2)),
        _formula(UNDERDAMPED.format(1)),
    ),
    Erratum(
        "(5.13) and (5.14), motor's side and link's side",
        "none",
        "",
        _formula("(link + eta**2*rotor)*qacc[0] + (friction + eta**2*bearing)*rate[0]"),
        _formula("eta*((rotor + link/eta**2)*eta*qacc[0] + (bearing + friction/eta**2)*eta*rate[0])"),
        "N m",
    ),
    Erratum(
        "(5.43), rate of the servo error",
        "q without its dot",
        "the planned rate less the joint's rate",
        _formula("qacc - q"),
        _formula("qacc - rate"),
        "rad/s",
    ),
)
