"""Does a robot stand on its servo alone? Native MuJoCo says so."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from humanoid_mjx import make_robot
from humanoid_mjx.files import folder
from humanoid_mjx.robot.holding import in_words, tipping


def height_after(robot, factor, seconds):
    """Height of the torso, in units of that at home, after a while on a servo so many times as stiff, or when it lies
    half as high."""
    model = robot.model
    data, (stiffness, damping) = mujoco.MjData(model), robot.servo
    joints = robot.driven
    places, dofs = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    data.qpos[2], data.qpos[places] = robot.start_height, robot.posture
    data.qvel[4] = 0.02  # a little push ahead
    torque = np.empty(model.nu)
    while data.time < seconds and data.qpos[2] > 0.5 * robot.start_height:
        torque[:] = factor * stiffness * (robot.posture - data.qpos[places]) - damping * data.qvel[dofs]
        data.ctrl[:] = np.clip(torque, -robot.torque_limits, robot.torque_limits)
        mujoco.mj_step(model, data)
    return data.qpos[2] / robot.start_height


@pytest.mark.parametrize("name", ["humanoid", "t1", "g1"])
def test_a_robot_tips_over_below_that_stiffness(name, tmp_path):
    if name != "humanoid":
        pytest.importorskip("mujoco_playground")
    if name == "g1":  # with the gains of its file motors give out before it stands
        text = (folder("robots") / "g1.yaml").read_text()
        name = str(tmp_path / "stiffer.yaml")
        Path(name).write_text(f"{text}servo: {{stiffness: 100, damping: 3}}")
    robot = make_robot(name)
    factor, _ = tipping(robot)
    said = [line for line in in_words(robot) if "tips over" in line]
    assert bool(said) == (factor > 1) == (name != "humanoid")
    assert height_after(robot, 1.6 * factor, 10.0) > 0.8
    assert height_after(robot, 0.75 * factor, 10.0) < 0.7
