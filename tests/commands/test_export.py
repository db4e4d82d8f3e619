"""Robots as MJCF files: what plain MuJoCo reads back moves as the robot does, to the six digits of the file."""

import mujoco
import numpy as np
import pytest
from typer.testing import CliRunner

from humanoid_mjx.cli import app
from humanoid_mjx.robot import ROBOTS, make_robot


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_file_has_the_robots_dynamics(robot, tmp_path):
    file = tmp_path / f"{robot}.xml"
    done = CliRunner().invoke(app, ["export", robot, str(file)])
    assert done.exit_code == 0, done.output
    assert str(file) in done.output.replace("\n", "")
    accelerations = []
    for model in (make_robot(robot).spec().compile(), mujoco.MjModel.from_xml_path(str(file))):
        rng = np.random.default_rng(0)
        data = mujoco.MjData(model)
        mujoco.mj_integratePos(model, data.qpos, rng.normal(size=model.nv), 0.1)
        data.qvel, data.ctrl = rng.normal(size=model.nv), rng.uniform(-1, 1, model.nu)
        mujoco.mj_forward(model, data)
        accelerations.append(data.qacc)
    six_digits = 1e-6 * np.abs(accelerations[0]).max()
    np.testing.assert_allclose(*accelerations, rtol=0, atol=six_digits)
