# pyright: reportAttributeAccessIssue=false
"""Paint a motion by MuJoCo's renderer, in a separate process that `opengl.py` starts.

    python -P opengl_worker.py FOLDER

FOLDER holds `model.mjb` and `job.npz`. Frames go to standard output as they are painted, red, green and blue a byte
each. Whatever a driver prints goes nowhere, and where it crashes only this process ends. It imports nothing of its
package, which would take longer than to paint.
"""

import os
import sys
from pathlib import Path

import mujoco
import numpy as np

GRID_LINES = 31
LINE_M = 0.0015
BACKDROP_M = 4.0


def main(folder: Path) -> None:
    """Paint what the folder describes."""
    frames = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    model = mujoco.MjModel.from_binary_path(str(folder / "model.mjb"))
    with np.load(folder / "job.npz") as file:
        job = {name: file[name] for name in file.files}
    height, width = (int(x) for x in job["size"])
    renderer, data, camera = mujoco.Renderer(model, height, width), mujoco.MjData(model), mujoco.MjvCamera()
    camera.azimuth, camera.elevation, camera.distance = job["azimuth"], job["elevation"], job["distance"]
    for qpos, middle in zip(job["qpos"], job["middle"], strict=True):
        data.qpos = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_camlight(model, data)
        camera.lookat = middle
        renderer.update_scene(data, camera)
        _add_light(renderer.scene, job["light"], middle)
        if job["grid"] > 0:
            _add_grid(renderer.scene, float(job["grid"]), middle, job["grid_color"])
        if not (model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX).any():
            _add_backdrop(renderer.scene, job["forward"], middle)
        frames.write(renderer.render().tobytes())
        frames.flush()


def _add_light(scene: mujoco.MjvScene, direction: np.ndarray, middle: np.ndarray) -> None:
    """A lamp far away, whose light throws shadows."""
    light = scene.lights[scene.nlight]
    light.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    light.pos, light.dir = middle - 2.0 * direction, direction
    light.attenuation, light.cutoff, light.exponent = (1.0, 0.0, 0.0), 60.0, 0.0
    light.ambient, light.diffuse, light.specular = (0.0,) * 3, (0.45,) * 3, (0.1,) * 3
    light.headlight, light.castshadow, light.texid = 0, 1, -1
    light.intensity, light.range, light.bulbradius = 0.0, 10.0, 0.02
    scene.nlight += 1


def _add_grid(scene: mujoco.MjvScene, spacing: float, middle: np.ndarray, color: np.ndarray) -> None:
    """Lines on the ground about the robot."""
    reach = spacing * (GRID_LINES // 2)
    near = np.rint(middle[:2] / spacing) * spacing
    for across in (0, 1):
        for place in np.linspace(-reach, reach, GRID_LINES):
            center, size = np.array([*near, 0.0002]), np.array([reach, reach, 0.0002])
            center[across] += place
            size[across] = LINE_M / 2
            _add_box(scene, size, center, np.eye(3), np.array([*color, 1.0]))


def _add_backdrop(scene: mujoco.MjvScene, forward: np.ndarray, middle: np.ndarray) -> None:
    """A white wall behind the robot where the model has no sky, which would otherwise be black."""
    aside = np.cross(forward, [0.0, 0.0, 1.0])
    aside /= np.linalg.norm(aside)
    turn = np.stack([aside, np.cross(aside, forward), -forward], axis=1)
    size = np.array([3.0 * BACKDROP_M, 3.0 * BACKDROP_M, 0.01])
    _add_box(scene, size, middle + BACKDROP_M * forward, turn, np.ones(4)).emission = 1.0


def _add_box(
    scene: mujoco.MjvScene, size: np.ndarray, center: np.ndarray, turn: np.ndarray, color: np.ndarray
) -> mujoco.MjvGeom:
    geom = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(geom, mujoco.mjtGeom.mjGEOM_BOX, size, center, turn.reshape(-1), color.astype(np.float32))
    geom.castshadow = 0
    scene.ngeom += 1
    return geom


if __name__ == "__main__":
    main(Path(sys.argv[1]))
