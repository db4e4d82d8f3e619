"""The table of `evaluate --gait`: a row for each command."""

from collections.abc import Sequence

import numpy as np
from rich.table import Table

from humanoid_mjx.runs.gaits import Gait, Summary

COLUMNS = (
    ("upright", "success", ".0%", True),
    ("forward\nm/s", "forward", ".3f", False),
    ("error\nm/s", "speed_error", ".3f", True),
    ("turn\nrad/s", "turn", ".2f", False),
    ("error\nrad/s", "turn_error", ".2f", True),
    ("drift\nm", "drift", ".2f", False),
    ("heading\ndegrees", "heading_error", ".0f", False),
    ("slip\nm/s", "slip", ".3f", True),
    ("duty", "duty", ".2f", False),
    ("flight", "flight", ".0%", False),
    ("step\nm", "step_length", ".3f", False),
    ("steps\n1/s", "step_frequency", ".1f", False),
    ("lift\nm", "clearance", ".3f", False),
    ("cost", "cost_of_transport", ".1f", False),
)
"""Heading, figure, its format, and whether its unfavourable end stands beside it."""


def gait_table(title: str, gaits: Sequence[Gait], beyond: Sequence[str] = ()) -> Table:
    """The main figures of the policy under each command."""
    table = Table(title=title, title_justify="left", padding=(0, 0), pad_edge=False)
    table.add_column("command")
    for heading, *_ in COLUMNS:
        table.add_column(heading, justify="right")
    for gait in gaits:
        if gait.agent == "greedy":
            cells = (_cell(gait.figures[name], form, ends) for _, name, form, ends in COLUMNS)
            table.add_row(gait.scenario + " *" * (gait.scenario in beyond), *cells)
    return table


def _cell(summary: Summary, form: str, ends: bool) -> str:
    if not np.isfinite(summary.median):
        return ""
    value = format(summary.median, form)
    return f"{value} ({format(bad_end(summary), form)})" if ends else value


def bad_end(summary: Summary) -> float:
    """The worst training seed; of a single one the unfavourable end of the interval over its episodes."""
    if len(summary.seeds) > 1:
        return summary.worst
    one = summary.seeds[0]
    return one.low if summary.better > 0 else one.high


def remarks(gaits: Sequence[Gait], beyond: Sequence[str]) -> list[str]:
    """Lines that belong below the table."""
    seeds = max(len(gait.figures["success"].seeds) for gait in gaits)
    many = "medians over the training seeds; in brackets the worst of them"
    one = "means over the episodes; in brackets the worse end of the 95 % interval"
    lines = [f"Errors are of means over whole gait cycles near 1 s. Figures are {many if seeds > 1 else one}."]
    if beyond:
        lines.append("* a command beyond those of training")
    for gait in gaits:
        turn, success = gait.figures["turn_seconds"], gait.figures["turn_success"]
        if gait.agent == "greedy" and np.isfinite(success.median):
            took = f", in {turn.median:.2f} s" if np.isfinite(turn.median) else ""
            lines.append(f"{gait.scenario}: 45 degrees within 1.5 s in {_cell(success, '.0%', True)} of episodes{took}")
    for agent in dict.fromkeys(gait.agent for gait in gaits if gait.agent != "greedy"):
        mine = [gait.figures for gait in gaits if gait.agent == agent]
        upright, error = (np.array([one[name].median for one in mine]) for name in ("success", "speed_error"))
        known = error[np.isfinite(error)]
        errors = f", its speed off by {known.mean():.3f} m/s" if len(known) else ""
        lines.append(f"The {agent} agent stays upright in {upright.mean():.0%} of episodes{errors}.")
    return lines
