"""Running sums over the samples of an episode, so that no motion is stored.

Sums begin after `SETTLING`; falls, drift, heading and peak torque are of the whole episode. Velocities are measured
from place to place, forward and to the left as the torso looks halfway between. They are compared with the command in
means over a window, so that the sway within a step is no error: over whole gait cycles, as many as come nearest to
`WINDOW`, or over `WINDOW` itself where a task has no clock.
"""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from humanoid_mjx.evaluation.gait.samples import Sample, wrapped
from humanoid_mjx.robot import Robot
from humanoid_mjx.tasks.legged.rewards import APART, LOADED
from humanoid_mjx.types import BoolScalar, FloatScalar, IntScalar

SETTLING, WINDOW = 2.0, 1.0
"""s"""

AIRBORNE = 0.04
"""How long a foot carries nothing before a touchdown ends a step, s; shorter, it chatters."""

EDGES = np.geomspace(1e-3, 1.0, 73).astype(np.float32)
"""Edges between the bins of slip, m/s, each a tenth above the one below, which is the largest error of a percentile."""

NEAR_GOAL = float(np.radians(5.0))
"""Error of the heading within which a sudden turn has ended, rad."""

HOLD = 5.0
"""How long after a sudden turn is commanded the heading has to stay near its goal, s."""


class Asked(NamedTuple):
    """What is asked of a body at one moment."""

    command: Float[Array, "3"]
    """Velocity forward and to the left, m/s, and turn rate to the left, rad/s."""
    goal: FloatScalar
    """Heading that a sudden turn is to reach, against that of the start, rad."""
    since: FloatScalar
    """How long ago the sudden turn was commanded, s; negative before it."""


class Window(NamedTuple):
    """Sums over the window under way."""

    samples: IntScalar
    motion: Float[Array, "3"]
    """Way forward and to the left, m, and turn to the left, rad."""
    asked: Float[Array, "3"]
    """The same as commanded."""
    work: FloatScalar
    """J"""


class Windows(NamedTuple):
    """Sums over the windows that are complete."""

    number: IntScalar
    errors: Float[Array, "4"]
    """Absolute errors of the windows' means: velocity forward, to the left and as a vector, m/s; turn rate, rad/s."""
    way: FloatScalar
    """Length of the windows' mean motions, m."""
    work: FloatScalar
    """J"""


class Slip(NamedTuple):
    """Speeds along the ground of the corners that touch."""

    total: FloatScalar
    """m/s"""
    bins: Int[Array, " bins"]
    """How many were between `EDGES`."""


class Feet(NamedTuple):
    """What the feet do."""

    loaded: Int[Array, " feet"]
    """Samples in which they carry weight."""
    air: Int[Array, " feet"]
    """Samples since they did."""
    lift: Float[Array, " feet"]
    """Largest height of the lowest corner since they did, m."""
    steps: Int[Array, " feet"]
    """Touchdowns after a time in the air."""
    lengths: Float[Array, " feet"]
    """By how much they were ahead of the foot on the other side then, m, summed."""
    lifts: Float[Array, " feet"]
    """The largest heights, m, summed over the steps."""


class Tally(NamedTuple):
    """The sums of one episode."""

    last: Sample
    start: Float[Array, "2"]
    """m"""
    turned: FloatScalar
    """Heading against that of the start, rad, beyond full turns."""
    samples: IntScalar
    """All of them."""
    counted: IntScalar
    """Those after `SETTLING`."""
    peak_torque: FloatScalar
    motion: Float[Array, "3"]
    window: Window
    windows: Windows
    slip: Slip
    feet: Feet
    flight: IntScalar
    """Samples in which no foot carries weight."""
    double: IntScalar
    """Samples in which all do."""
    crossing: IntScalar
    """Samples in which the feet are nearer each other, sideways, than `rewards.APART`."""
    contact: IntScalar
    """Samples in which the legs touch."""
    late: FloatScalar
    """When the heading was last off the goal of a sudden turn, s since it was commanded."""
    since: FloatScalar
    """The last of `Asked.since`."""


def begin(first: Sample) -> Tally:
    """The sums before the first sample; of `first` place, heading and angles matter."""
    none, number = jnp.float32(0), jnp.int32(0)
    some, counts = jnp.zeros(first.load.shape), jnp.zeros(first.load.shape, jnp.int32)
    return Tally(
        last=first._replace(torque=jnp.zeros_like(first.torque)),
        start=first.place,
        turned=none,
        samples=number,
        counted=number,
        peak_torque=none,
        motion=jnp.zeros(3),
        window=Window(number, jnp.zeros(3), jnp.zeros(3), none),
        windows=Windows(number, jnp.zeros(4), none, none),
        slip=Slip(none, jnp.zeros(len(EDGES) + 1, jnp.int32)),
        feet=Feet(counts, counts, some, counts, some, some),
        flight=number,
        double=number,
        crossing=number,
        contact=number,
        late=none,
        since=jnp.float32(-jnp.inf),
    )


def window_samples(cycle: FloatScalar | None, interval: float) -> IntScalar:
    """How many samples, `interval` seconds apart, make a window where a gait cycle takes `cycle` seconds."""
    seconds = WINDOW if cycle is None else jnp.maximum(jnp.round(WINDOW / cycle), 1.0) * cycle
    return jnp.round(jnp.asarray(seconds / interval)).astype(jnp.int32)


def add(tally: Tally, sample: Sample, asked: Asked, window: IntScalar, interval: float, robot: Robot) -> Tally:
    """The sums with one more sample, `interval` seconds after the last; `window` samples make a window."""
    last = tally.last
    counts = tally.samples * interval > SETTLING - interval / 2
    motion = jnp.where(counts, _motion(last, sample), 0.0)
    # The torque that acted from the last sample to this one was constant.
    work = jnp.where(counts, jnp.sum(jnp.abs(last.torque * (sample.angles - last.angles))), 0.0)
    loaded = sample.load > robot.force(LOADED)
    turned = tally.turned + wrapped(sample.heading - last.heading)
    off = (asked.since >= 0) & (asked.since <= HOLD) & (jnp.abs(asked.goal - turned) > NEAR_GOAL)
    inner, windows = _windows(tally, motion, counts * asked.command * interval, work, counts, window, interval)
    return tally._replace(
        last=sample,
        turned=turned,
        samples=tally.samples + 1,
        counted=tally.counted + counts,
        peak_torque=jnp.maximum(tally.peak_torque, jnp.abs(sample.torque).max()),
        motion=tally.motion + motion,
        window=inner,
        windows=windows,
        slip=_slip(tally.slip, sample, counts),
        feet=_feet(tally.feet, sample, loaded, counts, interval, robot),
        flight=tally.flight + (counts & ~loaded.any()),
        double=tally.double + (counts & loaded.all()),
        crossing=tally.crossing + (counts & (sample.gap[:, 1] < robot.length(APART)).any()),
        contact=tally.contact + (counts & (sample.legs_apart <= 0)),
        late=jnp.where(off, asked.since, tally.late),
        since=asked.since,
    )


def _motion(last: Sample, now: Sample) -> Float[Array, "3"]:
    """The way between samples, forward and to the left as the torso looks halfway between, m, and the turn, rad."""
    turn = wrapped(now.heading - last.heading)
    return jnp.append(as_seen(now.place - last.place, last.heading + turn / 2), turn)


def as_seen(way: Float[Array, "2"], heading: FloatScalar) -> Float[Array, "2"]:
    """A way on the ground, forward and to the left of who looks along `heading`."""
    cosine, sine = jnp.cos(heading), jnp.sin(heading)
    return jnp.stack([cosine * way[0] + sine * way[1], cosine * way[1] - sine * way[0]])


def _windows(
    tally: Tally,
    motion: Float[Array, "3"],
    asked: Float[Array, "3"],
    work: FloatScalar,
    counts: BoolScalar,
    size: IntScalar,
    interval: float,
) -> tuple[Window, Windows]:
    """The window under way, a new one where it is complete, and the sums over those that are."""
    old, all_ = tally.window, tally.windows
    now = Window(old.samples + counts, old.motion + motion, old.asked + asked, old.work + work)
    full, seconds = now.samples >= size, size * interval
    forward, left, turn = (now.motion - now.asked) / seconds
    errors = jnp.stack([jnp.abs(forward), jnp.abs(left), jnp.hypot(forward, left), jnp.abs(turn)])
    return Window(*(jnp.where(full, 0, part) for part in now)), Windows(
        all_.number + full,
        all_.errors + full * errors,
        all_.way + full * jnp.hypot(now.motion[0], now.motion[1]),
        all_.work + full * now.work,
    )


def _slip(slip: Slip, sample: Sample, counts: BoolScalar) -> Slip:
    touching = sample.touching & counts
    above = jnp.sum(sample.speed[..., None] > EDGES, axis=-1)
    inside = (above[..., None] == np.arange(len(EDGES) + 1)) & touching[..., None]
    return Slip(slip.total + jnp.sum(sample.speed * touching), slip.bins + inside.sum(axis=(0, 1), dtype=jnp.int32))


def _feet(
    feet: Feet, sample: Sample, loaded: Bool[Array, " feet"], counts: BoolScalar, interval: float, robot: Robot
) -> Feet:
    landed = loaded & (feet.air >= math.ceil(AIRBORNE / interval - 1e-6)) & counts
    right, left = robot.foot_pairs.T
    ahead = jnp.zeros(loaded.shape).at[right].set(-sample.gap[:, 0]).at[left].set(sample.gap[:, 0])
    return Feet(
        loaded=feet.loaded + (loaded & counts),
        air=jnp.where(loaded, 0, feet.air + 1),
        lift=jnp.where(feet.air > 0, jnp.maximum(feet.lift, sample.height), sample.height),
        steps=feet.steps + landed,
        lengths=feet.lengths + landed * ahead,
        lifts=feet.lifts + landed * feet.lift,
    )
