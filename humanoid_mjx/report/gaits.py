"""The table of `evaluate --gait`: a row for each command."""

import re
from collections.abc import Sequence

import numpy as np
from rich.table import Column, Table

from humanoid_mjx.evaluation.gait.figures import FIGURES, Gait

COLUMNS = (
    ("upright", "success", "z.0%", True),
    ("speed\nm/s", "forward", "z.3f", False),
    ("error\nm/s", "speed_error", "z.3f", True),
    ("turn\nrad/s", "turn", "z.2f", False),
    ("error\nrad/s", "turn_error", "z.2f", True),
    ("drift\nm", "drift", "z.2f", False),
    ("off\ndeg", "heading_error", "z.0f", False),
    ("slip\nm/s", "slip", "z.3f", True),
    ("duty", "duty", "z.2f", False),
    ("flight", "flight", "z.0%", False),
    ("step\nm", "step_length", "z.3f", False),
    ("steps\n1/s", "step_frequency", "z.1f", False),
    ("lift\nm", "clearance", "z.3f", False),
    ("cost", "cost_of_transport", "z.1f", False),
)
"""Heading, figure, its format, whether its unfavourable end stands beside it. The speed of a sidestep is sideways."""


def gait_table(title: str, gaits: Sequence[Gait], beyond: Sequence[str] = ()) -> Table:
    """The main figures of the policy under each command."""
    columns = (Column(heading, justify="right") for heading, *_ in COLUMNS)
    table = Table("command", *columns, title=title, title_justify="left", padding=(0, 0), pad_edge=False)
    for gait in (gait for gait in gaits if gait.agent == "greedy"):
        ways = {"forward": "left" if gait.command[1] else "forward"}
        cells = (_cell(gait, ways.get(name, name), form, ends) for _, name, form, ends in COLUMNS)
        table.add_row(gait.scenario + " *" * (gait.scenario in beyond), *cells)
    return table


def meanings() -> dict[str, str]:
    """The meaning of each of `COLUMNS`, by its heading in one line."""
    in_line = (heading.replace("\n", " (") + ")" * ("\n" in heading) for heading, *_ in COLUMNS)
    return {heading: FIGURES[name].meaning for heading, (_, name, *_) in zip(in_line, COLUMNS, strict=True)}


def _cell(gait: Gait, name: str, form: str, ends: bool) -> str:
    summary, better = gait.figures[name], FIGURES[name].better
    if not np.isfinite(summary.median):
        return ""
    first, *others = summary.seeds
    # The worst training seed; of a single one the unfavourable end of the interval over its episodes.
    end = summary.worst if others else first.low if better > 0 else first.high
    # Numbers without the 0 before their point.
    value, end = (re.sub(r"^(-?)0\.", r"\1.", format(x, form)) for x in (summary.median, end))
    return f"{value} ({end})" if ends else value


def remarks(gaits: Sequence[Gait], beyond: Sequence[str]) -> list[str]:
    """Lines that belong below the table."""
    seeds = max(len(gait.figures["success"].seeds) for gait in gaits)
    many = "medians over the training seeds, with the worst seed in brackets"
    one = (
        "means over the episodes, with the worse end of the 95 % interval in brackets: 100% (68%) says that all "
        "succeeded, and that in the long run 68% would or more"
    )
    lines = [f"Figures are {many if seeds > 1 else one}. A window is whole gait cycles, near 1 s."]
    if beyond:
        lines.append("* a command beyond those of training")
    for gait in gaits:
        turn, success = gait.figures["turn_seconds"], gait.figures["turn_success"]
        if gait.agent == "greedy" and np.isfinite(success.median):
            took = f", in {turn.median:.2f} s" if np.isfinite(turn.median) else ""
            share = _cell(gait, "turn_success", "z.0%", ends=True)
            lines.append(f"{gait.scenario}: 45 degrees within 1.5 s in {share} of episodes{took}")
    for agent in dict.fromkeys(gait.agent for gait in gaits if gait.agent != "greedy"):
        upright = np.mean([gait.figures["success"].median for gait in gaits if gait.agent == agent])
        lines.append(f"The {agent} agent stays upright in {upright:.0%} of episodes.")
    return lines
