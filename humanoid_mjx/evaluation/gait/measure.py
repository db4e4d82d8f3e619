"""The policies that `evaluate --gait` is given, and the world that it asks them in."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from humanoid_mjx.evaluation.gait.figures import Gait
from humanoid_mjx.evaluation.gait.scenarios import Scenario, gaits_of, play_scenarios, scenarios_of, walking_task
from humanoid_mjx.evaluation.policy import StoredPolicy, find_policy, policies_of_best
from humanoid_mjx.learners.rollout import AGENTS
from humanoid_mjx.tasks.legged.commands import Velocity
from humanoid_mjx.training.plan import resolved

WORLD = {"task.duration": "20", "task.push.impulse": "0", "task.randomise": "null", "task.terrain": "null"}
"""Values of the task unless others are asked for: 20 s in which nothing pushes the body, all on the same plane."""


class Measured(NamedTuple):
    """Policies of one task that differ by their training seed alone, and what they do."""

    policies: list[StoredPolicy]
    gaits: list[Gait]
    beyond: list[str]
    """Scenarios whose commands lie outside the ranges of the task's own."""

    def as_json(self) -> dict[str, Any]:
        """The gaits as plain values, with what they are of."""
        policies, gaits = [policy.as_json() for policy in self.policies], [gait.as_json() for gait in self.gaits]
        return {"policies": policies, "beyond_training": self.beyond, "gaits": gaits}


def trained_seeds(names: Sequence[str], point: int | None = None, overrides: Sequence[str] = ()) -> list[StoredPolicy]:
    """All runs of the best point of each run folder named, or of the point of this number, and the policies that are
    named themselves.

    Raises:
      InputError: as `find_policy`; or a policy's task moves no body by commands.
    """
    found: list[StoredPolicy] = []
    for name in names:
        if (path := Path(name)).is_dir():
            found += policies_of_best(path, point, overrides=overrides)
        else:
            found.append(find_policy(name, point, overrides))
    for policy in found:
        walking_task(policy.learner.task)
    return found


def settings_of(overrides: Sequence[str]) -> list[str]:
    """`WORLD` and the overrides, which take the place of what they concern."""
    keys = [override.partition("=")[0] for override in overrides]
    ours = {
        key: value
        for key, value in WORLD.items()
        if not any(other == key or other.startswith(f"{key}.") or key.startswith(f"{other}.") for other in keys)
    }
    return [*(f"{key}={value}" for key, value in ours.items()), *overrides]


def measure(policies: Sequence[StoredPolicy], episodes: int, tell: Callable[[int, int], None]) -> list[Measured]:
    """Measure the gaits of all agents, for each group of policies of the same task and the same kind of learner.

    `tell` is called with how many of a group's episodes have been played.
    """
    groups: dict[Any, list[StoredPolicy]] = {}
    for policy in policies:
        task = json.dumps(resolved(policy.config)["task"], sort_keys=True)
        groups.setdefault((task, jax.tree.structure((policy.learner, policy.policy))), []).append(policy)
    found = []
    for group in groups.values():
        learner, task = group[0].learner, walking_task(group[0].learner.task)
        stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(policy.policy for policy in group))
        scenarios = scenarios_of(task.robot)
        played = play_scenarios(learner, stacked, scenarios, episodes, float(task.duration), AGENTS, tell)
        beyond = [each.name for each in scenarios if _beyond(task, each)]
        found.append(Measured(group, gaits_of(played, scenarios), beyond))
    return found


def _beyond(task: Any, scenario: Scenario) -> bool:
    """True if the command lies outside the ranges of the task's commands."""
    if not isinstance(task.command, Velocity):
        return False
    low, high = task.command.ranges.T
    return bool(((jnp.array(scenario.command) < low - 1e-6) | (jnp.array(scenario.command) > high + 1e-6)).any())
