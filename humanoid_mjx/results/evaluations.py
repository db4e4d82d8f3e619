"""What an evaluation found: numbers with their intervals, as a table or as JSON."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table

from humanoid_mjx.results.statistics import iqm, iqm_interval, rate_interval


class Estimate(NamedTuple):
    """A number and its 95 % interval."""

    value: float
    low: float
    high: float


class Evaluation(NamedTuple):
    """How an agent did on a task."""

    policy: str
    agent: str
    success: Estimate
    """The share of episodes, with Wilson's interval."""
    episode_return: Estimate
    """Interquartile means, with bootstrap intervals over the episodes."""
    steps: Estimate
    mean_return: float

    def as_json(self) -> dict[str, Any]:
        """Plain values; the interval of each number beside it."""
        numbers = {"success": self.success, "return": self.episode_return, "steps": self.steps}
        return {"policy": self.policy, "agent": self.agent, "mean_return": self.mean_return} | {
            key: value
            for name, estimate in numbers.items()
            for key, value in ((name, estimate.value), (f"{name}_interval", [estimate.low, estimate.high]))
        }


def estimated(policy: str, agent: str, episodes: Mapping[str, np.ndarray]) -> Evaluation:
    """From what each episode gave."""
    success = np.asarray(episodes["success"], bool)
    measures = (np.asarray(episodes[name], float) for name in ("return", "steps"))
    total, steps = (Estimate(float(iqm(x)), *map(float, iqm_interval(x))) for x in measures)
    rate = Estimate(float(success.mean()), *rate_interval(success))
    return Evaluation(policy, agent, rate, total, steps, float(np.mean(episodes["return"])))


def evaluation_table(title: str, evaluations: Sequence[Evaluation]) -> Table:
    """A row for each, the intervals beside the numbers."""
    table = Table(title=title, title_justify="left")
    for heading in ("policy", "agent"):
        table.add_column(heading)
    for heading in ("success (95 %)", "return (95 %)", "steps (95 %)"):
        table.add_column(heading, justify="right")
    for evaluation in evaluations:
        success, total, steps = evaluation.success, evaluation.episode_return, evaluation.steps
        table.add_row(
            evaluation.policy,
            evaluation.agent,
            f"{success.value:.1%} ({success.low:.1%} to {success.high:.1%})",
            *(f"{x.value:.4g} ({x.low:.4g} to {x.high:.4g})" for x in (total, steps)),
        )
    return table
