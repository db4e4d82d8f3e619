"""`info ROBOT.xml` says yes where `make_physics("tree", ...)` does, and names the same things where it does not."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from humanoid_mjx.commands.info import survey
from humanoid_mjx.physics import make_physics
from humanoid_mjx.robot import Robot
from humanoid_mjx.spec import InputError

ARM = """<mujoco>{extra}<worldbody><geom name="floor" type="plane" size="0 0 1"/>
<body name="upper"><joint name="shoulder" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02"/>
<body name="lower" pos="0 0 -.2"><joint name="elbow" axis="0 1 0" damping=".1"/><site name="tip"/>
<geom name="hand" size=".03" pos="0 0 -.2"/></body></body>{bodies}</worldbody><actuator>{motors}</actuator></mujoco>"""


class Arm(Robot):
    """Two hinges."""

    xml: str

    def spec(self, timestep=None):
        return mujoco.MjSpec.from_string(self.xml)


MOTORS = {
    '<motor joint="elbow" ctrlrange="-5 5"/>': None,
    '<motor joint="elbow"/><motor joint="elbow" gear="-3"/>': None,
    "": None,
    '<motor joint="elbow" delay=".02" nsample="20"/>': "the delay of motor 0 of joint 'elbow'",
    '<motor name="m" joint="elbow" damping="3"/>': "the damping of motor 'm'",
    '<motor name="m" joint="elbow" damping="0 3"/>': "the dampingpoly of motor 'm'",
    '<motor name="m" joint="elbow" armature="3"/>': "the armature of motor 'm'",
    '<position joint="elbow" kp="3"/>': "the biastype of motor 0 of joint 'elbow'",
    '<velocity name="m" joint="elbow" kv="3"/>': "the biastype of motor 'm'",
    '<damper name="m" joint="elbow" kv="3" ctrlrange="0 1"/>': "the gaintype of motor 'm'",
    '<general name="m" joint="elbow" dyntype="filter"/>': "the dyntype of motor 'm'",
    '<general name="m" joint="elbow" dyntype="integrator" actearly="true"/>': "the dyntype of motor 'm'",
    '<intvelocity name="m" joint="elbow" kp="3" actrange="-1 1"/>': "the biastype of motor 'm'",
    '<muscle name="m" joint="elbow" lengthrange="0 1"/>': "the gaintype of motor 'm'",
    '<dcmotor name="m" joint="elbow" motorconst=".1" resistance="2"/>': "the gaintype of motor 'm'",
    '<adhesion name="m" body="upper" ctrlrange="0 1"/>': "the trntype of motor 'm'",
    '<motor name="m" jointinparent="elbow"/>': "the trntype of motor 'm'",
    '<motor name="m" site="tip"/>': "the trntype of motor 'm'",
    '<motor joint="shoulder"/><motor joint="elbow" ctrlrange="-1 2"/>': "the ctrlrange of motor 1 of joint 'elbow'",
    '<motor joint="elbow" forcerange="0 2"/>': "the forcerange of motor 0 of joint 'elbow'",
}

PLUGIN = """<extension><plugin plugin="mujoco.sensor.touch_grid"><instance name="p"><config key="size" value="1 1"/>
<config key="fov" value="45 45"/><config key="gamma" value="0"/></instance></plugin></extension>"""
EXTRA = {
    '<option><flag clampctrl="disable"/></option>': "the ctrllimited of motor 0 of joint 'elbow'",
    '<option integrator="discrete"/>': "the discrete integrator",
    '<sensor><gyro name="gyroscope" site="tip" cutoff="1"/></sensor>': "the cutoff of sensor 'gyroscope'",
    '<option><flag override="enable"/></option>': "the flag override",
    '<equality><joint name="e" joint1="elbow"/></equality>': "equality constraints",
    PLUGIN: "plugins",
}

BODIES = {
    '<body name="hand" mocap="true"/>': "the mocapid of body 'hand'",
    '<body><joint name="b" type="ball"/><geom size=".1"/></body>': "ball joints, as 'b'",
    '<body gravcomp="1" name="b"><joint name="j"/><geom size=".1"/></body>': "the gravcomp of body 'b'",
    '<body><joint name="j" springyield="2" stiffness="1"/><geom size=".1"/></body>': "the springyield of joint 'j'",
    '<body><joint stiffness="1 2"/><geom size=".1"/></body>': "the stiffnesspoly of joint 2",
    '<body><joint damping="1 2"/><geom size=".1"/></body>': "the dampingpoly of joint 2",
    '<body><joint/><geom size=".1" name="odd" mass="inf"/></body>': "the mass of body 3",
    '<body><joint/><geom size="inf" name="odd" mass="1"/></body>': "the size of geom 'odd'",
}


def cases():
    motor = '<motor joint="elbow" ctrlrange="-5 5"/>'
    for xml, words in MOTORS.items():
        yield ARM.format(extra="", bodies="", motors=xml), words
    for xml, words in EXTRA.items():
        yield ARM.format(extra=xml, bodies="", motors=motor), words
    for xml, words in BODIES.items():
        yield ARM.format(extra="", bodies=xml, motors=motor), words


@pytest.mark.parametrize(("xml", "words"), list(cases()))
def test_info_and_the_physics_answer_alike(xml, words, tmp_path):
    (tmp_path / "arm.xml").write_text(xml)
    lines, taken = survey(str(tmp_path / "arm.xml"))
    assert taken == (words is None)
    if words is None:
        make_physics("tree", robot=Arm(xml=xml))
        return
    assert any(line.startswith(f"  {words}; to change: ") for line in lines), lines
    with pytest.raises(InputError) as error:
        make_physics("tree", robot=Arm(xml=xml))
    assert words in str(error.value) and "\n" not in str(error.value)


SLIDES = """<mujoco><worldbody><geom size=".1"/><geom type="capsule" size=".1 .05" pos="1 0 0"/>
<body pos="0 0 .203"><joint type="slide" axis="0 0 1"/><geom size=".1"/></body>
<body pos="1 0 .203"><joint type="slide" axis="0 0 1"/><geom type="capsule" size=".1 .05" euler="0 90 0"/></body>
</worldbody></mujoco>"""


def test_shapes_that_only_slide_rest_on_each_other():
    """Nothing turns, so that the mass matrix and the shapes' directions are constants; there is no motor."""
    physics = make_physics("tree", robot=Arm(xml=SLIDES))
    world = physics.start(physics.qpos0, jnp.zeros(2))
    world = jax.jit(lambda world: physics.run(world, lambda stages: jnp.zeros(0), cycles=30))(world)
    data = mujoco.MjData(physics.model)
    mujoco.mj_step(physics.model, data, 30)
    assert data.ncon == 2
    np.testing.assert_allclose(world.qpos, data.qpos, atol=1e-6)


@pytest.mark.parametrize("motor", ['<motor name="m" site="tip"/>', '<adhesion name="m" body="b5" ctrlrange="0 1"/>'])
def test_a_motor_of_a_body_or_site_beyond_the_joints_is_refused_in_one_sentence(motor):
    bodies = "".join(f'<body name="b{k}"><site name="s{k}"/><geom size=".1"/></body>' for k in range(6))
    robot = Arm(xml=ARM.format(extra="", bodies=bodies, motors=motor.replace("tip", "s5")))
    with pytest.raises(InputError, match="robot: motor 'm' drives no joint; take a <motor> with joint="):
        _ = robot.joints
    with pytest.raises(InputError, match="no physics takes the trntype of motor 'm'"):
        make_physics("mujoco", robot=robot)


def test_bodies_without_a_name_move_in_native_mujoco():
    """Its sensors find bodies by name; a body of the model has the name that the first of these would get."""
    nameless = '<body><joint/><geom size=".1"/></body><body name="body4"><geom size=".1"/></body>'
    robot = Arm(xml=ARM.format(extra="", bodies="<body/>" + nameless, motors=""))
    physics = make_physics("mujoco", robot=robot)
    world = physics.run(physics.start(np.full(3, 0.1), np.zeros(3)), lambda stages: jnp.zeros(0), cycles=5)
    data = mujoco.MjData(mujoco.MjModel.from_xml_string(robot.xml))
    data.qpos[:] = 0.1
    mujoco.mj_step(data.model, data, 5)
    np.testing.assert_allclose(world.qpos, data.qpos, atol=1e-6)


def test_mujocos_messages_are_said_once_and_by_the_package(tmp_path, recwarn):
    xml = ARM.format(extra='<compiler settotalmass="9"/>', bodies="", motors="")
    (tmp_path / "arm.xml").write_text(xml)
    lines, _ = survey(str(tmp_path / "arm.xml"))
    assert len([line for line in lines if line.startswith("MuJoCo warns  compiler attribute")]) == 1
    assert not recwarn.list
    plugin = '<extension><plugin plugin="mujoco.pid"><instance name="p"/></plugin></extension>'
    (tmp_path / "arm.xml").write_text(ARM.format(extra=plugin, bodies="", motors=""))
    with pytest.raises(InputError) as error:
        survey(str(tmp_path / "arm.xml"))
    assert str(error.value).count("actuator not found for plugin instance 0") == 1
