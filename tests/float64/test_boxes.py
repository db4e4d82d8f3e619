"""Contacts of two boxes in thousands of poses, against native MuJoCo."""

import jax
import mujoco
import numpy as np
import pytest

from humanoid_mjx.mechanics.tree.boxes import Placed, box_contacts

ROBOT = """<mujoco><worldbody>
<body><freejoint/><geom type="box" size="{}" mass="1" margin="0.002"/></body>
<body><freejoint/><geom type="box" size="{}" mass="1" margin="0.002"/></body></worldbody></mujoco>"""
MARGIN = 0.004

pytestmark = pytest.mark.skipif(
    tuple(map(int, mujoco.__version__.split(".")[:2])) < (3, 12), reason="MuJoCo 3.12 has another algorithm"
)


@pytest.mark.parametrize("halves", [((0.1, 0.05, 0.02), (0.1, 0.05, 0.02)), ((0.3, 0.05, 0.1), (0.04, 0.07, 0.2))])
def test_boxes_touch_where_they_do_in_mujoco(halves):
    """Turned at random, by a little, and not at all against each other."""
    model = mujoco.MjModel.from_xml_string(ROBOT.format(*(" ".join(map(str, half)) for half in halves)))
    rng, count, data = np.random.default_rng(0), 4000, mujoco.MjData(model)
    turns = rng.normal(size=(2, count, 4))
    turns[1, : count // 2] = (
        turns[0, : count // 2] + rng.choice([0.0, 1e-6, 0.02], (count // 2, 1)) * turns[1, : count // 2]
    )
    middles = rng.normal(size=(count, 3)) * np.mean(halves)
    poses, expected = [], []
    for middle, one, two in zip(middles, *turns, strict=True):
        data.qpos = [0, 0, 0, *one, *middle, *two]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        poses.append((data.geom_xpos.copy(), data.geom_xmat.reshape(2, 3, 3).copy()))
        contact = data.contact
        expected.append((contact.pos.copy(), contact.frame[:, :3].copy(), contact.dist.copy()))
    at, axes = (np.array(part) for part in zip(*poses, strict=True))
    boxes = [Placed(at[:, k].T, axes[:, k].T, np.array(halves[k])[:, None]) for k in range(2)]
    places, normals, distances = (np.array(x) for x in jax.jit(lambda one, two: box_contacts(one, two, MARGIN))(*boxes))
    kinds = set()
    for row, (place, normal, distance) in enumerate(expected):
        on = distances[:, row] <= MARGIN
        assert on.sum() == len(place)
        kinds.add(len(place))
        found = np.c_[places[:, on, row].T, distances[on, row]]
        # In no order; vertices within 1e-7 of the face's size are one.
        errors = np.abs(found[:, None] - np.c_[place, distance]).max(axis=2)
        assert (errors.min(axis=1, initial=1.0) < 1e-8).all()
        assert (np.abs(normals[:, row] - normal) < 1e-8).all()
    assert {0, 1, 2, 3, 4, 5, 6} <= kinds
