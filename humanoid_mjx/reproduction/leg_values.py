"""The thesis's leg at many states at once, as arrays of numpy, and along the planned motion."""

from collections.abc import Callable, Mapping
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
    path: Quintic | None = None,
    integral: bool = False,
    **how: Any,
) -> Any:
    """The planned motion less that of a leg after each step, (steps, 5) rad, inside jax.

    Args:
      law: (`Reference`, qpos, qvel) -> torque, N m; with `integral` its last argument is that of the error, rad s.
      start: where the leg is at rest, (5,) rad. Of a batch of legs give each a start of its own, although all are
        alike: then jax traces the motion once, not twice.
      path: the plan, if it is not the thesis's.
      integrator: as in `dynamics.rollout`, as are the other keywords.
    """
    plan, steps = path or thesis_quintics(), round(thesis.QUINTIC_S / step_s)

    def controller(time: Any, qpos: Any, qvel: Any) -> Any:
        wanted = Reference(*plan.at(time))
        if not integral:
            return law(wanted, qpos, qvel)
        torque = law(wanted, qpos[:5], qvel[:5], qpos[5:])
        return jnp.concatenate([torque, wanted.qpos - qpos[:5]])

    def integrated(leg: Any, state: dynamics.State, torque: Any, dt: Any) -> dynamics.State:
        """A step of the leg and of the integrals, which stand behind the joints, as their rates behind the torques."""
        moved = integrator(leg, dynamics.State(state.qpos[:5], state.qvel[:5]), torque[:5], dt)
        integrals = state.qpos[5:] + dt * torque[5:]
        return dynamics.State(jnp.concatenate([moved.qpos, integrals]), jnp.concatenate([moved.qvel, torque[5:]]))

    begin, advance = (jnp.pad(start, (0, 5)), integrated) if integral else (start, integrator)
    states = dynamics.rollout(leg, begin, 0.0 * begin, controller, step_s, steps, advance, **how)[1]
    return jax.vmap(plan.at)(step_s * jnp.arange(1, steps + 1)).position - states.qpos[:, :5]


def plot_joints(panel: Any, times: np.ndarray, values: np.ndarray, marks: Mapping[float, Any] | None = None) -> None:
    """Draw over time, s, a labelled line for each joint, values (n, 5); and as dots printed values by their time."""
    for joint in range(5):
        panel.plot(times, values[:, joint], color=COLORS[joint], label=f"{joint + 1} {NAMES[joint]}")
        for time, printed in (marks or {}).items():
            panel.plot(time, printed[joint], "o", color=COLORS[joint], markersize=4, clip_on=False)
    panel.set(xlabel="time, s", xlim=(0, thesis.QUINTIC_S))
    label_lines(panel)
