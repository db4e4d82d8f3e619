"""Kinematics of a tree: poses of its bodies, and their velocities by degree of freedom.

Vectors have the axes of the world and start at one origin: that of the free body, or of the world where there is none.
Angular velocities of the free body are the world's in here, its own frame's in `qvel`.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from humanoid_mjx.mechanics.scalars import NULL, ONE, TWO, Scalar, Vector, add, cross, scale
from humanoid_mjx.mechanics.tree.algebra import (
    UNTURNED,
    Rotation,
    Spatial,
    combine,
    compose,
    in_lane,
    known,
    known_axes,
    number,
    root_over,
    subtract,
    times,
    total,
    vector,
)
from humanoid_mjx.mechanics.tree.structure import Joint, Table, Tree, Triple


class Pose(NamedTuple):
    """Pose of a body: its origin, m, and its axes."""

    position: Vector
    axes: Rotation


class Kinematics(NamedTuple):
    """A tree in one posture."""

    origin: Vector
    """In the world, m."""
    poses: tuple[Pose, ...]
    anchors: dict[int, Vector]
    """A point on the axis of each hinge, and the moved origin of a slide's body, by degree of freedom."""
    motions: tuple[Spatial, ...]
    """Velocities that a unit of each degree of freedom gives to the bodies that it moves."""

    def of_lane(self, body: int, index: int) -> Pose:
        """A body's pose in one lane; that of a body without lanes."""
        return in_lane(self.poses[body], index)

    def place(self, body: int, point: Triple) -> Vector:
        """A point of a body's frame, against the origin."""
        pose = self.poses[body]
        return add(pose.position, combine(pose.axes, vector(point)))

    def direction(self, body: int, axis: Triple) -> Vector:
        """A direction of a body's frame."""
        return combine(self.poses[body].axes, vector(axis))


def make_kinematics(tree: Tree, qpos: Sequence[Scalar]) -> Kinematics:
    """The bodies' poses at `qpos`, whose quaternion, if there is one, need not have length 1."""
    origin = Vector(*qpos[:3]) if tree.free is not None else NULL
    poses = [Pose(Vector(-origin.x, -origin.y, -origin.z), UNTURNED)]
    anchors: dict[int, Vector] = {}
    motions = [Spatial(axis, NULL) for axis in UNTURNED] + [Spatial(NULL, axis) for axis in UNTURNED]
    if tree.free is None:
        motions = []
    for index, body in enumerate(tree.bodies[1:], 1):
        if index == tree.free:
            poses.append(Pose(NULL, rotation(unit(qpos[3:7]))))
            continue
        parent = poses[body.parent]
        position = add(parent.position, combine(parent.axes, vector(body.position)))
        axes = compose(parent.axes, known_axes(body.axes))
        for joint in body.joints:
            anchor = add(position, combine(axes, vector(joint.anchor)))
            axis = combine(axes, vector(joint.axis))
            if joint.slides:
                position = add(position, scale(qpos[joint.coordinate] - number(joint.reference), axis))
                anchors[joint.dof] = position
                motions.append(Spatial(axis, NULL))
                continue
            axes = compose(axes, _turned(joint, qpos[joint.coordinate]))
            position = subtract(anchor, combine(axes, vector(joint.anchor))) if any(joint.anchor) else position
            anchors[joint.dof] = anchor
            motions.append(Spatial(cross(anchor, axis), axis))
        poses.append(Pose(position, axes))
    return Kinematics(origin, tuple(poses), anchors, tuple(motions))


def motions_of(tree: Tree, kinematics: Kinematics, speeds: Sequence[Scalar]) -> list[Spatial]:
    """The motion of each body where the degrees of freedom move at `speeds`, the free body's in the world's axes."""
    base = Spatial(Vector(*speeds[:3]), Vector(*speeds[3:6])) if tree.free is not None else None
    found = [Spatial(NULL, NULL)]
    for index, body in enumerate(tree.bodies[1:], 1):
        if index == tree.free and base is not None:
            found.append(base)
            continue
        turning = [times(speeds[joint.dof], kinematics.motions[joint.dof]) for joint in body.joints]
        found.append(total([found[body.parent], *turning]))
    return found


def to_world(tree: Tree, kinematics: Kinematics, rates: Sequence[Scalar]) -> list[Scalar]:
    """Velocities or accelerations with the free body's angular part in the world's axes, from those of `qvel`."""
    if tree.free is None:
        return list(rates)
    turned = combine(kinematics.poses[tree.free].axes, Vector(*rates[3:6]))
    return [*rates[:3], *turned, *rates[6:]]


def to_local(tree: Tree, kinematics: Kinematics, rates: Sequence[Scalar]) -> list[Scalar]:
    """The inverse of `to_world`; forces turn alike."""
    if tree.free is None:
        return list(rates)
    x, y, z = kinematics.poses[tree.free].axes
    turned = [a.x * rates[3] + a.y * rates[4] + a.z * rates[5] for a in (x, y, z)]
    return [*rates[:3], *turned, *rates[6:]]


def unit(quaternion: Sequence[Scalar]) -> list[Scalar]:
    """The quaternion at length 1."""
    w, x, y, z = quaternion
    factor = root_over(w * w + x * x + y * y + z * z)
    return [factor * part for part in quaternion]


def rotation(quaternion: Sequence[Scalar]) -> Rotation:
    """The axes of a frame from its unit quaternion, w x y z."""
    w, x, y, z = quaternion
    wx, wy, wz = (TWO * w * part for part in (x, y, z))
    xx, yy, zz = (TWO * part * part for part in (x, y, z))
    xy, xz, yz = TWO * x * y, TWO * x * z, TWO * y * z
    return (
        Vector(ONE - (yy + zz), xy + wz, xz - wy),
        Vector(xy - wz, ONE - (xx + zz), yz + wx),
        Vector(xz + wy, yz - wx, ONE - (xx + yy)),
    )


def _turned(joint: Joint, angle: Scalar) -> Rotation:
    """Rodrigues' formula about an axis of fixed components: an axis of the frame gives a rotation of two."""
    turn = angle - number(joint.reference)
    cosine, sine = Scalar(jnp.cos(turn.value)), Scalar(jnp.sin(turn.value))
    axis = np.stack(
        np.broadcast_arrays(*(np.asarray(part.values if isinstance(part, Table) else part) for part in joint.axis))
    )
    columns = []
    for unmoved in np.eye(3).reshape(3, 3, *[1] * (axis.ndim - 1)):
        along = axis * (axis * unmoved).sum(axis=0)
        across = np.cross(axis, unmoved, axis=0)
        parts = zip(along, np.broadcast_to(unmoved, axis.shape) - along, across, strict=True)
        columns.append(Vector(*(known(a) + cosine * known(b) + sine * known(c) for a, b, c in parts)))
    one, two, three = columns
    return one, two, three
