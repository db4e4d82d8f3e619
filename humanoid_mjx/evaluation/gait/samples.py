# pyright: reportAttributeAccessIssue=false
"""What a gait is measured by: one moment of a body, and how near its legs are to each other."""

from functools import lru_cache
from typing import NamedTuple

import jax
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
    """Where the hips are above the ground, x and y, m."""
    heading: FloatScalar
    """Where the torso looks, rad, -pi to pi."""
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
    """Where a body's x axis points, from above, rad, -pi to pi."""
    return jnp.arctan2(rotation[1, 0], rotation[0, 0])


def wrapped(angle: FloatScalar) -> FloatScalar:
    """The same angle from -pi to pi, rad."""
    return jnp.mod(angle + jnp.pi, 2 * jnp.pi) - jnp.pi


def legs_apart(poses: Poses, robot: Robot) -> FloatScalar:
    """The least distance between the capsules of the right and the left leg that cannot pass through each other, m.

    MuJoCo sees a contact where it is below 0.
    """
    distances = []
    for one, two in _pairs(robot):
        (middle, half), (other_middle, other_half) = (
            (poses.position[c.body] + poses.rotation[c.body] @ c.middle, poses.rotation[c.body] @ c.half)
            for c in (one, two)
        )
        gap = between_segments(middle, half, other_middle, other_half)
        distances.append(gap - np.float32(one.radius + two.radius))
    return jnp.stack(distances).min() if distances else jnp.asarray(jnp.inf)


def between_segments(
    middle: Float[Array, "3"], half: Float[Array, "3"], other_middle: Float[Array, "3"], other_half: Float[Array, "3"]
) -> FloatScalar:
    """The distance between two segments, each from its middle along half of it, which is not 0, both ways."""
    apart = middle - other_middle
    x, y = nearest_shares(*(Vector(*map(Scalar, vector)) for vector in (half, other_half, apart)))
    return jnp.linalg.norm(apart + x.value * half - y.value * other_half + 1e-12)


class _Capsule(NamedTuple):
    body: int
    middle: np.ndarray
    half: np.ndarray
    radius: float


@lru_cache
def _pairs(robot: Robot) -> list[tuple[_Capsule, _Capsule]]:
    """The pairs of capsules of the robot that feel each other."""
    with jax.ensure_compile_time_eval():
        model = robot.model

    def capsule(geom: int) -> _Capsule:
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
        half = rotation.reshape(3, 3)[:, 2] * model.geom_size[geom, 1]
        middle, half = (x.astype(np.float32) for x in (model.geom_pos[geom], half))
        return _Capsule(int(model.geom_bodyid[geom]), middle, half, float(model.geom_size[geom, 0]))

    kind = int(mujoco.mjtGeom.mjGEOM_CAPSULE)
    pairs = zip(model.pair_geom1, model.pair_geom2, strict=True)
    pairs = ((int(one), int(two)) for one, two in pairs)
    return [(capsule(one), capsule(two)) for one, two in pairs if model.geom_type[one] == model.geom_type[two] == kind]
