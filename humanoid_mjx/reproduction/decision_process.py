"""Findings of our own on chapter 6: what its decision process does that its text does not say."""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key
from pydantic import Field

from humanoid_mjx.reproduction.findings import Finding, Setting, check, experiment, listed
from humanoid_mjx.reproduction.joint_ways import printed_run
from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.finite import FiniteTask
from humanoid_mjx.thesis import q_learning as thesis
from humanoid_mjx.training.sweep import sweep
from humanoid_mjx.types import BoolScalar, FloatScalar, IntScalar

PRINTED = thesis.PSEUDO_CODE
SEEDS, SIDE_BY_SIDE = 32, 1024
"""Seeds of a point, and the most runs that a device trains at once: all that there are, so that no program is traced to
estimate their number."""

RUNS, STEPS = 100, 20_000
"""Runs of the pseudo-code with its decay, and the steps of each."""

BACK_REWARDS = (0.0, -1.0, -2.0, -4.0, -8.0, -16.0)
"""Rewards of a step back that are compared."""

STEPPING_BACK = {"name": "humanoid_mjx.reproduction.decision_process:SteppingBack", "steps": 6}
POSITIONS = {1: 24, 4: 25, 5: 13}
"""Places of each joint in steps of 5 degrees: with this number of states each place has a row of its own."""

LITERAL = {
    "task": {"action": thesis.FIGURES_ACTION, "states": PRINTED["states"]},
    "learner": {name: PRINTED[name] for name in ("epsilon", "epsilon_decay", "learning_rate", "discount")},
}


@experiment("finding-decay", "The declared decay of epsilon, applied", LITERAL)
def decay(setting: Setting) -> Iterator[Finding]:
    for joint in thesis.JOINT_RANGES:
        setting.tell(f"joint {joint}: {RUNS} runs of {STEPS:,} steps")
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
        setting.tell(f"joint {joint}: training with {len(discounts)} discounts, {SEEDS} seeds each")
        task = {"name": "joint_reach", "joint": joint, "states": POSITIONS[joint]}
        share[joint] = _greedy_success(task, {"learner.discount": discounts.tolist()})
    at_printed = int(np.argmin(np.abs(discounts - PRINTED["discount"])))
    for joint, (_, goal) in thesis.JOINT_RANGES.items():
        last, end = thesis.REWARD_SCALE * (goal - thesis.FIGURES_ACTION), thesis.REWARD_SCALE * goal
        quantity = f"joint {joint}: share of greedy episodes that reach the goal at the printed discount"
        claim = "in the next time of running it switches to the next state with the old values (6.4)"
        why = f"waiting a step before the goal for ever ({last:g} a step) is worth more than the goal ({end:g} + "
        why += f"{PRINTED['bonus']:g}, once) from {1 - last / (end + PRINTED['bonus']):.4f} on; in training the "
        most = max(discounts[share[joint] > 0.5], default=np.nan)
        why += f"largest discount tried at which most runs go to the goal is {most:g}"
        arrive = float(share[joint][at_printed])
        yield check(quantity, claim, round(arrive, 3), arrive > 0.99, why, 0.01)


@experiment("finding-negative-reward", "What a negative reward of stepping back would do")
def negative_reward(setting: Setting) -> Iterator[Finding]:
    """The finding that a cost for stepping back keeps a joint from it, as chapter 6 fears."""
    setting.tell(f"training with {len(BACK_REWARDS)} rewards of a step back")
    yield _stepping_back(_greedy_success(STEPPING_BACK, {"task.back_reward": list(BACK_REWARDS)}))


def _stepping_back(share: np.ndarray) -> Finding:
    """The verdict on the shares of runs that learn to step back, by reward of a step back."""
    costs = -np.array(BACK_REWARDS)
    keeps = share[costs > 0] < 0.5
    steps, discount = STEPPING_BACK["steps"], PRINTED["discount"]
    # The way is worth discount**(steps - 1) * bonus - cost * (1 - discount**steps) / (1 - discount), staying 0.
    limit = discount ** (steps - 1) * PRINTED["bonus"] * (1 - discount) / (1 - discount**steps)
    quantity = f"share of joints that step back to their goal when a step back is rewarded with {listed(-costs)}"
    claim = "if a negative reward is awarded, the feet will not bring themselves back (chapter 6)"
    why = f"{steps} steps back lead to the goal and its bonus of {PRINTED['bonus']:g}; staying earns "
    why += f"nothing. At a discount of {discount:g} the way back pays up to a cost of {limit:.2f} a step: "
    why += "only beyond it is the fear right"
    return check(quantity, claim, [round(float(s), 3) for s in share], keeps.all(), why)


class SteppingBack(FiniteTask):
    """A joint that has gone `steps` steps beyond its goal and can come to it on no other way than back.

    The actions are to stay, to step forwards, and to step back. A step back earns `back_reward`, reaching the goal
    `bonus` and ends the episode. Forwards there is room for as many steps again.
    """

    num_actions: ClassVar[int] = 3

    steps: int = Field(12, ge=1, le=1000, description="from the start back to the goal")
    bonus: float = traced(100.0)
    back_reward: float = traced(0.0, le=0, description="of every step back")

    @property
    def num_states(self) -> int:
        return 2 * self.steps + 1

    def reset(self, key: Key[Array, ""]) -> IntScalar:
        """Number of steps that the joint is beyond the goal."""
        return jnp.int32(self.steps)

    def step(
        self, state: IntScalar, action: IntScalar, key: Key[Array, ""]
    ) -> tuple[IntScalar, FloatScalar, BoolScalar]:
        back = action == 2
        state = jnp.clip(state + jnp.where(back, -1, action), 0, 2 * self.steps).astype(jnp.int32)
        there = state == 0
        return state, jnp.where(back, self.back_reward, 0.0) + jnp.where(there, self.bonus, 0.0), there


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
