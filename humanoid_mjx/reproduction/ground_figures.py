"""Figures of bodies on the ground: their balance, and where which parts of their feet touch."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from humanoid_mjx.mechanics.balance import support_polygon
from humanoid_mjx.report.style import COLORS, figure
from humanoid_mjx.reproduction.ground import Trial

TABLES = {"straight_walk": "Table 4.5", "sudden_turn": "Table 4.6"}

VIEW_M = 0.15
"""Distance from the origin that the figures show, m."""


def draw_balance(path: Path, played: Mapping[Trial, Any], balances: Mapping[Trial, Any]) -> None:
    """Centre of mass and zero-moment point against the support, forwards and sideways, and the margin."""
    with figure(path, 3, len(played), size=(3.6, 2.3), sharex=True) as (fig, axes):
        for column, (trial, way) in zip(axes.T, played.items(), strict=True):
            found = balances[trial]
            times = way.times[:-1]
            for axis, (panel, side) in enumerate(zip(column, ("forwards", "to the left"), strict=False)):
                corners = np.where(way.touching, way.corners[..., axis], np.nan)[:-1]
                some = way.touching[:-1].any(axis=1)
                low, high = (
                    np.where(some, f(np.nan_to_num(corners, nan=s), axis=1), np.nan)
                    for f, s in ((np.min, np.inf), (np.max, -np.inf))
                )
                panel.fill_between(times, 1e3 * low, 1e3 * high, color="0.85", label="support")
                panel.plot(
                    times, 1e3 * _near(found.point)[:, axis], color=COLORS[1], linewidth=1, label="zero-moment point"
                )
                panel.plot(times, 1e3 * found.center[:, axis], color=COLORS[0], label="centre of mass")
                panel.set(ylim=(-150, 150), ylabel=f"{side}, mm")
            column[2].plot(times, 1e3 * found.margin, color=COLORS[1], linewidth=1)
            column[2].plot(times, 1e3 * found.center_margin, color=COLORS[0])
            column[2].axhline(0, color="0.4", linewidth=0.8)
            column[2].set(ylim=(-100, 40), ylabel="margin in the support, mm", xlabel="time, s")
            column[0].set_title(f"{TABLES[trial.motion]}, {trial.controller}")
        axes[0, 0].legend(frameon=False, fontsize=7, loc="lower left")
        fig.suptitle("Until the fall", x=0.02, ha="left", fontsize="medium")


def draw_prints(path: Path, played: Mapping[Trial, Any], balances: Mapping[Trial, Any]) -> None:
    """View from above: the parts of the feet that touch, and the paths of the centre of mass and the zero-moment
    point."""
    with figure(path, 1, len(played), size=(3.4, 3.5)) as (_, axes):
        for panel, (trial, way) in zip(axes[0], played.items(), strict=True):
            found = balances[trial]
            for side, (name, color) in enumerate(zip(("right", "left"), COLORS, strict=False)):
                foot = slice(4 * side, 4 * side + 4)
                touched = 1e3 * way.corners[:, foot, :2][way.touching[:, foot]]
                panel.scatter(-touched[:, 1], touched[:, 0], s=5, color=color, label=f"{name} foot's corners")
                print_ = 1e3 * support_polygon(way.corners[0, foot, :2])
                panel.fill(-print_[:, 1], print_[:, 0], color=color, alpha=0.15, linewidth=0)
            point = 1e3 * _near(found.point)
            panel.plot(-point[:, 1], point[:, 0], color=COLORS[2], linewidth=0.8, label="zero-moment point")
            panel.plot(-1e3 * found.center[:, 1], 1e3 * found.center[:, 0], color=COLORS[6], label="centre of mass")
            panel.set_aspect("equal")
            panel.set(xlim=(-150, 150), ylim=(-130, 170), xlabel="to the right, mm")
            panel.set_title(f"{TABLES[trial.motion]}, {trial.controller}: falls at {way.seconds:g} s", fontsize=8)
        axes[0, 0].set_ylabel("forwards, mm (shaded: the feet at the start)")
        axes[0, 0].legend(frameon=False, fontsize=7, loc="upper right")


def _near(point: np.ndarray) -> np.ndarray:
    """The points without those far off, where hardly any force pushes the ground."""
    return np.where((np.abs(point) < VIEW_M).all(axis=1, keepdims=True), point, np.nan)
