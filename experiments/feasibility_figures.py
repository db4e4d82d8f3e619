"""Figures of what the lower body can do with the two columns of Table 3.2."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from feasible_postures import Body
from feasible_ranges import LEANS, Column
from feasible_torques import INNER, Way, hiking, rocking, slowest

from humanoid_mjx.report.style import COLORS, figure
from humanoid_mjx.reproduction.posture_figures import draw_postures
from humanoid_mjx.robot import lower_body as robot
from humanoid_mjx.robot.ranges import TORQUE_LIMIT
from humanoid_mjx.thesis import leg as thesis

PERIODS = np.linspace(0.1, 1.6, 151)


def draw_stances(path: Path, columns: Mapping[str, Column]) -> None:
    """The least leaning posture on one foot with each column."""
    draw_postures(
        path,
        "The least that the torso leans to stand on the right foot alone",
        [
            (f"{name} ranges: {math.degrees(column.lean):.0f} degrees", Body(name).standing(column.balanced))
            for name, column in columns.items()
        ],
    )


def draw_feasibility(
    path: Path,
    columns: Mapping[str, Column],
    rows: Mapping[str, np.ndarray],
    body: Body,
    joints: np.ndarray,
    way: Way,
) -> None:
    """Balance on one foot, rocking from foot to foot, turns of a foot, and torques."""
    with figure(path, 2, 2, size=(5.4, 3.7)) as (fig, axes):
        _balance(axes[0, 0], columns)
        _rocking(axes[0, 1], body, joints, way)
        _turns(axes[1, 0], columns, way)
        _torques(axes[1, 1], rows)
        fig.suptitle(
            "What the lower body can do with its soles flat, by Table 3.2's ranges of the joints", x=0.02, ha="left"
        )


def _balance(panel: Any, columns: Mapping[str, Column]) -> None:
    half = 1e3 * robot.FOOT_WIDTH / 2
    panel.axhspan(-20, 0, color="0.92", linewidth=0)
    panel.text(45, -19.2, "mass beside the sole: it falls", ha="right", color="0.35", fontsize=8)
    for color, (name, column) in zip(COLORS, columns.items(), strict=False):
        for margins, dashes, words in ((column.lifted, "-", "other foot lifted"), (column.planted, "--", "both flat")):
            panel.plot(LEANS, 1e3 * np.array(margins), dashes, color=color, label=f"{name} ranges, {words}")
    panel.axhline(half, color="0.5", linewidth=0.8)
    panel.text(1, half + 0.4, "middle of the sole", color="0.35", fontsize=8)
    panel.set_ylim(-20, 15)
    panel.set_xlabel("largest lean of the torso, degrees")
    panel.set_ylabel("mass inside the sole's edge by, mm")
    panel.set_title("Can it stand still on one foot?")
    panel.legend(frameon=False, fontsize=7, ncols=2, loc=(0.05, 0.07))


def _rocking(panel: Any, body: Body, joints: np.ndarray, way: Way) -> None:
    period, stance = way.period, way.stance
    rocks = [rocking(body, joints, float(t), stance) for t in PERIODS]
    hikes = [math.degrees(hiking(body, float(t), stance)[1]) for t in PERIODS]
    end = slowest(body, joints, stance)
    panel.plot(PERIODS, np.degrees([rock.tilt for rock in rocks]), color=COLORS[2])
    panel.plot(PERIODS, hikes, color=COLORS[3])
    panel.text(0.99, 4.2, "tilt of the soles,\nif it rocks stiffly", color=COLORS[2], fontsize=8, va="top")
    hike = "hike of the free hip,\nif the soles stay flat"
    panel.text(period - 0.02, 17.0, hike, color=COLORS[3], fontsize=8, ha="right")
    panel.axvline(period, color="0.4", linewidth=0.8)
    panel.text(period - 0.02, 29.0, f"gait of `walk`:\n{period:g} s", fontsize=8, va="top", ha="right")
    panel.axvspan(end, PERIODS[-1], color="0.92", linewidth=0)
    panel.text(
        end + 0.01,
        28.5,
        f"the mass sways\n{1e3 * INNER:g} mm: it comes\nabove a sole",
        fontsize=8,
        va="top",
        color="0.35",
    )
    panel.set_xlim(PERIODS[0], PERIODS[-1])
    panel.set_ylim(0, 30)
    panel.set_xlabel("period of the gait, s")
    panel.set_ylabel("degrees")
    panel.set_title("What a sway from foot to foot takes instead")


def _turns(panel: Any, columns: Mapping[str, Column], way: Way) -> None:
    sweep = math.degrees(way.turn * way.on_ground)
    panel.axvspan(-sweep / 2, sweep / 2, color="0.85", linewidth=0)
    for row, column in enumerate(columns.values()):
        inwards, outwards = math.degrees(column.toes_in), math.degrees(column.toes_out)
        panel.barh(row, inwards + outwards, left=-inwards, height=0.5, color=COLORS[row])
        panel.text(outwards + 1, row, f"out {outwards:.0f}", va="center", fontsize=8)
        panel.text(-inwards - 1, row, f"in {inwards + 0.0:.0f}", va="center", ha="right", fontsize=8)
    rate = f"{way.turn:g} rad/s"
    panel.text(0, -0.52, f"grey: what a foot turns each way at {rate}", ha="center", fontsize=8)
    panel.set_yticks(range(len(columns)), [f"{name}\nranges" for name in columns])
    panel.set_ylim(-0.65, len(columns) - 0.4)
    panel.set_xlim(-65, 70)
    panel.grid(False, axis="y")
    panel.set_xlabel("heading of a flat foot against the torso, degrees; negative: toes in")
    panel.set_title("How far can a foot turn below bent knees?")


def _torques(panel: Any, rows: Mapping[str, np.ndarray]) -> None:
    wide = 0.8 / len(rows)
    shades = (COLORS[4], COLORS[2], COLORS[5], COLORS[0], COLORS[1])
    for i, ((words, torque), color) in enumerate(zip(rows.items(), shades, strict=True)):
        panel.bar(np.arange(5) + (i - (len(rows) - 1) / 2) * wide, torque, wide, color=color, label=words)
    panel.axhline(TORQUE_LIMIT, color="black", linewidth=0.8)
    panel.text(-0.45, TORQUE_LIMIT + 0.03, "limit of the motors, chosen to suffice", fontsize=8)
    places = np.arange(5)
    panel.hlines(thesis.MAX_TORQUES, places - 0.45, places + 0.45, color="black", linewidth=2, label="Table 4.7")
    panel.set_xticks(range(5), [joint.replace("_", " ") for joint in thesis.JOINT_NAMES])
    panel.set_ylim(0, 2.3)
    panel.grid(False, axis="x")
    panel.set_ylabel("largest torque of a leg that ..., N m")
    panel.set_title("Are the motors strong enough?")
    panel.legend(frameon=False, fontsize=7, loc=(0.4, 0.56))
