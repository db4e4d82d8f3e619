"""Chapter 5 on the ground: a plain servo and computed torque hold the standing body, still and pushed."""

from collections.abc import Mapping
from typing import Any

from humanoid_mjx.reproduction.findings import Finding, Setting, check, experiment, listed, unprinted
from humanoid_mjx.reproduction.ground import Path, Trial, play

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
def standing(setting: Setting) -> list[Finding]:
    """Findings on the controllers that stand, and the pushes that they withstand."""
    still = {name: Trial(name) for name in CONTROLLERS}
    sides = [*((name, side) for name in PAIR for side in SIDES), (ROLL_HELD, "sideways")]
    pushed = {
        (name, side, impulse): Trial(name, push=(impulse * SIDES[side][0], impulse * SIDES[side][1]))
        for name, side in sides
        for impulse in IMPULSES
    }
    paths = play([*still.values(), *pushed.values()], SECONDS, setting.config)
    pushes = {key: paths[trial] for key, trial in pushed.items()}
    alone = {name: paths[trial] for name, trial in still.items()}
    taken = {key: _largest({i: pushes[*key, i] for i in IMPULSES}) for key in sides}
    blind: Path = alone["section 5.7"]
    stands = f"seconds of {SECONDS:g} that computed torque of section 5.7 with Table 5.1's gains stands"
    fixed = "the section's law treats the torso as fixed and ignores the ground; within the contacts computed torque "
    fixed += f"{alone['computed torque'].fate('stands')}, and a servo of {setting.config['servo']['stiffness']:g} "
    fixed += f"N m/rad {alone['servo'].fate('stands')}"
    largest = "the largest push {} that it stands, N s: servo, computed torque within the contacts"
    impulses = f"of {listed(IMPULSES)} N s on the hips over 0.1 s"
    withstood = [unprinted(largest.format(side), [taken[name, side] for name in PAIR], impulses) for side in SIDES]
    rolls = judge_roll(*({i: pushes[name, "sideways", i] for i in IMPULSES} for name in ("servo", ROLL_HELD)))
    return [unprinted(stands, blind.seconds, fixed), *withstood, rolls]


def judge_roll(free: Mapping[float, Any], held: Mapping[float, Any]) -> Finding:
    """The finding that hip rolls help against pushes from the side (chapter 8), from the paths of a servo by impulse.

    Args:
      free: of the body as it is.
      held: of the body whose rolls are held.
    """
    largest = [_largest(free), _largest(held)]
    quantity = "the largest push sideways that it stands, N s: with hip rolls, and with hip rolls that are held"
    claim = "the third joints help to stay in place when a sudden impact comes from the side (8)"
    why = "under a servo that holds the posture and takes no step; as the ankles do not roll, two flat feet leave the "
    why += "hips no way aside"
    return check(quantity, claim, largest, largest[0] > largest[1], why, 0.0)


def _largest(paths: Mapping[float, Any]) -> float:
    """The largest impulse without a fall, N s."""
    return max((impulse for impulse, path in paths.items() if not path.fell), default=0.0)
