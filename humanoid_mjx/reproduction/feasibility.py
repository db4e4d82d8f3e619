"""What the lower body can do before it learns anything: stand on one leg, shift its weight, step and turn, with the two
columns of ranges of Table 3.2, and what torque that takes. The walking task's default column follows from it.

The source says nothing of this, so nothing is judged; but which column serves a walk is computed.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from humanoid_mjx.reproduction.feasible_postures import Body
from humanoid_mjx.reproduction.feasible_ranges import CLEAR, HELD, LEANS, LEG_LENGTH, Column, explore
from humanoid_mjx.reproduction.feasible_torques import INNER, OUTER, carried, gait, hiking, rocking, slowest
from humanoid_mjx.reproduction.findings import Experiment, Finding, Setting, listed, three_digits, unprinted
from humanoid_mjx.robot.ranges import TORQUE_LIMIT
from humanoid_mjx.thesis import leg as thesis

NAME = "feasibility-3.2"

CONFIG = {
    "gait": {"period": 0.5, "stance": 0.6},
    "posture": {"knee": 30.0},
    "walk": {"speed": 0.25, "sideways": 0.1, "turn": 1.0, "lift": 0.015},
}
"""The gait's clock, s and share; the bend of the knees, degrees; what a walk is to do at least, m/s and rad/s, and how
high it lifts its ankles, m. Clock, posture and the commands sideways and round are those of the task `walk`."""

COLUMNS = ("proposed", "human")

SUDDEN = 45.0
"""Change of heading that a sudden turn makes, degrees."""

Config = Mapping[str, Mapping[str, float]]


class Needs(NamedTuple):
    """What a walk about its posture asks of the ranges."""

    roll: float
    """rad. So far the hips roll both ways: with the body as it rocks, to keep the torso level, or for a foot that is
    left behind sideways."""
    turn: float
    """rad. So far a foot turns both ways against the torso."""
    travel: float
    """m. So far the hips pass over a foot."""

    def unmet(self, column: Column) -> list[str]:
        """What a column does not allow, in words."""
        roll, turn = np.degrees([self.roll, self.turn])
        allowed = {
            f"a hip that rolls inwards by {roll:.1f} degrees": -column.roll[0] >= self.roll,
            f"a hip that rolls outwards by {roll:.1f} degrees": column.roll[1] >= self.roll,
            f"toes {turn:.1f} degrees inwards": column.toes_in >= self.turn,
            f"toes {turn:.1f} degrees outwards": column.toes_out >= self.turn,
            f"hips that pass {1e3 * self.travel:.0f} mm over a foot": column.longest[0] >= self.travel,
        }
        return [words for words, can in allowed.items() if not can]


class Loads(NamedTuple):
    """Largest torques, (5,) N m each, of a leg that carries all, and of one in the air."""

    slow: np.ndarray
    """Carrying, as slow as statics,"""
    fast: np.ndarray
    """carrying at the pace of the gait,"""
    swing: np.ndarray
    """and swinging at it."""


def feasibility(setting: Setting) -> list[Finding]:
    from humanoid_mjx.reproduction.feasibility_figures import draw_feasibility, draw_stances

    config = setting.config
    joints, height = posture(config)
    columns = {name: explore(name, height, setting.tell) for name in COLUMNS}
    setting.tell("rocking and walking")
    body = Body("human")
    loads = walking_loads(body, config, columns["human"].longest[1])
    _write(setting.out / f"{NAME}.md", columns, loads)
    draw_stances(setting.out / f"{NAME}-stances.png", columns)
    draw_feasibility(setting.out / f"{NAME}.png", columns, loads, body, joints, config)
    return [
        *on_balance(columns),
        *on_rocking(body, joints, config),
        *on_steps(columns, config),
        *on_torques(columns, loads, config),
        conclude(columns, needed(body, config)),
    ]


def posture(config: Config) -> tuple[np.ndarray, float]:
    """The joints, (10,) rad, with the knees bent and flat feet below the hips, and the hips' height above the ankles."""
    bend = math.radians(config["posture"]["knee"]) / 2
    return np.tile([bend, 0.0, 0.0, 2 * bend, -bend], 2), LEG_LENGTH * math.cos(bend)


def needed(body: Body, config: Config) -> Needs:
    """What the walk of the config needs."""
    joints, height = posture(config)
    (period, stance), walk = config["gait"].values(), config["walk"]
    on_ground = stance * period
    aside = math.asin(walk["sideways"] * on_ground / 2 / height)
    tilt = rocking(body, joints, period, stance).tilt
    return Needs(max(aside, tilt), walk["turn"] * on_ground / 2, walk["speed"] * on_ground)


def walking_loads(body: Body, config: Config, height: float) -> Loads:
    """Torques of the config's walk, its hips so high above the ankles, m; each foot carries all while it stands."""
    (period, stance), walk = config["gait"].values(), config["walk"]
    moments = list(zip(*gait(walk["speed"], height, period, stance, walk["lift"]), strict=True))
    still, moving = (
        np.abs([carried(body, *states).torque for states in (tuple(m[:1]) if slow else m for m in moments)])
        for slow in (True, False)
    )
    stands = np.arange(len(moments)) < stance * len(moments)
    return Loads(still[stands, :5].max(axis=0), moving[stands, :5].max(axis=0), moving[stands, 5:].max(axis=0))


def on_balance(columns: Mapping[str, Column]) -> list[Finding]:
    """One foot, and the weight shifted to it."""
    mm = {name: [_mm(x) for x in c.lifted] for name, c in columns.items()}
    both = {name: [_mm(x) for x in c.planted] for name, c in columns.items()}
    high = [_mm(c.highest) for c in columns.values()]
    share = [float(np.abs(c.torque).max() / TORQUE_LIMIT) for c in columns.values()]
    leans = listed(LEANS)
    order = " and ".join(columns)
    return [
        unprinted(
            NAME,
            f"margin of the centre of mass in the sole of one foot, torso upright, mm: {order}",
            [row[0] for row in mm.values()],
            f"the best posture, the other foot lifted by {_mm(CLEAR):g} mm, of a sole that offers {_mm(OUTER - INNER) / 2}"
            f"; negative is outside, where it falls. With a lean up to {leans} degrees: {_rows(mm)}. No ankle rolls, so "
            "the hip stays above the foot's middle line, and only leaning or turning the torso over it, or the other "
            "leg thrown across, brings the mass there",
        ),
        unprinted(
            NAME,
            f"least lean of the torso to stand on one foot, degrees: {order}",
            [round(math.degrees(c.lean), 1) for c in columns.values()],
            f"the mass {_mm(HELD):g} mm inside the sole's edges; it takes {share[0]:.0%} and {share[1]:.0%} of the "
            f"torque of the busiest joint, and up to {LEANS[-1]:g} degrees the other foot gets {high[0]:.0f} and "
            f"{high[1]:.0f} mm high",
        ),
        unprinted(
            NAME,
            f"margin in one sole with both flat on the ground, side by side below the hips, mm: {order}",
            [_mm(c.beside) for c in columns.values()],
            f"up to {LEANS[-1]:g} degrees of lean: the mass stays in the middle, {_mm(INNER):g} mm from either sole, as "
            "hips above both feet can neither roll nor turn. With the feet put anywhere, the legs clear of each other, "
            f"leaning up to {leans} degrees: {_rows(both)}. So no weight is shifted at rest before a foot is lifted",
        ),
    ]


def on_rocking(body: Body, joints: np.ndarray, config: Config) -> list[Finding]:
    """Sideways sway that is not at rest."""
    period, stance = config["gait"].values()
    way = rocking(body, joints, period, stance)
    longest = slowest(body, joints, stance)
    drop, hike = hiking(body, period, stance)
    upright = carried(body, body.standing(np.zeros(10)))
    borne = (OUTER - INNER) / 2 * upright.force[2]
    return [
        unprinted(
            NAME,
            f"sway to each side, mm, and tilt of the soles, degrees, of a body that rocks from foot to foot in {period:g} s",
            [round(_mm(way.sway), 1), round(math.degrees(way.tilt), 1)],
            f"over the soles' outer edges, {_mm(OUTER):g} mm from the middle, falling as exp({way.rate:.2f} t), while a "
            f"foot is in the air for {(1 - stance) * period:g} s; a point mass at that height has sqrt(g / h) = "
            f"{way.natural:.2f} / s. Above {longest:.2f} s the mass would have to come above a sole",
        ),
        unprinted(
            NAME,
            "hike of the free hip, degrees, if no sole tilts",
            round(math.degrees(hike), 1),
            f"in {period:g} s, of which a foot is in the air for {(1 - stance) * period:g} s: on one "
            f"straight leg level hips take {upright.torque[2]:.2f} N m at its roll, the sole's inner edge bears "
            f"{borne:.2f}, and so the free hip drops at {drop:.0f} rad/s^2 and has to be thrown up before; in 1 s it "
            f"would be {math.degrees(hiking(body, 1.0, stance)[1]):.0f} degrees, as it grows with the period's square",
        ),
    ]


def on_steps(columns: Mapping[str, Column], config: Config) -> list[Finding]:
    """Steps and turns."""
    on_ground, period = config["gait"]["stance"] * config["gait"]["period"], config["gait"]["period"]
    order = " and ".join(columns)
    each = list(columns.values())
    rates = [(c.toes_in + c.toes_out) / on_ground for c in each]
    steps = [math.ceil(math.radians(SUDDEN) / (rate * period / 2)) for rate in rates]
    extension = [abs(thesis.JOINT_RANGES[name][0][0]) for name in columns]
    return [
        unprinted(
            NAME,
            f"speed with flat feet, level hips and an upright torso, m/s: {order}",
            [three_digits(c.longest[0] / on_ground) for c in each],
            f"hips {_mm(each[0].longest[1]):.0f} mm above the ankles pass {_mm(each[0].longest[0]):.0f} mm over a foot "
            f"while it stands, {on_ground:g} s; in the walking posture {_mm(each[0].travel):.0f} mm, "
            f"{each[0].travel / on_ground:.2f} m/s, and {_mm(each[0].rolling):.0f} mm, {each[0].rolling / on_ground:.2f} "
            f"m/s, if the heel leaves the ground first. Behind the hip the ankle ends it, at 20 degrees of dorsiflexion "
            f"in both columns, not the hip's extension of {extension[0]:g} and {extension[1]:g}; the same ankle lets a "
            f"level foot be lifted by {_mm(each[0].level):.1f} mm only",
        ),
        unprinted(
            NAME,
            f"toes in and out in the walking posture, the foot flat, degrees: {order}",
            [[round(math.degrees(c.toes_in), 1) + 0.0, round(math.degrees(c.toes_out), 1)] for c in each],
            "a thigh that is not upright has to roll inwards when its foot turns inwards, which the proposed hip cannot. "
            f"Swept from end to end while the foot stands, these turn by {rates[0]:.1f} and {rates[1]:.1f} rad/s; "
            f"{SUDDEN:g} degrees take {steps[0]} and {steps[1]} steps of {period / 2:g} s",
        ),
    ]


def on_torques(columns: Mapping[str, Column], loads: Loads, config: Config) -> list[Finding]:
    """Torques as shares of the limit."""
    walk = config["walk"]
    rows = {
        "a leg that carries all, slowly through a step": loads.slow,
        f"the same at {walk['speed']:g} m/s": loads.fast,
        "a leg that swings": loads.swing,
        **{f"one foot with the {name} ranges": np.abs(c.torque).reshape(2, 5).max(axis=0) for name, c in columns.items()},
    }
    worst = max(rows, key=lambda name: rows[name].max())
    return [
        unprinted(
            NAME,
            f"largest share of the limit of {TORQUE_LIMIT:g} N m",
            round(float(rows[worst].max() / TORQUE_LIMIT), 2),
            "; ".join(
                f"{name}: "
                + ", ".join(f"{joint.replace('_', ' ')} {t:.2f}" for joint, t in zip(thesis.JOINT_NAMES, row, strict=True))
                for name, row in rows.items()
            )
            + " N m. Torque does not tell the columns apart",
        )
    ]


def conclude(columns: Mapping[str, Column], needs: Needs) -> Finding:
    """Which columns allow a walk about its posture."""
    unmet = {name: needs.unmet(column) for name, column in columns.items()}
    return unprinted(
        NAME,
        "columns of Table 3.2 with which a walk can swing both ways about its posture",
        [name for name, missing in unmet.items() if not missing],
        "; ".join(f"{name} {'lacks ' + ', '.join(words) if words else 'lacks nothing'}" for name, words in unmet.items()),
    )


def _mm(metres: float) -> float:
    return round(1e3 * metres, 2) + 0.0


def _rows(values: Mapping[str, list[float]]) -> str:
    return "; ".join(f"{name} {listed(round(x, 1) for x in row)}" for name, row in values.items())


def _write(path: Path, columns: Mapping[str, Column], loads: Loads) -> None:
    """All that was found as a table."""
    each = columns.values()
    rows: list[tuple[str, list[float]]] = []
    for words, field in (("the other lifted", "lifted"), ("both flat, anywhere", "planted")):
        for i, lean in enumerate(LEANS):
            rows.append((f"margin in one sole, {words}, lean {lean:g} degrees, mm", [_mm(getattr(c, field)[i]) for c in each]))
    rows += [
        ("both flat below the hips, mm", [_mm(c.beside) for c in each]),
        ("least lean on one foot, degrees", [math.degrees(c.lean) for c in each]),
        ("other foot lifted by, mm", [_mm(c.highest) for c in each]),
        ("hips pass over a flat foot in the walking posture, mm", [_mm(c.travel) for c in each]),
        ("the same at the best height, mm", [_mm(c.longest[0]) for c in each]),
        ("the same in the walking posture, the foot ending on its toes, mm", [_mm(c.rolling) for c in each]),
        ("level foot lifted by, mm", [_mm(c.level) for c in each]),
        ("toes in, degrees", [math.degrees(c.toes_in) for c in each]),
        ("toes out, degrees", [math.degrees(c.toes_out) for c in each]),
    ]
    for i, joint in enumerate(thesis.JOINT_NAMES):
        name = joint.replace("_", " ")
        rows.append((f"{name}, on one foot, N m", [abs(float(c.torque[i])) for c in each]))
        for words, torque in zip(("carrying, slowly", "carrying, walking", "swinging"), loads, strict=True):
            rows.append((f"{name}, {words}, N m", [float(torque[i])] * 2))
    with path.open("w", encoding="utf-8") as file:
        file.write(f"| what | {' | '.join(columns)} |\n|---|---|---|\n")
        file.writelines(f"| {what} | {' | '.join(f'{v:.4g}' for v in values)} |\n" for what, values in rows)


EXPERIMENTS = [Experiment(NAME, "What the lower body can do with each column of Table 3.2", feasibility, CONFIG)]
