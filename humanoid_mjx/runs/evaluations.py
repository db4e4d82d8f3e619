"""Results of an evaluation: numbers with their intervals."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from humanoid_mjx.runs.statistics import iqm, iqm_interval, rate_interval


class Estimate(NamedTuple):
    """A number and its 95 % interval."""

    value: float
    low: float
    high: float


class Evaluation(NamedTuple):
    """Success, return and steps of an agent on a task."""

    policy: str
    agent: str
    success: Estimate
    """The share of episodes, with Wilson's interval."""
    episode_return: Estimate
    """Interquartile means, with bootstrap intervals over the episodes."""
    steps: Estimate
    mean_return: float
    discounted_return: float
    """Interquartile mean; what Q-learning maximises."""

    def as_json(self) -> dict[str, Any]:
        """The evaluation as plain values, with each number's interval beside it."""
        estimates = {"success": self.success, "return": self.episode_return, "steps": self.steps}
        found = {name: getattr(self, name) for name in ("policy", "agent", "mean_return", "discounted_return")}
        for name, estimate in estimates.items():
            found |= {name: estimate.value, f"{name}_interval": [estimate.low, estimate.high]}
        return found


def estimated(policy: str, agent: str, episodes: Mapping[str, np.ndarray]) -> Evaluation:
    """The evaluation of episodes from the results of each."""
    success = np.asarray(episodes["success"], bool)
    measures = (np.asarray(episodes[name], float) for name in ("return", "steps"))
    total, steps = (Estimate(float(iqm(x)), *map(float, iqm_interval(x))) for x in measures)
    rate = Estimate(float(success.mean()), *rate_interval(success))
    means = float(np.mean(episodes["return"])), float(iqm(np.asarray(episodes["discounted_return"], float)))
    return Evaluation(policy, agent, rate, total, steps, *means)
