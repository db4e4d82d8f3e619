"""Kinematics of a tree: poses of its bodies, and their velocities by degree of freedom.

Vectors have the axes of the world and start at one origin: that of the free body, or of the world where there is none.
Angular velocities of the free body are the world's in here, its own frame's in `qvel`. Shapes are those of `algebra`.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from humanoid_mjx.mechanics.rotations import rotation_matrix
from humanoid_mjx.mechanics.tree.algebra import (
    EYE,
    column,
    compose,
    cross,
    dot,
    in_lane,
    joined,
    numbers,
    transposed,
    turn,
)
from humanoid_mjx.mechanics.tree.structure import Joint, Tree, Triple


class Pose(NamedTuple):
    """Pose of a body: its origin, m, and its rotation."""

    position: Any
    axes: Any
    """The body's axes in the world as columns."""


class Kinematics(NamedTuple):
    """A tree in one posture."""

    origin: Any
    """In the world, m."""
    poses: tuple[Pose, ...]
    anchors: dict[int, Any]
    """A point on the axis of each hinge, and the moved origin of a slide's body, by degree of freedom."""
    motions: tuple[Any, ...]
    """Spatial velocities that a unit of each degree of freedom gives to the bodies that it moves."""

    def of_lane(self, body: int, index: int) -> Pose:
        """A body's pose in one lane; that of a body without lanes."""
        return in_lane(self.poses[body], index)

    def place(self, body: int, point: Any) -> Any:
        """A point of a body's frame, against the origin."""
        return self.poses[body].position + self.direction(body, point)

    def direction(self, body: int, axis: Any) -> Any:
        """A direction of a body's frame."""
        return turn(self.poses[body].axes, numbers(axis) if isinstance(axis, tuple) else axis)


def make_kinematics(tree: Tree, qpos: Sequence[Any]) -> Kinematics:
    """The bodies' poses at `qpos`, whose quaternion, if there is one, need not have length 1."""
    free = tree.free is not None
    origin = column(qpos[:3]) if free else np.zeros((3, 1, 1))
    poses, anchors = [Pose(-origin, EYE)], dict[int, Any]()
    motions = list(np.eye(6)[..., None, None]) if free else []
    for index, body in enumerate(tree.bodies[1:], 1):
        if index == tree.free:
            axes = rotation_matrix(unit(column(qpos[3:7]))[:, 0, 0])[..., None, None]
            poses.append(Pose(np.zeros((3, 1, 1)), axes))
            continue
        parent = poses[body.parent]
        position = _moved(parent.position, parent.axes, body.position)
        axes = compose(parent.axes, transposed(numbers(body.axes)))
        for joint in body.joints:
            anchor = _moved(position, axes, joint.anchor)
            axis, way = turn(axes, numbers(joint.axis)), qpos[joint.coordinate] - numbers(joint.reference)
            if joint.slides:
                position = anchors[joint.dof] = position + way * axis
                motions.append(joined(axis, np.zeros((3, 1, 1))))
                continue
            axes = compose(axes, _turned(joint, way))
            position = anchor - turn(axes, numbers(joint.anchor)) if any(joint.anchor) else anchor
            anchors[joint.dof] = anchor
            motions.append(joined(cross(anchor, axis), axis))
        poses.append(Pose(position, axes))
    return Kinematics(origin, tuple(poses), anchors, tuple(motions))


def motions_of(tree: Tree, kinematics: Kinematics, speeds: Sequence[Any]) -> list[Any]:
    """The motion of each body where the degrees of freedom move at `speeds`, the free body's in the world's axes."""
    found = [np.zeros((6, 1, 1))]
    for index, body in enumerate(tree.bodies[1:], 1):
        if index == tree.free:
            found.append(column(speeds[:6]))
            continue
        found.append(sum((speeds[j.dof] * kinematics.motions[j.dof] for j in body.joints), found[body.parent]))
    return found


def to_world(tree: Tree, kinematics: Kinematics, rates: Sequence[Any], back: bool = False) -> list[Any]:
    """Velocities or accelerations with the free body's angular part in the world's axes, from those of `qvel`, or
    `back` to those; forces turn alike."""
    if tree.free is None:
        return list(rates)
    axes = kinematics.poses[tree.free].axes
    turned = turn(transposed(axes) if back else axes, column(rates[3:6]))
    return [*rates[:3], *jnp.unstack(turned), *rates[6:]]


to_local = partial(to_world, back=True)


def unit(quaternion: Any) -> Any:
    """The quaternion at length 1."""
    return quaternion * lax.rsqrt(dot(quaternion, quaternion))


def _moved(position: Any, axes: Any, point: Triple) -> Any:
    """The place of a point of a frame; that of its origin is the frame's own, so that `drifts_of` knows it."""
    return position + turn(axes, numbers(point)) if any(point) else position


def _turned(joint: Joint, angle: Any) -> Any:
    """Rodrigues' formula about an axis of fixed components: an axis of the frame gives a rotation of two."""
    axis = numbers(joint.axis)
    along, across = axis[:, None] * axis, transposed(cross(axis, EYE))
    return along + jnp.cos(angle) * (EYE - along) + jnp.sin(angle) * across
