# pyright: reportAttributeAccessIssue=false
"""A drawing of the robots: their joints at zero, each with its axis and the sense in which it turns."""

from itertools import combinations, product
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float

from humanoid_mjx.report.style import COLORS, figure
from humanoid_mjx.robot import make_robot

ROBOTS = {"legs": "legs: the chain of Table 4.1, torso fixed", "lower_body": "lower_body: Table 3.1 at 1:4"}
"""Robots and their names in the drawing."""

SENSES = {
    "hip_pitch": "hip pitch: the leg swings forward",
    "hip_yaw": "hip yaw: the toes turn outwards",
    "hip_roll": "hip roll: the leg swings outwards",
    "knee_pitch": "knee pitch: the shank swings back",
    "ankle_pitch": "ankle pitch: the toes go down",
}
"""What a positive angle does, by joint, on both sides."""

AXIS_M = 0.035
TURN_M = 0.011
"""Length of a drawn axis, and radius of the arc around its end."""


def draw_robots(path: Path) -> Path:
    """Draw both robots at zero into a .png: arrows along the joint axes of the right leg, by the right-hand rule."""
    with figure(path, 1, len(ROBOTS), size=(5.2, 5.6), subplot_kw={"projection": "3d"}) as (fig, axes):
        for panel, (name, title) in zip(axes[0], ROBOTS.items(), strict=True):
            _draw_robot(panel, name)
            panel.set_title(title)
        for row, (joint, words) in enumerate(SENSES.items()):
            fig.text(
                0.02 + 0.335 * (row % 3), 0.045 - 0.025 * (row // 3), f"+ {words}", color=_color(joint), fontsize=9
            )
        fig.get_layout_engine().set(rect=(0.0, 0.08, 1.0, 0.92))
    return path


def _draw_robot(panel: Any, name: str) -> None:
    """Lines between the joints, boxes by their edges, the axes of the right leg's joints, the world's directions."""
    model = make_robot(name).spec().compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for line, color in _outline(model, data):
        panel.plot(*line.T, color=color if color == COLORS[-1] else "0.45", linewidth=1.4)
    for joint, words in SENSES.items():
        index = model.joint(f"right_{joint}").id
        _draw_axis(panel, data.xanchor[index], data.xaxis[index], _color(joint), words.partition(":")[0])
    middle = np.array([0.0, 0.0, data.xpos[1:, 2].min() / 2 + data.xpos[1:, 2].max() / 2])
    corner = middle + np.array([0.02, 0.11, 0.09])
    for direction, label in zip(np.eye(3), ("x forward", "y left", "z up"), strict=True):
        tip = corner + 0.03 * direction
        panel.plot(*np.stack([corner, tip]).T, color="0.2", linewidth=1.0)
        panel.text(*(tip + 0.006 * direction), label, fontsize=7, color="0.2")
    for axis, place in zip("xyz", middle, strict=True):
        getattr(panel, f"set_{axis}lim")(place - 0.14, place + 0.14)
    panel.set_box_aspect((1, 1, 1), zoom=1.25)
    panel.view_init(elev=14, azim=-50)
    panel.set_axis_off()


def _outline(model: mujoco.MjModel, data: mujoco.MjData) -> list[tuple[np.ndarray, str]]:
    """Points and colour of each line: the right leg in one colour, the left in another."""

    def color(body: int) -> str:
        name = model.body(body).name
        return COLORS[0] if name.startswith("right") else COLORS[1] if name.startswith("left") else COLORS[-1]

    lines = []
    for body in range(2, model.nbody):
        parent = model.body_parentid[body]
        lines.append((data.xpos[[parent, body]], color(body)))
    for geom in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_BOX):
        corners = np.array(list(product((-1, 1), repeat=3)))
        rotation = data.geom_xmat[geom].reshape(3, 3)
        places = data.geom_xpos[geom] + (corners * model.geom_size[geom]) @ rotation.T
        for a, b in combinations(range(8), 2):
            if np.abs(corners[a] - corners[b]).sum() == 2:
                lines.append((places[[a, b]], color(int(model.geom_bodyid[geom]))))
    return lines


def _draw_axis(panel: Any, place: Float[np.ndarray, "3"], axis: Float[np.ndarray, "3"], color: str, label: str) -> None:
    """An arrow along a joint's axis, and around it an arc with a head in the sense of a positive angle."""
    panel.quiver(*place, *(AXIS_M * axis), color=color, linewidth=1.6, arrow_length_ratio=0.15)
    across = np.cross(axis, [1.0, 0.0, 0.0] if abs(axis[0]) < 0.9 else [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    angles = np.linspace(0.0, 1.5 * np.pi, 40)[:, None]
    arc = place + 0.65 * AXIS_M * axis + TURN_M * (np.cos(angles) * across + np.sin(angles) * np.cross(axis, across))
    panel.plot(*arc.T, color=color, linewidth=1.2)
    panel.quiver(*arc[-1], *(3.0 * (arc[-1] - arc[-2])), color=color, linewidth=1.2, arrow_length_ratio=1.0)
    # To the left of the leg, where nothing else is drawn; only the yaw's axis lies along the leg.
    tip, away = (0.8, "left") if axis[2] < -0.5 else (0.0 if axis[1] > 0.5 else 1.4, "right")
    words = f"       {label}" if away == "left" else f"{label}    "
    above = np.array([0.0, 0.0, 0.006 if label.startswith("ankle") else 0.0])  # beyond the lines of the foot
    panel.text(*(place + tip * AXIS_M * axis + above), words, color=color, fontsize=7.5, ha=away, va="bottom")


def _color(joint: str) -> str:
    return COLORS[(0, 1, 2, 3, 5)[list(SENSES).index(joint)]]
