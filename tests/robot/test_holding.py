"""Does a robot stand on its servo alone? Native MuJoCo says so."""

from importlib.util import find_spec
from pathlib import Path

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
import yaml
from tree_robots import FOUR_LEGS

from humanoid_mjx import make_robot
from humanoid_mjx.files import folder
from humanoid_mjx.robot.holding import in_words, standing, tipping
from humanoid_mjx.tasks.legged.gait import Steps


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
    if name != "humanoid":  # with the gains of their files motors give out before they stand
        if find_spec("mujoco_playground") is None:
            pytest.skip("no package mujoco_playground")
        text = (folder("robots") / f"{name}.yaml").read_text()
        name = str(tmp_path / "stiffer.yaml")
        Path(name).write_text(f"{text}servo: {{stiffness: 100, damping: 3}}")
    robot = make_robot(name)
    factor, _ = tipping(robot)
    said = [line for line in in_words(robot) if "tips over" in line]
    assert bool(said) == (factor > 1) == (name != "humanoid")
    assert height_after(robot, 1.6 * factor, 10.0) > 0.8
    assert height_after(robot, 0.75 * factor, 10.0) < 0.7


NECK = """<freejoint/><body pos="0 0 .1"><joint name="neck" axis="0 1 0" damping=".5" stiffness="20"/>
  <geom pos="0 0 .05" size=".05" mass=".5" contype="0" conaffinity="0"/></body>"""


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("<freejoint/>", "<freejoint/>"),
        ('range="-80 80"', 'range="-80 80" stiffness="10" springref="10"'),
        ('name="trunk"', 'name="trunk" gravcomp="0.6"'),
        ('name="calf"', 'name="calf" gravcomp="1"'),
        ("<freejoint/>", NECK),
    ],
)
def test_the_servo_gives_the_torques_that_weight_and_springs_ask_for(old, new, tmp_path):
    """After two seconds of native MuJoCo. Feet that slide a little pull sideways, hence 5 %."""
    joints = [f"{kind}_{i}_{j}" for kind in ("hip", "knee") for i in "01" for j in "01"]
    motors = "".join(f'<motor joint="{joint}" ctrlrange="-50 50"/>' for joint in joints)
    text = FOUR_LEGS.replace("</mujoco>", f"<actuator>{motors}</actuator></mujoco>")
    assert old in text
    (tmp_path / "base.xml").write_text(text.replace(old, new, 1))
    feet = ", ".join(f"calf_{i}_{j}" for i in "01" for j in "01")
    keys = f'model: base.xml\nhome: {{"hip.*": 35, "knee.*": -70}}\nfeet: [{feet}]\n'
    (tmp_path / "robot.yaml").write_text(f"{keys}servo: {{stiffness: 300, damping: 3}}\n")
    robot = make_robot(str(tmp_path / "robot.yaml"))
    model, data = robot.model, mujoco.MjData(robot.model)
    places, dofs = model.jnt_qposadr[robot.driven], model.jnt_dofadr[robot.driven]
    data.qpos[2], data.qpos[places] = robot.start_height, robot.posture
    while data.time < 2.0:
        data.ctrl[:] = 300 * (robot.posture - data.qpos[places]) - 3 * data.qvel[dofs]
        mujoco.mj_step(model, data)
    torque, _ = standing(robot)
    np.testing.assert_allclose(torque, np.abs(data.ctrl), rtol=0.05, atol=0.05 * torque.max())
    assert tipping(robot)[0] < 1


def softer(path, times, **keys):
    """The humanoid's YAML in a folder, its servo so many times as soft, with other keys; None takes one out."""
    data = yaml.safe_load((folder("robots") / "humanoid.yaml").read_text())
    data["model"] = str(folder("robots") / data["model"])
    firm = make_robot("humanoid")
    gains = [dict(zip(firm.joints, (each / times).tolist(), strict=True)) for each in firm.servo]
    data["servo"] = dict(zip(("stiffness", "damping"), gains, strict=True))
    data = {key: value for key, value in (data | keys).items() if value is not None}
    (path / "soft.yaml").write_text(yaml.safe_dump(data, sort_keys=False))
    return str(path / "soft.yaml")


def again(robot):
    """The robot as the config of a run has it."""
    values = robot.model_dump()
    return make_robot(values.pop("name"), **values)


def test_soft_robots_are_told_to_go_farther(tmp_path):
    firm = make_robot("humanoid")
    assert tipping(firm)[0] < 1 and (firm.steps, firm.rests) == (1.0, True)
    name = softer(tmp_path, 8.0)
    robot = make_robot(name)
    factor = tipping(robot)[0]
    assert factor == pytest.approx(8.0 * tipping(firm)[0], rel=1e-6) and robot.shares == firm.shares
    assert robot.steps == pytest.approx(factor**0.4, rel=0.05) and not robot.rests
    assert any(f"sway {robot.steps:g} times as far" in line for line in in_words(robot))
    assert again(robot) == robot
    plain = make_robot(softer(tmp_path, 8.0, shares=None))
    assert plain.steps == robot.steps and len(set(plain.shares)) == 1
    assert plain.shares[0] == pytest.approx(tipping(plain)[0] ** 0.6, rel=0.05)
    assert again(plain) == plain


def test_what_a_yaml_says_and_runs_of_before_hold(tmp_path):
    name = softer(tmp_path, 8.0, steps=1.5)
    assert make_robot(name).steps == 1.5 and again(make_robot(name)) == make_robot(name)
    still = make_robot(softer(tmp_path, 8.0, rests=True))
    assert still.rests and still.steps > 1 and again(still) == still
    before = make_robot(softer(tmp_path, 8.0, shares=None))
    stored = make_robot(before.name, content=before.content)  # of a run of before the key
    assert (stored.steps, stored.shares, stored.rests) == (1.0, (), True)


def test_who_would_tip_over_steps_on_the_spot_when_told_to_stand(tmp_path):
    """Within a cycle the clock of a robot that rests stays at 0; the other's goes round, and lifts the feet."""
    soft = make_robot(softer(tmp_path, 8.0))
    for robot in soft, soft.model_copy(update={"rests": True}):
        gait, still, lifted = Steps(period=0.5), jnp.zeros(3), []
        clock = gait.start(jnp.float32(0.1), robot)
        for _ in range(25):
            clock = gait.after(clock, still, 0.02, robot)
            lifted.append(np.abs(gait.reference(clock, still, robot)).max())
        assert float(clock.phase) == pytest.approx(0.0 if robot.rests else 0.1, abs=1e-5)
        assert (max(lifted) > 0.2) == (not robot.rests) and min(lifted) < 0.05


LEG = """
<body name="hip_SIDE" pos="0 Y 0"><joint name="roll_SIDE" axis="1 0 0"/><geom type="sphere" size=".03" mass=".2"/>
  <body name="foot_SIDE" pos="0 0 -.2"><joint name="yaw_SIDE" axis="0 0 1"/>
    <geom name="sole_SIDE" type="box" size=".08 .04 .01" mass=".2"/></body></body>"""


def test_a_robot_that_its_flat_feet_hold_is_not_soft(tmp_path):
    """Four joints and two feet that stay where they are leave no freedom."""
    legs = LEG.replace("SIDE", "r").replace("Y", "-.1") + LEG.replace("SIDE", "l").replace("Y", ".1")
    joints = [f"{name}_{side}" for side in "rl" for name in ("roll", "yaw")]
    motors = "".join(f'<motor joint="{joint}" ctrllimited="true" ctrlrange="-20 20"/>' for joint in joints)
    trunk = '<body name="trunk" pos="0 0 .3"><freejoint/><geom type="box" size=".1 .1 .05" mass="3"/>'
    text = f"<mujoco><worldbody>{trunk}{legs}</body></worldbody><actuator>{motors}</actuator></mujoco>"
    (tmp_path / "b.xml").write_text(text)
    (tmp_path / "b.yaml").write_text(
        "model: b.xml\nfeet: [sole_r, sole_l]\nmirror: {_r: _l}\nservo: {stiffness: 0.1}\n"
    )
    robot = make_robot(str(tmp_path / "b.yaml"))
    assert tipping(robot) == (0.0, 0) and (robot.steps, robot.shares) == (1.0, ())
