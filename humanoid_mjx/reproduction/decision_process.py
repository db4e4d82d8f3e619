"""Findings of our own on chapter 6: what its decision process does that its text does not say."""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from humanoid_mjx.reproduction.findings import Finding, Setting, check, experiment
from humanoid_mjx.reproduction.joint_ways import printed_run
from humanoid_mjx.thesis import q_learning as thesis
from humanoid_mjx.training.sweep import sweep

PRINTED = thesis.PSEUDO_CODE
SEEDS, SIDE_BY_SIDE = 32, 1024
"""Seeds of a point, and the most runs that a device trains at once: all that there are, so that no program is traced to
estimate their number."""

RUNS, STEPS = 100, 20_000
"""Runs of the pseudo-code with its decay, and the steps of each."""

STEPS_BACK = 6
"""Steps that a joint has gone beyond its goal."""

POSITIONS = {1: 24, 4: 25, 5: 13}
"""Places of each joint in steps of 5 degrees: with this number of states each place has a row of its own."""

LITERAL = {
    "task": {"action": thesis.FIGURES_ACTION, "states": PRINTED["states"]},
    "learner": {name: PRINTED[name] for name in ("epsilon", "epsilon_decay", "learning_rate", "discount")},
}


@experiment("finding-decay", "The declared decay of epsilon, applied", LITERAL)
def decay(setting: Setting) -> Iterator[Finding]:
    """The pseudo-code with its declared epsilonDecay applied."""
    for joint in thesis.JOINT_RANGES:
        run = printed_run(joint, setting.config, runs=RUNS, steps=STEPS)
        reached = int(run.terminated.any(axis=1).sum())
        quantity = f"joint {joint} reaches its goal, of {RUNS} runs with the declared decay of epsilon"
        why = f"epsilonDecay = {setting.config['learner']['epsilon_decay']:g} is declared, not used; applied in every "
        why += f"step, exploration dies before the joint arrives, and greedy ties mean to stay ({STEPS:,} steps)"
        target = "reaches the target (7 E to 7 G)"
        yield check(quantity, target, reached, reached == RUNS, why, 0, possible=reached > 0)


@experiment("finding-waiting", "The reward pays for waiting")
def waiting(setting: Setting) -> Iterator[Finding]:
    """The discount from which the reward pays for waiting just before the goal."""
    discounts = np.round(np.arange(0.80, 0.99, 0.01), 2)
    share = {}
    for joint in POSITIONS:
        task = {"name": "joint_reach", "joint": joint, "states": POSITIONS[joint]}
        share[joint] = _greedy_success(task, {"learner.discount": discounts.tolist()})
    at_printed = int(np.argmin(np.abs(discounts - PRINTED["discount"])))
    for joint, (_, goal) in thesis.JOINT_RANGES.items():
        last, end = thesis.REWARD_SCALE * (goal - thesis.FIGURES_ACTION), thesis.REWARD_SCALE * goal
        quantity = f"joint {joint}: share of greedy episodes that reach the goal at the printed discount"
        claim = "in the next time of running it switches to the next state with the old values (6.4)"
        why = f"waiting a step before the goal for ever ({last:g} a step) is worth more than the goal ({end:g} + "
        why += f"{PRINTED['bonus']:g}, once) from {1 - last / (end + PRINTED['bonus']):.4f} on; in training the "
        why += "largest discount tried at which most runs go to the goal is "
        why += f"{np.max(discounts, where=share[joint] > 0.5, initial=0.0):g}"
        arrive = float(share[joint][at_printed])
        yield check(quantity, claim, round(arrive, 3), arrive > 0.99, why, 0.01)


@experiment("finding-negative-reward", "What a negative reward of stepping back would do")
def negative_reward(setting: Setting) -> list[Finding]:
    """The finding that a cost for stepping back keeps a joint from it, as chapter 6 fears."""
    return [_stepping_back(largest_cost(STEPS_BACK, PRINTED["bonus"], PRINTED["discount"]))]


def _stepping_back(limit: float) -> Finding:
    """The verdict on the largest cost of a step back at which the way back is worth more than to stay."""
    quantity = f"largest cost of a step back at which {STEPS_BACK} of them to the goal are worth more than to stay"
    claim = "if a negative reward is awarded, the feet will not bring themselves back (chapter 6)"
    why = f"the goal earns its bonus of {PRINTED['bonus']:g}, staying nothing, at a discount of "
    why += f"{PRINTED['discount']:g}: only beyond this cost is the fear right"
    return check(quantity, claim, round(limit, 2), limit <= 0, why)


def largest_cost(steps: int, bonus: float, discount: float) -> float:
    """The largest cost of a step back at which going to the goal is worth more than staying forever.

    The way is worth `discount**(steps - 1) * bonus - cost * (1 - discount**steps) / (1 - discount)`, staying 0.
    """
    return discount ** (steps - 1) * bonus * (1 - discount) / (1 - discount**steps)


def _greedy_success(task: dict[str, Any], axes: dict[str, list[float]]) -> np.ndarray:
    """The share of seeds whose greedy policy reaches the goal after standard training, along a sweep."""
    config = {
        "name": "finding",
        "task": task | {"max_episode_steps": 100},
        "learner": {"name": "tabular_q", "epsilon": 1.0, "epsilon_decay": 0.999, "learning_rate": 0.1},
        "sweep": {"mode": "zip", "axes": axes},
        "seeds": SEEDS,
        "episodes": 3000,
    }
    with tempfile.TemporaryDirectory() as folder:
        summary = sweep(config, Path(folder) / "run", pool_size=SIDE_BY_SIDE).summary
    return np.array([summary["greedy_success"][summary["point"] == p].mean() for p in np.unique(summary["point"])])
