"""Figures of a gait from the sums of an episode, and their intervals over episodes and training seeds."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Num

from humanoid_mjx.evaluation.gait.tally import HOLD, Tally, as_seen
from humanoid_mjx.robot import Robot
from humanoid_mjx.runs.statistics import Estimate, mean_interval, mean_known, rate_interval
from humanoid_mjx.thesis.leg import GRAVITY
from humanoid_mjx.types import BoolScalar, FloatScalar

SLOW = 0.035
"""Mean speed, as a share of the robot's pace, below which there is no cost of transport."""

IN_TIME = 1.5
"""Time limit of a sudden turn, s: it succeeds if the heading stays near its goal from then on."""


class Figure(NamedTuple):
    """A figure of a gait."""

    unit: str
    better: int
    """1 where more is better, -1 where less is, 0 where neither."""
    meaning: str


FIGURES = {
    "success": Figure("", 1, "share of episodes without a fall"),
    "seconds": Figure("s", 1, "until the fall, or the end"),
    "forward": Figure("m/s", 0, "mean velocity forward"),
    "left": Figure("m/s", 0, "mean velocity to the left"),
    "turn": Figure("rad/s", 0, "mean turn rate, to the left"),
    "speed_error": Figure("m/s", -1, "mean absolute error of the velocity as a vector, of means over a window"),
    "turn_error": Figure("rad/s", -1, "mean absolute error of the turn rate, of means over a window"),
    "drift": Figure("m", -1, "distance from the start where no velocity is commanded, from a straight way elsewhere"),
    "heading_error": Figure("degrees", -1, "change of the heading where none is commanded"),
    "slip": Figure("m/s", -1, "mean speed along the ground of the corners of the feet that touch it"),
    "duty": Figure("", 0, "share of time that a foot carries weight, mean of all feet"),
    "flight": Figure("", -1, "share of time that no foot carries weight"),
    "step_length": Figure("m", 0, "by how much a foot is ahead of that on the other side at touchdown, mean of all"),
    "step_frequency": Figure("1/s", 0, "touchdowns of all feet"),
    "clearance": Figure("m", 1, "largest height of a foot's lowest corner in a step"),
    "duty_asymmetry": Figure("", -1, "difference of left and right by their mean"),
    "crossing": Figure("", -1, "share of time that the feet are too near each other, sideways"),
    "leg_contact": Figure("", -1, "share of time that the legs touch each other"),
    "peak_torque": Figure("N m", -1, "largest torque of a joint"),
    "cost_of_transport": Figure("", -1, "work of the joints, positive and negative, by weight and way"),
    "turn_seconds": Figure("s", -1, "until the heading is within 5 degrees of a sudden turn's goal for good"),
    "turn_success": Figure("", 1, "share of sudden turns that take at most 1.5 s, without a fall"),
}
"""The figures of an episode by name."""

RATES = "success", "turn_success"
"""Figures that are 0 or 1 in an episode."""


def figures(
    tally: Tally,
    asked: Float[Array, "3"],
    turns: BoolScalar,
    fallen: BoolScalar,
    robot: Robot,
    mass: FloatScalar,
    interval: float,
) -> dict[str, FloatScalar]:
    """The figures of an episode, NaN where one has no meaning.

    Args:
      asked: the command of the episode.
      turns: whether there is a sudden turn, too.
      mass: factor on the robot's own.
      interval: s between samples.
    """
    sums, windows = tally.sums, tally.windows
    seconds, steps = sums["samples"] * interval, sums["steps"]
    means = {name: total / _positive(sums["samples"]) for name, total in sums.items()}
    straight = (asked[2] == 0) & ~turns
    sides = robot.foot_pairs.T
    duties = jnp.stack([means["loaded"][side].mean() for side in sides])
    asymmetry = jnp.abs(duties[1] - duties[0]) / _positive(duties.mean())
    way = jnp.where(windows["way"] > robot.speed(SLOW) * seconds, windows["way"], jnp.nan)
    return {
        "success": 1.0 - fallen,
        "seconds": tally.samples * interval,
        **dict(zip(("forward", "left", "turn"), sums["motion"] / _positive(seconds), strict=True)),
        **dict(zip(("speed_error", "turn_error"), windows["errors"] / _positive(windows["number"]), strict=True)),
        "drift": jnp.where(turns, jnp.nan, _drift(tally, asked)),
        "heading_error": jnp.where(straight, jnp.degrees(jnp.abs(tally.turned)), jnp.nan),
        "slip": sums["slip"] / _positive(sums["touching"]),
        "duty": means["loaded"].mean(),
        **{name: means[name] for name in ("flight", "crossing", "leg_contact")},
        "step_length": sums["lengths"].sum() / _positive(steps.sum()),
        "step_frequency": steps.sum() / _positive(seconds),
        "clearance": sums["lifts"].sum() / _positive(steps.sum()),
        "duty_asymmetry": asymmetry,
        "peak_torque": tally.peak_torque,
        "cost_of_transport": windows["work"] / (robot.mass * mass * GRAVITY * way),
    } | _sudden_turn(tally, turns, fallen)


def _positive(number: Num[Array, "*parts"]) -> Float[Array, "*parts"]:
    """A divisor: NaN in the place of 0."""
    return jnp.where(number > 0, number, jnp.nan)


def _drift(tally: Tally, asked: Float[Array, "3"]) -> FloatScalar:
    """Distance from the start, or of the straight way along the first heading; NaN for a way that turns, m."""
    forward, left = as_seen(tally.last.place - tally.start, tally.last.heading - tally.turned)
    speed = jnp.hypot(asked[0], asked[1])
    aside = jnp.abs(asked[0] * left - asked[1] * forward) / _positive(speed)
    return jnp.where(speed == 0, jnp.hypot(forward, left), jnp.where(asked[2] == 0, aside, jnp.nan))


def _sudden_turn(tally: Tally, turns: BoolScalar, fallen: BoolScalar) -> dict[str, FloatScalar]:
    """A turn counts once it was watched to the end of `HOLD`, or ended in a fall."""
    watched = turns & (tally.since >= HOLD)
    settled = watched & (tally.late < HOLD - 0.1)
    success = settled & (tally.late <= IN_TIME) & ~fallen
    return {
        "turn_seconds": jnp.where(settled, tally.late, jnp.nan),
        "turn_success": jnp.where(watched | (turns & fallen), 1.0 * success, jnp.nan),
    }


class Summary(NamedTuple):
    """A figure under one command."""

    seeds: tuple[Estimate, ...]
    """The mean over the episodes of each training seed with its 95 % interval; NaN where the figure has no meaning."""
    median: float
    """Over the training seeds."""
    worst: float
    """The least favourable of the training seeds; NaN for a figure of which neither more nor less is better."""

    def as_json(self) -> dict[str, Any]:
        """The figure as plain values: of the seeds [value, low, high] each; None in the place of NaN."""
        seeds = [[_plain(number) for number in seed] for seed in self.seeds]
        return {"median": _plain(self.median), "worst": _plain(self.worst), "seeds": seeds}


class Gait(NamedTuple):
    """The gait of an agent under one command."""

    agent: str
    scenario: str
    command: tuple[float, float, float]
    """Velocity forward and to the left, m/s, and turn rate to the left, rad/s."""
    figures: dict[str, Summary]

    def as_json(self) -> dict[str, Any]:
        """The gait as plain values."""
        figures = {name: summary.as_json() for name, summary in self.figures.items()}
        return {"agent": self.agent, "scenario": self.scenario, "command": list(self.command), "figures": figures}


def summarised(episodes: Mapping[str, Float[np.ndarray, "seeds episodes"]]) -> dict[str, Summary]:
    """The figures of one command from those of each episode, in the order of `FIGURES`."""
    names = [name for name in FIGURES if name in episodes]
    values = np.stack([np.asarray(episodes[name], float) for name in names], axis=-1)
    known, means = np.isfinite(values), mean_known(values, axis=1)
    intervals = [mean_interval(of_seed) for of_seed in values]
    found = {}
    for column, name in enumerate(names):
        estimates, better = [], FIGURES[name].better
        for seed, (low, high) in enumerate(intervals):
            one = values[seed, known[seed, :, column], column]
            ends = rate_interval(one > 0.5) if name in RATES and len(one) else (low[column], high[column])
            estimates.append(Estimate(float(means[seed, column]), *map(float, ends)))
        sure = means[np.isfinite(means[:, column]), column]
        median, worst = np.nan, np.nan
        if len(sure):
            median, worst = np.median(sure), {1: sure.min(), -1: sure.max(), 0: np.nan}[better]
        found[name] = Summary(tuple(estimates), float(median), float(worst))
    return found


def _plain(value: float) -> float | None:
    """The number to six digits, which is what float32 holds; None for NaN."""
    return float(f"{value:.6g}") if np.isfinite(value) else None
