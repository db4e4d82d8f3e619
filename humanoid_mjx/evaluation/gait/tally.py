# pyright: reportAttributeAccessIssue=false
"""Samples of a gait, each one moment of a body, and running sums over those of an episode, so that no motion is stored.

Sums begin after `SETTLING`; falls, drift, heading and peak torque are of the whole episode. Velocities are measured
from place to place, forward and to the left as the torso looks halfway between. They are compared with the command in
means over a window, so that the sway within a step is no error: over whole gait cycles, as many as come nearest to
`WINDOW`, or over `WINDOW` itself where a task has no clock.
"""

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from humanoid_mjx.mechanics.rotations import heading_frame
from humanoid_mjx.mechanics.terrain import Terrain
from humanoid_mjx.mechanics.tree.segments import nearest_shares
from humanoid_mjx.physics.base import Poses, Sensed
from humanoid_mjx.robot import Robot
from humanoid_mjx.tasks.legged.rewards import SHAPES
from humanoid_mjx.tasks.legged.view import feet_of
from humanoid_mjx.types import BoolScalar, FloatScalar, IntScalar


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
    x, y = nearest_shares(*(rows[..., None, None] for rows in (one, other, apart)))
    way = apart + x[..., 0] * one - y[..., 0] * other
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


SETTLING, WINDOW = 2.0, 1.0
"""s"""

AIRBORNE = 0.04
"""Least time in the air before a touchdown that counts as a step, s; shorter ones are chatter."""

NEAR_GOAL = float(np.radians(5.0))
"""Error of the heading within which a sudden turn has ended, rad."""

HOLD = 5.0
"""Observation time after the command of a sudden turn, s: the heading must stay near its goal until its end."""


class Asked(NamedTuple):
    """The command to a body at one moment."""

    command: Float[Array, "3"]
    """Velocity forward and to the left, m/s, and turn rate to the left, rad/s."""
    goal: FloatScalar
    """Heading that a sudden turn is to reach, against that of the start, rad."""
    since: FloatScalar
    """Time since the sudden turn was commanded, s; negative before it."""


Sums = dict[str, Float[Array, "..."]]


class Tally(NamedTuple):
    """The sums of one episode, and what the next sample is compared with."""

    last: Sample
    start: Float[Array, "2"]
    """m"""
    turned: FloatScalar
    """Heading against that of the start, rad, beyond full turns."""
    samples: IntScalar
    """All of them."""
    peak_torque: FloatScalar
    late: FloatScalar
    """Last time at which the heading was off the goal of a sudden turn, s since the command."""
    since: FloatScalar
    """The last of `Asked.since`."""
    air: Int[Array, " feet"]
    """Samples since each foot carried weight."""
    lift: Float[Array, " feet"]
    """Largest height of the lowest corner since then, m."""
    sums: Sums
    """Over the samples after `SETTLING`."""
    window: Sums
    """Over the samples of the window under way."""
    windows: Sums
    """Over the windows that are complete."""


def begin(first: Sample, robot: Robot) -> Tally:
    """The sums before the first sample; of `first` place, heading and angles matter."""
    zero, feet = jnp.float32(0), jnp.zeros(first.load.shape)
    first = first._replace(torque=jnp.zeros_like(first.torque))
    samples, since, air = jnp.int32(0), jnp.float32(-jnp.inf), feet.astype(jnp.int32)
    tally = Tally(first, first.place, zero, samples, zero, zero, since, air, feet, {}, {}, {})
    now, way = _counted(tally, first, Asked(jnp.zeros(3), zero, zero), 1.0, robot)
    window = _blank(way)
    return tally._replace(sums=_blank(now), window=window, windows=_blank(_compared(window, jnp.float32(1.0))))


def _blank(parts: Mapping[str, Any]) -> Sums:
    return {name: jnp.zeros(jnp.shape(part)) for name, part in parts.items()}


def window_samples(cycle: FloatScalar | None, interval: float) -> IntScalar:
    """Number of samples of a window, `interval` seconds apart, where a gait cycle takes `cycle` seconds."""
    seconds = WINDOW if cycle is None else jnp.maximum(jnp.round(WINDOW / cycle), 1.0) * cycle
    return jnp.round(jnp.asarray(seconds / interval)).astype(jnp.int32)


def add(tally: Tally, sample: Sample, asked: Asked, window: IntScalar, interval: float, robot: Robot) -> Tally:
    """The sums with one more sample, `interval` seconds after the last; `window` samples make a window."""
    counts = tally.samples * interval > SETTLING - interval / 2
    now, way = _counted(tally, sample, asked, interval, robot)
    inner = _added(tally.window, counts, way)
    full = inner["samples"] >= window
    turned = tally.turned + way["motion"][2]
    off = (asked.since >= 0) & (asked.since <= HOLD) & (jnp.abs(asked.goal - turned) > NEAR_GOAL)
    return Tally(
        last=sample,
        start=tally.start,
        turned=turned,
        samples=tally.samples + 1,
        peak_torque=jnp.maximum(tally.peak_torque, jnp.abs(sample.torque).max()),
        late=jnp.where(off, asked.since, tally.late),
        since=asked.since,
        air=jnp.where(now["loaded"], 0, tally.air + 1),
        lift=jnp.where(tally.air > 0, jnp.maximum(tally.lift, sample.height), sample.height),
        sums=_added(tally.sums, counts, now),
        window={name: jnp.where(full, 0.0, total) for name, total in inner.items()},
        windows=_added(tally.windows, full, _compared(inner, window * interval)),
    )


def _counted(
    tally: Tally, sample: Sample, asked: Asked, interval: float, robot: Robot
) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    """The parts of a sample in the sums, and in those of a window."""
    last, motion = tally.last, _motion(tally.last, sample)
    loaded = sample.load > robot.force(SHAPES.loaded)
    landed = loaded & (tally.air >= math.ceil(AIRBORNE / interval - 1e-6))
    right, left = robot.foot_pairs.T
    ahead = jnp.zeros(loaded.shape).at[right].set(-sample.gap[:, 0]).at[left].set(sample.gap[:, 0])
    now = {
        "samples": 1.0,
        "motion": motion,  # way forward and to the left, m, and turn to the left, rad
        "loaded": loaded,  # whether each foot carries weight
        "flight": ~loaded.any(),
        "crossing": (sample.gap[:, 1] < robot.length(SHAPES.apart)).any(),
        "leg_contact": sample.legs_apart <= 0,
        "slip": jnp.sum(sample.speed * sample.touching),  # of the corners that touch, m/s
        "touching": sample.touching.sum(),
        "steps": landed,  # touchdowns after a time in the air
        "lengths": landed * ahead,  # by how much each foot is ahead of that on the other side then, m
        "lifts": landed * tally.lift,  # m
    }
    # The torque that acted from the last sample to this one was constant.
    work = jnp.sum(jnp.abs(last.torque * (sample.angles - last.angles)))
    return now, {"samples": 1.0, "motion": motion, "asked": asked.command * interval, "work": work}


def _added(sums: Sums, flag: BoolScalar, now: Mapping[str, Any]) -> Sums:
    """Sums with what is now, where the flag is set."""
    return {name: total + jnp.where(flag, now[name], 0.0) for name, total in sums.items()}


def _compared(window: Sums, seconds: FloatScalar) -> Mapping[str, Any]:
    """A window beside its command: absolute errors of the mean velocity as a vector, m/s, and of the mean turn rate,
    rad/s; length of its mean motion, m; work, J."""
    forward, left, turn = (window["motion"] - window["asked"]) / seconds
    errors = jnp.stack([jnp.hypot(forward, left), jnp.abs(turn)])
    return {"number": 1.0, "errors": errors, "way": jnp.hypot(*window["motion"][:2]), "work": window["work"]}


def _motion(last: Sample, now: Sample) -> Float[Array, "3"]:
    """The way between samples, forward and to the left as the torso looks halfway between, m, and the turn, rad."""
    turn = wrapped(now.heading - last.heading)
    return jnp.append(as_seen(now.place - last.place, last.heading + turn / 2), turn)


def as_seen(way: Float[Array, "2"], heading: FloatScalar) -> Float[Array, "2"]:
    """A way on the ground, forward and to the left of who looks along `heading`."""
    cosine, sine = jnp.cos(heading), jnp.sin(heading)
    return jnp.stack([cosine * way[0] + sine * way[1], cosine * way[1] - sine * way[0]])
