"""The formulas as printed against the verified mechanics: what is wrong, what it should be, and what it does."""

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx import dynamics, kinematics
from humanoid_mjx.reproduction.findings import Finding, Setting, check, experiment, three_digits
from humanoid_mjx.reproduction.leg_values import over
from humanoid_mjx.reproduction.printed.formulas import ENTRIES, Erratum, States, evaluate
from humanoid_mjx.robot.leg import AS_PRINTED, Leg, corrected_inertias
from humanoid_mjx.thesis import leg as thesis

STATES = 2000

TOLERANCE = 1e-3
"""Tolerance as a share of the quantity's largest value: the printed coefficients have three digits."""

NUMBERS = ("largest error", "median error", "largest value")

CIRCLE = ((-180.0, 180.0),) * 5


@experiment("errata", "The formulas as printed, and what is wrong with them")
def errata(setting: Setting) -> list[Finding]:
    anywhere, in_range = _states(CIRCLE), _states(thesis.JOINT_RANGES["proposed"])
    findings = [_compare(entry, in_range if entry.in_range else anywhere) for entry in ENTRIES]
    setting.table(
        ("place", "fault", *NUMBERS, "verdict", "what it should be, and where tried"),
        (
            (f.quantity, f.printed, *(f"{found[key]:.3g} {found['unit']}".strip() for key in NUMBERS), f.verdict, f.why)
            for f in findings
            for found in [f.reproduced]
        ),
    )
    return findings


def _compare(entry: Erratum, states: States) -> Finding:
    errors = entry.errors(states)
    size = float(np.abs(evaluate(entry.right, states)).max())
    agrees = bool(errors.max() <= TOLERANCE * (size or 1.0))
    found = dict(zip(NUMBERS, map(three_digits, (errors.max(), np.median(errors), size)), strict=True))
    where = "Table 3.2's ranges" if entry.in_range else "the full circle"
    why = (f"should be: {entry.fix}; " if entry.fix else "") + f"over {STATES} random postures in {where}"
    fault, tolerance = "no fault" if entry.fault == "none" else entry.fault, f"{TOLERANCE:g} of the largest value"
    return check(entry.place, fault, found | {"unit": entry.unit}, agrees, why, tolerance)


def _states(ranges: tuple[tuple[float, float], ...]) -> States:
    """Random postures in these ranges, degrees, with what is true there."""
    low, high = np.radians(ranges).T
    random = np.random.default_rng(0)
    q = random.uniform(low, high, (STATES, 5))
    leg = Leg.physical()
    frames, jac = over(kinematics.frames, leg, q), over(kinematics.jacobian, leg, q)
    links = np.linalg.solve(frames[:, :-1], frames[:, 1:])
    true = {"T": frames[:, -1], "A": links, "J": jac} | over(_dynamics, (Leg.thesis(), Leg.thesis(AS_PRINTED)), q)
    true = {name: np.moveaxis(value, 0, -1) for name, value in true.items()}
    qd, qdd = random.uniform(-2, 2, (2, 5, STATES))
    return States(q.T, thesis.LINK_LENGTHS, true, qd, qdd, corrected_inertias())


def _dynamics(legs: tuple[Leg, Leg], q: jax.Array) -> dict[str, jax.Array]:
    """The terms of the equation of motion of the leg of section 4.6, with gravity along it and sideways."""
    leg, sideways = legs
    # The velocity term is a quadratic form; its coefficients follow from its values at sums of unit vectors.
    unit = jnp.eye(5)
    plus, minus = unit[:, None] + unit, unit[:, None] - unit
    at = jax.vmap(jax.vmap(lambda qd: dynamics.coriolis(leg, q, qd)))
    return {
        "mass": dynamics.mass_matrix(leg, q),
        "h": jnp.moveaxis(at(plus) - at(minus), -1, 0) / 4,
        "upright_gravity": dynamics.gravity(leg, q),
        "sideways_gravity": dynamics.gravity(sideways, q),
    }
