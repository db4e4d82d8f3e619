"""The thesis's leg at many states at once, as arrays of numpy, and along the planned motion."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx import dynamics
from humanoid_mjx.control import Reference
from humanoid_mjx.mechanics.trajectories import Quintic, thesis_quintics
from humanoid_mjx.report.style import COLORS, label_lines
from humanoid_mjx.thesis import leg as thesis

NAMES = [name.replace("_", " ") for name in thesis.JOINT_NAMES]


def over(function: Callable[..., Any], model: Any, *states: Any) -> Any:
    """The values of `function(model, *state)`, states first; an array, or a tree of them, as the function returns."""
    found = jax.jit(jax.vmap(function, in_axes=(None, *[0] * len(states))))(model, *states)
    return jax.tree.map(lambda x: np.asarray(x, float), found)


def planned(times: np.ndarray, path: Quintic | None = None) -> Any:
    """The planned `Motion`, (times, 5) each: rad, rad/s and rad/s^2; or that along another path."""
    return over(Quintic.at, thesis_quintics() if path is None else path, times)


def errors_along(
    leg: Any,
    law: Callable[..., Any],
    start: Any,
    step_s: float,
    integrator: Any = dynamics.semi_implicit_euler,
    **how: Any,
) -> Any:
    """The planned motion less that of a leg after each step, (steps, 5) rad, inside jax.

    Args:
      law: (`Reference`, qpos, qvel) -> torque, N m.
      start: where the leg is at rest, (5,) rad. Of a batch of legs give each a start of its own, although all are
        alike: then jax traces the motion once, not twice.
      integrator, how: as in `dynamics.rollout`.
    """
    path, steps = thesis_quintics(), round(thesis.QUINTIC_S / step_s)

    def controller(time: Any, qpos: Any, qvel: Any) -> Any:
        return law(Reference(*path.at(time)), qpos, qvel)

    states = dynamics.rollout(leg, start, 0.0 * start, controller, step_s, steps, integrator, **how)[1]
    return jax.vmap(path.at)(step_s * jnp.arange(1, steps + 1)).position - states.qpos


def plot_joints(panel: Any, across: np.ndarray, values: np.ndarray) -> None:
    """Draw a line for each joint, values (n, 5), in its colour, labelled with number and name."""
    for joint in range(5):
        panel.plot(across, values[:, joint], color=COLORS[joint], label=f"{joint + 1} {NAMES[joint]}")
    label_lines(panel)
