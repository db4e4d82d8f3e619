"""Figures 7.6 to 7.10: how controllers follow the planned motion from q = 0.

Section 7 D prints an error for each joint, without its model of the leg. `VARIANTS` are what it may have meant.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx import compute, dynamics
from humanoid_mjx.control import Reference, implicit_euler, servo
from humanoid_mjx.mechanics.trajectories import rest_to_rest
from humanoid_mjx.report.style import COLORS, label_lines, log_axis
from humanoid_mjx.reproduction.findings import (
    Finding,
    Setting,
    check,
    compare,
    experiment,
    in_words,
    listed,
    three_digits,
    unprinted,
)
from humanoid_mjx.reproduction.leg_values import NAMES, errors_along, planned
from humanoid_mjx.reproduction.printed import dynamics as printed_dynamics
from humanoid_mjx.robot.leg import ALONG_THE_LEG, AS_PRINTED, Leg, corrected_inertias, script_inertias
from humanoid_mjx.spec import InputError
from humanoid_mjx.thesis import leg as thesis

JOINTS = range(5)
STEP_S, ANALOG_STEP_S = 2e-4, 2e-3
"""Steps of a controller whose torque is held over each, and of one whose torque is not, s: some of the laws as printed
are unstable if it is held."""

SHOWN_S = 0.01
"""Time from one point of a figure to the next, s."""

TOLERANCES = (5e-5, 0.005, 0.0005, 0.005, 0.0005)
"""Half of the last digit of section 7 D's errors, rad; joint 1's is that of its place."""

OVERSHOOT_RAD, LEAST_SHOWN = 1e-3, 1e-6
"""Smallest overshoot that counts, and the least error that the figures show, rad."""

FACTORS = tuple(2.0**power for power in range(-2, 8))
SHARES = (0.003, 0.01, 0.03, 0.1, 0.2, 0.3, 0.5)
"""Factors on the gains, and shares of Kp Kd, the largest Ki of a stable joint of unit inertia, that may cure errors."""

BEGIN = np.radians(thesis.QUINTIC_RANGES)[:, 0]
"""Start of the planned motion, rad."""

CONFIG = {
    name: {f"joint{i}": gain for i, gain in enumerate(gains, start=1)}
    for name, gains in (("kp", thesis.KP), ("kd", thesis.KD))
}
PRINTED = {f"{name} of {joint}": gain for name, gains in CONFIG.items() for joint, gain in gains.items()}


def _as_printed(faults: tuple[str, ...], model: Any, qpos: Any, qvel: Any, qacc: Any) -> Any:
    columns = qpos[:, None], qvel[:, None], qacc[:, None]
    return printed_dynamics.inverse_dynamics(model, *columns, faults)[:, 0]


LAWS: dict[str, Callable[..., Any]] = {
    "computed torque": dynamics.inverse_dynamics,
    "servo": lambda model, qpos, qvel, qacc: qacc,
    "partitioned PD": lambda model, qpos, qvel, qacc: dynamics.joint_inertias(model, qpos) * qacc,
    "partitioned PD holding the weight": lambda model, qpos, qvel, qacc: (
        dynamics.joint_inertias(model, qpos) * qacc + dynamics.gravity(model, qpos)
    ),
    "mass matrix": lambda model, qpos, qvel, qacc: dynamics.mass_matrix(model, qpos) @ qacc,
    "as printed": partial(_as_printed, printed_dynamics.ALL),
    "velocity terms as printed": partial(_as_printed, ("rule", "slips", "speeds")),
}
"""Torques from a model, the joints' state and the accelerations that the gains ask for."""


class Variant(NamedTuple):
    """A controller and the leg that it drives. By default the parameters are those of section 4.6, corrected."""

    words: str
    law: str
    rate: float = 1.0
    """0 where the rate itself is fed back, in place of its error."""
    acceleration: float = 1.0
    """0 where the planned acceleration is not fed forward."""
    leg: str = "thesis"
    model: str = "thesis"


EXACT = Variant("computed torque", "computed torque")
PARTITIONED = Variant("partitioned PD, inertias of the posture", "partitioned PD")
LAGGING = Variant("computed torque with the rate fed back, not its error", "computed torque", 0.0, 0.0)
UNIT = Variant("partitioned PD, unit inertias", "servo")
VARIANTS = (
    EXACT,
    Variant("computed torque without the planned acceleration", "computed torque", acceleration=0.0),
    LAGGING,
    Variant("computed torque, gravity sideways in the model, along the leg in truth", "computed torque", leg="along"),
    UNIT,
    Variant("PD", "servo", acceleration=0.0),
    Variant("PD with the rate fed back, not its error", "servo", 0.0, 0.0),
    PARTITIONED,
    Variant("partitioned PD on the script's leg", "partitioned PD", leg="script", model="script"),
    Variant("partitioned PD holding the weight", "partitioned PD holding the weight"),
    Variant("the mass matrix without velocity terms and weight", "mass matrix"),
    Variant("the script as printed, on its leg", "as printed", leg="script", model="the script"),
    Variant("the script as printed, with the inertias of section 4.6", "as printed", model="half lengths"),
    Variant("the same with its velocity terms alone as printed", "velocity terms as printed", model="centroids"),
)

DRAWN = {
    EXACT: "computed torque, exact model",
    PARTITIONED: "partitioned PD: inertias of the posture, nothing else of the model",
    LAGGING: "computed torque that feeds back the rate, not the rate's error",
    UNIT: "partitioned PD with every inertia 1 kg m²",
}


def tracking(joint: int, setting: Setting) -> list[Finding]:
    """Figures 7.6 to 7.10, by joint: the error left after 5 s, the overshoot, and the printed place."""
    used, kp, kd = _gains(setting)
    setting.tell(f"the motion under {len(VARIANTS)} controllers")
    motions = _motions(kp, kd)
    _draw(setting, joint, {words: motions[variant][:, joint] for variant, words in DRAWN.items()})
    printed, tolerance = thesis.TRACKING["error"][joint], TOLERANCES[joint]
    left = {v: abs(float(e[-1, joint])) for v, e in motions.items()}
    nearest = min(left, key=lambda v: abs(left[v] - printed))
    own = in_words(used, PRINTED)
    errors, ratio = motions[EXACT][:, joint], float(kd[joint] / (2 * np.sqrt(kp[joint])))
    overshoot = float(np.max(-np.sign(errors[0]) * errors)) if errors[0] else float(np.abs(errors).max())
    values = used, PRINTED
    end = f"joint {joint + 1}: error left after {thesis.QUINTIC_S:g} s, rad"
    exact = f"{own}: exact computed torque, whatever the leg; partitioned PD leaves {three_digits(left[PARTITIONED])}; "
    exact += f"of {len(VARIANTS)} controllers the nearest ({nearest.words}) leaves {three_digits(left[nearest])}"
    possible = abs(left[nearest] - printed) < tolerance
    beyond = f"joint {joint + 1}: overshoot of the actual position, rad (the text sees one)"
    damped = f"{own}, damping ratio {ratio:.2f}: over 1, an error that starts at rest never changes its sign; what is "
    damped += f"left here is the step of {1e3 * STEP_S:g} ms. What the text sees is the way from q = 0 to the start of "
    damped += "the plan"
    found, agrees = three_digits(max(overshoot, 0.0)), overshoot > OVERSHOOT_RAD
    return [
        compare(end, printed, left[EXACT], tolerance, exact, values=values, possible=possible),
        check(beyond, "> 0", found, agrees, damped, OVERSHOOT_RAD, values),
    ]


@experiment("control-7d", "The five errors of section 7 D under one controller", CONFIG)
def together(setting: Setting) -> list[Finding]:
    """Section 7 D: whether any one controller leaves all five errors; the table of those tried."""
    used, kp, kd = _gains(setting)
    setting.tell(f"the motion under {len(VARIANTS)} controllers")
    printed, motions = np.array(thesis.TRACKING["error"]), _motions(kp, kd)
    left = {variant: np.abs(errors[-1]) for variant, errors in motions.items()}
    rows = {"printed": printed} | {variant.words: errors for variant, errors in left.items()}
    setting.table(
        ("error after 5 s, rad", *(f"joint {joint + 1}" for joint in JOINTS)),
        ((words, *(f"{x:.5f}" if np.isfinite(x) else "diverges" for x in row)) for words, row in rows.items()),
    )
    nearest = min(left, key=lambda v: float(np.abs(left[v] - printed).max()))
    possible = bool((np.abs(left[nearest] - printed) < TOLERANCES).all())
    why = f"{in_words(used, PRINTED)}: of {len(VARIANTS)} controllers the nearest ({nearest.words}) is off by up to "
    why += f"{np.abs(left[nearest] - printed).max():.2g}; control-7d.md has them all"
    quantity, judged = "errors of the five joints after 5 s under one controller, rad", {"possible": possible}
    places = f"places after {thesis.QUINTIC_S:g} s, rad: the targets less the printed errors"
    own, at = np.array(thesis.FIGURE_7_1)[:, 1] - printed, np.array(thesis.TRACKING["end"])
    within = np.array(TOLERANCES) + 5e-4
    differ = listed(np.flatnonzero(np.abs(own - at) > within) + 1)
    numbers = "the text's own numbers, nothing is simulated"
    numbers += f"; they contradict each other in joint {differ}" * bool(differ)
    return [
        compare(quantity, printed, left[nearest], TOLERANCES, why, values=(used, PRINTED), **judged),
        compare(places, at, own, within, numbers, 4, could_differ=False),
    ]


def _draw(setting: Setting, joint: int, errors: Mapping[str, np.ndarray]) -> None:
    """Angle of a joint under each controller and its distance from the plan, beside the printed values. `errors`: by
    what a controller is called, the plan less the joint's angle at even times, rad."""
    times = np.linspace(0, thesis.QUINTIC_S, len(next(iter(errors.values()))))
    plan = planned(times).position[:, joint]
    last = (thesis.QUINTIC_S - 0.3, thesis.QUINTIC_S)
    place, distance = thesis.TRACKING["end"][joint], thesis.TRACKING["error"][joint]
    bar = {"color": COLORS[6], "linewidth": 4, "solid_capstyle": "butt", "clip_on": False}
    title = f"Joint {joint + 1} ({NAMES[joint]}) from q = 0"
    with setting.figure(1, 2, size=(5.2, 4.2), title=title, legend=2) as (_, axes):
        places, distances = axes[0]
        places.plot(times, plan, color=COLORS[6], linestyle="--", linewidth=1, label="planned", zorder=3)
        widths = (5, 1.4, 1.4, 1.4)  # the thesis's own law stays visible below the others
        for color, width, (words, error) in zip(COLORS, widths, errors.items(), strict=False):
            look = {"color": color, "linewidth": width, "alpha": 0.5 if width > 2 else 1.0}
            places.plot(times, plan - error, label=words, **look)
            distances.plot(times, np.abs(error), **look)
        log_axis(distances, upright=True)
        distances.set_ylim(LEAST_SHOWN, 3)
        places.plot(last, [place] * 2, **bar, label="as printed, at 5 s")
        distances.plot(last, [max(distance, LEAST_SHOWN)] * 2, **bar)
        if distance < LEAST_SHOWN:
            distances.annotate("0 as printed", (last[0], LEAST_SHOWN), (-4, 3), textcoords="offset points", ha="right")
        places.set(title="Angle of the joint", ylabel="angle, rad")
        distances.set(title="Distance from the planned motion", ylabel="distance, rad (logarithmic)")
        for panel in axes[0]:
            panel.set(xlabel="time, s", xlim=(0, thesis.QUINTIC_S))


def _gains(setting: Setting) -> tuple[dict[str, float], tuple[float, ...], tuple[float, ...]]:
    """Return the gains in use by name, and kp and kd by joint.

    Raises:
      InputError: a gain that is no number, negative or not finite.
    """
    used = {f"{name} of {joint}": gain for name in CONFIG for joint, gain in setting.config[name].items()}
    for name, gain in used.items():
        if not (isinstance(gain, (int, float)) and 0 <= gain < np.inf):
            raise InputError(f"{name} must be finite and at least 0, got {gain!r}.")
    kp, kd = (tuple(map(float, setting.config[name].values())) for name in CONFIG)
    return used, kp, kd


def _models() -> dict[str, Any]:
    """Legs, of one structure, so that one program serves them all; and models of the equations as printed."""
    legs = {
        "thesis": Leg.thesis(AS_PRINTED),
        "script": Leg.matlab_script(AS_PRINTED),
        "along": Leg.thesis(ALONG_THE_LEG),
    }
    structure = jax.tree.structure(Leg.thesis((0.0, -1.0, -1.0)))

    def printed(lengths: tuple[float, ...], inertia: np.ndarray) -> printed_dynamics.Model:
        return printed_dynamics.Model(lengths, inertia, printed_dynamics.script_centroids(lengths))

    corrected = printed(thesis.LINK_LENGTHS, corrected_inertias())
    return {name: structure.unflatten(jax.tree.leaves(leg)) for name, leg in legs.items()} | {
        "the script": printed(thesis.SCRIPT_LENGTHS, script_inertias()),
        "half lengths": corrected,
        "centroids": corrected._replace(centroids=np.array(thesis.LINK_CENTROIDS)),
    }


@cache
def _motions(kp: tuple[float, ...], kd: tuple[float, ...]) -> dict[Variant, np.ndarray]:
    """(points, 5) Errors of every variant, rad, from time 0 on; infinite where it diverges."""
    gains, found = (np.array(kp), np.array(kd), np.zeros(5), BEGIN), {}
    for law in dict.fromkeys(variant.law for variant in VARIANTS):
        variants = [variant for variant in VARIANTS if variant.law == law]
        found |= zip(variants, _errors(variants, [gains] * len(variants)), strict=True)
    return {variant: found[variant] for variant in VARIANTS}


def _errors(variants: Sequence[Variant], gains: Sequence[tuple[np.ndarray, ...]]) -> np.ndarray:
    """(variants, points, 5) Errors of variants of one law, rad, from time 0 on; infinite where one diverges. `gains`:
    of each kp, kd and that of the integral, 1/s^3, and where its plan begins, rad, (5,) each; the leg begins at 0."""
    models = _models()
    cases = [
        (v.rate, v.acceleration, models[v.leg], models[v.model], *own) for v, own in zip(variants, gains, strict=True)
    ]
    together = jax.tree.map(lambda *x: jnp.stack([jnp.asarray(y, float) for y in x]), *cases)
    return np.nan_to_num(np.asarray(_program(variants[0].law)(*together), np.float64), nan=np.inf)


@cache
def _program(law: str) -> Callable[..., Any]:
    """From the shares of planned rate and acceleration that the law sees, leg, model and gains, with a leading axis, to
    the errors, (cases, points, 5), rad."""

    def simulate(rate: Any, acceleration: Any, leg: Any, model: Any, kp: Any, kd: Any, ki: Any, begin: Any) -> Any:
        path = rest_to_rest(begin, np.radians(thesis.QUINTIC_RANGES)[:, 1], thesis.QUINTIC_S)

        def act(plan: Reference, qpos: Any, qvel: Any, integral: Any = 0.0) -> Any:
            seen = Reference(plan.qpos, rate * plan.qvel, acceleration * plan.qacc)
            return LAWS[law](model, qpos, qvel, servo(kp, kd, seen, qpos, qvel) + ki * integral)

        step_s, how = STEP_S, dict[str, Any](integral=True)
        if "as printed" in law:
            step_s, how = ANALOG_STEP_S, {"integrator": dynamics.runge_kutta, "cycle": None}
        elif law == "servo":
            how |= {"integrator": implicit_euler(kp, kd)}
        errors, shown = errors_along(leg, act, 0.0 * begin, step_s, path=path, **how), round(SHOWN_S / step_s)
        return jnp.concatenate([begin[None], errors[shown - 1 :: shown]])

    return jax.jit(jax.vmap(simulate), compiler_options=compute.compiler_options("scalars"))


TUNINGS = {
    "Kd as a multiple of Table 5.1's": (1, [(1.0, factor, 0.0) for factor in FACTORS]),
    "Kp as a multiple of Table 5.1's, same damping": (0, [(factor, factor**0.5, 0.0) for factor in FACTORS]),
    "Ki of an integral term (PID) as a share of Kp Kd": (2, [(1.0, 1.0, share) for share in SHARES]),
}
"""Ways of tuning: which of the factors on Kp and Kd and of the share of Ki changes, and all three of each trial."""


@experiment("remedies-7d", "What would cure the errors of section 7 D", CONFIG)
def remedies(setting: Setting) -> list[Finding]:
    """The remedies that section 7 D names, and an integral term (5.7), under its own law, partitioned PD."""
    _, kp, kd = _gains(setting)
    kp, kd, none = np.array(kp), np.array(kd), np.zeros(5)
    scales = [scale for _, tried in TUNINGS.values() for scale in tried]
    gains = [*((p * kp, d * kd, share * kp * kd, BEGIN) for p, d, share in scales), (kp, kd, none, none)]
    setting.tell(f"the motion under {len(gains)} tunings of partitioned PD")
    *errors, from_zero = np.abs(_errors([PARTITIONED] * len(gains), gains))
    ends = np.split(np.array(errors)[:, -1], np.cumsum([len(tried) for _, tried in TUNINGS.values()])[:-1])
    title = f"Partitioned PD, {thesis.QUINTIC_S:g} s after the start: error that each joint has left (no dot: unstable)"
    with setting.figure(1, 3, size=(4.0, 3.4), title=title, sharey=True) as (_, axes):
        for panel, (words, (which, tried)), left in zip(axes[0], TUNINGS.items(), ends, strict=True):
            across = np.array(tried)[:, which]
            for joint in JOINTS:
                panel.plot(across, left[:, joint], "o-", color=COLORS[joint], markersize=3, label=NAMES[joint])
            log_axis(panel)
            log_axis(panel, upright=True)
            panel.set_xticks(across[::2])
            panel.set(xlabel=words, ylim=(1e-4, 2))
        axes[0, 0].set_ylabel("error left, rad")
        label_lines(axes[0, -1])
    return judge_remedies(from_zero.max(axis=0), *(left.min(axis=0) for left in ends))


def judge_remedies(from_zero: np.ndarray, rates: np.ndarray, gains: np.ndarray, integrals: np.ndarray) -> list[Finding]:
    """Findings on section 7 D's remedies from errors by joint, (5,) rad: the largest on a plan that begins at 0, and
    the least left at the end by any Kd, any Kp, and any Ki that was tried."""
    span, ki = f"of {FACTORS[0]:g} to {FACTORS[-1]:g} times Table 5.1's", f"of {SHARES[0]:g} to {SHARES[-1]:g} of Kp Kd"
    start = "with the exact model nothing is left (control-7d); partitioned PD ignores the weight on any plan"
    both = f"the least over Kp {span}, Kd with its root: the error falls as 1 / Kp, and the largest gains are unstable "
    both += f"where the torque is held for {1e3 * STEP_S:g} ms"
    rate = f"the least over Kd {span}: what is left is the weight over Kp, which no rate changes; more damping lags"
    term = f"the least over Ki {ki}; nothing is printed of the PID that section 5.7 names"
    zero = "joints 1 and 2: largest error on a plan that begins at the zero position, rad"
    adjusted, none = "joints 3 to 5: error left by tuning the rate's gain, rad", np.zeros(5)
    return [
        compare(zero, none[:2], from_zero[:2], OVERSHOOT_RAD, start),
        compare("joint 2: error left by tuning the PD, rad", 0.0, gains[1], TOLERANCES[1], both),
        compare(adjusted, none[2:], rates[2:], TOLERANCES[2:], rate),
        unprinted("error left by an integral term, rad, by joint", three_digits(integrals), term),
    ]


for _joint in JOINTS:
    experiment(f"figure-7.{_joint + 6}", f"Planned and actual position of joint {_joint + 1}", CONFIG)(
        partial(tracking, _joint)
    )
