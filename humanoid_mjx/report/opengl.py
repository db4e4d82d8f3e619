# pyright: reportAttributeAccessIssue=false
"""MuJoCo's own renderer wherever it finds OpenGL, without any setting.

MuJoCo takes one way to OpenGL for a whole process, named by MUJOCO_GL before the first import, and drivers that do not
work print, raise or crash. So a separate process paints (`opengl_worker.py`), and `ways.py` says which way to try next.
"""

import copy
import os
import queue
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float

from humanoid_mjx.report import opengl_worker
from humanoid_mjx.report.raycast import LINE, Frame
from humanoid_mjx.report.scene import AZIMUTH, ELEVATION, GRID_M, LIGHT, Scene, colored, make_camera
from humanoid_mjx.report.ways import ways
from humanoid_mjx.types import AnyArray

PATIENCE_S = 120.0
"""A process that has painted nothing for so long, s, is given up. A first picture takes seconds on a busy machine."""

APART = 0.002
"""Share by which each further ball is made smaller: surfaces in the same place would flicker."""


def paint(
    model: mujoco.MjModel, qpos: Float[AnyArray, "frames nq"], scene: Scene, width: int, height: int
) -> Iterator[Frame] | None:
    """The frames of a motion as MuJoCo paints them; nothing where there is no OpenGL.

    Raises:
      RuntimeError: while they are taken, if the renderer stops before the last.
    """
    for way in ways():
        frames = _Frames(model, qpos, scene, (height, width), way)
        first = frames.take()
        if first is not None and first.min() < first.max():
            return _all_of(first, frames, len(qpos))
        frames.close()
    return None


def _all_of(first: Frame, frames: "_Frames", count: int) -> Iterator[Frame]:
    try:
        yield first
        for number in range(1, count):
            frame = frames.take()
            if frame is None:
                raise RuntimeError(f"MuJoCo's renderer stopped after {number} of {count} frames.")
            yield frame
    finally:
        frames.close()


class _Frames:
    """What a worker paints, as far as it gets."""

    def __init__(
        self, model: mujoco.MjModel, qpos: Float[AnyArray, "frames nq"], scene: Scene, size: tuple[int, int], way: str
    ):
        self.size = size
        self._folder = tempfile.TemporaryDirectory(prefix="humanoid-mjx-")
        folder = Path(self._folder.name)
        mujoco.mj_saveModel(_painted(model, scene, size), str(folder / "model.mjb"), None)
        job = {
            "qpos": np.asarray(qpos, np.float64),
            "middle": scene.middle,
            "size": np.array(size),
            "azimuth": AZIMUTH,
            "elevation": ELEVATION,
            "forward": make_camera(size[0]).forward,
            "distance": scene.distance,
            "light": LIGHT,
            "grid": GRID_M if scene.ground else 0.0,
            "grid_color": LINE,
        }
        np.savez(folder / "job.npz", allow_pickle=False, **job)
        environment = os.environ | {"MUJOCO_GL": way}
        environment.pop("PYOPENGL_PLATFORM", None)
        self._process = subprocess.Popen(
            [sys.executable, "-P", str(opengl_worker.__file__), str(folder)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            cwd=folder,
            env=environment,
        )
        self._queue: queue.Queue[bytes | None] = queue.Queue(maxsize=4)
        self._closed = threading.Event()
        threading.Thread(target=self._read, daemon=True).start()

    def take(self) -> Frame | None:
        """The next frame; nothing where the process has ended or does nothing any more."""
        try:
            raw = self._queue.get(timeout=PATIENCE_S)
        except queue.Empty:
            return None
        return None if raw is None else np.frombuffer(raw, np.uint8).reshape(*self.size, 3)

    def close(self) -> None:
        """End the process and remove what it was given."""
        self._closed.set()
        self._process.kill()
        self._process.wait()
        self._folder.cleanup()

    def _read(self) -> None:
        """Runs in a thread, so that `take` can lose patience."""
        assert self._process.stdout is not None
        length = self.size[0] * self.size[1] * 3
        while not self._closed.is_set():
            raw: bytes | None = self._process.stdout.read(length)
            raw = raw if len(raw or b"") == length else None
            while not self._closed.is_set():
                try:
                    self._queue.put(raw, timeout=0.1)
                    break
                except queue.Full:
                    continue
            if raw is None:
                return


def _painted(model: mujoco.MjModel, scene: Scene, size: tuple[int, int]) -> mujoco.MjModel:
    """A copy of the model with the colours of the sides, a soft light and room for the picture."""
    own = copy.copy(model)
    for geom in range(own.ngeom):
        own.geom_rgba[geom] = colored(model, geom)
    own.vis.global_.offheight, own.vis.global_.offwidth = size
    balls = np.flatnonzero(own.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE)
    own.geom_size[balls, 0] *= 1.0 - APART * (1 + np.arange(len(balls)))
    own.vis.headlight.ambient, own.vis.headlight.diffuse = (0.5,) * 3, (0.25,) * 3
    own.vis.headlight.specular = (0.1,) * 3
    own.stat.extent = 2.0 * scene.view
    return own
