"""Sections 5.3 to 5.7, which show nothing: computed torque, its errors, what limits them and its cost; gears."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx import compute, dynamics
from humanoid_mjx.control import Reference, implicit_euler, servo
from humanoid_mjx.mechanics.trajectories import thesis_quintics
from humanoid_mjx.report.style import COLORS, log_axis
from humanoid_mjx.reproduction import tracking
from humanoid_mjx.reproduction.findings import Finding, Setting, check, experiment, listed, three_digits, unprinted
from humanoid_mjx.reproduction.leg_values import errors_along, over, planned
from humanoid_mjx.robot.leg import Leg
from humanoid_mjx.thesis import leg as thesis

STEP_S = 5e-4
CYCLES = (1, 2, 5, 10, 20, 50, 100)
"""Steps in a control cycle."""

MODELS = {
    "the right model": (0.0, 0.0),
    "a model 30 % too light": (-0.3, 0.0),
    "a model 30 % too heavy": (0.3, 0.0),
    "30 g at the toe": (0.0, 0.03),
}
"""Error of the inertias in the controller's model as a share, and a payload that the model does not have, kg."""

LAWS = ("partitioned PD", "partitioned PD holding the weight", "computed torque")

LOST = 10.0
"""Error from which a controller has lost the plan, rad."""


@experiment("robustness-5.7", "Computed torque and linear controllers: errors and cost")
def robustness(setting: Setting) -> list[Finding]:
    """Root mean square errors by law, cycle time and model, and what the text says of them and of the cost."""
    setting.tell(f"{len(CYCLES) * len(MODELS)} legs under {len(LAWS)} controllers each")
    errors = {law: _errors(law) for law in LAWS}
    title = "The planned motion, gains of Table 5.1: root mean square error of the worst joint (no dot: unstable)"
    with setting.figure(1, len(MODELS), (3.0, 3.2), title, legend=3, sharex=True, sharey=True) as (_, axes):
        for panel, (number, words) in zip(axes[0], enumerate(MODELS), strict=True):
            for (law, found), color in zip(errors.items(), COLORS, strict=False):
                panel.plot(
                    1e3 * STEP_S * np.array(CYCLES), found[:, number], "o-", color=color, label=law, markersize=3
                )
            log_axis(panel)
            log_axis(panel, upright=True)
            panel.set(title=words, xlabel="control cycle, ms")
        axes[0, 0].set_ylabel("error, rad")
    return [*judge_errors(errors), judge_cost({law: operations(law) for law in ("servo", *LAWS)})]


def judge_errors(errors: Mapping[str, np.ndarray]) -> list[Finding]:
    """Findings on the errors, (cycles, models) rad by law."""
    linear, torque = np.minimum(*(errors[law] for law in LAWS[:2])), errors[LAWS[2]]
    cycles, right, worse = [1e3 * STEP_S * cycle for cycle in CYCLES], torque[:, 0], torque[0, 1:]
    found, left = three_digits(right[0]), " and ".join(f"{errors[law][0, 0]:.2g}" for law in LAWS[:2])
    why = f"at a cycle of {cycles[0]:g} ms the linear ones leave {left} rad; with the right model nothing is left that "
    why += "could disturb computed torque, so only they err"
    unstable, beaten, of = np.isinf(torque[-1]).sum(), (linear < torque)[0].sum(), len(MODELS)
    alone = f"with the right model; at {cycles[-1]:g} ms {unstable} of {of} legs are unstable"
    beside = f"the right model leaves {found:g} rad; a linear controller leaves less in {beaten} of {of} cases"
    name, wins, grows = "computed torque", (right <= linear[:, 0]).all(), right[0] < right[1] < 0.01
    exact, cycle = f"{name} with the right model, rad", f"{name} at cycles of {cycles[0]:g} and {cycles[1]:g} ms, rad"
    wrong, limited = f"{name} with {', '.join(list(MODELS)[1:])}, rad", (worse > right[0]).all()
    return [
        check(exact, "better performance than linear controllers (5.7)", found, wins, why, could_differ=False),
        check(cycle, "close to 0, and more with the cycle time (5.6)", three_digits(right[:2]), grows, alone),
        check(wrong, "inaccurate parameters limit it (5.7)", three_digits(worse), limited, beside),
    ]


def operations(law: str) -> int:
    """Arithmetic operations of one torque of the leg under a law, as XLA compiles it."""
    state = jnp.zeros(5)
    program = jax.jit(partial(_torque, law, Leg.physical()), compiler_options=compute.compiler_options("scalars"))
    cost: Any = program.lower(Reference(state, state, state), state, state).compile().cost_analysis()
    return int(cost["flops"])


def judge_cost(counts: Mapping[str, int]) -> Finding:
    """The finding that computed torque is more intensive than linear controllers (5.7), from operations by law."""
    *linear, torque = counts.values()
    quantity = f"arithmetic operations of one torque of the leg: {', '.join(counts)}"
    why = f'as XLA compiles them; {" and ".join(f"{torque / count:.2g}" for count in linear)} times as many. "Highly '
    why += f'expensive" has no number: at 1e8 operations a second they take {torque / 100:.2g} microseconds'
    claim = "computationally more intensive than linear controllers (5.7)"
    return check(quantity, claim, list(counts.values()), torque > max(linear), why)


def _errors(law: str) -> np.ndarray:
    """(cycles, models) Root mean square over the motion, of the worst joint, rad; infinite where the plan is lost."""
    cases = [(cycle, *model) for cycle in CYCLES for model in MODELS.values()]
    worst = _of_batch(partial(_root_mean_squares, law), *zip(*cases, strict=True)).reshape(len(CYCLES), len(MODELS))
    return np.where(worst < LOST, worst, np.inf)


def _of_batch(error: Callable[..., Any], *cases: Any) -> np.ndarray:
    """(n,) The largest of a leg's errors, (5,) rad, from the values of a case, (n,) each, and the start of the plan."""
    start = jnp.tile(thesis_quintics().at(0.0).position, (len(cases[0]), 1))
    program = jax.jit(jax.vmap(error), compiler_options=compute.compiler_options("scalars"))
    return np.asarray(program(*map(jnp.array, cases), start), float).max(axis=1)


def _root_mean_squares(law: str, cycle: Any, error: Any, payload: Any, start: Any) -> Any:
    """(5,) Root mean square of the errors under a law, rad, by steps of a cycle, model error, payload and start."""
    leg = Leg.physical()
    act = partial(_torque, law, leg.scaled(1.0 + error))
    # Euler's step would undo a hold of one step: it too takes the dynamics from the state at the start of the step.
    # The method of fourth order loops over its stages, which makes it 25 times slower and no digit better here.
    errors = errors_along(leg.carrying(payload), act, start, STEP_S, dynamics.midpoint, cycle=cycle)
    return jnp.sqrt(jnp.mean(errors**2, axis=0))


def _torque(law: str, model: Leg, plan: Reference, qpos: Any, qvel: Any) -> Any:
    return tracking.LAWS[law](model, qpos, qvel, servo(jnp.array(thesis.KP), jnp.array(thesis.KD), plan, qpos, qvel))


HIGH, SHOWN = np.array([10.0, 30.0, 100.0, 300.0]), 100.0
"""Gear ratios far above 1, and the one at which inertias are told."""

ROTORS = np.array([1e-8, 1e-7, 1e-6, 1e-5])
"""Rotor inertias that are tried, kg m^2: from motors of a few grams to one that weighs more than the leg."""

TRACKS = np.radians(1.0)
"""Largest error of a good trajectory tracking, rad."""


@experiment("motors-5.3", "Gear and motor")
def motors(setting: Setting) -> list[Finding]:
    """Sections 5.3 and 5.4: what a gear makes of the leg's dynamics."""
    inertia = over(dynamics.joint_inertias, Leg.physical(), planned(np.linspace(0, thesis.QUINTIC_S, 501)).position)
    least, mean, most = inertia.min(axis=0), inertia.mean(axis=0), inertia.max(axis=0)
    errors = _of_batch(partial(_ignoring_d, mean), (HIGH**2 * ROTORS[:, None]).ravel())
    varies = (most - least) / (least + SHOWN**2 * ROTORS[:, None])
    quantity = f"share by which I_eff of (5.20) varies at a gear of {SHOWN:g}, by rotor and joint"
    why = 'from the least to the largest on the planned motion; "almost constant for highly geared manipulators" (5.4) '
    why += "holds or fails with the rotor, of which nothing is printed. Without a gear and a rotor it varies by a "
    why += f"factor of up to {(most / least).max():.1f}"
    errors = np.nan_to_num(errors, nan=np.inf).reshape(len(ROTORS), len(HIGH))
    return [unprinted(quantity, _by_rotor(varies), why), judge_tracking(errors)]


def judge_tracking(errors: np.ndarray) -> Finding:
    """The finding on section 5.3's claim that a highly geared joint tracks well though its controller ignores d.

    No rotor and no gear is printed, so there is a verdict only where it is the same for all of them. `errors`: the
    largest of the worst joint, (rotors, gears), rad, by `ROTORS` and `HIGH`.
    """
    tracks = errors <= TRACKS
    quantity = f"largest error of the planned motion without d, rad, by rotor and gears of {listed(HIGH)}"
    found = _by_rotor(errors)
    why = "worst joint, each alone under Table 5.1's gains and the mean of its I_eff, the leg as it is, gravity along "
    why += f"it; of {tracks.size} rotors and gears {tracks.sum()} track within a degree. What counts is the inertia "
    why += "that the rotor adds to the joint, gear ratio^2 times its own"
    if tracks.any() and not tracks.all():
        return unprinted(quantity, found, f"{why}: the claim (5.3) holds or fails with values that are not printed")
    return check(quantity, "a good trajectory tracking performance (5.3)", found, tracks.all(), why, float(TRACKS))


def _ignoring_d(inertia: np.ndarray, added: Any, start: Any) -> Any:
    """(5,) The largest errors, rad, of joints whose controllers know of the links a constant inertia, kg m^2, alone,
    where rotors add `added` to each."""

    def act(plan: Reference, qpos: Any, qvel: Any) -> Any:
        return (inertia + added) * servo(jnp.array(thesis.KP), jnp.array(thesis.KD), plan, qpos, qvel)

    free = implicit_euler(jnp.zeros(5), jnp.zeros(5), armature=added)
    return jnp.abs(errors_along(Leg.physical(), act, start, 2 * STEP_S, free)).max(axis=0)


def _by_rotor(values: np.ndarray) -> dict[str, list[float]]:
    """Rows of values by the rotor's inertia."""
    named = zip(ROTORS, np.minimum(values, 1e9), strict=True)
    return {f"{rotor:g} kg m^2": three_digits(row) for rotor, row in named}
