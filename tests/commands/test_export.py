"""Robots as MJCF: what plain MuJoCo reads back moves alike, to the six digits of the file. Policies as C: the same
values to rounding, the same actions where no two choices are as good."""

import mujoco
import numpy as np
import pytest
from c_policy import answers
from command_line import told

from humanoid_mjx import InputError
from humanoid_mjx.commands.export import export
from humanoid_mjx.robot import ROBOTS, make_robot


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_file_has_the_robots_dynamics(robot, tmp_path):
    file = tmp_path / f"{robot}.xml"
    assert str(file) in told("export", robot, file).replace("\n", "")
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


@pytest.mark.parametrize("name", ["walk", "stand"])
def test_a_shipped_policy_acts_the_same(tmp_path, name):
    q, found, actions, _ = answers(name, tmp_path)
    # Sums of up to 256 products in another order, through four layers, in single precision.
    tolerance = 2e-4 * q.std()
    np.testing.assert_allclose(found, q, atol=tolerance)
    first, second = np.sort(q, axis=-1)[..., :-3:-1].transpose(2, 0, 1)
    clear = first - second > 2 * tolerance
    assert clear.mean() > 0.99
    np.testing.assert_array_equal(actions[clear], q.argmax(axis=-1)[clear])


def test_only_networks_become_c(tmp_path):
    with pytest.raises(InputError, match="posture_switch: only policies of deep_q can be written as C"):
        export("posture_switch", tmp_path / "policy.c")
