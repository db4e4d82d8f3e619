"""Search what the lower body can do before it learns anything: stand on one leg, shift its weight, step and turn, with
the two columns of ranges of Table 3.2, and what torque that takes.

    python experiments/feasibility.py    # writes docs/bench/feasibility.json, and two figures into runs/, in a minute

The default column of the tasks on the ground follows from it; docs/robot.md says what it found. The thesis prints
nothing of this, so nothing is judged.
"""

import argparse
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from feasibility_figures import draw_feasibility, draw_stances
from feasible_postures import Body
from feasible_ranges import LEANS, LEG_LENGTH, Column, explore
from feasible_torques import Way, carried, gait, hiking, rocking, slowest

from humanoid_mjx.compute import made_by
from humanoid_mjx.tasks import make_task
from humanoid_mjx.thesis import leg as thesis

RECORD = Path(__file__).parent.parent / "docs" / "bench" / "feasibility.json"

TASK = make_task("walk")

WAY = Way(
    period=TASK.gait.period,
    stance=TASK.gait.stance,
    speed=0.25,
    sideways=TASK.command.sideways[1],
    turn=TASK.command.turn[1],
    lift=0.015,
)
"""What a walk is to do at least: clock, posture and the commands sideways and round are those of the task `walk`."""

HEIGHT = LEG_LENGTH * math.cos(TASK.posture[0])
"""Height of the hips above the ankles in the walking posture, m."""

SUDDEN = 45.0
"""Change of heading that a sudden turn makes, degrees."""

Row = tuple[str, list[float]]
"""Words, and a value for each column."""


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


def needed(body: Body, way: Way) -> Needs:
    """What a walk that starts from the task's posture needs."""
    aside = math.asin(way.sideways * way.on_ground / 2 / HEIGHT)
    tilt = rocking(body, TASK.posture, way.period, way.stance).tilt
    return Needs(max(aside, tilt), way.turn * way.on_ground / 2, way.speed * way.on_ground)


def torque_rows(body: Body, columns: Mapping[str, Column], way: Way) -> dict[str, np.ndarray]:
    """The largest torques of a leg, (5,) N m, by what it does; each foot carries all while it stands."""
    height = columns["human"].longest[1]
    moments = list(zip(*gait(way.speed, height, way.period, way.stance, way.lift), strict=True))
    still = np.abs([carried(body, qpos).torque for qpos, _, _ in moments])
    moving = np.abs([carried(body, *states).torque for states in moments])
    stands, pace = np.arange(len(moments)) < way.stance * len(moments), f"at {way.speed:g} m/s"
    return {
        "carries all, slowly": still[stands, :5].max(axis=0),
        f"carries all {pace}": moving[stands, :5].max(axis=0),
        f"swings {pace}": moving[stands, 5:].max(axis=0),
    } | {f"stands on one foot, {n} ranges": np.abs(c.torque).reshape(2, 5).max(axis=0) for n, c in columns.items()}


def column_rows(columns: Mapping[str, Column], way: Way) -> list[Row]:
    """What each column allows. No ankle rolls, so the hip stays above the middle line of a flat foot: the mass comes
    there only as the torso leans or turns over it, or the other leg is thrown across."""
    each = columns.values()
    rows = [
        (f"margin in one sole, {words}, leaning up to {lean:g} degrees, mm", [1e3 * getattr(c, field)[i] for c in each])
        for words, field in (("the other lifted", "lifted"), ("both flat, anywhere", "planted"))
        for i, lean in enumerate(LEANS)
    ]
    lengths = {
        "margin in one sole, both flat below the hips": [c.beside for c in each],
        "other foot lifted by": [c.highest for c in each],
        "hips pass over a flat foot in the walking posture": [c.travel for c in each],
        "hips pass over a flat foot at the best height": [c.longest[0] for c in each],
        "that height above the ankles": [c.longest[1] for c in each],
        "hips pass over a foot that ends on its toes, in the walking posture": [c.rolling for c in each],
        "level foot lifted by": [c.level for c in each],
    }
    angles = {"least lean on one foot": "lean", "toes in": "toes_in", "toes out": "toes_out"}
    rows += [(f"{words}, mm", [1e3 * x for x in values]) for words, values in lengths.items()]
    rows += [(f"{words}, degrees", [math.degrees(getattr(c, x)) for c in each]) for words, x in angles.items()]
    rates = [(c.toes_in + c.toes_out) / way.on_ground for c in each]
    return [
        *rows,
        ("speed on flat feet, hips level, m/s", [c.longest[0] / way.on_ground for c in each]),
        ("speed over the toes, m/s", [c.rolling / way.on_ground for c in each]),
        ("turn of a foot swept while it stands, rad/s", rates),
        (
            f"steps of a turn by {SUDDEN:g} degrees",
            [math.ceil(2 * math.radians(SUDDEN) / r / way.period) for r in rates],
        ),
    ]


def sway_rows(body: Body, way: Way) -> list[Row]:
    """Sideways sway that is not at rest: a stiff body that rocks over the soles' outer edges, or, the soles flat, a hip
    that is thrown up, by an angle that grows with the period's square."""
    rock, (drop, hike) = rocking(body, TASK.posture, way.period, way.stance), hiking(body, way.period, way.stance)
    return [
        ("sway to each side, mm", [1e3 * rock.sway]),
        ("tilt of the soles, degrees", [math.degrees(rock.tilt)]),
        ("rate at which it falls, 1/s", [rock.rate]),
        ("the same of a point at its height, 1/s", [rock.natural]),
        ("period above which the mass comes above a sole, s", [slowest(body, TASK.posture, way.stance)]),
        ("hike of the free hip if no sole tilts, degrees", [math.degrees(hike)]),
        ("drop of the free hip, rad/s^2", [drop]),
    ]


def lacking(columns: Mapping[str, Column], needs: Needs) -> dict[str, str]:
    """What each column lacks for a walk about its posture, in words; empty where it lacks nothing."""
    return {name: ", ".join(needs.unmet(column)) for name, column in columns.items()}


def study(out: Path) -> tuple[dict[str, Column], dict[str, Any]]:
    """Explore both columns. Return them and the record of the study; the figures go into the folder."""
    out.mkdir(parents=True, exist_ok=True)
    columns = {name: explore(name, HEIGHT, lambda words: print(words, flush=True)) for name in ("proposed", "human")}
    body = Body("human")
    torques = torque_rows(body, columns, WAY)
    draw_stances(out / "feasibility-stances.png", columns)
    draw_feasibility(out / "feasibility.png", columns, torques, body, TASK.posture, WAY)
    return columns, {
        "ranges": {words: dict(zip(columns, values, strict=True)) for words, values in column_rows(columns, WAY)},
        "sway": {"period, s": WAY.period} | {words: values[0] for words, values in sway_rows(body, WAY)},
        "largest torques, N m": {
            words: dict(zip(thesis.JOINT_NAMES, map(float, values), strict=True))
            for words, values in (torques | {"Table 4.7": np.array(thesis.MAX_TORQUES)}).items()
        },
        "lacks": lacking(columns, needed(body, WAY)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/feasibility"), help="the folder of the figures")
    _, found = study(parser.parse_args().out)
    RECORD.write_text(json.dumps(made_by() | found, indent=1) + "\n")
    print(RECORD)


if __name__ == "__main__":
    main()
