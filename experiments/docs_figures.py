# pyright: reportAttributeAccessIssue=false
"""Make the figures of the documentation again that no record holds.

python experiments/docs_figures.py               # all, in a minute
python experiments/docs_figures.py conventions   # one of them

The film is made by `walk_film.py`; `docs/throughput.py` and `sweep_curves.py` draw records. `maze_learning_curves.png`
is the figure of `humanoid-mjx sweep maze`, `maze_learned.png` that of `humanoid-mjx plot runs/maze --y learned`.
"""

import argparse
import subprocess
import sys
from itertools import product
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from matplotlib.patches import Circle, Polygon
from PIL import Image
from scipy.spatial import ConvexHull

from humanoid_mjx.report.rendering import FPS
from humanoid_mjx.report.style import COLORS, figure
from humanoid_mjx.robot import make_robot
from humanoid_mjx.thesis.leg import BODY_MM, JOINT_NAMES, JOINT_RANGES, SCALE

METRES = {name: mm * 1e-3 * SCALE for name, mm in BODY_MM.items()}
HIP_OFFSET = METRES["torso_length"] / 2
THIGH_LENGTH, SHANK_LENGTH = METRES["upper_leg_height"], METRES["lower_leg_height"]
FOOT_LENGTH, FOOT_HEIGHT = METRES["foot_length"], METRES["foot_height"]
HIP_HEIGHT = THIGH_LENGTH + SHANK_LENGTH + FOOT_HEIGHT

DOCS = Path(__file__).parent.parent / "docs"

# A view is the directions of the world that point to the right and up in it. Its viewer looks along up x right.
SIDE = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
FRONT = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
ABOVE = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])

SENSES = {
    "hip_pitch": (SIDE, "from the right", 40.0, "thigh forward"),
    "hip_yaw": (ABOVE, "from above", 40.0, "toes outwards"),
    "hip_roll": (FRONT, "from the front", 30.0, "leg outwards"),
    "knee_pitch": (SIDE, "from the right", 60.0, "shank back"),
    "ankle_pitch": (SIDE, "from the right", 30.0, "toes down"),
}
"""The joints: the view that shows each best, its name, an angle in degrees, and what that angle does."""

JOINT_COLORS = dict(zip(SENSES, (COLORS[0], COLORS[1], COLORS[2], "#A8497F", "#A06A00"), strict=True))
GHOST, FILL, EDGE = "0.93", "0.80", "0.45"
AXIS_M, EYE_M = 0.045, 0.0085
"""Length of a drawn axis, and radius of the circle where it points out of the page or into it."""

LABELS = {
    "front": ((-0.090, 0.215), (-0.068, 0.172), (-0.068, 0.243), (-0.068, 0.120), (-0.068, 0.025)),
    "side": ((0.028, 0.215), (-0.028, 0.172), (-0.050, 0.215), (-0.028, 0.120), (-0.028, 0.025)),
}
"""Positions of the names of the joints in the large views, m."""


def conventions(path: Path) -> None:
    """The lower body: its sizes, the axes of its joints, and what a positive angle of each does."""
    with figure(path, 2, 10, size=(0.88, 3.85)) as (fig, axes):
        grid = axes[0, 0].get_gridspec()
        grid.set_height_ratios((1.1, 0.9))
        for panel in axes.flat:
            panel.remove()
        large = [fig.add_subplot(grid[0, 5 * k : 5 * k + 5]) for k in range(2)]
        small = [fig.add_subplot(grid[1, 2 * k : 2 * k + 2]) for k in range(5)]
        for panel in (*large, *small):
            panel.set_axis_off()
            panel.set_aspect("equal")
        for panel, draw in zip(large, (_front, _side), strict=True):
            draw(panel)
        for panel, joint in zip(small, SENSES, strict=True):
            _sense(panel, joint)
        fig.text(0.5, 0.012, CAPTION, ha="center", va="bottom", fontsize=8.5, color="0.25", linespacing=1.4)
        fig.get_layout_engine().set(rect=(0.0, 0.065, 1.0, 0.925), h_pad=0.05, w_pad=0.02)
    with Image.open(path) as picture:
        _save(picture, path)


CAPTION = """Above: axes of the right leg's joints; a dot in a circle: towards you, a cross: away from you.
Below: grey, every angle 0; in colour, one joint at a positive angle, with the ranges of Table 3.2 and, in brackets, a \
human's."""


def _save(picture: Image.Image, path: Path) -> None:
    """Save a picture in 256 colours, chosen to be near to all of its own, not to the frequent ones."""
    picture.convert("RGB").quantize(256, method=Image.Quantize.MAXCOVERAGE).save(path, optimize=True)


def _front(panel: Any) -> None:
    model, data = _body({})
    _paint(panel, model, data, FRONT, FILL)
    panel.set_title("seen from the front", loc="center")
    _span(panel, (-HIP_OFFSET, 0.305), (HIP_OFFSET, 0.305), f"{2e3 * HIP_OFFSET:.1f} mm")
    for low, high, name in (
        (HIP_HEIGHT - THIGH_LENGTH, HIP_HEIGHT, "thigh"),
        (HIP_HEIGHT - THIGH_LENGTH - SHANK_LENGTH, HIP_HEIGHT - THIGH_LENGTH, "shank"),
        (0.0, HIP_HEIGHT - THIGH_LENGTH - SHANK_LENGTH, "foot"),
    ):
        _span(panel, (0.075, low), (0.075, high), f" {name} {1e3 * (high - low):.0f} mm", upright=True)
    _arrows(panel, data, FRONT, LABELS["front"])
    _directions(panel, FRONT, (0.115, 0.262), ("x", "y left", "z up"))
    panel.text(-HIP_OFFSET, -0.028, "right leg", ha="center", fontsize=8.5)
    panel.text(HIP_OFFSET, -0.028, "left leg", ha="center", fontsize=8.5)
    panel.set_xlim(-0.155, 0.165)
    panel.set_ylim(-0.04, 0.32)


def _side(panel: Any) -> None:
    model, data = _body({})
    _paint(panel, model, data, SIDE, FILL)
    panel.set_title("seen from the right", loc="center")
    heel = data.geom("right_foot").xpos[0] - FOOT_LENGTH / 2
    _span(panel, (heel, -0.015), (heel + FOOT_LENGTH, -0.015), f"foot {1e3 * FOOT_LENGTH:.0f} mm", below=True)
    _span(panel, (0.1, 0.0), (0.1, HIP_HEIGHT), f" hips {1e3 * HIP_HEIGHT:.0f} mm\n above the ground", upright=True)
    _arrows(panel, data, SIDE, LABELS["side"])
    _directions(panel, SIDE, (0.082, 0.262), ("x forward", "y", "z up"))
    panel.set_xlim(-0.15, 0.17)
    panel.set_ylim(-0.04, 0.32)


def _sense(panel: Any, joint: str) -> None:
    """One joint at a positive angle before the robot at zero."""
    view, words, degrees, meaning = SENSES[joint]
    _paint(panel, *_body({}), view, GHOST, edge="0.75")
    model, data = _body({f"right_{joint}": np.radians(degrees)})
    bodies = _below(model, f"right_{joint}")
    _paint(panel, model, data, view, JOINT_COLORS[joint], bodies=bodies, edge="0.2", alpha=0.75)
    zero = _body({})[1]
    tip = data.geom("right_foot").xpos + data.geom("right_foot").xmat.reshape(3, 3)[:, 0] * FOOT_LENGTH / 2
    start = zero.geom("right_foot").xpos + np.array([FOOT_LENGTH / 2, 0.0, 0.0])
    place = view @ zero.joint(f"right_{joint}").xanchor
    _turn(panel, place, view @ start - place, view @ tip - place, JOINT_COLORS[joint])
    panel.set_title(
        f"{joint} = +{degrees:.0f}°\n{meaning}\n({words})", color=JOINT_COLORS[joint], loc="center", fontsize=9
    )
    spans = [JOINT_RANGES[name][JOINT_NAMES.index(joint)] for name in ("proposed", "human")]
    (low, high), (lowest, highest) = spans
    ranges = f"{low:.0f}° to {high:.0f}°\n({lowest:.0f}° to {highest:.0f}°)"
    panel.text(0.5, -0.01, ranges, fontsize=8.5, ha="center", va="top", transform=panel.transAxes)
    left = {"hip_pitch": -0.05, "hip_yaw": -0.072, "hip_roll": -0.175}.get(joint, -0.12)
    bottom, width = (-0.07, 0.16) if view is ABOVE else (-0.02, 0.24)
    panel.set_xlim(left, left + width)
    panel.set_ylim(bottom, bottom + 1.25 * width)


def _turn(panel: Any, place: np.ndarray, start: np.ndarray, end: np.ndarray, color: str) -> None:
    """An arrow on a circle about `place`, from one direction to another, the short way."""
    first, last = np.arctan2(start[1], start[0]), np.arctan2(end[1], end[0])
    last = first + (last - first + np.pi) % (2 * np.pi) - np.pi
    radius = 1.06 * max(np.linalg.norm(start), np.linalg.norm(end))
    angles = np.linspace(first, last, 40)
    path = place + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    panel.plot(*path.T, color=color, linewidth=1.6)
    panel.annotate("", path[-1], path[-4], arrowprops={"arrowstyle": "-|>", "color": color, "linewidth": 1.6})


def _arrows(panel: Any, data: Any, view: np.ndarray, labels: Any) -> None:
    """The axes of the right leg's joints in a view: arrows, or circles where they point out of the page or into it."""
    towards = np.cross(view[0], view[1])
    for joint, label in zip(JOINT_NAMES, labels, strict=True):
        found = data.joint(f"right_{joint}")
        place, axis, color = view @ found.xanchor, np.round(view @ found.xaxis, 6), JOINT_COLORS[joint]
        if axis.any():
            arrow = {"arrowstyle": "-|>", "color": color, "linewidth": 2.0, "shrinkA": 0, "shrinkB": 0}
            panel.annotate("", place + AXIS_M * axis, place, arrowprops=arrow)
        else:
            _eye(panel, place, found.xaxis @ towards > 0, color)
        panel.text(*label, joint, color=color, fontsize=10, ha="left" if label[0] > 0 else "right", va="center")


def _eye(panel: Any, place: np.ndarray, towards: bool, color: str) -> None:
    """A circle with a dot for an axis that points to the viewer, with a cross for one that points away."""
    panel.add_patch(Circle(tuple(place), EYE_M, facecolor="white", edgecolor=color, linewidth=1.8, zorder=3))
    if towards:
        panel.add_patch(Circle(tuple(place), EYE_M / 3, color=color, zorder=4))
        return
    for slope in (1, -1):
        reach = EYE_M / np.sqrt(2) * np.array([1.0, slope])
        panel.plot(*np.stack([place - reach, place + reach]).T, color=color, linewidth=1.6, zorder=4)


def _directions(panel: Any, view: np.ndarray, corner: tuple[float, float], names: tuple[str, str, str]) -> None:
    """The directions of the world that lie in a view."""
    for direction, name in zip(np.eye(3), names, strict=True):
        flat = view @ direction
        if not flat.any():
            continue
        tip = np.array(corner) + 0.032 * flat
        panel.annotate("", tip, corner, arrowprops={"arrowstyle": "-|>", "color": "0.25", "linewidth": 1.1})
        panel.text(
            *(tip + 0.006 * flat), name, fontsize=8, color="0.25", ha="left" if flat[0] else "center", va="center"
        )


def _span(panel: Any, start: Any, end: Any, words: str, upright: bool = False, below: bool = False) -> None:
    """A length with its number."""
    arrow = {"arrowstyle": "<->", "color": "0.4", "linewidth": 0.9, "shrinkA": 0, "shrinkB": 0}
    panel.annotate("", end, start, arrowprops=arrow)
    middle = (np.array(start) + end) / 2
    if upright:
        panel.text(*middle, words, fontsize=8, color="0.3", va="center", ha="left")
    else:
        shift, side = (-0.005, "top") if below else (0.003, "bottom")
        panel.text(middle[0], middle[1] + shift, words, fontsize=8, color="0.3", ha="center", va=side)


def _body(angles: dict[str, float], robot: str = "lower_body") -> tuple[Any, Any]:
    """The standing lower body, or another robot, with some joints at angles, rad."""
    model = make_robot(robot).spec().compile()
    data = mujoco.MjData(model)
    for name, angle in angles.items():
        data.joint(name).qpos[:] = angle
    mujoco.mj_forward(model, data)
    return model, data


def _below(model: Any, joint: str) -> set[int]:
    """The bodies that a joint moves."""
    moved = {int(model.joint(joint).bodyid[0])}
    for body in range(model.nbody):
        if int(model.body_parentid[body]) in moved:
            moved.add(body)
    return moved


def _paint(
    panel: Any,
    model: Any,
    data: Any,
    view: np.ndarray,
    color: str,
    bodies: set[int] | None = None,
    edge: str = EDGE,
    alpha: float = 1.0,
) -> None:
    """The outlines of the bodies in a view, the nearest last, and the ground where it is seen from its side."""
    towards = np.cross(view[0], view[1])
    if view is not ABOVE and bodies is None and (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE).any():
        panel.axhline(0.0, color="0.6", linewidth=1.0, zorder=0)
    geoms = [g for g in range(model.ngeom) if model.geom_group[g] < 3 and model.geom_bodyid[g]]
    for geom in sorted(geoms, key=lambda g: data.geom_xpos[g] @ towards):
        if bodies is not None and model.geom_bodyid[geom] not in bodies:
            continue
        points = _surface(model, data, geom, view) @ view.T
        panel.add_patch(
            Polygon(
                points[ConvexHull(points).vertices],
                facecolor=color,
                edgecolor=edge,
                linewidth=0.9,
                alpha=alpha,
                zorder=1,
            )
        )


def _surface(model: Any, data: Any, geom: int, view: np.ndarray) -> np.ndarray:
    """Points whose hull in the view is that of a box, ball or capsule."""
    size, place, frame = model.geom_size[geom], data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3)
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
        return place + (np.array(list(product((-1, 1), repeat=3))) * size) @ frame.T
    angles = np.linspace(0.0, 2.0 * np.pi, 48)[:, None]
    ring = size[0] * (np.cos(angles) * view[0] + np.sin(angles) * view[1])
    half = size[1] if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CAPSULE else 0.0
    return np.concatenate([place + ring + sign * half * frame[:, 2] for sign in (-1, 1)])


MOMENTS_S = (0.0, 1.24, 3.24, 5.24, 7.24, 9.24)
"""Frames of `stand`: the beginning, and each push while its arrow is drawn."""


def stand(path: Path) -> None:
    """Six moments of the shipped policy of `stand`, in two rows."""
    film = path.with_suffix(".gif")
    subprocess.run([sys.executable, "-m", "humanoid_mjx", "play", "stand", "--out", str(film)], check=True)
    with Image.open(film) as frames:
        width, height = frames.size
        rows = Image.new("RGB", (3 * width, 2 * height))
        for number, seconds in enumerate(MOMENTS_S):
            frames.seek(round(seconds * FPS))
            rows.paste(frames.convert("RGB"), (number % 3 * width, number // 3 * height))
    film.unlink()
    _save(rows, path)


def legs(path: Path) -> None:
    """The chain of Table 4.1 as two legs, with the axes of the right one's joints."""
    model, data = _body({}, "legs")
    with figure(path, 1, 2, size=(4.4, 4.9)) as (_, axes):
        views = {"front": (FRONT, ("x", "y left", "z up")), "right": (SIDE, ("x forward", "y", "z up"))}
        for panel, (words, (view, names)) in zip(axes[0], views.items(), strict=True):
            _paint(panel, model, data, view, FILL)
            heights = [data.joint(f"right_{joint}").xanchor[2] for joint in JOINT_NAMES]
            left = -0.105 if view is FRONT else -0.055
            raised = (0.0, -0.025, 0.0, 0.0, 0.0) if view is FRONT else (0.02, -0.015, -0.005, 0.0, 0.0)
            _arrows(panel, data, view, [(left, height + up) for height, up in zip(heights, raised, strict=True)])
            _directions(panel, view, (0.1, -0.02), names)
            panel.set_title(f"seen from the {words}", loc="center")
            panel.set_axis_off()
            panel.set_aspect("equal")
            panel.set(xlim=(-0.17, 0.17), ylim=(-0.3, 0.04))


FIGURES = {make.__name__: make for make in (conventions, stand, legs)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("figures", nargs="*", metavar="FIGURE", help=f"{', '.join(FIGURES)}")
    parser.add_argument("--out", type=Path, default=DOCS, help="the folder")
    chosen = parser.parse_args()
    if odd := [name for name in chosen.figures if name not in FIGURES]:
        parser.error(f"there is no figure {odd[0]}; there are {', '.join(FIGURES)}")
    for name in chosen.figures or FIGURES:
        target = chosen.out / f"{name}.png"
        FIGURES[name](target)
        print(target)


if __name__ == "__main__":
    main()
