"""What trees may have, each on a robot as small as can be, against native MuJoCo with a converged solver."""

import mujoco
import numpy as np
import pytest
from tree_robots import converged, dropped, native, qacc_of

from humanoid_mjx.mechanics.tree.folding import fold
from humanoid_mjx.mechanics.tree.reading import read_tree
from humanoid_mjx.mechanics.tree.step import Values

PLANAR = """
<mujoco>
  <option {option}/>
  <worldbody>
    <geom type="plane" size="0 0 1"/>
    <body pos="0 0 0.35">
      <joint type="slide" axis="1 0 0"/>
      <joint type="slide" axis="0 0 1" ref="0.1" stiffness="3" springref="0.2"/>
      <joint type="hinge" axis="0 1 0"/>
      <geom type="capsule" fromto="-0.1 0 0 0.1 0 0" size="0.04" mass="2"/>
      <body pos="0.05 0 -0.02">
        <joint name="hip" axis="0 1 0" pos="0 0 0.02" damping="0.3" frictionloss="0.4" solreffriction="0.03 1"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.15" size="0.02" mass="0.4" contype="0"/>
        <body pos="0 0 -0.15" euler="0 20 0">
          <joint name="ankle" type="slide" axis="0 0.1 1" range="-0.03 0.03" limited="true" frictionloss="2"
                 damping="1" actuatorfrcrange="-6 9" actuatorfrclimited="true"/>
          <geom type="capsule" fromto="0 0 0 0 0 -0.1" size="0.03" mass="0.3"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="ankle" kp="300" kv="20"/>
    <motor joint="ankle" gear="5" ctrlrange="-1 1" ctrllimited="true"/>
    <position joint="hip" kp="20" kv="2" forcerange="-1 1" forcelimited="true" gear="2"/>
  </actuator>
  <sensor><user dim="2"/><rangefinder site="eye"/></sensor>
</mujoco>""".replace('<body pos="0 0 0.35">', '<body pos="0 0 0.35"><site name="eye"/>')
"""A body that moves in a plane, on a leg that slides: dry friction, motors that share a joint and bound each other."""


@pytest.mark.parametrize(
    "option", ['timestep="0.004"', 'integrator="implicitfast"', 'integrator="RK4" timestep="0.005"']
)
def test_steps_are_mujocos(option):
    agrees(PLANAR.format(option=option))


def agrees(xml, count=300, seed=0):
    """Accelerations, and positions and velocities after a step."""
    model = converged(mujoco.MjModel.from_xml_string(xml))
    tree = fold(read_tree(model))
    at = dropped(model, count, seed)
    qpos, qvel, qacc, settled = qacc_of(tree, 1)(Values(), *at)
    assert settled.all()
    expected = native(model, *at)
    size = 1.0 + np.linalg.norm(expected, axis=1)
    assert (np.linalg.norm(qacc - expected, axis=1) / size).max() < 1e-9
    data = mujoco.MjData(model)
    for i, (data.qpos, data.qvel, data.ctrl) in enumerate(zip(*at, strict=True)):
        data.qacc_warmstart = 0.0
        mujoco.mj_step(model, data)
        # What rounding of the accelerations comes to in a step.
        atol = 1e-9 * size[i] * model.opt.timestep + 1e-12
        np.testing.assert_allclose(qvel[i], data.qvel, rtol=0.0, atol=atol)
        np.testing.assert_allclose(qpos[i], data.qpos, rtol=0.0, atol=atol)


SHAPES = """
<mujoco>
  <worldbody>
    <geom type="plane" size="0 0 1" euler="5 -3 0" friction="0.6"/>
    <body pos="0 0 0.3">
      <freejoint/>
      <geom type="box" size="0.1 0.06 0.03" mass="1" euler="10 20 30" margin="0.002"/>
      <body pos="0.15 0 0">
        <joint axis="0 1 0" range="-60 60" limited="true" damping="0.05"/>
        <geom type="cylinder" size="0.05 0.03" mass="0.4" pos="0.05 0 0" euler="80 0 0" contype="2" conaffinity="1"/>
      </body>
      <body pos="-0.15 0 0">
        <joint axis="1 0 0" range="-60 60" limited="true" damping="0.05"/>
        <geom type="ellipsoid" size="0.07 0.04 0.05" mass="0.4" contype="2" conaffinity="1"/>
      </body>
      <geom type="cylinder" size="0.03 0.04" pos="0 0 0.1" mass="0.2" contype="0"/>
    </body>
  </worldbody>
</mujoco>"""


def test_shapes_on_a_plane_are_mujocos():
    """A box, cylinders that stand, lie and lean, an ellipsoid, on a slope."""
    agrees(SHAPES, count=500)


def test_free_bodies_in_a_fluid_are_mujocos():
    """By the boxes of their inertias, in a wind; turns by Runge and Kutta's method."""
    option = '<option density="300" viscosity="2" wind="1 -0.5 0.2" integrator="RK4" timestep="0.01"/>'
    agrees(SHAPES.replace("<worldbody>", f"{option}<worldbody>", 1), count=50, seed=1)


def test_upright_capsules_rub():
    """Where the axis of a capsule gives no tangent, as of legs at home."""
    xml = """<mujoco><worldbody><geom type="plane" size="0 0 1"/>
    <body pos="0 0 0.29"><freejoint/><geom type="capsule" size="0.1 0.2" mass="2"/></body></worldbody></mujoco>"""
    model = converged(mujoco.MjModel.from_xml_string(xml))
    at = model.qpos0[None], np.array([[1.0, 2.0, -0.1, 0.0, 0.0, 0.0]]), np.zeros((1, 0))
    expected = native(model, *at)
    assert (expected[0, :2] < -1.0).all()
    np.testing.assert_allclose(qacc_of(read_tree(model))(Values(), *at)[0], expected, atol=1e-9)
