"""Measure how fast tiles and a network follow a change of the leg, from what they know and anew.

    python experiments/relearning_legs.py --json docs/bench/relearning_legs.json    # some minutes on two cores
    python experiments/relearning_legs.py --json docs/bench/relearning_legs.json --out docs/relearning_legs.png

Five seeds learn `leg_reach`. Then its links become heavier, its joints get dry friction, or its goals lie elsewhere.
The same seeds learn on from these policies, and anew.
"""

import json
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from relearning import asked

import humanoid_mjx
from humanoid_mjx import compute
from humanoid_mjx.config import load
from humanoid_mjx.report.style import COLORS, count_axis, figure, label_lines
from humanoid_mjx.runs.statistics import difference, estimate
from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.continuous import State, begin
from humanoid_mjx.tasks.leg_reach import TERMS, LegReach

SEEDS, LATER, RECORD = 5, 200_000, 20
"""Seeds, control steps after the change, and points of a curve: five more episodes of each environment or so."""

BEFORE = {"leg_reach_linear": 400_000, "leg_reach": 600_000}
"""Shipped configs, and control steps before the change: as many as reach a success of .95 or more."""

CHANGES = {
    "links 1.25 times as heavy": {"load": 1.25},
    "dry friction of 0.001 N m": {"friction": 0.001},
    "goals in the upper halves": {"upper": 1.0},
}
POINTS = {"epsilon 0.3, decays": (0.3, 0.95), "epsilon 0.01": (0.01, 1.0)}
WAYS = ("known", "new start")

RUB_SPEED = 0.05
"""Speed at which dry friction is 3 / 4 of its most, rad/s."""


class ChangedLeg(LegReach):
    """`leg_reach` with changes that its controller does not know; goals lie in the lower half of each joint's range, or
    with `upper` 1 in the upper half."""

    load: float = traced(1.0, description="factor on the mass of each link")
    friction: float = traced(0.0, description="dry friction of each joint, N m")
    upper: float = traced(0.0, description="share of a half range by which goals are higher")

    def reset(self, key: Any) -> State:
        body = super().reset(key).data
        low, high = self.simulator.robot.ranges_rad.T
        goal, mass = low + (body.goal - low + self.upper * (high - low)) / 2, body.mass * self.load
        world = self._plant(mass).start(body.world.qpos, jnp.zeros(low.shape))
        body = body._replace(goal=goal, mass=mass, world=world)
        return begin(body, self.observe(body), TERMS)

    def controller(self, setpoint: Any) -> Any:
        law = super().controller(setpoint)
        return lambda stages: law(stages) - self.friction * jnp.tanh(stages.qvel / RUB_SPEED)


def config(name: str, change: Mapping[str, float], steps: int, seeds: int = SEEDS) -> dict[str, Any]:
    """Return a shipped config with a changed leg, as plain values."""
    data = load(name, []).model_dump(mode="json", exclude_none=True, exclude={"episodes", "sweep"})
    data["task"] = {"name": "relearning_legs:ChangedLeg", **change}
    data["learner"] |= {"evaluations": 2, "evaluation_envs": 256}
    return {key: data[key] for key in ("name", "task", "learner")} | {
        "seeds": seeds, "total_steps": steps, "record": RECORD,
    }  # fmt: skip


def measured(place: Path, name: str) -> dict[str, Any]:
    """Return by change and way: failed episodes since the change and curves, by point and seed."""
    old = humanoid_mjx.sweep(config(name, {}, BEFORE[name]), place / "before", quiet=True)
    found: dict[str, Any] = {"before": old.summary["greedy_success"].tolist(), "changes": {}}
    epsilons, decays = map(list, zip(*POINTS.values(), strict=True))
    for change, values in CHANGES.items():
        overrides = [f"task.{key}={value}" for key, value in values.items()]
        kept = humanoid_mjx.evaluate(old, episodes=512, overrides=overrides)["greedy"].success
        case: dict[str, Any] = {"old policy, greedy": kept.value}
        for way in WAYS:
            data = config(name, values, LATER)
            axes = {
                "learner.epsilon": epsilons,
                "learner.epsilon_decay": decays,
                "learner.epsilon_min": [0.01] * len(POINTS),
            }
            data["sweep"] = {"mode": "zip", "axes": axes}
            data["learner"] |= {"start_from": str(old.path)} if way == WAYS[0] else {}
            run = humanoid_mjx.sweep(data, place / change.replace(" ", "_") / way, quiet=True)
            success = run.results["success"].reshape(len(POINTS), SEEDS, RECORD).astype(float)
            episodes = LATER / np.nanmean(run.results["steps"])
            failed = episodes * (1.0 - np.nanmean(success, axis=2))
            case[way] = {
                "failed": np.rint(failed).tolist(),
                "curve": np.round(np.nanmedian(success, axis=1), 4).tolist(),
                "greedy": run.summary["greedy_success"].reshape(len(POINTS), SEEDS).astype(float).round(4).tolist(),
            }
        found["changes"][change] = case
        print(name, change, verdict(case), sep="\n", flush=True)
    return found


def verdict(case: Mapping[str, Any]) -> str:
    """A line a point: failed episodes of each way, and their difference by seeds."""
    lines = [f"  old policy, greedy: {case['old policy, greedy']}"]
    for point, words in enumerate(POINTS):
        known, new = (np.array(case[way]["failed"][point]) for way in WAYS)
        greedy = [np.median(case[way]["greedy"][point]) for way in WAYS]
        lines.append(f"  {words}: {estimate(known)}, {estimate(new)}, {difference(known, new)}; greedy {greedy}")
    return "\n".join(lines)


def draw(record: Mapping[str, Any], path: Path) -> None:
    """Draw the success while learning since the change: a row a learner, a panel a change."""
    rows = record["learners"]
    with figure(path, len(rows), len(CHANGES), (3.2, 2.6), sharey="row") as (fig, panels):
        words = "Success while learning since the change, median of five seeds; solid: known, dashed: new start"
        fig.suptitle(words, x=0.01, ha="left")
        for row, (name, found) in zip(panels, rows.items(), strict=True):
            for panel, (change, case) in zip(row, found["changes"].items(), strict=True):
                for way, style in zip(WAYS, ("-", "--"), strict=True):
                    for curve, words, color in zip(case[way]["curve"], POINTS, COLORS, strict=False):
                        label = words if style == "-" else "_"
                        panel.plot(np.linspace(0, LATER, RECORD + 1)[1:], curve, style, color=color, label=label)
                panel.set_title(change)
                panel.set_xlabel("control steps since the change")
                count_axis(panel)
            row[0].set_ylabel(f"{name}\nshare of episodes that succeed")
        label_lines(panels[0, -1])


def main() -> None:
    """Measure, and write a record; or draw one."""
    if not (file := asked(__doc__, draw)):
        return
    compute.start()
    record = compute.made_by() | {"seeds": SEEDS, "learners": {}}
    with tempfile.TemporaryDirectory() as folder:
        for name in BEFORE:
            record["learners"][name] = measured(Path(folder) / name, name)
            file.write_text(json.dumps(record) + "\n")


if __name__ == "__main__":
    main()
