"""Figure 7.5 and Table 4.7: the torques of the planned motion, and which model they come from."""

from collections.abc import Iterator, Mapping
from itertools import product
from typing import Any, NamedTuple

import jax
import numpy as np

from humanoid_mjx import dynamics
from humanoid_mjx.mechanics.trajectories import rest_to_rest
from humanoid_mjx.report.style import COLORS
from humanoid_mjx.reproduction.findings import Finding, Setting, compare, experiment, in_words
from humanoid_mjx.reproduction.leg_values import NAMES, over, planned, plot_joints
from humanoid_mjx.reproduction.printed import dynamics as printed
from humanoid_mjx.robot.leg import Leg, corrected_inertias, script_inertias
from humanoid_mjx.thesis import leg as thesis

FIGURE_TOLERANCE, TABLE_TOLERANCE = 1e-8, 5e-5
"""N m. Figure 7.5 has nine decimal places, all of which the recovered round masses give at the start; Table 4.7 has
four."""

NEAR = 0.02
"""Share of a printed torque within which a model is near it."""

SAMPLES = 501


def _config(masses: tuple[float, ...], degree: float, knee: float) -> dict[str, dict[str, float]]:
    return {
        "masses": {f"m{i}": m for i, m in enumerate(masses, start=1)},
        "units": {"degree": degree},
        "knee": {"end": knee},
    }


SOLVED = [(link, thesis.FIGURE_7_5_MASSES[link - 1]) for link in (2, 3, 4)]
AS_PLANNED = _config(thesis.LINK_MASSES, np.pi / 180, thesis.QUINTIC_RANGES[3][1])
RECOVERED = _config(thesis.FIGURE_7_5_MASSES, thesis.FIGURE_7_5_DEGREE, thesis.QUINTIC_RANGES[2][1])
"""With the knee driven by joint 3's trajectory, as in the straight walking of section 7 B."""

EVIDENCE = (
    "so are all quantities of this figure; gravity along this joint's axis, as printed, leaves it no torque",
    *(f"m{link} was solved from this number; that it comes out round is evidence ({m:.6f} kg)" for link, m in SOLVED),
    "evidence for the model: no value was fitted to it, and all nine digits agree",
)
"""Evidence of the start torques for the recovered values, by joint: only the last could have differed."""

GRAVITY = {"sideways": (0.0, 0.0, -thesis.GRAVITY), "along the leg": (0.0, -thesis.GRAVITY, 0.0)}

DEGREES = {"pi/180": np.pi / 180, "3.15/180": thesis.FIGURE_7_5_DEGREE}
FAULTS = {
    "the script's equations": printed.ALL,
    "the wrong rule alone": ("rule",),
    "the slips alone": ("slips",),
    "the wrong speeds alone": ("speeds",),
    "the right equations": (),
}


class Trial(NamedTuple):
    """A model of the torques, in words, and the torques it gives, (5,) N m."""

    words: str
    maxima: np.ndarray
    """The greatest."""
    peaks: np.ndarray
    """The largest by size."""
    solved: np.ndarray
    """True where the greatest torque is that at the start, of which a mass of the model was solved."""


@experiment("figure-7.5", "The joint torques of the planned motion", RECOVERED)
def torques(setting: Setting) -> Iterator[Finding]:
    """Figure 7.5: the torques at the start, at the end and at most, by the recovered model."""
    config, t = setting.config, np.linspace(0, thesis.QUINTIC_S, SAMPLES)
    motion = _motion(t, config["knee"]["end"], config["units"]["degree"])
    masses = np.array(list(config["masses"].values()))
    with jax.enable_x64(True):
        leg = Leg.figure_7_5().scaled(mass=masses / np.array(thesis.FIGURE_7_5_MASSES))
        tau = _torque(leg, motion)
        upright = _torque(Leg.physical(), _motion(t, thesis.QUINTIC_RANGES[3][1], np.pi / 180))
        model = printed.Model(thesis.LINK_LENGTHS, np.array(leg.pseudo_inertia), np.array(thesis.LINK_CENTROIDS))
    erroneous = printed.inverse_dynamics(model, *motion)
    curves = {"The script's equations, recovered values": erroneous, "The right equations, same values": tau}
    _draw(setting, t, curves | {"Solid links, gravity along the leg, knee to 120°": upright})
    words = in_words(_flat(config), _flat(AS_PLANNED))
    for j, (mark, why) in enumerate(zip(thesis.FIGURE_7_5["start"], EVIDENCE, strict=True)):
        quantity, why = f"joint {j + 1} ({NAMES[j]}) at the start, N m", f"{words}; {why}" if j == 0 else why
        yield _finding(quantity, mark, tau[j, 0], why, config, could_differ=j > len(SOLVED))
    yield from _end(t, tau, config)
    for j, mark in enumerate(thesis.FIGURE_7_5["maximum"]):
        why = f"off by {100 * abs(tau[j].max() / mark - 1):.2g} %; the script's erroneous velocity terms with the same "
        why += f"values give {erroneous[j].max():.5f}"
        quantity, at_start = f"joint {j + 1} ({NAMES[j]}), greatest, N m", bool(tau[j].argmax() == 0)
        why += "; it is the torque at the start" * at_start
        yield _finding(quantity, mark, tau[j].max(), why, config, could_differ=not at_start or j > len(SOLVED))


def _end(t: np.ndarray, tau: np.ndarray, config: Mapping[str, Any]) -> list[Finding]:
    """The printed end values against the motion's end, and against the time that fits joints 2 to 5 best."""
    marks = np.array(thesis.FIGURE_7_5["end"])
    off = np.abs(tau / marks[:, None] - 1)
    best = int(off[1:].max(axis=0).argmin())
    early = f"at {t[best]:.2f} s of {thesis.QUINTIC_S:g}, chosen because it fits joints 2 to 5 best: off by up to "
    early += f"{100 * off[1:, best].max():.2g} %"
    parts = [
        ("all joints at the end, N m", slice(0, 5), -1, "at rest joint 1 has no torque, whatever the masses"),
        ("joints 2 to 5 shortly before the end, N m", slice(1, 5), best, early),
        ("joint 1 shortly before the end, N m", slice(0, 1), best, f"{early}, and joint 1 by {off[0, best]:.0%}"),
    ]
    return [_finding(words, marks[joints], tau[joints, at], why, config) for words, joints, at, why in parts]


def _finding(quantity: str, mark: Any, value: Any, why: str, config: Mapping[str, Any], **judged: Any) -> Finding:
    values = _flat(config), _flat(AS_PLANNED)
    return compare(quantity, mark, value, FIGURE_TOLERANCE, why, 9, values=values, **judged)


def _draw(setting: Setting, t: np.ndarray, curves: Mapping[str, np.ndarray]) -> None:
    """Torques of the planned motion by model, (5, times) N m each, with what is printed of their start and end."""
    title = "Torques of the planned motion; as section 7 C prints them, dots: start and end, triangles: the greatest"
    printed_ends = {0.0: thesis.FIGURE_7_5["start"], thesis.QUINTIC_S: thesis.FIGURE_7_5["end"]}
    with setting.figure(1, len(curves), size=(4.3, 3.8), title=title, sharey=True) as (_, axes):
        for panel, (words, tau) in zip(axes[0], curves.items(), strict=True):
            plot_joints(panel, t, tau.T, printed_ends if panel is not axes[0, 2] else None)
            panel.set_title(words)
            for joint, mark in enumerate(thesis.FIGURE_7_5["maximum"] if panel is not axes[0, 2] else ()):
                look = {"color": COLORS[joint], "markersize": 6, "markeredgecolor": "white", "clip_on": False}
                panel.plot(t[tau[joint].argmax()], mark, "^", **look)
        axes[0, 0].set_ylabel("joint torque, N m")


@experiment("table-4.7", "The greatest joint torques")
def maxima(setting: Setting) -> Iterator[Finding]:
    """Table 4.7 against every combination of what is printed and what was recovered."""
    marks = np.array(thesis.MAX_TORQUES)
    trials = _trials()
    off = np.array([np.abs(trial.maxima / marks - 1) for trial in trials])
    near = off <= NEAR
    order = np.lexsort((off.max(axis=1), -near.sum(axis=1)))
    rows = []
    for i in order[:20]:
        torques, shares = (f"{x:.4f}" for x in trials[i].maxima), (f"{100 * x:.2g} %" for x in off[i])
        rows.append((trials[i].words, ", ".join(torques), ", ".join(shares)))
    setting.table(("model", "greatest torque of joints 1 to 5, N m", "off by"), rows)
    best, fitting = trials[order[0]], np.flatnonzero(near.sum(axis=1) >= 4)
    values = _flat(RECOVERED), _flat(AS_PLANNED)
    for joint, mark in enumerate(marks):
        possible = bool(near[fitting, joint].any())
        why = f"of {len(trials)} models {len(fitting)} are within {NEAR:.0%} in four joints; nearest: {best.words}, "
        why += f"off by {100 * off[order[0], joint]:.2g} %"
        if not possible and len(fitting):
            why += f"; none of the {len(fitting)} comes nearer than {100 * off[fitting, joint].min():.2g} %"
        if best.solved[joint]:
            why += "; it is the torque at the start, from which a mass was solved"
        quantity, judged = f"joint {joint + 1} ({NAMES[joint]}), N m", {"values": values, "possible": possible}
        judged["could_differ"] = not best.solved[joint]
        yield compare(quantity, mark, best.maxima[joint], TABLE_TOLERANCE, why, 5, **judged)
    # A signed maximum is not what a motor needs.
    joint = int((best.peaks / best.maxima).argmax())
    why = f"the table has the greatest values with their signs; joint {joint + 1} needs {best.peaks[joint]:.4f} N m "
    why += f"the other way: section 7 C's own start value is {thesis.FIGURE_7_5['start'][joint]:.4f}"
    quantity = "the largest torques of joints 2 to 5, which select the motors, N m"
    yield compare(quantity, marks[1:], best.peaks[1:], TABLE_TOLERANCE, why, 4, values=values)


def _trials() -> list[Trial]:
    """The greatest torques of all combinations of faults, parameters, centroids, gravity, knee and degree."""
    trials, t = [], np.linspace(0, thesis.QUINTIC_S, SAMPLES)
    for knee, (degree, size) in product((120.0, 45.0), DEGREES.items()):
        q, qd, qdd = _motion(t, knee, size)
        for (parameters, model), (faults, names) in product(_models().items(), FAULTS.items()):
            inertial = np.einsum("ijn,jn->in", printed.mass_matrix(model, q, names), qdd)
            inertial += printed.coriolis(model, q, qd, names)
            half = model._replace(centroids=printed.script_centroids(model.lengths))
            legs = {"r of appendix H": half, "its centroids": model}
            for (centroids, leg), (way, g) in product(legs.items(), GRAVITY.items()):
                tau = inertial + printed.gravity(leg._replace(gravity=g), q)
                words = f"{faults}, {parameters}, {centroids}, gravity {way}, knee to {knee:g}, {degree}"
                as_solved = way == "sideways" and "recovered" in parameters
                solved = (tau.argmax(axis=1) == 0) & (np.arange(5) <= len(SOLVED)) & as_solved
                trials.append(Trial(words, tau.max(axis=1), np.abs(tau).max(axis=1), solved))
    return trials


def _models() -> dict[str, printed.Model]:
    def model(lengths: tuple[float, ...], inertia: np.ndarray, centroids: Any = thesis.LINK_CENTROIDS) -> printed.Model:
        return printed.Model(lengths, inertia, np.array(centroids))

    recovered = np.array(thesis.FIGURE_7_5_MASSES) / np.array(thesis.LINK_MASSES)
    rods = script_inertias()
    return {
        "the script's links": model(thesis.SCRIPT_LENGTHS, rods, rods[:, :3, 3] / rods[:, 3, 3, None]),
        "section 4.6 as printed": model(thesis.LINK_LENGTHS, np.array(thesis.PSEUDO_INERTIAS)),
        "section 4.6 with the recovered masses": model(
            thesis.LINK_LENGTHS, corrected_inertias() * recovered[:, None, None]
        ),
    }


def _motion(t: np.ndarray, knee: float, degree: float) -> tuple[np.ndarray, ...]:
    """(5, n) each: the planned motion in double precision, with the knee's end in degrees and radians per degree."""
    ends = np.array(thesis.QUINTIC_RANGES)
    ends[3, 1] = knee
    with jax.enable_x64(True):
        motion = planned(t, rest_to_rest(ends[:, 0] * degree, ends[:, 1] * degree, thesis.QUINTIC_S))
    return tuple(x.T for x in motion)


def _torque(leg: Any, motion: tuple[np.ndarray, ...]) -> np.ndarray:
    """(5, n) The verified torques of a motion, N m."""
    return over(dynamics.inverse_dynamics, leg, *(x.T for x in motion)).T


def _flat(config: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """The values of a config by names to read."""
    return {
        **config["masses"],
        "radians per degree": config["units"]["degree"],
        "end of the knee in degrees": config["knee"]["end"],
    }
