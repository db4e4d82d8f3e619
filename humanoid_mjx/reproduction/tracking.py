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
"""What counts as an overshoot, and the least error that the figures show, rad."""

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
    used, kp, kd, motions = _simulated(setting)
    _draw(setting, joint, {words: motions[variant][:, joint] for variant, words in DRAWN.items()})
    printed, tolerance = thesis.TRACKING["error"][joint], TOLERANCES[joint]
    left = {v: abs(float(e[-1, joint])) for v, e in motions.items()}
    nearest = min(left, key=lambda v: abs(left[v] - printed))
    own = in_words(used, PRINTED)
    errors, ratio = motions[EXACT][:, joint], float(kd[joint] / (2 * np.sqrt(kp[joint])))
    overshoot = float(np.max(-np.sign(errors[0]) * errors)) if errors[0] else float(np.abs(errors).max())
    target, values = thesis.FIGURE_7_1[joint][1], (used, PRINTED)
    end = f"joint {joint + 1}: error left after {thesis.QUINTIC_S:g} s, rad"
    exact = f"{own}: exact computed torque, whatever the leg; partitioned PD leaves {three_digits(left[PARTITIONED])}; "
    exact += f"of {len(VARIANTS)} controllers the nearest ({nearest.words}) leaves {three_digits(left[nearest])}"
    possible = abs(left[nearest] - printed) < tolerance
    beyond = f"joint {joint + 1}: overshoot of the actual position, rad (the text sees one)"
    damped = f"{own}, damping ratio {ratio:.2f}: over 1, an error that starts at rest never changes its sign; what is "
    damped += f"left here is the step of {1e3 * STEP_S:g} ms. What the text sees is the way from q = 0 to the start of "
    damped += "the plan"
    found, agrees = three_digits(max(overshoot, 0.0)), overshoot > OVERSHOOT_RAD
    place = f"joint {joint + 1}: place after {thesis.QUINTIC_S:g} s, rad: the target less the printed error"
    mark = thesis.TRACKING["end"][joint]
    own_numbers = f"the text's own numbers, nothing is simulated: target {target:g}, error {printed:g}"
    return [
        compare(end, printed, left[EXACT], tolerance, exact, values=values, possible=possible),
        check(beyond, "> 0", found, agrees, damped, OVERSHOOT_RAD, values),
        compare(place, mark, target - printed, tolerance + 5e-4, own_numbers, 4, could_differ=False),
    ]


@experiment("control-7d", "The five errors of section 7 D under one controller", CONFIG)
def together(setting: Setting) -> list[Finding]:
    """Section 7 D: whether any one controller leaves all five errors; the table of those tried."""
    used, _, _, motions = _simulated(setting)
    printed = np.array(thesis.TRACKING["error"])
    left = {variant: np.abs(errors[-1]) for variant, errors in motions.items()}
    rows = {"printed": printed} | {variant.words: errors for variant, errors in left.items()}
    setting.table(
        ("error after 5 s, rad", *(f"joint {joint + 1}" for joint in JOINTS)),
        ((words, *(f"{x:.5f}" if np.isfinite(x) else "diverges" for x in row)) for words, row in rows.items()),
    )
    nearest = min(left, key=lambda v: float(np.abs(left[v] - printed).max()))
    agrees = bool((np.abs(left[nearest] - printed) < TOLERANCES).all())
    why = f"{in_words(used, PRINTED)}: of {len(VARIANTS)} controllers the nearest ({nearest.words}) is off by up to "
    why += f"{np.abs(left[nearest] - printed).max():.2g}; control-7d.md has them all"
    quantity, values = "errors of the five joints after 5 s under one controller, rad", (used, PRINTED)
    found = [three_digits(x) for x in left[nearest]]
    return [check(quantity, printed.tolist(), found, agrees, why, values=values, possible=agrees)]


def _draw(setting: Setting, joint: int, errors: Mapping[str, np.ndarray]) -> None:
    """Angle of a joint under each controller and its distance from the plan, beside the printed values.

    Args:
      errors: by what a controller is called, the plan less the joint's angle at even times, rad.
    """
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


def _simulated(setting: Setting) -> tuple[dict[str, float], tuple[float, ...], tuple[float, ...], Any]:
    """Return the gains in use by name, kp and kd by joint, and the errors of every variant (`_motions`).

    Raises:
      InputError: a gain that is no number, negative or not finite.
    """
    used = {f"{name} of {joint}": gain for name in CONFIG for joint, gain in setting.config[name].items()}
    for name, gain in used.items():
        if not (isinstance(gain, (int, float)) and 0 <= gain < np.inf):
            raise InputError(f"{name} must be finite and at least 0, got {gain!r}.")
    kp, kd = (tuple(map(float, setting.config[name].values())) for name in CONFIG)
    setting.tell(f"the motion under {len(VARIANTS)} controllers")
    return used, kp, kd, _motions(kp, kd)


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
    models, found = _models(), {}
    for law in dict.fromkeys(variant.law for variant in VARIANTS):
        variants = [variant for variant in VARIANTS if variant.law == law]
        cases = [(v.rate, v.acceleration, models[v.leg], models[v.model], np.zeros(5)) for v in variants]
        together = jax.tree.map(lambda *x: jnp.stack([jnp.asarray(y, float) for y in x]), *cases)
        errors = np.asarray(_program(law)(together, np.array(kp), np.array(kd)), np.float64)
        found |= zip(variants, np.nan_to_num(errors, nan=np.inf), strict=True)
    return {variant: found[variant] for variant in VARIANTS}


@cache
def _program(law: str) -> Callable[..., Any]:
    """From cases of a law, with a leading axis, kp and kd to the errors, (cases, points, 5), rad. A case: the shares of
    the planned rate and acceleration that the law sees, its leg, its model, the start."""

    def simulate(case: Any, kp: Any, kd: Any) -> Any:
        rate, acceleration, leg, model, start = case

        def act(plan: Reference, qpos: Any, qvel: Any) -> Any:
            seen = Reference(plan.qpos, rate * plan.qvel, acceleration * plan.qacc)
            return LAWS[law](model, qpos, qvel, servo(kp, kd, seen, qpos, qvel))

        if "as printed" in law:
            step_s, how = ANALOG_STEP_S, {"integrator": dynamics.runge_kutta, "cycle": None}
        else:
            step_s, how = STEP_S, {"integrator": implicit_euler(kp, kd)} if law == "servo" else {}
        errors, shown = errors_along(leg, act, start, step_s, **how), round(SHOWN_S / step_s)
        return jnp.concatenate([thesis_quintics().at(0.0).position[None] - start, errors[shown - 1 :: shown]])

    program = jax.vmap(simulate, in_axes=(0, None, None))
    return jax.jit(program, compiler_options=compute.compiler_options("scalars"))


for _joint in JOINTS:
    experiment(f"figure-7.{_joint + 6}", f"Planned and actual position of joint {_joint + 1}", CONFIG)(
        partial(tracking, _joint)
    )
