"""Section 4.8 on the ground: Tables 4.5 and 4.6 and the pattern generator on the free lower body.

The thesis plays its gaits on a leg whose torso is fixed. Here both legs carry the torso, the left one half a period
after the right, joints as in `robot.lower_body`; the body starts upright with its lowest corner on the ground.
"""

from typing import Any

import numpy as np

from humanoid_mjx.report.style import COLORS, figure
from humanoid_mjx.reproduction.findings import Experiment, Finding, Setting, judge, listed
from humanoid_mjx.thesis import leg as thesis

TABLES = {"straight_walk": "Table 4.5", "sudden_turn": "Table 4.6"}
PAIR = ("servo", "computed torque")
NAME = "gaits-4.8"
SECONDS = 3.0
STEP_M, TURN_DEG, SLIP = 0.06, 5.0, 0.02
"""What counts: as a way, a foot's length; as a turn, the yaw of Table 4.6; as a foot that stays, m/s."""

AMPLITUDES, FREQUENCIES = (0.1, 0.25, 0.5, 1.0), (0.625, 1.25, 2.5)
"""Of the pattern generator: share of the table's angles, and Hz; the table's own are 1 and 1.25."""

VIEW_M = 0.15
"""What the figures show."""

CONFIG = {"servo": {"kp": 6.0, "kd": 0.2}, "computed_torque": {"kp": 400.0, "kd": 40.0, "share": 0.1}}


def walking(setting: Setting) -> list[Finding]:
    """Whether it walks and turns, with the balance on the way."""
    from humanoid_mjx.reproduction.ground import Trial, balance_of, play

    tables = {(gait, name): Trial(name, gait) for gait in TABLES for name in PAIR}
    generated = {
        (gait, name, amplitude, frequency): Trial(name, gait, frequency, amplitude)
        for gait in TABLES
        for name in PAIR
        for amplitude in AMPLITUDES
        for frequency in FREQUENCIES
    }
    paths = play([*tables.values(), *generated.values()], SECONDS, setting.config)
    played = {key: paths[trial] for key, trial in tables.items()}
    balances = {key: balance_of(path) for key, path in played.items()}
    others = {key: paths[trial] for key, trial in generated.items()}
    _write(setting, played, others)
    _draw_balance(setting, played, balances)
    _draw_prints(setting, played, balances)
    findings = [finding for gait in TABLES for finding in _of_table(gait, played, balances)]
    return [*findings, _turns(played), *(_of_generator(gait, others) for gait in TABLES)]


def _of_table(gait: str, played: Any, balances: Any) -> list[Finding]:
    pair = [played[gait, name] for name in PAIR]
    inside = [float(np.mean(balances[gait, name].margin > 0)) for name in PAIR]
    falls = [path.seconds if path.fell else SECONDS for path in pair]
    edges = [float(np.mean([len(_hull(*row)) < 3 for row in zip(p.corners, p.touching, strict=True)])) for p in pair]
    columns = (thesis.STRAIGHT_WALK[joint] for joint in ("hip_pitch", "knee_pitch", "ankle_pitch"))
    tilts = [hip - knee - ankle for hip, knee, ankle in zip(*columns, strict=True)]
    beside = [1e3 * max(-float(_finite(balances[gait, name].center_margin).min()), 0.0) for name in PAIR]
    return [
        Finding(
            name=NAME,
            quantity=f"{TABLES[gait]}: seconds of {SECONDS:g} on its feet, m forwards: {', '.join(PAIR)}",
            printed="walks",
            reproduced=[[t, round(path.distance, 3)] for t, path in zip(falls, pair, strict=True)],
            tolerance=STEP_M,
            verdict=judge(any(_walks(path) for path in pair), {}, {}),
            why="; ".join(
                f"{name}: stance feet slip at {path.slip:.3f} m/s, joints are {path.tracking:.3f} rad off the table"
                for name, path in zip(PAIR, pair, strict=True)
            )
            + "; played as printed, without feedback of balance",
        ),
        Finding(
            name=NAME,
            quantity=f"{TABLES[gait]}: share of the time that the zero-moment point is inside the support polygon",
            printed=1.0,
            reproduced=[round(x, 3) for x in inside],
            tolerance=0.01,
            verdict=judge(max(inside) > 0.99, {}, {}),
            why=f"section 4.8.1 asks for it; for {edges[0]:.2f} and {edges[1]:.2f} of the time the feet touch with an "
            f"edge or a corner, which has no inside: to the torso the table tilts the sole by {min(tilts):g} to "
            f"{max(tilts):g} degrees; the mass centre goes {beside[0]:.0f} and {beside[1]:.0f} mm beyond what touches",
        ),
        Finding(
            name=NAME,
            quantity=f"{TABLES[gait]}: speed of stance feet over the ground, m/s: {', '.join(PAIR)}",
            printed=None,
            reproduced=[round(path.slip, 3) for path in pair],
            tolerance=SLIP,
            verdict=judge(all(path.slip < SLIP for path in pair), {}, {}),
            why=f"nothing is printed; feet under {SLIP:g} would count as standing",
        ),
    ]


def _turns(played: Any) -> Finding:
    turned = [round(played["sudden_turn", name].turn - played["straight_walk", name].turn, 1) for name in PAIR]
    stays = [not played["sudden_turn", name].fell for name in PAIR]
    both = [f"{played[gait, name].turn:.0f}" for gait in TABLES for name in PAIR]
    return Finding(
        name=NAME,
        quantity=f"turn of Table 4.6 beyond that of Table 4.5, degrees to the left: {', '.join(PAIR)}",
        printed="turns",
        reproduced=turned,
        tolerance=TURN_DEG,
        verdict=judge(any(abs(t) > TURN_DEG and s for t, s in zip(turned, stays, strict=True)), {}, {}),
        why=f"the torso twists by {', '.join(both)} degrees (Table 4.5, then 4.6); a twist that ends in a fall, as "
        f"{stays.count(False)} of {len(PAIR)} do here, is no turn",
    )


def _of_generator(gait: str, others: Any) -> Finding:
    from humanoid_mjx.reproduction.ground import balance_of

    mine = {key[1:]: path for key, path in others.items() if key[0] == gait}
    longest = max(mine, key=lambda key: (mine[key].seconds, mine[key].distance))
    path = mine[longest]
    name, amplitude, frequency = longest
    inside = float(np.mean(balance_of(path).margin > 0))
    walks = [key for key, path in mine.items() if _walks(path)]
    stay = sum(not path.fell for path in mine.values())
    return Finding(
        name=NAME,
        quantity=f"pattern generator on {TABLES[gait]}: settings of {len(mine)} with which it walks",
        printed=None,
        reproduced=len(walks),
        tolerance=None,
        verdict=judge(bool(walks), {}, {}),
        why=f"amplitudes {listed(AMPLITUDES)}, {listed(FREQUENCIES)} Hz, both controllers: {stay} stay up for "
        f"{SECONDS:g} s; longest up ({path.seconds:g} s, {path.distance:.3f} m): {name}, "
        f"{amplitude:g} at {frequency:g} Hz, with the zero-moment point inside for {inside:.2f} of the time",
    )


def _hull(corners: np.ndarray, touching: np.ndarray) -> np.ndarray:
    from humanoid_mjx.mechanics.balance import support_polygon

    return support_polygon(corners[touching, :2])


def _finite(values: np.ndarray) -> np.ndarray:
    return values[np.isfinite(values)]


def _walks(path: Any) -> bool:
    return not path.fell and path.distance > STEP_M


def _write(setting: Setting, played: Any, others: Any) -> None:
    """Every trial's numbers as a table."""
    rows = [(*key, "as printed", "", path) for key, path in played.items()]
    rows += [(*key, path) for key, path in others.items()]
    with (setting.out / f"{NAME}.md").open("w", encoding="utf-8") as file:
        file.write(
            "| gait | controller | amplitude | Hz | up, s | forwards, m | twist, degrees | slip, m/s | off, rad |\n"
        )
        file.write("|---" * 9 + "|\n")
        for gait, name, amplitude, frequency, path in rows:
            up = f"{path.seconds:g}" + ("" if path.fell else " (all)")
            numbers = f"{up} | {path.distance:.3f} | {path.turn:.0f} | {path.slip:.3f} | {path.tracking:.3f}"
            file.write(f"| {TABLES[gait]} | {name} | {amplitude} | {frequency} | {numbers} |\n")


def _draw_balance(setting: Setting, played: Any, balances: Any) -> None:
    """Centre of mass and zero-moment point against the support, forwards and sideways, and the margin."""
    with figure(setting.out / f"{NAME}-balance.png", 3, len(played), size=(3.6, 2.3), sharex=True) as (fig, axes):
        for column, (key, path) in zip(axes.T, played.items(), strict=True):
            found = balances[key]
            times = path.times[:-1]
            for axis, (panel, way) in enumerate(zip(column, ("forwards", "to the left"), strict=False)):
                corners = np.where(path.touching, path.corners[..., axis], np.nan)[:-1]
                some = path.touching[:-1].any(axis=1)
                low, high = (
                    np.where(some, f(np.nan_to_num(corners, nan=s), axis=1), np.nan)
                    for f, s in ((np.min, np.inf), (np.max, -np.inf))
                )
                panel.fill_between(times, 1e3 * low, 1e3 * high, color="0.85", label="support")
                panel.plot(
                    times, 1e3 * _near(found.point)[:, axis], color=COLORS[1], linewidth=1, label="zero-moment point"
                )
                panel.plot(times, 1e3 * found.center[:, axis], color=COLORS[0], label="centre of mass")
                panel.set_ylim(-150, 150)
                panel.set_ylabel(f"{way}, mm")
            column[2].plot(times, 1e3 * found.margin, color=COLORS[1], linewidth=1)
            column[2].plot(times, 1e3 * found.center_margin, color=COLORS[0])
            column[2].axhline(0, color="0.4", linewidth=0.8)
            column[2].set_ylim(-100, 40)
            column[2].set_ylabel("margin in the support, mm")
            column[2].set_xlabel("time, s")
            column[0].set_title(f"{TABLES[key[0]]}, {key[1]}")
        axes[0, 0].legend(frameon=False, fontsize=7, loc="lower left")
        fig.suptitle("Until the fall", x=0.02, ha="left", fontsize="medium")


def _draw_prints(setting: Setting, played: Any, balances: Any) -> None:
    """From above: what of the feet touches, and the ways of the centre of mass and the zero-moment point."""
    with figure(setting.out / f"{NAME}-prints.png", 1, len(played), size=(3.4, 3.5)) as (_, axes):
        for panel, (key, path) in zip(axes[0], played.items(), strict=True):
            found = balances[key]
            for side, (name, color) in enumerate(zip(("right", "left"), COLORS, strict=False)):
                foot = slice(4 * side, 4 * side + 4)
                touched = 1e3 * path.corners[:, foot, :2][path.touching[:, foot]]
                panel.scatter(-touched[:, 1], touched[:, 0], s=5, color=color, label=f"{name} foot's corners")
                print_ = 1e3 * _hull(path.corners[0, foot], np.ones(4, bool))
                panel.fill(-print_[:, 1], print_[:, 0], color=color, alpha=0.15, linewidth=0)
            point = 1e3 * _near(found.point)
            panel.plot(-point[:, 1], point[:, 0], color=COLORS[2], linewidth=0.8, label="zero-moment point")
            panel.plot(-1e3 * found.center[:, 1], 1e3 * found.center[:, 0], color=COLORS[6], label="centre of mass")
            panel.set_aspect("equal")
            panel.set_xlim(-150, 150)
            panel.set_ylim(-130, 170)
            panel.set_xlabel("to the right, mm")
            panel.set_title(f"{TABLES[key[0]]}, {key[1]}: falls at {path.seconds:g} s", fontsize=8)
        axes[0, 0].set_ylabel("forwards, mm (shaded: the feet at the start)")
        axes[0, 0].legend(frameon=False, fontsize=7, loc="upper right")


def _near(point: np.ndarray) -> np.ndarray:
    """Without what is far off, where hardly a force pushes the ground."""
    return np.where((np.abs(point) < VIEW_M).all(axis=1, keepdims=True), point, np.nan)


EXPERIMENTS = [Experiment(NAME, "The gaits of Tables 4.5 and 4.6 on the ground", walking, CONFIG)]
