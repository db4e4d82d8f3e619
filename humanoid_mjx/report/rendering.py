# pyright: reportAttributeAccessIssue=false
"""Motions as pictures and videos: by MuJoCo's renderer where it finds OpenGL, else as stick figures.

MuJoCo's renderer needs a display, or the environment variable MUJOCO_GL set to egl (a GPU) or osmesa (a CPU).
"""

import os
import shutil
import subprocess
from collections.abc import Callable
from functools import partial
from itertools import combinations, product
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from humanoid_mjx.report.style import COLORS
from humanoid_mjx.spec import InputError
from humanoid_mjx.types import AnyArray

WIDTH, HEIGHT = 480, 360
STRIP = 6
"""Frames side by side where a motion becomes one picture."""

VIEW_M = 0.36
"""What the pictures show from top to bottom, at least: the standing body and some room."""

Frame = UInt8[np.ndarray, "height width 3"]


def render(model: mujoco.MjModel, qpos: Float[AnyArray, "frames nq"], path: Path, fps: float = 25.0) -> Path:
    """Write a motion to a file: .gif or .mp4 as a video, .png as up to six of its frames side by side.

    Args:
      model: of the robot.
      qpos: the motion, a row for each frame.
      path: the file; its folder is made where there is none.
      fps: frames a second.

    Raises:
      InputError: another kind of file, or .mp4 where there is no ffmpeg.
    """
    if path.suffix not in (".gif", ".mp4", ".png"):
        raise InputError(f"{path}: the file must end in .gif, .mp4 or .png.")
    if path.suffix == ".mp4" and shutil.which("ffmpeg") is None:
        raise InputError(f"{path}: .mp4 needs the program ffmpeg, which is not installed; .gif needs nothing.")
    path.parent.mkdir(parents=True, exist_ok=True)
    motion = np.asarray(qpos, np.float64)
    if path.suffix == ".png":
        motion = motion[np.unique(np.linspace(0, len(motion) - 1, STRIP).astype(int))]
    frames = draw(model, motion)
    if path.suffix == ".png":
        Image.fromarray(np.concatenate(frames, axis=1)).save(path)
    elif path.suffix == ".gif":
        first, *rest = map(Image.fromarray, frames)
        first.save(path, save_all=True, append_images=rest, duration=1000 / fps, loop=0)
    else:
        _encode(frames, path, fps)
    return path


def render_motion(
    model: mujoco.MjModel, qpos: Float[AnyArray, "rows nq"], step_s: float, path: Path, fps: float = 25.0
) -> Path:
    """`render` a motion at its own speed, given a row every `step_s`, s; between rows it is drawn as even."""
    rows = np.arange(0.0, len(qpos) - 0.999, 1.0 / (fps * step_s))
    columns = [np.interp(rows, np.arange(len(qpos)), column) for column in np.asarray(qpos, np.float64).T]
    return render(model, np.stack(columns, axis=1), path, fps)


def draw(model: mujoco.MjModel, qpos: Float[np.ndarray, "frames nq"]) -> list[Frame]:
    """A picture of each posture."""
    data, frames = mujoco.MjData(model), []
    view = _view(model, qpos)
    paint = _renderer(model, view) or partial(_sticks, view=view)
    for row in qpos:
        data.qpos = row
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        frames.append(paint(model, data))
    return frames


def _view(model: mujoco.MjModel, qpos: Float[np.ndarray, "frames nq"]) -> float:
    """Metres from top to bottom in which every posture has room."""
    data, reach = mujoco.MjData(model), 0.0
    for row in qpos:
        data.qpos = row
        mujoco.mj_kinematics(model, data)
        reach = max(reach, np.abs(data.xpos[1:] - _middle(model, data)).max())
    return max(VIEW_M, 2.1 * reach)


def _renderer(model: mujoco.MjModel, view: float) -> Callable[[mujoco.MjModel, mujoco.MjData], Frame] | None:
    """MuJoCo's renderer, or nothing where it finds no OpenGL."""
    if not (os.environ.get("MUJOCO_GL") or os.environ.get("DISPLAY")):
        return None
    try:
        renderer = mujoco.Renderer(model, HEIGHT, WIDTH)
    except Exception:  # what it raises depends on the back end
        return None
    camera = mujoco.MjvCamera()
    camera.distance, camera.azimuth, camera.elevation = 2.0 * view, 130.0, -12.0

    def paint(model: mujoco.MjModel, data: mujoco.MjData) -> Frame:
        camera.lookat = _middle(model, data)
        renderer.update_scene(data, camera)
        return renderer.render()

    return paint


def _middle(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """The middle of the picture: it follows the robot over the ground, not up and down, or hangs below it."""
    height = 0.42 * VIEW_M if _has_ground(model) else model.body_pos[1][2] - 0.33 * VIEW_M
    return np.array([*data.xpos[1][:2], height])


def _has_ground(model: mujoco.MjModel) -> bool:
    return bool((model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE).any())


def _sticks(model: mujoco.MjModel, data: mujoco.MjData, view: float) -> Frame:
    """Seen from the right and from the front: a line from each joint to the next, boxes by their edges."""
    figure = Figure(figsize=(WIDTH / 100, HEIGHT / 100), dpi=100)
    figure.subplots_adjust(left=0.08, right=0.98, bottom=0.07, top=0.92, wspace=0.2)
    canvas = FigureCanvasAgg(figure)
    middle = _middle(model, data)
    for axis, across, title in zip(figure.subplots(1, 2), (0, 1), ("from the right", "from the front"), strict=True):
        if _has_ground(model):
            axis.axhline(0.0, color="0.6", linewidth=1.0)
        for line, color in outline(model, data):
            axis.plot(line[:, across], line[:, 2], color=color, linewidth=1.5, solid_capstyle="round")
        half = view / 2
        axis.set_xlim(middle[across] - half, middle[across] + half)
        axis.set_ylim(middle[2] - half, middle[2] + half)
        axis.set_aspect("equal")
        axis.set_title(title, fontsize=8)
        axis.tick_params(labelsize=6)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def outline(model: mujoco.MjModel, data: mujoco.MjData) -> list[tuple[np.ndarray, str]]:
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


def _encode(frames: list[Frame], path: Path, fps: float) -> None:
    """Let ffmpeg make a video that browsers play."""
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{WIDTH}x{HEIGHT}", "-r", str(fps), "-i", "-"]
    command = ["ffmpeg", "-y", "-loglevel", "error", *raw, "-pix_fmt", "yuv420p", str(path)]
    done = subprocess.run(command, input=np.stack(frames).tobytes(), capture_output=True)
    if done.returncode:
        raise RuntimeError(f"ffmpeg could not write {path}: {done.stderr.decode(errors='replace').strip()}")
