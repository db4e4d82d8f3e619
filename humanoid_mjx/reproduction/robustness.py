"""Tracking errors of controllers when the model, the load or the cycle time differs from their design.

Section 5.6 says that a cycle time keeps the error from being 0, section 5.7 that computed torque follows better than
linear controllers do; neither is shown there.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx import compute, dynamics
from humanoid_mjx.control import Reference, servo
from humanoid_mjx.mechanics.trajectories import thesis_quintics
from humanoid_mjx.report.style import SEQUENTIAL
from humanoid_mjx.reproduction import tracking
from humanoid_mjx.reproduction.findings import Finding, Setting, check, experiment, three_digits
from humanoid_mjx.robot.leg import Leg
from humanoid_mjx.spec import InputError
from humanoid_mjx.thesis import leg as thesis

STEP_S = 5e-4
CYCLES = (1, 2, 20, 100)
"""Steps in a control cycle."""

MODEL_ERROR = 0.3
"""Largest error of every link's inertia in the controller's model, as a share."""

PAYLOAD = 0.03
"""Largest payload at the toe, kg."""

CONFIG = {"grid": {"model_errors": 13, "payloads": 21}}
"""Number of model errors, from too light to too heavy, and of payloads, from none upwards."""

TRIED = {
    "partitioned PD": "partitioned PD",
    "partitioned PD and weight": "partitioned PD holding the weight",
    "computed torque": "computed torque",
}

WORST, BEST = 1.0, 1e-3
"""Ends of the colours, rad."""

LOST = 10.0
"""Error from which a controller has lost the plan, rad."""


@experiment("robustness-map", "Tracking over model error, payload and cycle time", CONFIG)
def robustness(setting: Setting) -> list[Finding]:
    """Root mean square errors over model error, payload and cycle time, as heat maps; what the text says of them."""
    errors = _errors(*_grid(setting), setting.tell)
    _draw(setting, errors)
    exact, load = len(errors["computed torque"][0]) // 2, 0
    partitioned, holding, torque = errors.values()
    linear = np.minimum(partitioned, holding)
    wins, follows = bool((torque <= linear)[:, exact, load].all()), np.isfinite(np.minimum(torque, linear))
    return [
        check(
            "computed torque with the right model follows better than the linear controllers",
            "better trajectory performance than linear controllers (5.7)",
            wins,
            wins,
            f"at cycles of {', '.join(f'{c * STEP_S * 1e3:g}' for c in CYCLES)} ms it leaves "
            f"{_list(torque[:, exact, load])} rad, partitioned PD {_list(partitioned[:, exact, load])}, holding the "
            f"weight {_list(holding[:, exact, load])}; of all legs that one of them can control, computed torque "
            f"is the best for {(torque < linear)[follows].mean():.0%}; with the right model nothing is left that "
            "could disturb it, so only the linear controllers err",
            could_differ=False,
        ),
        check(
            "the error is not 0 because of the cycle time: computed torque at "
            f"{CYCLES[0] * STEP_S * 1e3:g} and {CYCLES[1] * STEP_S * 1e3:g} ms, rad",
            "close to 0, and more with the cycle time",
            [three_digits(torque[i, exact, load]) for i in (0, 1)],
            torque[0, exact, load] < torque[1, exact, load] < 0.01,
            f"but for the cycle nothing is wrong there; a model {MODEL_ERROR:.0%} too heavy at "
            f"{CYCLES[0] * STEP_S * 1e3:g} ms leaves {three_digits(torque[0, -1, load])} rad, {PAYLOAD:g} kg at the "
            f"toe {three_digits(torque[0, exact, -1])} rad; at {CYCLES[-1] * STEP_S * 1e3:g} ms "
            f"{np.isinf(torque[-1]).mean():.0%} of the legs are unstable",
        ),
    ]


def _grid(setting: Setting) -> tuple[np.ndarray, np.ndarray]:
    """Model errors, the middle one 0, and payloads, the first one 0."""
    counts = setting.config["grid"]
    for name, least in (("model_errors", 3), ("payloads", 2)):
        count = counts[name]
        if not isinstance(count, int) or count < least or (name == "model_errors" and count % 2 == 0):
            odd = "an odd number" if name == "model_errors" else "a number"
            raise InputError(f"grid.{name} must be {odd} of at least {least}, got {count!r}.")
    payloads = np.linspace(0.0, PAYLOAD, counts["payloads"])
    return np.linspace(-MODEL_ERROR, MODEL_ERROR, counts["model_errors"]), payloads


def _errors(model_errors: np.ndarray, payloads: np.ndarray, tell: Callable[[str], None]) -> dict[str, np.ndarray]:
    """(cycles, model errors, payloads) Root mean square over the motion, of the worst joint, rad, by controller."""
    robots = [x.ravel() for x in np.meshgrid(np.array(CYCLES), model_errors, payloads, indexing="ij")]
    arrays = [jnp.asarray(x, dtype) for x, dtype in zip(robots, (int, float, float), strict=True)]
    # A start of its own for each leg, although all are alike: then jax traces the motion once, not twice.
    arrays.append(jnp.tile(thesis_quintics().at(0.0).position, (len(robots[0]), 1)))
    shape = (len(CYCLES), len(model_errors), len(payloads))
    errors = {}
    for law, words in TRIED.items():
        tell(f"{len(robots[0]):,} legs under {words}")
        worst = np.asarray(_program(law)(*arrays)).max(axis=1).reshape(shape)
        errors[law] = np.where(worst < LOST, worst, np.inf)
    return errors


def _program(law: str) -> Callable[..., Any]:
    """From steps of a cycle, model errors, payloads and starts, (legs, ...) each, to root mean squares of the errors,
    (legs, 5), rad."""
    leg, planned = Leg.physical(), thesis_quintics()
    kp, kd = jnp.array(thesis.KP), jnp.array(thesis.KD)
    steps = round(thesis.QUINTIC_S / STEP_S)

    def simulate(cycle: Any, error: Any, payload: Any, start: Any) -> Any:
        model = leg.scaled(1.0 + error)

        def controller(time: Any, qpos: Any, qvel: Any) -> Any:
            qacc = servo(kp, kd, Reference(*planned.at(time)), qpos, qvel)
            return tracking.LAWS[law](model, qpos, qvel, qacc)

        # Euler's step would undo a hold of one step: it too takes the dynamics from the state at the start of the step.
        # The method of fourth order loops over its stages, which makes it 25 times slower and no digit better here.
        states = dynamics.rollout(
            leg.carrying(payload), start, 0.0 * start, controller, STEP_S, steps, dynamics.midpoint, cycle=cycle
        )[1]
        wanted = jax.vmap(planned.at)(STEP_S * jnp.arange(1, steps + 1)).position
        return jnp.sqrt(jnp.mean((wanted - states.qpos) ** 2, axis=0))

    return jax.jit(jax.vmap(simulate), compiler_options=compute.compiler_options("scalars"))


def _draw(setting: Setting, errors: dict[str, np.ndarray]) -> None:
    from matplotlib.colors import LogNorm

    extent = (0.0, 1e3 * PAYLOAD, -100 * MODEL_ERROR, 100 * MODEL_ERROR)
    look = {"origin": "lower", "aspect": "auto", "extent": extent, "cmap": SEQUENTIAL + "_r"}
    with setting.figure(len(TRIED), len(CYCLES), (2.7, 2.4), sharex=True, sharey=True) as (fig, axes):
        for row, (law, words) in zip(axes, TRIED.items(), strict=True):
            row[0].set_ylabel(f"{words}\nmodel error, %", fontsize=8)
            for panel, error in zip(row, errors[law], strict=True):
                panel.set_facecolor("0.8")
                image = panel.imshow(np.where(np.isinf(error), np.nan, error), norm=LogNorm(BEST, WORST), **look)
                panel.grid(False)
        for top, bottom, cycle in zip(axes[0], axes[-1], CYCLES, strict=True):
            top.set_title(f"cycle of {cycle * STEP_S * 1e3:g} ms")
            bottom.set_xlabel("payload, g")
        words = "root mean square error of the worst joint, rad"
        fig.colorbar(image, ax=axes, label=words, extend="both", format="{x:g}")
        legs = sum(error.size for error in errors.values())
        words = f"{legs:,} legs on the planned motion, gains of Table 5.1; grey: unstable"
        fig.suptitle(words, x=0.02, ha="left", fontsize="medium")


def _list(values: np.ndarray) -> str:
    return ", ".join("no end" if np.isinf(x) else f"{x:.2g}" for x in values)
