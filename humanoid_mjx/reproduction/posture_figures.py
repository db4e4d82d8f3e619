# pyright: reportAttributeAccessIssue=false
"""Postures of the lower body on the ground as shaded pictures."""

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float

from humanoid_mjx.report.rendering import draw
from humanoid_mjx.report.style import figure
from humanoid_mjx.robot.lower_body import LowerBody


def draw_postures(path: Path, title: str, postures: Sequence[tuple[str, Float[np.ndarray, " angles"]]]) -> None:
    """A panel for each posture, its lowest point on the ground.

    Args:
      path: of the figure.
      title: its heading.
      postures: words, and the ten joints, the right leg's first, rad, of an upright body, or `qpos` of any.
    """
    model = LowerBody().model
    pictures = draw(model, np.array([_on_the_ground(model, angles) for _, angles in postures]))
    with figure(path, 1, len(postures), size=(3.5, 3.4)) as (fig, axes):
        for panel, (words, _), picture in zip(axes[0], postures, pictures, strict=True):
            panel.imshow(picture)
            panel.set_axis_off()
            panel.set_title(words, loc="center", fontsize=8.5)
        fig.suptitle(f"{title}\nRight leg blue, left leg orange", x=0.02, ha="left", fontsize="medium")


def _on_the_ground(model: mujoco.MjModel, angles: Float[np.ndarray, " angles"]) -> Float[np.ndarray, " nq"]:
    """The `qpos` of a posture whose lowest box, ball or capsule touches the ground."""
    data = mujoco.MjData(model)
    data.qpos[model.nq - len(angles) :] = angles
    mujoco.mj_kinematics(model, data)
    lowest = []
    for kind, size, place, frame in zip(model.geom_type, model.geom_size, data.geom_xpos, data.geom_xmat, strict=True):
        if kind == mujoco.mjtGeom.mjGEOM_BOX:
            lowest.append(place[2] - np.abs(frame[6:]) @ size)
        elif kind != mujoco.mjtGeom.mjGEOM_PLANE:
            lowest.append(place[2] - size[0] - abs(frame[8]) * size[1])
    data.qpos[2] -= min(lowest)
    return data.qpos.copy()
