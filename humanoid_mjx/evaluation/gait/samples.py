# pyright: reportAttributeAccessIssue=false
"""Samples of a gait: one moment of a body, and how near its legs are to each other."""

from functools import lru_cache
from typing import NamedTuple

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Bool, Float

from humanoid_mjx.mechanics.rotations import heading_frame
from humanoid_mjx.mechanics.scalars import Scalar, Vector
from humanoid_mjx.mechanics.terrain import Terrain
from humanoid_mjx.mechanics.tree.segments import nearest_shares
from humanoid_mjx.physics.base import Poses, Sensed
from humanoid_mjx.robot import Robot
from humanoid_mjx.tasks.legged.view import feet_of
from humanoid_mjx.types import FloatScalar


class Sample(NamedTuple):
    """The true state of a body at the beginning of a time step."""

    place: Float[Array, "2"]
    """Place of the hips above the ground, x and y, m."""
    heading: FloatScalar
    """Direction in which the torso looks, rad, -pi to pi."""
    angles: Float[Array, " joints"]
    """rad"""
    torque: Float[Array, " joints"]
    """Torques that act until the next time step, N m."""
    gap: Float[Array, "pairs 2"]
    """From the ankle of each right foot to that of its image, forward and to the left as the torso looks, m."""
    height: Float[Array, " feet"]
    """Height of the lowest corner of each foot above the ground, m."""
    load: Float[Array, " feet"]
    """Force with which the ground pushes each foot up, N."""
    speed: Float[Array, "feet corners"]
    """Speed of each foot's corners along the ground, m/s."""
    touching: Bool[Array, "feet corners"]
    legs_apart: FloatScalar
    """Least distance between the surfaces of the right and the left leg, m; not above 0 where they touch."""


def sample_of(sensed: Sensed, body_names: tuple[str, ...], robot: Robot, terrain: Terrain | None = None) -> Sample:
    """The moment that `sensed` is of."""
    torso, feet = 1, feet_of(sensed, body_names, robot, terrain)
    rotation = sensed.poses.rotation[torso]
    right, left = robot.foot_pairs.T
    return Sample(
        place=sensed.poses.position[torso, :2],
        heading=heading_of(rotation),
        angles=sensed.readings.encoders,
        torque=sensed.torque,
        gap=((feet.position[left] - feet.position[right]) @ heading_frame(rotation).T)[:, :2],
        height=feet.height,
        load=feet.load,
        speed=jnp.linalg.norm(feet.corner_velocity[..., :2], axis=-1),
        touching=feet.touching,
        legs_apart=legs_apart(sensed.poses, robot),
    )


def heading_of(rotation: Float[Array, "3 3"]) -> FloatScalar:
    """Direction of a body's x axis from above, rad, -pi to pi."""
    return jnp.arctan2(rotation[1, 0], rotation[0, 0])


def wrapped(angle: FloatScalar) -> FloatScalar:
    """The same angle from -pi to pi, rad."""
    return jnp.mod(angle + jnp.pi, 2 * jnp.pi) - jnp.pi


def legs_apart(poses: Poses, robot: Robot) -> FloatScalar:
    """The least distance between the capsules of the right and the left leg that cannot pass through each other, m.

    MuJoCo sees a contact where it is below 0.
    """
    bodies, middles, halves, radii = _pairs(robot)
    if not len(bodies):
        return jnp.asarray(jnp.inf)
    place = poses.position[bodies] + jnp.einsum("psij,psj->psi", poses.rotation[bodies], middles)
    half = jnp.einsum("psij,psj->psi", poses.rotation[bodies], halves)
    apart, (one, other) = place[:, 0] - place[:, 1], half.swapaxes(0, 1)
    x, y = nearest_shares(*(Vector(*map(Scalar, rows.T)) for rows in (one, other, apart)))
    way = apart + x.value[:, None] * one - y.value[:, None] * other
    return (jnp.linalg.norm(way + 1e-12, axis=1) - radii).min()


@lru_cache
def _pairs(robot: Robot) -> tuple[np.ndarray, ...]:
    """The pairs of capsules that feel each other: bodies, middles, ways from there to an end, sums of the radii."""
    model = robot.model
    pairs, axes = np.stack([model.pair_geom1, model.pair_geom2], axis=1), np.empty((model.ngeom, 3))
    pairs = pairs[(model.geom_type[pairs] == mujoco.mjtGeom.mjGEOM_CAPSULE).all(axis=1)]
    for axis, quaternion in zip(axes, model.geom_quat, strict=True):
        mujoco.mju_rotVecQuat(axis, np.array([0.0, 0.0, 1.0]), quaternion)
    shapes = model.geom_pos, axes * model.geom_size[:, 1:2], model.geom_size[:, 0]
    middles, halves, radii = (shape.astype(np.float32)[pairs] for shape in shapes)
    return model.geom_bodyid[pairs], middles, halves, radii.sum(axis=1)
