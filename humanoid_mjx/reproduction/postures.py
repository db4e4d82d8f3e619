"""Figures 7.17 and 7.18: both legs go from one posture to another, by what a table learned."""

import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from humanoid_mjx.evaluation.episode import motion_of, play
from humanoid_mjx.evaluation.film import Film
from humanoid_mjx.evaluation.policy import find_policy
from humanoid_mjx.report.rendering import render_film
from humanoid_mjx.reproduction.findings import Finding, Setting, check, experiment, three_digits, unprinted
from humanoid_mjx.reproduction.ground import draw_bodies, standing
from humanoid_mjx.robot import make_robot
from humanoid_mjx.thesis import leg
from humanoid_mjx.thesis import q_learning as thesis
from humanoid_mjx.training.sweep import sweep

JOINTS = ("hip", "knee", "ankle")
RANGES = [leg.JOINT_RANGES["proposed"][joint] for joint in (0, 3, 4)]
LEGS = {"right": 1.0, "left": -1.0}
"""The left leg takes opposite values (6.4)."""

PRINTED_GOAL = {"knee": -120.0}
"""Goal that section 7 H prints, degrees."""

TRAINING = {
    "task": {"places": 3, "max_episode_steps": 40},
    "learner": {"epsilon": 0.5, "epsilon_decay": 0.95, "learning_rate": 0.5},
}
SEEDS, EPISODES = 8, 60
SAME = 0.02
"""Share by which two measurements may differ and count as the same."""

HEAVY = 2.0
"""Mass of the robot, as a multiple of the mass in its controller's model, for the claim of section 7 H."""


class Switch(NamedTuple):
    """Measures of a switch of posture."""

    settling: float
    """Time until all joints are within the task's tolerance of the goal for good, s; NaN if they never are."""
    overshoot: float
    """The furthest that a joint goes beyond its goal, degrees to the hundredth."""
    energy: float
    """The integral of |torque * velocity| over time and joints, J."""
    peak: float
    """The largest torque, N m."""


@experiment("figure-7.17", "The initial posture of the legs")
def initial(setting: Setting) -> list[Finding]:
    upright = {'As the figure has it, "0° for all the joint"': (0.0, 0.0, 0.0)}
    starts = {section: ends[0] for section, ends in thesis.POSTURES.items()}
    _draw(setting, "Initial", upright | {_words(*each): each[1] for each in starts.items()})
    return [_in_range(section, "start", degrees) for section, degrees in starts.items()]


@experiment("figure-7.18", "The next posture of the legs, and the way there", TRAINING)
def following(setting: Setting) -> Iterator[Finding]:
    goals = {section: ends[1] for section, ends in thesis.POSTURES.items()}
    hip, _, ankle = goals["7H"]
    as_printed = (hip, PRINTED_GOAL["knee"], ankle)
    printed = {f"{_words('7H', as_printed)}, the knee as printed": as_printed}
    _draw(setting, "Next", {_words(*each): each[1] for each in goals.items()} | printed)
    yield from (_in_range(section, "goal", degrees) for section, degrees in goals.items())
    yield _sign()
    for section in thesis.POSTURES:
        yield from _switch(section, setting)


def _draw(setting: Setting, when: str, postures: Mapping[str, tuple[float, ...]]) -> None:
    """A panel for each posture by its words, hip, knee and ankle of the right leg in degrees; its lowest foot is on the
    ground, yaw and roll are 0."""
    legs, row = np.zeros((2, 5)), []
    for words, degrees in postures.items():
        legs[:, [0, 3, 4]] = np.radians(degrees) * np.array(list(LEGS.values()))[:, None]
        row.append((words, standing(legs.ravel())))
    draw_bodies(setting, f"{when} postures: degrees of the right leg, the left takes the opposite", [row], (3.5, 3.4))


def _in_range(section: str, when: str, degrees: tuple[float, ...]) -> Finding:
    """The finding on the joints of both legs that a posture takes out of their ranges."""
    outside = [
        f"{side} {joint} {sign * angle + 0.0:g} of {low:g} to {high:g}"
        for side, sign in LEGS.items()
        for joint, angle, (low, high) in zip(JOINTS, degrees, RANGES, strict=True)
        if not low <= sign * angle <= high
    ]
    quantity = f"section {section}: joints of both legs outside Table 3.2's proposed ranges at the {when}"
    why = ", ".join(outside) + " degrees" if outside else "all are inside"
    return check(quantity, "the ranges of Table 3.2", len(outside), not outside, why, 0)


def _sign() -> Finding:
    """The goal of the knee in section 7 H."""
    low, high = RANGES[1]
    used, as_printed = {"knee": thesis.POSTURES["7H"][1][1]}, PRINTED_GOAL["knee"]
    where = {knee: "inside" if low <= knee <= high else "outside" for knee in (used["knee"], as_printed)}
    quantity = "section 7H: goal of the right knee inside its range of Table 3.2, degrees"
    why = f"the range is {low:g} to {high:g}: {as_printed:g} is {where[as_printed]}; {used['knee']:g}, which the "
    why += f"table's sign makes of it, is {where[used['knee']]}"
    agrees = where[used["knee"]] == "inside"
    return check(quantity, as_printed, used["knee"], agrees, why, 0.0, (used, PRINTED_GOAL))


def _switch(section: str, setting: Setting) -> list[Finding]:
    """Train on a posture, show the motion, and measure it, also of a heavier robot."""
    setting.tell(f"section {section}: training {SEEDS} tables of {EPISODES} episodes")
    trained = _train(section, setting.config)
    setting.tell(f"section {section}: playing and drawing the motion")
    task = trained.learner.task
    episode = play(trained)
    motion = motion_of(trained, episode)
    path = setting.out / f"figure-7.18-{section}.gif"
    render_film(Film(make_robot("legs").spec().compile(), motion.qpos, task.timestep), path)
    setting.tell(f"section {section}: the same with {HEAVY:g} times the mass")
    learned = _measure(motion, task)
    heavy = task.replace(mass=np.float32(HEAVY))
    trained = trained._replace(learner=trained.learner.replace(task=heavy))
    loaded = _measure(motion_of(trained, play(trained)), task)
    measures = "settling time, s, overshoot, degrees, energy, J, and peak torque, N m"
    why = f"learned in {EPISODES} episodes; it takes {len(episode.actions)} decisions"
    found = unprinted(f"section {section}: {measures}, of the switch", [*map(_short, learned)], why)
    return [found, _involves_dynamics(section, learned, loaded)]


def _involves_dynamics(section: str, learned: Switch, loaded: Switch) -> Finding:
    """Section 7 H's claim, by the same table on a robot of another mass."""
    settles = "never settles" if np.isnan(loaded.settling) else f"settles in {loaded.settling:g} s"
    before, after = (np.array([switch.settling, switch.energy]) for switch in (learned, loaded))
    alike = (np.abs(before - after) <= SAME * np.maximum(before, after)).all()
    quantity = f"section {section}: settling time, s, and energy, J, of the same table on a robot {HEAVY:g} times as "
    quantity += "heavy"
    why = f"the heavy robot {settles}; at the mass that the controller believes they are {learned.settling:g} s and "
    why += f"{learned.energy:.3g} J: the table only names set-points, and the torque comes from the leg's model"
    claim = "there is no kinematics and dynamics involved (7 H)"
    return check(quantity, claim, [*map(_short, after)], alike, why, SAME)


def _train(section: str, config: dict[str, Any]) -> Any:
    """The best of a few short runs."""
    full = {
        "name": "posture",
        "task": {"name": "posture_switch", "posture": section} | config["task"],
        "learner": {"name": "tabular_q"} | config["learner"],
        "seeds": SEEDS,
        "episodes": EPISODES,
        "record": 1,
    }
    with tempfile.TemporaryDirectory() as folder:
        return find_policy(sweep(full, Path(folder) / "run", pool_size=SEEDS).path)


def _measure(motion: Any, task: Any) -> Switch:
    """The measures of a motion from the task's start to its goal."""
    start, goal = (np.asarray(task.whole_body(task.grid[:, end])) for end in (0, -1))
    off = np.degrees(motion.qpos - goal)
    away = np.flatnonzero((np.abs(off) > float(task.tolerance)).any(axis=1))
    settled = 0 if len(away) == 0 else int(away[-1]) + 1
    return Switch(
        settling=round((settled + 1) * task.timestep, 6) if settled < len(off) else float("nan"),
        overshoot=round(max(0.0, float((off * np.sign(goal - start)).max())), 2),
        energy=float(np.abs(motion.torque * motion.qvel).sum() * task.timestep),
        peak=float(np.abs(motion.torque).max()),
    )


def _short(value: float) -> float | None:
    return None if np.isnan(value) else three_digits(value)


def _words(section: str, degrees: tuple[float, ...]) -> str:
    return f"Section {section}\n" + ", ".join(f"{joint} {a:g}°" for joint, a in zip(JOINTS, degrees, strict=True))
