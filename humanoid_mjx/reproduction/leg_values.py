"""The thesis's leg at many states at once, as arrays of numpy."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

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


def plot_joints(panel: Any, across: np.ndarray, values: np.ndarray) -> None:
    """Draw a line for each joint, values (n, 5), in its colour, labelled with number and name."""
    for joint in range(5):
        panel.plot(across, values[:, joint], color=COLORS[joint], label=f"{joint + 1} {NAMES[joint]}")
    label_lines(panel)
