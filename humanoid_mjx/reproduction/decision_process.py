"""Findings of our own on chapter 6: what its decision process does that its text does not say."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from humanoid_mjx.report.style import COLORS, figure
from humanoid_mjx.reproduction.findings import Experiment, Finding, Setting, judge
from humanoid_mjx.thesis import q_learning as thesis

PRINTED = thesis.PSEUDO_CODE
SEEDS = 32
POSITIONS = {1: 24, 4: 25, 5: 13}
"""Places of each joint in steps of 5 degrees: with so many states, rows and places are the same."""


def decay(setting: Setting) -> list[Finding]:
    """The pseudo-code with its declared epsilonDecay at work."""
    from humanoid_mjx.reproduction.traces import printed_run

    findings = []
    for joint in thesis.JOINT_RANGES:
        run = printed_run(joint, setting.config, runs=100, steps=20_000)
        reached = int(run.terminated.any(axis=1).sum())
        findings.append(
            Finding(
                name="finding-decay",
                quantity=f"joint {joint} reaches its goal, of 100 runs",
                printed=100,
                reproduced=reached,
                tolerance=0,
                verdict=judge(reached == 100, {}, {}, possible=reached > 0),
                why=f"epsilonDecay = {setting.config['learner']['epsilon_decay']:g} is declared, not used; applied in "
                "every step, exploration dies before the joint arrives, and greedy ties mean to stay (20,000 steps)",
            )
        )
    return findings


def waiting(setting: Setting) -> list[Finding]:
    """From which discount on the reward pays for waiting just before the goal."""
    discounts = np.round(np.arange(0.80, 0.99, 0.01), 2)
    share = {joint: _greedy_success(joint, {"learner.discount": discounts.tolist()}) for joint in POSITIONS}
    at_printed = int(np.argmin(np.abs(discounts - PRINTED["discount"])))
    findings = []
    for joint, (_, goal) in thesis.JOINT_RANGES.items():
        last, end = thesis.REWARD_SCALE * (goal - thesis.FIGURES_ACTION), thesis.REWARD_SCALE * goal
        findings.append(
            Finding(
                name="finding-waiting",
                quantity=f"joint {joint}: share of greedy episodes that reach the goal at the printed discount",
                printed=1.0,
                reproduced=round(float(share[joint][at_printed]), 3),
                tolerance=0.01,
                verdict=judge(bool(share[joint][at_printed] > 0.99), {}, {}),
                why=f"waiting a step before the goal for ever ({last:g} a step) is worth more than the goal ({end:g} + "
                f"{PRINTED['bonus']:g}, once) from {1 - last / (end + PRINTED['bonus']):.4f} on; in training the "
                f"largest discount tried at which most runs go to the goal is {_largest(discounts, share[joint]):g}",
            )
        )
    with figure(setting.out / "finding-waiting.png", 1, 1, size=(5.5, 3.4)) as (_, axes):
        panel = axes[0, 0]
        for row, joint in enumerate(POSITIONS):
            panel.plot(discounts, share[joint], color=COLORS[row], marker="o", markersize=3)
            place = _largest(discounts, share[joint]) + 0.005, 0.25 + 0.2 * row
            panel.annotate(f"joint {joint}", place, (4, 0), textcoords="offset points", color=COLORS[row])
        panel.axvline(PRINTED["discount"], color="0.5", linewidth=1, linestyle="--")
        panel.annotate("printed", (PRINTED["discount"], 0.05), (-40, 0), textcoords="offset points", color="0.3")
        panel.set_title(f"The reward pays for waiting (standard rules, {SEEDS} seeds each)")
        panel.set_xlabel("discount")
        panel.set_ylabel("greedy episodes that reach the goal")
    return findings


def aliasing(setting: Setting) -> list[Finding]:
    """What few states do: several places share a row of the table, whose optimum is not that of the places."""
    discounts = np.round(np.arange(0.88, 0.93, 0.005), 3)
    largest = {}
    for states in (thesis.TABLES_STATES, PRINTED["states"], POSITIONS[1]):
        share = _greedy_success(1, {"learner.discount": discounts.tolist()}, {"states": states})
        largest[states] = _largest(discounts, share)
    own = largest[POSITIONS[1]]
    return [
        Finding(
            name="finding-aliasing",
            quantity=f"joint 1 with {states} states for 24 places: largest discount tried at which it goes to the goal",
            printed=None,
            reproduced=value,
            tolerance=0.0025,
            verdict=judge(abs(value - own) <= 0.0025, {}, {}),
            why=f"with a row for every place it is {own:g}; {24 / states:.2g} places share a row here, and the reward "
            "of the last row is paid for waiting anywhere in it",
        )
        for states, value in largest.items()
    ]


def negative_reward(setting: Setting) -> list[Finding]:
    """What a cost for every step would do, which chapter 6 argues against."""
    rewards = [0.0, -2.0, -5.0, -10.0, -20.0]
    share = _greedy_success(1, {"task.step_reward": rewards, "learner.discount": [0.95] * len(rewards)})
    return [
        Finding(
            name="finding-negative-reward",
            quantity="joint 1 at discount 0.95: share of greedy episodes that reach the goal, by reward of every step",
            printed="a negative reward would keep a foot from stepping back (chapter 6)",
            reproduced={f"{reward:g}": round(float(s), 3) for reward, s in zip(rewards, share, strict=True)},
            tolerance=None,
            verdict=judge(bool((np.diff(share) < 0).any()), {}, {}),
            why="a cost for every step is what makes waiting not pay, and it hinders nothing: no cost lowers the share",
        )
    ]


def _largest(discounts: np.ndarray, share: np.ndarray) -> float:
    """The largest discount at which more than half of the runs reach the goal."""
    return float(discounts[share > 0.5].max()) if (share > 0.5).any() else float("nan")


def _greedy_success(joint: int, axes: dict[str, list[float]], task: dict[str, Any] | None = None) -> np.ndarray:
    """The share of seeds whose greedy policy reaches the goal after standard training, along a sweep."""
    from humanoid_mjx.training.sweep import sweep

    config = {
        "name": "finding",
        "task": {"name": "joint_reach", "joint": joint, "states": POSITIONS[joint], "max_episode_steps": 100}
        | (task or {}),
        "learner": {"name": "tabular_q", "epsilon": 1.0, "epsilon_decay": 0.999, "learning_rate": 0.1},
        "sweep": {"mode": "zip", "axes": axes},
        "seeds": SEEDS,
        "episodes": 3000,
    }
    with tempfile.TemporaryDirectory() as folder:
        summary = sweep(config, Path(folder) / "run").summary
    return np.array([summary["greedy_success"][summary["point"] == p].mean() for p in np.unique(summary["point"])])


LITERAL = {
    "task": {"action": thesis.FIGURES_ACTION, "states": PRINTED["states"]},
    "learner": {
        "epsilon": PRINTED["epsilon"],
        "epsilon_decay": PRINTED["epsilon_decay"],
        "learning_rate": PRINTED["learning_rate"],
        "discount": PRINTED["discount"],
    },
}

EXPERIMENTS = [
    Experiment("finding-decay", "The declared decay of epsilon, applied", decay, LITERAL),
    Experiment("finding-waiting", "The reward pays for waiting", waiting),
    Experiment("finding-aliasing", "Few states alias many places", aliasing),
    Experiment("finding-negative-reward", "What a negative reward would do", negative_reward),
]
