"""Judge and draw what chapter 8 of the thesis says of its design, from the record of `experiments/chapter_8.py`.

python experiments/chapter_8_verdicts.py       # prints the verdicts and writes docs/chapter_8.png, in seconds
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Num
from scipy import stats

from humanoid_mjx.report.style import COLORS, figure
from humanoid_mjx.reproduction.findings import Finding, unprinted
from humanoid_mjx.runs.statistics import estimate, improvement

ROOT = Path(__file__).parent.parent

ROUND = "turn +1.0", "turn -1.0"
AHEAD = "forward 0.15", "forward 0.3", "forward 0.5", "forward 0.8"

LEVEL = 0.05
"""Share of false verdicts over all claims."""

LITTLE, SLOWER = 0.05, 0.05
"""Share of episodes, and m/s: differences that are no deviation."""

YAW = "the motion of the second joint helps to take the turn very efficiently and stabilize the body (8)"
ROLL = "the third joints help to stay back in the original position when a sudden impact comes from the side (8)"
FAST = "the fast movement will be achieved without any deviation in the stability (8)"
PITCH = "the first, fourth and fifth joint lie in one plane, do not disturb each other, and move fast (8)"


def above(one: Num[np.ndarray, " n"], other: Num[np.ndarray, " m"]) -> float:
    """The probability that independent runs alike separate so far with `one` above: Mann and Whitney's test, exact."""
    exact: Any = stats.PermutationMethod(n_resamples=9_999, rng=np.random.default_rng(0))
    return float(stats.mannwhitneyu(one, other, alternative="greater", method=exact).pvalue)


def holm(probabilities: Num[np.ndarray, " tests"]) -> Float[np.ndarray, " tests"]:
    """The probabilities of several tests, corrected for their number (S. Holm, 1979)."""
    order, count = np.argsort(probabilities), len(probabilities)
    raised = np.maximum.accumulate(np.asarray(probabilities)[order] * (count - np.arange(count)))
    return np.minimum(raised[np.argsort(order)], 1.0)


class What(NamedTuple):
    """A figure under some commands and pushes."""

    figure: str
    commands: Sequence[str]
    push: float = 0.0
    """N s"""


class Record:
    """The figures of a record by body."""

    def __init__(self, data: dict[str, Any]) -> None:
        self._rows = {(row["body"], row["push"]): row for row in data["rows"]}
        self.bodies = list(dict.fromkeys(row["body"] for row in data["rows"]))
        self.pushes = sorted({row["push"] for row in data["rows"]})

    def seeds(self, body: str, what: What) -> Float[np.ndarray, " seeds"]:
        """A figure of each training seed, mean of its commands. Where no body lived to have it: that of one that stands
        still, 1 rad/s for `turn_error` and else 0."""
        row = self._rows[body, what.push]
        values = [row[what.figure][row["commands"].index(command)] for command in what.commands]
        return np.nan_to_num(np.array(values, float), nan=float(what.figure == "turn_error")).mean(axis=0)


TURN, ERROR = What("turn_success", ["sudden turn"]), What("turn_error", ROUND)
FASTEST, UPRIGHT = What("forward", AHEAD[-1:]), What("success", AHEAD[-1:])


class Claim(NamedTuple):
    """A claim that seeds of one kind are above those of another, or below by no more than is allowed."""

    quantity: str
    words: str
    one: Float[np.ndarray, " seeds"]
    other: Float[np.ndarray, " seeds"]
    better: int = 1
    """-1 where less is better."""
    allowed: float = 0.0


def findings(record: Record) -> list[Finding]:
    """The verdicts on all claims, corrected for their number, and what the proposed ranges do."""
    whole, fixed = "all joints", "no yaw, no roll"

    def helps(quantity: str, claim: str, without: str, what: What, better: int = 1) -> Claim:
        one, other = (record.seeds(body, what) for body in (whole, without))
        return Claim(f"{quantity}: {whole}, {without}", claim, one, other, better)

    def in_ranges(quantity: str, what: What) -> Finding:
        found, why = _told(*(record.seeds(body, what) for body in ("proposed ranges", whole)))
        return unprinted(f"{quantity}: proposed ranges, human ranges", found, why)

    slow, fast = (record.seeds(whole, What("success", [command])) for command in (AHEAD[0], AHEAD[-1]))
    few, all_ = (record.seeds(body, FASTEST) * record.seeds(body, UPRIGHT) for body in (fixed, whole))
    claims = [
        helps("turns by 45 degrees within 1.5 s", YAW, "no yaw", TURN),
        helps("error of the turn rate at 1 rad/s, rad/s", YAW, "no yaw", ERROR, better=-1),
        helps("upright for 20 s, turning at 1 rad/s", YAW, "no yaw", What("success", ROUND)),
        *(
            helps(f"upright, pushed aside by {push:g} N s, {on}", ROLL, "no roll", What("success", [on], push))
            for push in record.pushes[1:]
            for on in ("stand", "forward 0.3")
        ),
        Claim(f"upright for 20 s: told 0.8 m/s, told 0.15 m/s; {whole}", FAST, fast, slow, allowed=LITTLE),
        Claim(f"speed told 0.8 m/s by the share upright: {fixed}, {whole}", PITCH, few, all_, allowed=SLOWER),
    ]
    return [
        *judged(claims),
        in_ranges("turns by 45 degrees within 1.5 s", TURN),
        in_ranges("upright, pushed aside by 0.5 N s, forward 0.3", What("success", ["forward 0.3"], 0.5)),
        in_ranges("speed told 0.8 m/s, m/s", FASTEST),
    ]


def judged(claims: Sequence[Claim]) -> list[Finding]:
    """The verdicts by the exact test of Mann and Whitney, corrected for the number of claims by Holm's method: a claim
    is reproduced if chance separates the seeds so far in at most 5 % of the cases, differs if that holds of its
    opposite, and else the seeds cannot tell."""
    pairs = [(c.better * c.one + c.allowed, c.better * c.other) for c in claims]
    true = holm(np.array([above(one, other) for one, other in pairs]))
    false = holm(np.array([above(other, one) for one, other in pairs]))
    found = []
    for claim, yes, no in zip(claims, true, false, strict=True):
        verdict = "reproduced" if yes <= LEVEL else "differs" if no <= LEVEL else "cannot_tell"
        values, why = _told(claim.one, claim.other)
        limit = f"; {claim.allowed:g} less would be no deviation" if claim.allowed else ""
        why += f"; corrected p {min(yes, no):.2g}{limit}"
        found.append(Finding(claim.quantity, claim.words, values, None, verdict, why))
    return found


def _told(one: np.ndarray, other: np.ndarray) -> tuple[list[float], str]:
    """Both medians, and in words both with their intervals, and how often a seed of one is above one of the other."""
    words = " and ".join("{:.3f} ({:.3f} to {:.3f})".format(*estimate(seeds, 0.0)) for seeds in (one, other))
    pairs = f"the first is above in {improvement(one, other):.0%} of the pairs"
    return [round(float(np.median(seeds)), 3) for seeds in (one, other)], f"{words} in {len(one)} seeds; {pairs}"


def draw(record: Record, target: Path) -> None:
    """One row for each body: a dot for each training seed, and the median with its 95 % interval."""
    panels = (
        ("45 degrees at once\nwithin 1.5 s", [("", TURN)]),
        ("error of the turn rate\nat 1 rad/s, rad/s", [("", ERROR)]),
        (
            "upright for 20 s at 0.3 m/s,\npushed aside every 3 s",
            [(f"{push:g} N s", What("success", ["forward 0.3"], push)) for push in record.pushes[1:]],
        ),
        (
            "upright for 20 s, not\npushed, by command",
            [(f"{command[8:]} m/s", What("success", [command])) for command in AHEAD[::3]],
        ),
        (
            "forward speed, m/s,\nby command",
            [(f"{command[8:]} m/s", What("forward", [command])) for command in AHEAD[1:]],
        ),
    )
    places = np.arange(len(record.bodies))[::-1]
    with figure(target, 1, len(panels), size=(2.5, 3.0), sharey=True) as (_, axes):
        for panel, (heading, of) in zip(axes[0], panels, strict=True):
            for shift, color, (label, what) in zip((0.22, 0.0, -0.22), COLORS, of, strict=False):
                for place, body in zip(places + (shift if len(of) > 1 else 0.0), record.bodies, strict=True):
                    seeds = record.seeds(body, what)
                    middle, low, high = estimate(seeds)
                    panel.plot(seeds, np.full(len(seeds), place), "o", color=color, alpha=0.35, markersize=3)
                    panel.errorbar(
                        middle,
                        place,
                        xerr=[[middle - low], [high - middle]],
                        fmt="|",
                        color=color,
                        capsize=2,
                        markersize=8,
                    )
                if label:
                    panel.plot([], [], "o", color=color, markersize=3, label=label)
            if of[0][0]:
                below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.08), "ncols": 3, "columnspacing": 0.8}
                panel.legend(frameon=False, fontsize=7, **below)
            if of[0][1].figure in ("success", "turn_success"):
                panel.set_xlim(-0.05, 1.05)  # shares; intervals may reach beyond
            panel.set_title(heading)
        axes[0, 0].set_yticks(places, record.bodies)


def main() -> None:
    """Print the verdicts, and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, default=ROOT / "docs/bench/chapter_8.json", help="the record")
    parser.add_argument("--out", type=Path, default=ROOT / "docs/chapter_8.png", help="the figure")
    given = parser.parse_args()
    record = Record(json.loads(given.json.read_text()))
    for finding in findings(record):
        print(f"{finding.verdict}: {finding.quantity}: {finding.why}")
    draw(record, given.out)


if __name__ == "__main__":
    main()
