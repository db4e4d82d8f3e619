"""Measure how fast a table follows a change of its world, from what it knows and anew.

    python experiments/relearning.py --json docs/bench/relearning.json    # a minute on two cores
    python experiments/relearning.py --json docs/bench/relearning.json --out docs/relearning.png    # draws a record

Each sweep trains in one world. Three more sweeps then train in the changed world, with the same seeds: from the earlier
policies with epsilon as at the start, from the earlier policies with epsilon as it had decayed by then, and anew.
"""

import argparse
import json
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.ticker import EngFormatter

import humanoid_mjx
from humanoid_mjx import compute
from humanoid_mjx.report.style import COLORS, figure, label_lines, log_axis
from humanoid_mjx.runs.curves import read_learning
from humanoid_mjx.runs.statistics import difference, interval
from humanoid_mjx.tasks.navigate import shortest_path

EPSILONS, DECAYS = (0.01, 0.03, 0.1, 0.3), (1.0, 0.97)
"""Values of epsilon at the start, and factors on it after each episode."""

SEEDS, EPISODES, LATER, MOST = 100, 300, 2000, 200
"""Seeds, episodes before the change and after, and steps after which an episode is cut off."""

RIGHT, LEFT, BOTH = "########.", ".########", ".#######."


def room(wall: str, goal: str = "........G") -> tuple[str, ...]:
    """A room with a wall across it, as in the mazes of Sutton and Barto (2018), figures 8.4 and 8.5."""
    return (goal, ".........", ".........", wall, ".........", "...S.....")


CHANGES = {
    "a way is blocked, a longer one opens": (room(RIGHT), room(LEFT)),
    "a shortcut opens": (room(LEFT), room(BOTH)),
    "the goal moves": (room(RIGHT), room(RIGHT, "G........")),
}
"""Maps before and after the change."""

WAYS = ("known, epsilon again", "known, epsilon as decayed", "new start")


def asked(words: str | None, draw: Callable[[Mapping[str, Any], Path], None]) -> Path | None:
    """The record that the command line wants made; None if it wanted one drawn, which is done."""
    parser = argparse.ArgumentParser(description=words, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, required=True, help="the record, which is made if there is no --out")
    parser.add_argument("--out", type=Path, help="draw the record instead")
    given = parser.parse_args()
    if given.out:
        draw(json.loads(given.json.read_text()), given.out)
    return None if given.out else given.json


def main() -> None:
    """Measure, and write a record; or draw one."""
    if not (file := asked(__doc__, draw)):
        return
    compute.start()
    record = compute.made_by() | {"seeds": SEEDS, "changes": {}}
    with tempfile.TemporaryDirectory() as folder:
        for name, maps in CHANGES.items():
            record["changes"][name] = measured(Path(folder) / name, *maps)
            print(name, verdict(record["changes"][name]), sep="\n", flush=True)
    file.write_text(json.dumps(record) + "\n")


def table(grid: tuple[str, ...], episodes: int) -> dict[str, Any]:
    """Return the config of a sweep of tables on a map."""
    task = {"name": "navigate", "map": list(grid), "step_reward": -1.0, "bonus": 0.0, "max_episode_steps": MOST}
    learner = {"name": "tabular_q", "discount": 0.95, "learning_rate": 0.5, "epsilon_min": 0.0}
    return {"name": "room", "task": task, "learner": learner, "seeds": SEEDS, "episodes": episodes, "record": episodes}


def points(decayed: bool) -> dict[str, Any]:
    """Return the sweep over `EPSILONS` and `DECAYS`; `decayed`: epsilon as it is at the end of such a training."""
    both = [(epsilon, decay) for epsilon in EPSILONS for decay in DECAYS]
    if decayed:
        both = [(epsilon * decay**EPISODES, 1.0) for epsilon, decay in both]
    epsilons, decays = map(list, zip(*both, strict=True))
    return {"mode": "zip", "axes": {"learner.epsilon": epsilons, "learner.epsilon_decay": decays}}


def measured(place: Path, before: tuple[str, ...], after: tuple[str, ...]) -> dict[str, Any]:
    """Return the excess steps of each way after the change, by horizon, point and seed; and by point the share of seeds
    whose greedy path is the shortest at the end."""
    known, least = place / "known", shortest_path(after) or 0
    humanoid_mjx.sweep(table(before, EPISODES) | {"sweep": points(False)}, known, quiet=True)
    found: dict[str, Any] = {"regret": {}, "greedy": {}}
    for way in WAYS:
        config = table(after, LATER) | {"sweep": points(way == WAYS[1])}
        if way != WAYS[2]:
            config["learner"] |= {"start_from": str(known)}
        run = humanoid_mjx.sweep(config, place / way, quiet=True)
        learning = read_learning(run.path, config, run.summary, quickest=True)
        excess = learning.read("steps") - least
        for episodes in (EPISODES, LATER):
            regret = np.rint(excess[..., :episodes].sum(axis=-1)).astype(int).tolist()
            found["regret"].setdefault(f"excess steps in {episodes:,} episodes", {})[way] = regret
        found["greedy"][way] = (run.summary["greedy_steps"].reshape(-1, SEEDS) == least).mean(axis=1).tolist()
    return found


def verdict(case: Mapping[str, Any]) -> str:
    """A line a way: its best setting, what it loses there, and the difference from a new start at its best."""
    pairs, lines = [(epsilon, decay) for epsilon in EPSILONS for decay in DECAYS], []
    for horizon, ways in case["regret"].items():
        regrets = {way: np.array(values) for way, values in ways.items()}
        best = {way: int(np.median(values, axis=1).argmin()) for way, values in regrets.items()}
        new = regrets[WAYS[2]][best[WAYS[2]]]
        lines.append(f"  {horizon}")
        for way, values in regrets.items():
            own, (epsilon, decay), greedy = values[best[way]], pairs[best[way]], case["greedy"][way]
            low, high = interval(own)
            words = f"    {way}: {np.median(own):.4g} ({low:.4g} to {high:.4g}) at epsilon {epsilon}, decay {decay}"
            words += "" if way == WAYS[2] else f"; minus new start {difference(own, new)}"
            lines.append(f"{words}; greedy at the end {greedy[best[way]]}, of all points {greedy}")
    return "\n".join(lines)


def draw(record: Mapping[str, Any], path: Path) -> None:
    """Draw what each way loses over epsilon, a panel a change, a line a way and decay."""
    cases = [(name, *each) for name, case in record["changes"].items() for each in case["regret"].items()]
    horizons = list(dict.fromkeys(horizon for _, horizon, _ in cases))
    cases.sort(key=lambda case: horizons.index(case[1]))
    with figure(path, 2, 3, (4.0, 2.8)) as (fig, panels):
        words = "Loss after a change of the world, over epsilon: median and 95 % interval over seeds"
        fig.suptitle(words, x=0.01, ha="left")
        for panel, (name, horizon, ways) in zip(panels.flat, cases, strict=False):
            for color, (way, regret) in zip(COLORS, ways.items(), strict=False):
                for row, decay in enumerate(DECAYS):
                    if way == WAYS[1] and decay == 1.0:
                        continue  # the same as the first way
                    values = np.array(regret)[row :: len(DECAYS)]
                    low, high = interval(values.T)
                    middle, style = np.median(values, axis=1), "-" if decay == 1.0 else "--"
                    words = f"{way}, {'constant' if decay == 1.0 else f'decay {decay}'}"
                    panel.plot(EPSILONS, middle, style, color=color, marker="o", markersize=3, label=words)
                    panel.fill_between(EPSILONS, low, high, color=color, alpha=0.15, linewidth=0)
            panel.set_title(name)
            panel.set_xlabel("epsilon at the start")
            panel.set_ylabel(horizon)
            log_axis(panel)
            panel.set_ylim(bottom=0.0)
            panel.yaxis.set_major_formatter(EngFormatter(sep=""))
        label_lines(panels[0, -1])


if __name__ == "__main__":
    main()
