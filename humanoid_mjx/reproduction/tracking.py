"""Figures 7.6 to 7.10: how controllers follow the planned motion from q = 0.

Section 7 D prints an error for each joint, without its model of the leg. `VARIANTS` are what it may have meant.
"""

from collections.abc import Callable, Mapping
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx import compute, dynamics
from humanoid_mjx.control import Reference, implicit_euler, servo
from humanoid_mjx.mechanics.trajectories import thesis_quintics
from humanoid_mjx.report.style import COLORS, log_axis
from humanoid_mjx.reproduction.findings import Finding, Setting, check, compare, experiment, in_words, three_digits
from humanoid_mjx.reproduction.printed import dynamics as printed_dynamics
from humanoid_mjx.robot.leg import ALONG_THE_LEG, AS_PRINTED, Leg, corrected_inertias, script_inertias
from humanoid_mjx.spec import InputError
from humanoid_mjx.thesis import leg as thesis

JOINTS = range(5)
STEP_S = 2e-4
SHOWN_S = 0.01
"""Time from one point of a figure to the next, s."""

ANALOG_STEP_S = 2e-3
"""Step for a controller whose torque is not held, s. Some of the laws as printed are unstable if it is."""

TOLERANCES = (5e-5, 0.005, 0.0005, 0.005, 0.0005)
"""Half of the last digit of section 7 D's errors, rad; joint 1's is that of its place."""

OVERSHOOT_RAD = 1e-3

LEAST_SHOWN = 1e-6
"""The least error that the figures show, rad."""

CONFIG = {
    name: {f"joint{i}": gain for i, gain in enumerate(gains, start=1)}
    for name, gains in (("kp", thesis.KP), ("kd", thesis.KD))
}
PRINTED = {f"{name} of {joint}": gain for name, gains in CONFIG.items() for joint, gain in gains.items()}


def _partitioned(model: Any, qpos: Any, qvel: Any, qacc: Any) -> Any:
    return dynamics.joint_inertias(model, qpos) * qacc


def _as_printed(model: Any, qpos: Any, qvel: Any, qacc: Any) -> Any:
    columns = qpos[:, None], qvel[:, None], qacc[:, None]
    return printed_dynamics.inverse_dynamics(model[0], *columns, model[1])[:, 0]


LAWS: dict[str, Callable[..., Any]] = {
    "computed torque": dynamics.inverse_dynamics,
    "servo": lambda model, qpos, qvel, qacc: qacc,
    "partitioned PD": _partitioned,
    "partitioned PD and weight": lambda model, qpos, qvel, qacc: (
        _partitioned(model, qpos, qvel, qacc) + dynamics.gravity(model, qpos)
    ),
    "mass matrix": lambda model, qpos, qvel, qacc: dynamics.mass_matrix(model, qpos) @ qacc,
    "as printed": _as_printed,
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
    Variant("partitioned PD holding the weight", "partitioned PD and weight"),
    Variant("the mass matrix without velocity terms and weight", "mass matrix"),
    Variant("the script as printed, on its leg", "as printed", leg="script", model="script as printed"),
    Variant("the script as printed, with the inertias of section 4.6", "as printed", model="its equations"),
    Variant("the same with its velocity terms alone as printed", "as printed", model="its velocity terms"),
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
    curves = {words: motions[variant][:, joint] for variant, words in DRAWN.items()}
    _draw(setting, joint, curves)
    printed, tolerance = thesis.TRACKING["error"][joint], TOLERANCES[joint]
    left = {v: abs(float(e[-1, joint])) for v, e in motions.items()}
    nearest = min(left, key=lambda v: abs(left[v] - printed))
    own = partial(in_words, used, PRINTED)
    errors, ratio = motions[EXACT][:, joint], float(kd[joint] / (2 * np.sqrt(kp[joint])))
    overshoot = float(np.max(-np.sign(errors[0]) * errors)) if errors[0] else float(np.abs(errors).max())
    target, values = thesis.FIGURE_7_1[joint][1], (used, PRINTED)
    return [
        compare(
            f"joint {joint + 1}: error left after {thesis.QUINTIC_S:g} s, rad",
            printed,
            left[EXACT],
            tolerance,
            f"{own()}: exact computed torque, whatever the leg; partitioned PD leaves "
            f"{three_digits(left[PARTITIONED])}; of {len(VARIANTS)} controllers the nearest ({nearest.words}) leaves "
            f"{three_digits(left[nearest])}",
            values=values,
            possible=abs(left[nearest] - printed) < tolerance,
        ),
        check(
            f"joint {joint + 1}: overshoot of the actual position, rad (the text sees one)",
            "> 0",
            three_digits(max(overshoot, 0.0)),
            overshoot > OVERSHOOT_RAD,
            f"{own()}, damping ratio {ratio:.2f}: over 1, an error that starts at rest never changes its sign; what is "
            f"left here is the step of {1e3 * STEP_S:g} ms. What the text sees is the way from q = 0 to the start of "
            "the plan",
            OVERSHOOT_RAD,
            values,
        ),
        compare(
            f"joint {joint + 1}: place after {thesis.QUINTIC_S:g} s, rad: the target less the printed error",
            thesis.TRACKING["end"][joint],
            target - printed,
            tolerance + 5e-4,
            f"the text's own numbers, nothing is simulated: target {target:g}, error {printed:g}",
            4,
            could_differ=False,
        ),
    ]


@experiment("control-7d", "The five errors of section 7 D under one controller", CONFIG)
def together(setting: Setting) -> list[Finding]:
    """Section 7 D: whether any one controller leaves all five errors; the table of those tried."""
    used, kp, kd = _gains(setting)
    setting.tell(f"the motion under {len(VARIANTS)} controllers")
    printed = np.array(thesis.TRACKING["error"])
    left = {variant: np.abs(errors[-1]) for variant, errors in _motions(kp, kd).items()}
    rows = {"printed": printed} | {variant.words: errors for variant, errors in left.items()}
    setting.table(
        ("error after 5 s, rad", *(f"joint {joint + 1}" for joint in JOINTS)),
        ((words, *(f"{x:.5f}" if np.isfinite(x) else "diverges" for x in row)) for words, row in rows.items()),
    )
    nearest = min(left, key=lambda v: float(np.abs(left[v] - printed).max()))
    agrees = bool((np.abs(left[nearest] - printed) < TOLERANCES).all())
    return [
        check(
            "errors of the five joints after 5 s under one controller, rad",
            printed.tolist(),
            [three_digits(x) for x in left[nearest]],
            agrees,
            f"{in_words(used, PRINTED)}: of {len(VARIANTS)} controllers the nearest ({nearest.words}) is off by up "
            f"to {np.abs(left[nearest] - printed).max():.2g}; control-7d.md has them all",
            values=(used, PRINTED),
            possible=agrees,
        )
    ]


def _draw(setting: Setting, joint: int, errors: Mapping[str, np.ndarray]) -> None:
    """Angle of a joint under each controller and its distance from the plan, beside the printed values.

    Args:
      errors: by what a controller is called, the plan less the joint's angle at even times, rad.
    """
    times = np.linspace(0, thesis.QUINTIC_S, len(next(iter(errors.values()))))
    planned = np.radians(thesis.QUINTIC_COEFFICIENTS[joint]) @ [times**0, times**3, times**4, times**5]
    last = (thesis.QUINTIC_S - 0.3, thesis.QUINTIC_S)
    printed = thesis.TRACKING["end"][joint], thesis.TRACKING["error"][joint]
    bar = {"color": COLORS[6], "linewidth": 4, "solid_capstyle": "butt", "clip_on": False}
    with setting.figure(1, 2, size=(5.2, 4.2)) as (fig, axes):
        places, distances = axes[0]
        places.plot(times, planned, color=COLORS[6], linestyle="--", linewidth=1, label="planned")
        for color, (words, error) in zip(COLORS, errors.items(), strict=False):
            places.plot(times, planned - error, color=color, label=words)
            distances.plot(times, np.abs(error), color=color)
        log_axis(distances, upright=True)
        distances.set_ylim(LEAST_SHOWN, 3)
        places.plot(last, [printed[0]] * 2, **bar, label="as printed, at 5 s")
        distances.plot(last, [max(printed[1], LEAST_SHOWN)] * 2, **bar)
        if printed[1] < LEAST_SHOWN:
            distances.annotate("0 as printed", (last[0], LEAST_SHOWN), (-4, 3), textcoords="offset points", ha="right")
        places.set(title="Angle of the joint", ylabel="angle, rad")
        distances.set(title="Distance from the planned motion", ylabel="distance, rad (logarithmic)")
        for panel in axes[0]:
            panel.set(xlabel="time, s", xlim=(0, thesis.QUINTIC_S))
        handles, words = places.get_legend_handles_labels()
        fig.legend(handles, words, loc="outside lower center", ncols=2, frameon=False)
        name = thesis.JOINT_NAMES[joint].replace("_", " ")
        fig.suptitle(f"Joint {joint + 1} ({name}) from q = 0", x=0.02, ha="left", fontsize="medium")


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


def _printed_models() -> dict[str, tuple[printed_dynamics.Model, tuple[str, ...]]]:
    """Models of the thesis's equations with their faults, by name."""

    def model(lengths: tuple[float, ...], inertia: Any) -> printed_dynamics.Model:
        return printed_dynamics.Model(lengths, inertia, printed_dynamics.script_centroids(lengths))

    corrected, velocity = model(thesis.LINK_LENGTHS, corrected_inertias()), ("rule", "slips", "speeds")
    return {
        "script as printed": (model(thesis.SCRIPT_LENGTHS, script_inertias()), printed_dynamics.ALL),
        "its equations": (corrected, printed_dynamics.ALL),
        "its velocity terms": (corrected._replace(centroids=np.array(thesis.LINK_CENTROIDS)), velocity),
    }


@cache
def _motions(kp: tuple[float, ...], kd: tuple[float, ...]) -> dict[Variant, np.ndarray]:
    """(points, 5) Errors of every variant, rad, from time 0 on; infinite where it diverges."""
    groups: dict[tuple[str, str, str], list[Variant]] = {}
    for variant in VARIANTS:
        groups.setdefault((variant.law, variant.leg, variant.model), []).append(variant)
    found: dict[Variant, np.ndarray] = {}
    for key, variants in groups.items():
        keeps = np.array([(v.rate, v.acceleration) for v in variants])
        # A start of its own for each variant, although all are alike: then jax traces the motion once, not twice.
        starts = np.zeros((len(variants), 5))
        errors = _program(*key)(keeps, starts, np.array(kp), np.array(kd))
        found |= zip(variants, np.asarray(errors, np.float64), strict=True)
    return {variant: np.nan_to_num(found[variant], nan=np.inf) for variant in VARIANTS}


@cache
def _program(law: str, leg: str, model: str) -> Callable[..., Any]:
    """From the shares of the planned rate and acceleration that the law sees, (variants, 2), the start, (variants, 5),
    kp and kd to the errors, (variants, points, 5), rad."""
    legs = {
        "thesis": Leg.thesis(AS_PRINTED),
        "script": Leg.matlab_script(AS_PRINTED),
        "along": Leg.thesis(ALONG_THE_LEG),
    }
    models = legs | _printed_models()
    planned, act = thesis_quintics(), LAWS[law]
    times = jnp.linspace(0.0, thesis.QUINTIC_S, round(thesis.QUINTIC_S / SHOWN_S) + 1)
    wanted = jax.vmap(planned.at)(times).position

    def simulate(keep: Any, start: Any, kp: Any, kd: Any) -> Any:
        def controller(time: Any, qpos: Any, qvel: Any) -> Any:
            plan = planned.at(time)
            seen = Reference(plan.position, keep[0] * plan.velocity, keep[1] * plan.acceleration)
            return act(models[model], qpos, qvel, servo(kp, kd, seen, qpos, qvel))

        if law == "as printed":
            integrator, step_s, cycle = dynamics.runge_kutta, ANALOG_STEP_S, None
        else:
            integrator = implicit_euler(kp, kd) if law == "servo" else dynamics.semi_implicit_euler
            step_s, cycle = STEP_S, 1
        steps, shown = round(thesis.QUINTIC_S / step_s), round(SHOWN_S / step_s)
        states = dynamics.rollout(legs[leg], start, start, controller, step_s, steps, integrator, cycle=cycle)[1]
        return wanted - jnp.concatenate([jnp.zeros((1, 5)), states.qpos[shown - 1 :: shown]])

    program = jax.vmap(simulate, in_axes=(0, 0, None, None))
    return jax.jit(program, compiler_options=compute.compiler_options("scalars"))


for _joint in JOINTS:
    experiment(f"figure-7.{_joint + 6}", f"Planned and actual position of joint {_joint + 1}", CONFIG)(
        partial(tracking, _joint)
    )
