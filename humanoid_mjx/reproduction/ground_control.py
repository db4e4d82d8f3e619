"""Chapter 5 on the ground: a plain servo and computed torque hold the standing body, still and pushed."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from humanoid_mjx.report.style import COLORS, label_lines
from humanoid_mjx.reproduction.findings import Experiment, Finding, Setting, check, listed, unprinted
from humanoid_mjx.reproduction.ground import Path, Trial, play
from humanoid_mjx.thesis import leg as thesis

SECONDS = 3.0
SIDES = {"forwards": (1.0, 0.0), "backwards": (-1.0, 0.0), "sideways": (0.0, 1.0)}
IMPULSES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
"""Impulses on the hips over 0.1 s, N s. The body weighs 1.7 kg."""

SHOWN = 0.2
"""Impulse of the pushes drawn, N s."""

PAIR = ("servo", "computed torque")
CONTROLLERS = (*PAIR, "section 5.7")
ROLL_HELD = "servo, rolls held"
NAME = "ground-control"
CONFIG = {
    "servo": {"stiffness": 6.0, "damping": 0.2},
    "computed_torque": {"natural_frequency": 20.0, "damping_ratio": 1.0, "share": 0.1},
}


def standing(setting: Setting) -> list[Finding]:
    """Findings on the controllers that stand, the pushes that they withstand, and the joints that give way."""
    still = {name: Trial(name) for name in CONTROLLERS}
    pushed = {
        (name, side, impulse): Trial(name, push=(impulse * x, impulse * y))
        for name in PAIR
        for side, (x, y) in SIDES.items()
        for impulse in IMPULSES
    }
    rolls = {(ROLL_HELD, "sideways", impulse): Trial(ROLL_HELD, push=(0.0, impulse)) for impulse in IMPULSES}
    pushed |= rolls
    paths = play([*still.values(), *pushed.values()], SECONDS, setting.config)
    pushes = {key: paths[trial] for key, trial in pushed.items()}
    alone = {name: paths[trial] for name, trial in still.items()}
    taken = {
        (name, side): max((i for i in IMPULSES if not pushes[name, side, i].fell), default=0.0)
        for name, side in dict.fromkeys((name, side) for name, side, _ in pushes)
    }
    gives = {name: [_largest(pushes[name, side, SHOWN]) for side in SIDES] for name in PAIR}
    _draw(setting, pushes, alone, taken)
    blind: Path = alone["section 5.7"]
    return [
        unprinted(
            f"seconds of {SECONDS:g} that computed torque of section 5.7 with Table 5.1's gains stands",
            blind.seconds,
            "the section's law treats the torso as fixed and ignores the ground; within the contacts computed "
            f"torque {_stands(alone['computed torque'])}, and a servo of {setting.config['servo']['stiffness']:g} "
            f"N m/rad {_stands(alone['servo'])}",
        ),
        *(
            unprinted(
                f"the largest push {side} that it stands, N s: servo, computed torque within the contacts",
                [taken[name, side] for name in PAIR],
                f"of {listed(IMPULSES)} N s on the hips over 0.1 s; {_better(taken, side)}",
            )
            for side in SIDES
        ),
        unprinted(
            f"the furthest that a joint gives way to {SHOWN:g} N s ({', '.join(SIDES)}), rad: computed torque",
            [round(x, 4) for x in gives["computed torque"]],
            f"the servo gives way by {', '.join(f'{x:.4f}' for x in gives['servo'])}",
        ),
        judge_roll(*({i: pushes[name, "sideways", i] for i in IMPULSES} for name in ("servo", ROLL_HELD))),
    ]


def judge_roll(free: Mapping[float, Any], held: Mapping[float, Any]) -> Finding:
    """The finding that hip rolls help against pushes from the side (chapter 8), from the paths of a servo by impulse.

    Args:
      free: of the body as it is.
      held: of the body whose rolls are held.
    """
    largest = [max((i for i, path in paths.items() if not path.fell), default=0.0) for paths in (free, held)]
    off = [_aside(paths[SHOWN]) for paths in (free, held)]
    return check(
        "the largest push sideways that it stands, N s: with hip rolls, and with hip rolls that are held",
        "the third joints help to stay in place when a sudden impact comes from the side (8)",
        largest,
        largest[0] > largest[1],
        f"under a servo that holds the posture and takes no step; {SHOWN:g} N s move the hips aside by "
        f"{1e3 * off[0]:.1f} mm, and by {1e3 * off[1]:.1f} mm where the rolls are held: as the ankles do not roll, two "
        "feet that are flat leave the hips no way aside",
        0.0,
    )


def _aside(path: Any) -> float:
    """Largest distance of the hips sideways from their start, m."""
    return float(np.abs(path.qpos[:, 1] - path.qpos[0, 1]).max())


def _largest(path: Any) -> float:
    return float(np.abs(path.error).max())


def _stands(path: Any) -> str:
    return f"falls after {path.seconds:g} s" if path.fell else "stands"


def _better(taken: Any, side: str) -> str:
    servo, torque = (taken[name, side] for name in PAIR)
    if servo == torque:
        return "both stand the same"
    return f"{'computed torque' if torque > servo else 'the servo'} stands the larger one"


def _draw(setting: Setting, pushes: Any, alone: Any, taken: Any) -> None:
    with setting.figure(1, 3, size=(4.4, 3.2)) as (fig, axes):
        heights, gives, bars = axes[0]
        for color, (name, path) in zip(COLORS, alone.items(), strict=False):
            heights.plot(path.times, 1e3 * path.qpos[:, 2], color=color, label=name)
        heights.set(ylabel="hips above the ground, mm", xlim=(0, SECONDS), title="standing")
        label_lines(heights)
        for side, style in zip(SIDES, ("-", "--", ":"), strict=True):
            for color, name in zip(COLORS, PAIR, strict=False):
                path = pushes[name, side, SHOWN]
                gives.plot(path.times, 1e3 * np.abs(path.error).max(axis=1), style, color=color)
        gives.set(xlim=(0.4, 1.4), ylabel="furthest joint from its place, mrad")
        gives.set_title(f"pushed by {SHOWN:g} N s: {', '.join(SIDES)} (-, - -, ...)", fontsize=8)
        for panel in (heights, gives):
            panel.set_xlabel("time, s")
        places = np.arange(len(SIDES))
        for shift, color, name in zip((-0.2, 0.2), COLORS, PAIR, strict=False):
            bars.bar(places + shift, [taken[name, side] for side in SIDES], 0.36, color=color, label=name)
        bars.set_xticks(places, list(SIDES))
        bars.set(ylabel="largest push that it stands, N s", title="steps of 0.1")
        bars.legend(frameon=False)
        gains = f"Table 5.1: {thesis.KP[0]:g} and {thesis.KD[0]:g} for joint 1"
        fig.suptitle(f"The free lower body under three controllers ({gains})", x=0.02, ha="left", fontsize="medium")


EXPERIMENTS = [Experiment(NAME, "A servo and computed torque on the ground, still and pushed", standing, CONFIG)]
