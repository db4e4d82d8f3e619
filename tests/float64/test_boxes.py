"""Contacts of boxes with boxes, balls and capsules in thousands of poses, against native MuJoCo."""

import jax
import mujoco
import numpy as np
import pytest

from humanoid_mjx.mechanics.tree.boxes import Placed, box_contacts, place_gap
from humanoid_mjx.mechanics.tree.segments import POINT

ROBOT = """<mujoco><worldbody>
<body><freejoint/><geom type="{}" size="{}" mass="1" margin="0.002"/></body>
<body><freejoint/><geom type="box" size="{}" mass="1" margin="0.002"/></body></worldbody></mujoco>"""
MARGIN = 0.004

pytestmark = pytest.mark.skipif(
    tuple(map(int, mujoco.__version__.split(".")[:2])) < (3, 12), reason="MuJoCo 3.12 has another algorithm"
)


@pytest.mark.parametrize("halves", [((0.1, 0.05, 0.02), (0.1, 0.05, 0.02)), ((0.3, 0.05, 0.1), (0.04, 0.07, 0.2))])
def test_boxes_touch_where_they_do_in_mujoco(halves):
    """Turned at random, by a little, and not at all against each other."""
    model = mujoco.MjModel.from_xml_string(ROBOT.format("box", *(" ".join(map(str, half)) for half in halves)))
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


QUARTERS = np.array([[1.0, 0.0, 0.0, 0.0], [0.5**0.5, 0.5**0.5, 0.0, 0.0], [0.5**0.5, 0.0, 0.5**0.5, 0.0]])
"""Turns of the axis z to each axis."""


def product(one, two):
    """Of two quaternions, at length 1."""
    found = np.empty(4)
    mujoco.mju_mulQuat(found, one, two)
    return found / np.linalg.norm(found)


def poses_of(size, half, count):
    """Places and turns of a capsule or ball of this size, turns of a box in the origin of these half edges, and whether
    MuJoCo's answer hangs on rounding: every third capsule is parallel to axes of a box that is turned at random.

    The others: parallel to an axis of the world and of the box, turned in a face, by a little, or at random; near to
    the box, or on a face or in it.
    """
    rng, reach, half = np.random.default_rng(0), np.array(half) + sum(size) / 2, np.array(half)
    for number in range(count):
        box = np.array([1.0, 0, 0, 0]) if number % 3 else product(rng.normal(size=4), QUARTERS[0])
        axis, along = np.eye(3)[rng.integers(3)], QUARTERS[rng.integers(3)]
        angle, case = rng.normal(), number // 3 % 4
        turn = [along, rng.normal(size=4), along + 10.0 ** -rng.integers(1, 4) * rng.normal(size=4), along][case]
        if case == 3:
            turn = product(np.r_[np.cos(angle), np.sin(angle) * axis], along)
        place = rng.uniform(-reach, reach)
        if rng.random() < 0.5:
            place = np.where(axis, rng.choice([-1.0, 1.0]) * (half + rng.uniform(-0.3, 1.05) * size[0]), place)
        found = np.empty(3)
        mujoco.mju_rotVecQuat(found, place, box)
        yield found, product(box, turn), box, number % 3 == 0 and case in (0, 3)


def contacts_of(data, place, turn, box):
    """Rows of place, normal and distance."""
    data.qpos = [*place, *turn, 0, 0, 0, *box]
    mujoco.mj_kinematics(data.model, data)
    mujoco.mj_collision(data.model, data)
    return np.c_[data.contact.pos, data.contact.frame[:, :3], data.contact.dist]


@pytest.mark.parametrize("size", [(0.04,), (0.03, 0.08), (0.02, 0.2), (0.05, 0.02)])
@pytest.mark.parametrize("half", [(0.1, 0.05, 0.02), (0.05, 0.05, 0.05), (0.3, 0.05, 0.1)])
def test_balls_and_capsules_touch_boxes_where_they_do_in_mujoco(size, half):
    """On faces, edges and corners, through the box, with their middle in it, parallel to faces and edges.

    Whether the axis of a capsule that is parallel to a face leads away from it is rounding, also of MuJoCo, whose
    second contact hangs on it: the answer may be that to a capsule turned by 1e-15.
    """
    kind, count = "capsule" if len(size) > 1 else "sphere", 6000
    model = mujoco.MjModel.from_xml_string(ROBOT.format(kind, *(" ".join(map(str, part)) for part in (size, half))))
    data, rng, at = mujoco.MjData(model), np.random.default_rng(1), list(poses_of(size, half, count))
    expected, frames = [], []
    for *pose, _ in at:
        expected.append(contacts_of(data, *pose))
        frames.append((data.geom_xpos.copy(), data.geom_xmat.reshape(2, 3, 3).copy()))
    places, axes = (np.array(part) for part in zip(*frames, strict=True))
    box = Placed(places[:, 1].T, axes[:, 1].T, np.array(half)[:, None])
    shape = places[:, 0].T, max(size[1:], default=POINT) * axes[:, 0, :, 2].T, size[0]
    which = np.array([[1], [2]] if kind == "capsule" else [[0]])
    found = jax.jit(jax.vmap(lambda which: place_gap(shape, box, which, balls=kind == "sphere", margin=MARGIN)))(which)
    found = np.concatenate([found[0], found[1], found[2][:, None]], axis=1).transpose(2, 0, 1)
    kinds, doubtful = set(), 0
    for (*pose, doubt), wanted, rows in zip(at, expected, found, strict=True):
        rows = rows[rows[:, 6] <= MARGIN]
        if doubt and not alike(rows, wanted):
            doubtful += 1
            turned = [product(pose[1], np.r_[1.0, turn]) for turn in 1e-15 * rng.normal(size=(32, 3))]
            assert any(alike(rows, contacts_of(data, pose[0], turn, pose[2])) for turn in turned)
        else:
            assert alike(rows, wanted)
        kinds.add(len(wanted))
    assert doubtful < 0.02 * count
    assert kinds == ({0, 1, 2} if kind == "capsule" else {0, 1})


def alike(one, two):
    return one.shape == two.shape and np.abs(one - two).max(initial=0.0) < 1e-9
