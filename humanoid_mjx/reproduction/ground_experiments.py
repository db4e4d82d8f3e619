"""The free lower body on the ground: laws that hold it, still and pushed (chapter 5); the gaits of section 4.8.

The thesis plays its gaits on a leg whose torso is fixed. Here both legs carry the torso; the body starts upright with
its lowest corner on the ground. The tables say nothing of the senses in which hip, knee and ankle count, of what the
left leg does meanwhile, nor whether both legs yaw in the same sense: all readings are tried.
"""

from collections.abc import Iterator, Mapping
from itertools import product

import numpy as np

from humanoid_mjx.reproduction.findings import Finding, Setting, check, experiment, listed, unprinted
from humanoid_mjx.reproduction.ground import (
    LASTS_S,
    PHASES,
    Path,
    Trial,
    balanced,
    draw_bodies,
    physics,
    play,
    standing,
)

SECONDS = 3.0
SIDES = {"forwards": (1.0, 0.0), "backwards": (-1.0, 0.0), "sideways": (0.0, 1.0)}
IMPULSES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
"""Impulses on the hips over 0.1 s, N s. The body weighs 1.7 kg."""

PAIR = ("servo", "computed torque")
CONTROLLERS = (*PAIR, "section 5.7")
ROLL_HELD = "servo, rolls held"
CONFIG = {
    "servo": {"stiffness": 6.0, "damping": 0.2},
    "computed_torque": {"natural_frequency": 20.0, "damping_ratio": 1.0, "share": 0.1},
}


@experiment("ground-control", "A servo and computed torque on the ground, still and pushed", CONFIG)
def control(setting: Setting) -> list[Finding]:
    still = {name: Trial(name) for name in CONTROLLERS}
    sides = [*((name, side) for name in PAIR for side in SIDES), (ROLL_HELD, "sideways")]
    pushed = {
        (name, side, impulse): Trial(name, push=(impulse * SIDES[side][0], impulse * SIDES[side][1]))
        for name, side in sides
        for impulse in IMPULSES
    }
    paths = play([*still.values(), *pushed.values()], SECONDS, setting.config)
    servo, torque, blind = (paths[still[name]] for name in CONTROLLERS)
    taken = {key: max((i for i in IMPULSES if not paths[pushed[*key, i]].fell), default=0.0) for key in sides}
    stands = f"seconds of {SECONDS:g} that computed torque of section 5.7 with Table 5.1's gains stands"
    fixed = "the section's law treats the torso as fixed and ignores the ground; within the contacts computed torque "
    fixed += f"{torque.fate('stands')}, and a servo of {setting.config['servo']['stiffness']:g} N m/rad "
    fixed += servo.fate("stands")
    largest = "the largest push {} that it stands, N s: servo, computed torque within the contacts"
    impulses = f"of {listed(IMPULSES)} N s on the hips over 0.1 s"
    withstood = [unprinted(largest.format(side), [taken[name, side] for name in PAIR], impulses) for side in SIDES]
    return [unprinted(stands, blind.seconds, fixed), *withstood, judge_roll(taken)]


def judge_roll(taken: Mapping[tuple[str, str], float]) -> Finding:
    """The finding that hip rolls help against pushes from the side (chapter 8), from the largest impulse, N s, that a
    servo stands as it is and with its rolls held."""
    largest = [taken[name, "sideways"] for name in ("servo", ROLL_HELD)]
    quantity = "the largest push sideways that it stands, N s: with hip rolls, and with hip rolls that are held"
    claim = "the third joints help to stay in place when a sudden impact comes from the side (8)"
    why = "under a servo that holds the posture and takes no step; as the ankles do not roll, two flat feet leave the "
    why += "hips no way aside"
    return check(quantity, claim, largest, largest[0] > largest[1], why, 0.0)


TABLES = {"straight_walk": "Table 4.5", "sudden_turn": "Table 4.6"}
COLUMNS = 7
STEP_M, TURN_DEG = 0.06, 5.0
"""Thresholds: a foot's length counts as walking, m; the yaw of Table 4.6 as turning, degrees."""

SIGNS = tuple((hip, knee, ankle) for hip, knee, ankle in product((1, -1), repeat=3))
"""Signs of hip, knee and ankle in each reading of the tables, the one in the senses of `lower_body` first."""

HEADS = ("gait", "reading", "controller", "up, s", "forwards, m", "turn that lasts, degrees", "off the plan, rad")


@experiment("gaits-4.8", "The gaits of Tables 4.5 and 4.6 on the ground", CONFIG)
def walking(setting: Setting) -> Iterator[Finding]:
    played = play(printed_trials(), SECONDS, setting.config, setting.tell)
    setting.tell("balance")
    inside = {trial: balanced(path) for trial, path in played.items()}
    setting.table(HEADS, (_row(trial, path) for trial, path in played.items()))
    _draw(setting, played)
    yield from on_tables(played, inside)


def _draw(setting: Setting, played: Mapping[Trial, Path]) -> None:
    """Each table as it is planned, and the body that stands longest on the ground up to its fall."""
    rows, step_s = [], physics().step_s
    for gait, table in TABLES.items():
        best = max((t for t in played if t.motion == gait), key=lambda t: played[t].seconds)
        path, period = played[best], round(LASTS_S / step_s)
        plan = path.qpos[:, 7:] - path.error
        for words, motion in ((f"{table} as planned", plan[: period + 1]), (f"under {best.controller}", path.qpos)):
            at = np.linspace(0, len(motion) - 1, COLUMNS).astype(int)
            bodies = map(standing, motion[at]) if "planned" in words else motion[at]
            times = [f"{words}: 0 s", *(f"{step_s * i:.2g} s" for i in at[1:])]
            rows.append(list(zip(times, bodies, strict=True)))
    title = "A period of the gaits as planned, and on the ground up to the fall, in the reading that stands longest"
    draw_bodies(setting, title, rows, (2.2, 1.8))


def printed_trials() -> list[Trial]:
    """The tables as they are printed, in every reading, under every controller."""
    return [
        Trial(controller, gait, signs=signs, same_yaw=same, phase=phase)
        for gait in TABLES
        for same in ((False, True) if gait == "sudden_turn" else (False,))
        for phase in PHASES
        for signs in SIGNS
        for controller in CONTROLLERS
    ]


def on_tables(played: Mapping[Trial, Path], inside: Mapping[Trial, np.ndarray]) -> Iterator[Finding]:
    """The findings on the tables as printed."""
    for gait, table in TABLES.items():
        mine = {trial: path for trial, path in played.items() if trial.motion == gait}
        best = max(mine, key=lambda trial: (walks(mine[trial]), mine[trial].seconds))
        quantity = f"{table}: seconds of {SECONDS:g} on its feet and m forwards, in the best of all readings"
        claim = "a successful walk is obtained (5.8)" if gait == "straight_walk" else "a stable sudden turn (5.8)"
        why = f"{len(SIGNS)} readings of the signs of hip, knee and ankle, the left leg {', '.join(PHASES)}, under "
        why += f"{', '.join(CONTROLLERS)}; this is {reading(best)} under {best.controller}. Played as printed, without "
        why += "feedback of balance"
        found, agrees = [mine[best].seconds, round(mine[best].distance, 3)], any(map(walks, mine.values()))
        yield check(quantity, claim, found, agrees, why, STEP_M)
        best = max(mine, key=lambda trial: inside[trial].mean())
        share = float(inside[best].mean())
        quantity = f"{table}: share of the time that the zero-moment point is inside the support polygon"
        why = f"the most of all readings, {reading(best)} under {best.controller}, up to its fall; feet that touch "
        why += "with an edge or a corner have no inside"
        yield check(quantity, "lies inside for a successful walk (4.8.1)", round(share, 3), share > 0.99, why, 0.01)
    yield _turns(played)


def _turns(played: Mapping[Trial, Path]) -> Finding:
    """By how much the sudden turn turns further than the straight walk, in the same reading and controller."""
    turned = {
        t: path.lasting_turn - played[t._replace(motion="straight_walk", same_yaw=False)].lasting_turn
        for t, path in played.items()
        if t.motion == "sudden_turn"
    }
    standing = {t: turn for t, turn in turned.items() if not played[t].fell}
    counted = standing or turned
    best = max(counted, key=lambda t: abs(counted[t]))
    quantity = "turn of Table 4.6 beyond that of Table 4.5, degrees to the left, the largest of all readings"
    why = f"{len(turned)} bodies: {len(SIGNS)} readings of the signs, the yaw mirrored or in the same sense, the left "
    why += f"leg {', '.join(PHASES)}, {', '.join(CONTROLLERS)}; {len(standing)} stay up, and a twist that ends in a "
    why += f"fall or returns within a period is no turn. This is {reading(best)} under {best.controller}, which "
    why += f"{played[best].fate('stays up')}. A mirrored yaw that comes back within the period cannot turn a body over "
    why += "a period"
    agrees = any(abs(turn) > TURN_DEG for turn in standing.values())
    return check(quantity, "turns", round(counted[best], 1), agrees, why, TURN_DEG)


def walks(path: Path) -> bool:
    """True if a body stays on its feet and gets forwards by more than a step."""
    return not path.fell and path.distance > STEP_M


def reading(trial: Trial) -> str:
    """A trial's reading of its table, in words."""
    turned = [name for name, sign in zip(("hip", "knee", "ankle"), trial.signs, strict=True) if sign < 0]
    signs = " and ".join(turned) + " reversed" if turned else "no sign reversed"
    yaw = ", yaw in the same sense" if trial.same_yaw else ", yaw mirrored" if trial.motion == "sudden_turn" else ""
    return signs + yaw + ("" if trial.phase == PHASES[0] else f", left leg {trial.phase}")


def _row(trial: Trial, path: Path) -> list[str]:
    """A trial and its numbers as a row of the table."""
    up = f"{path.seconds:g}" + ("" if path.fell else " (all)")
    numbers = f"{path.distance:.3f}", f"{path.lasting_turn:.0f}", f"{np.sqrt(np.mean(path.error**2)):.3f}"
    return [TABLES[trial.motion], reading(trial), trial.controller, up, *numbers]
