"""What the lower body can do before it learns anything: stand on one leg, shift its weight, step and turn, with the two
columns of ranges of Table 3.2, and what torque that takes. The walking task's default column follows from it.

The source says nothing of this, so nothing is judged; but which column serves a walk is computed.
"""

import math
from collections.abc import Iterable, Mapping
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
    "gait": {"period": 0.48, "stance": 0.62},
    "posture": {"knee": 30.0},
    "walk": {"speed": 0.25, "sideways": 0.15, "turn": 1.0, "lift": 0.015},
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
    rows = torque_rows(columns, loads, config)
    _write(setting.out / f"{NAME}.md", columns, rows)
    draw_stances(setting.out / f"{NAME}-stances.png", columns)
    draw_feasibility(setting.out / f"{NAME}.png", columns, rows, body, joints, config)
    return [
        *on_balance(columns),
        *on_rocking(body, joints, config),
        *on_steps(columns, config),
        on_torques(rows),
        conclude(columns, needed(body, config)),
    ]


def posture(config: Config) -> tuple[np.ndarray, float]:
    """The walking posture's joints, (10,) rad, feet flat below the hips, and the hips' height above the ankles, m."""
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
    each, leans = list(columns.values()), listed(LEANS)
    alone, both = ({name: getattr(c, field) for name, c in columns.items()} for field in ("lifted", "planted"))
    within = {name: [f"{x:g} degrees" for x, y in zip(LEANS, both[name], strict=True) if y > 0] for name in columns}
    first = ", ".join(f"{leans[0] if leans else 'no lean'} ({name})" for name, leans in within.items())
    return [
        unprinted(
            NAME,
            f"margin of the mass in the sole of one foot, upright, mm: {' and '.join(columns)}",
            [_mm(c.lifted[0]) for c in each],
            f"the best posture, the other foot {_mm(CLEAR):g} mm up; the middle of a sole has "
            f"{_mm(OUTER - INNER) / 2:g}, a negative margin is a fall. Leaning up to {leans} degrees: {_rows(alone)}. "
            "No ankle rolls, so the hip "
            "stays above the foot's middle line: the mass comes there only as the torso leans or turns over it, or the "
            "other leg is thrown across",
        ),
        unprinted(
            NAME,
            f"least lean of the torso to stand on one foot, degrees: {' and '.join(columns)}",
            [round(math.degrees(c.lean), 1) for c in each],
            f"the mass {_mm(HELD):g} mm inside; the busiest joint gives "
            f"{_both(np.abs(c.torque).max() / TORQUE_LIMIT for c in each)} of its torque. Leaning up to {LEANS[-1]:g} "
            f"degrees the other foot comes {_both(c.highest for c in each)} m high",
        ),
        unprinted(
            NAME,
            f"margin in one sole, both flat below the hips, mm: {' and '.join(columns)}",
            [_mm(c.beside) for c in each],
            f"leaning up to {LEANS[-1]:g} degrees: hips above both feet neither roll nor turn, so the mass stays in "
            f"the middle. With the feet put anywhere, leaning up to {leans} degrees: {_rows(both)}; it comes above a "
            f"sole from {first} on: a walk shifts no weight at rest",
        ),
    ]


def on_rocking(body: Body, joints: np.ndarray, config: Config) -> list[Finding]:
    """Sideways sway that is not at rest."""
    period, stance = config["gait"].values()
    air = (1 - stance) * period
    way, longest = rocking(body, joints, period, stance), slowest(body, joints, stance)
    drop, hike = hiking(body, period, stance)
    upright = carried(body, body.standing(np.zeros(10)))
    borne = (OUTER - INNER) / 2 * upright.force[2]
    return [
        unprinted(
            NAME,
            f"sway to each side, mm, and tilt of the soles, degrees, as it rocks from foot to foot in {period:g} s",
            [round(_mm(way.sway), 1), round(math.degrees(way.tilt), 1)],
            f"stiff, over the soles' outer edges, {_mm(OUTER):g} mm from the middle, a foot in the air for {air:g} s: "
            f"it falls as exp({way.rate:.2f} t), a point at its height, by sqrt(g / h), as exp({way.natural:.2f} t). "
            f"In a period above {longest:.2f} s the mass has to come {_mm(INNER):g} mm aside, above a sole",
        ),
        unprinted(
            NAME,
            f"hike of the free hip, degrees, if no sole tilts in {period:g} s",
            round(math.degrees(hike), 1),
            f"level hips take {upright.torque[2]:.2f} N m at the roll of a straight leg, and a sole's edge bears "
            f"{borne:.2f}: the free hip drops at {drop:.0f} rad/s^2 and has to be thrown up first; in 1 s by "
            f"{math.degrees(hiking(body, 1.0, stance)[1]):.0f} degrees, since it grows with the period's square. So "
            "a quick gait asks the least",
        ),
    ]


def on_steps(columns: Mapping[str, Column], config: Config) -> list[Finding]:
    """Steps and turns."""
    period, on_ground = config["gait"]["period"], config["gait"]["stance"] * config["gait"]["period"]
    each = list(columns.values())
    rates = [(c.toes_in + c.toes_out) / on_ground for c in each]
    steps = [math.ceil(math.radians(SUDDEN) / (rate * period / 2)) for rate in rates]
    return [
        unprinted(
            NAME,
            f"speed on flat feet, hips level, torso upright, m/s: {' and '.join(columns)}",
            [three_digits(c.longest[0] / on_ground) for c in each],
            f"hips {_both(_mm(c.longest[1]) for c in each)} mm above the ankles pass "
            f"{_both(_mm(c.longest[0]) for c in each)} mm over a foot in {on_ground:g} s. Lower ones would bend the "
            "hind foot's ankle beyond its 20 degrees: in the walking posture they pass "
            f"{_both(_mm(c.travel) for c in each)} mm, or, the heel rising until the hip cannot stretch further, "
            f"{_both(_mm(c.rolling) for c in each)} mm, {_both(c.rolling / on_ground for c in each)} m/s. The same "
            f"ankle lets a level foot be lifted by {_both(_mm(c.level) for c in each)} mm only, in both columns",
        ),
        unprinted(
            NAME,
            f"toes in and out in the walking posture, sole flat, degrees: {' and '.join(columns)}",
            [[round(math.degrees(x), 1) + 0.0 for x in (c.toes_in, c.toes_out)] for c in each],
            "above bent knees the thigh points forward, and a foot can turn inwards only if its hip rolls inwards. "
            f"Swept while the foot stands this gives {_both(rates)} rad/s, and {SUDDEN:g} degrees in "
            f"{steps[0]} and {steps[1]} steps of {period / 2:g} s",
        ),
    ]


def on_torques(rows: Mapping[str, np.ndarray]) -> Finding:
    """Torques against the limit."""
    worst = max(rows, key=lambda words: rows[words].max())
    names = ", ".join(joint.replace("_", " ") for joint in thesis.JOINT_NAMES)
    told = "; ".join(f"{words} {', '.join(f'{x:.2f}' for x in row)}" for words, row in rows.items())
    return unprinted(
        NAME,
        f"largest share of the torque limit of {TORQUE_LIMIT:g} N m",
        round(float(rows[worst].max() / TORQUE_LIMIT), 2),
        f"where it {worst}; {names}, N m: {told}",
    )


def torque_rows(columns: Mapping[str, Column], loads: Loads, config: Config) -> dict[str, np.ndarray]:
    """The largest torques of a leg, (5,) N m, by what it does."""
    pace = f"at {config['walk']['speed']:g} m/s"
    walks = dict(zip(("carries all, slowly", f"carries all {pace}", f"swings {pace}"), loads, strict=True))
    still = {f"stands on one foot, {n} ranges": np.abs(c.torque).reshape(2, 5).max(axis=0) for n, c in columns.items()}
    return walks | still


def conclude(columns: Mapping[str, Column], needs: Needs) -> Finding:
    """Which columns allow a walk about its posture."""
    unmet = {name: needs.unmet(column) for name, column in columns.items()}
    return unprinted(
        NAME,
        "columns of Table 3.2 with which a walk can swing both ways about its posture",
        [name for name, missing in unmet.items() if not missing],
        "; ".join(f"{name} lacks {', '.join(words) if words else 'nothing'}" for name, words in unmet.items()),
    )


def _mm(metres: float) -> float:
    return round(1e3 * metres, 2) + 0.0


def _rows(margins: Mapping[str, list[float]]) -> str:
    return "; ".join(f"{name} {listed(round(_mm(x), 1) for x in row)}" for name, row in margins.items())


def _both(values: Iterable[float]) -> str:
    """Numbers of the columns in words, one where they agree."""
    return " and ".join(dict.fromkeys(f"{value:.3g}" for value in values))


def _write(path: Path, columns: Mapping[str, Column], rows: Mapping[str, np.ndarray]) -> None:
    """All that was found, as two tables."""
    each, table = columns.values(), []
    for words, field in (("the other lifted", "lifted"), ("both flat, anywhere", "planted")):
        for i, lean in enumerate(LEANS):
            margins = [1e3 * getattr(column, field)[i] for column in each]
            table.append((f"margin in one sole, {words}, leaning up to {lean:g} degrees, mm", margins))
    lengths = {
        "margin in one sole, both flat below the hips": [c.beside for c in each],
        "other foot lifted by": [c.highest for c in each],
        "hips pass over a flat foot in the walking posture": [c.travel for c in each],
        "hips pass over a flat foot at the best height": [c.longest[0] for c in each],
        "hips pass over a foot that ends on its toes, in the walking posture": [c.rolling for c in each],
        "level foot lifted by": [c.level for c in each],
    }
    angles = {"least lean on one foot": "lean", "toes in": "toes_in", "toes out": "toes_out"}
    table += [(f"{words}, mm", [1e3 * x for x in values]) for words, values in lengths.items()]
    table += [(f"{words}, degrees", [math.degrees(getattr(c, x)) for c in each]) for words, x in angles.items()]
    joints = [joint.replace("_", " ") for joint in thesis.JOINT_NAMES]
    with path.open("w", encoding="utf-8") as file:
        for heads, lines in (("what", *columns), table), (("largest torque of a leg that, N m", *joints), rows.items()):
            file.write(f"| {' | '.join(heads)} |\n{'|---' * len(heads)}|\n")
            file.writelines(f"| {what} | {' | '.join(f'{x + 0.0:.2f}' for x in values)} |\n" for what, values in lines)
            file.write("\n")


EXPERIMENTS = [Experiment(NAME, "What the lower body can do with each column of Table 3.2", feasibility, CONFIG)]
