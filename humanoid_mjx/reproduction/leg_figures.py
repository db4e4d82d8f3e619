"""Figures of the leg on its planned motion: torques, and how joints follow it."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from humanoid_mjx.report.style import COLORS, figure, label_lines, log_axis
from humanoid_mjx.thesis import leg as thesis

LEAST = 1e-6
"""The least error that is shown, rad."""

NAMES = [name.replace("_", " ") for name in thesis.JOINT_NAMES]


def draw_torques(path: Path, t: np.ndarray, curves: Mapping[str, np.ndarray]) -> None:
    """Torques of the planned motion by model, (5, times) N m each, with what is printed of their start and end."""
    with figure(path, 1, len(curves), size=(4.3, 3.8), sharey=True) as (fig, axes):
        for panel, (title, tau) in zip(axes[0], curves.items(), strict=True):
            for joint in range(5):
                panel.plot(t, tau[joint], color=COLORS[joint])
            panel.set(title=title, xlabel="time, s", xlim=(0, thesis.QUINTIC_S))
        for time, when in ((0.0, "start"), (thesis.QUINTIC_S, "end")):
            for joint, mark in enumerate(thesis.FIGURE_7_5[when]):
                axes[0, 0].plot(time, mark, "o", color=COLORS[joint], markersize=5, clip_on=False)
        for panel, tau in zip(axes[0], curves.values(), strict=True):
            label_lines(panel, tau[:, -1].tolist(), [f"{i} {name}" for i, name in enumerate(NAMES, 1)], COLORS[:5])
        axes[0, 0].set_ylabel("joint torque, N m")
        fig.suptitle("Torques of the planned motion; dots: start and end as section 7 C prints them", x=0.02, ha="left")


def draw_tracking(path: Path, joint: int, errors: Mapping[str, np.ndarray]) -> None:
    """Angle of a joint under each controller and its distance from the plan, beside the printed values.

    Args:
      errors: by what a controller is called, the plan less the joint's angle at even times, rad.
    """
    times = np.linspace(0, thesis.QUINTIC_S, len(next(iter(errors.values()))))
    planned = np.radians(thesis.QUINTIC_COEFFICIENTS[joint]) @ [times**0, times**3, times**4, times**5]
    last = (thesis.QUINTIC_S - 0.3, thesis.QUINTIC_S)
    printed = thesis.TRACKING["end"][joint], thesis.TRACKING["error"][joint]
    bar = {"color": COLORS[6], "linewidth": 4, "solid_capstyle": "butt", "clip_on": False}
    with figure(path, 1, 2, size=(5.2, 4.2)) as (fig, axes):
        places, distances = axes[0]
        places.plot(times, planned, color=COLORS[6], linestyle="--", linewidth=1, label="planned")
        for color, (words, error) in zip(COLORS, errors.items(), strict=False):
            places.plot(times, planned - error, color=color, label=words)
            distances.plot(times, np.abs(error), color=color)
        log_axis(distances, upright=True)
        distances.set_ylim(LEAST, 3)
        places.plot(last, [printed[0]] * 2, **bar, label="as printed, at 5 s")
        distances.plot(last, [max(printed[1], LEAST)] * 2, **bar)
        if printed[1] < LEAST:
            distances.annotate("0 as printed", (last[0], LEAST), (-4, 3), textcoords="offset points", ha="right")
        places.set(title="Where the joint is", ylabel="angle, rad")
        distances.set(title="How far it is from the plan", ylabel="distance, rad (logarithmic)")
        for panel in axes[0]:
            panel.set(xlabel="time, s", xlim=(0, thesis.QUINTIC_S))
        handles, words = places.get_legend_handles_labels()
        fig.legend(handles, words, loc="outside lower center", ncols=2, frameon=False)
        name = thesis.JOINT_NAMES[joint].replace("_", " ")
        fig.suptitle(f"Joint {joint + 1} ({name}) from q = 0", x=0.02, ha="left", fontsize="medium")
