"""What the commands of the command line do, and what they print."""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from humanoid_mjx import runtime
from humanoid_mjx.config import dump_yaml, load
from humanoid_mjx.data import names
from humanoid_mjx.results.figures import sweep_figures
from humanoid_mjx.results.statistics import iqm, iqm_interval
from humanoid_mjx.results.style import short
from humanoid_mjx.training.progress import Bar

console = Console(highlight=False, width=None if sys.stdout.isatty() else 120)

BEST_POINTS = 10
"""Rows of the summary that is printed."""


def run_sweep(config: str, out: Path | None, overrides: Sequence[str], resume: bool) -> None:
    """`humanoid-mjx sweep`."""
    runtime.start()
    from humanoid_mjx.training.sweep import sweep

    with Bar(console) as bar:
        try:
            run = sweep(config, out, resume=resume, overrides=overrides, reporter=bar)
        except KeyboardInterrupt:
            console.print("Stopped. What is finished is stored; the same command with --resume completes it.")
            raise typer.Exit(130) from None
        bar.phase("drawing figures")
        axes = list(run.config.sweep.axes) if run.config.sweep else []
        summary = run.summary
        paths = sweep_figures(run.path / "figures", run.config.name, axes, run.results, summary, bar.unit)
    print_summary(axes, summary)
    for path in (run.path / "results.parquet", run.path / "summary.parquet", *paths):
        console.print(f"{path}", soft_wrap=True)


def print_summary(axes: Sequence[str], summary: Mapping[str, np.ndarray]) -> None:
    """The best points of a sweep: those that succeed most often, and among them the quickest."""
    points = np.unique(summary["point"])
    rows = [summary["point"] == point for point in points]
    success = np.array([summary["greedy_success"][row].mean() for row in rows])
    steps = np.array([iqm(summary["greedy_steps"][row]) for row in rows])
    learning = np.array([iqm(summary["steps"][row]) for row in rows])
    best = np.lexsort((learning, steps, -np.round(success, 3)))[:BEST_POINTS]
    title = f"{len(points)} points; the best {len(best)}" if len(points) > 1 else "1 point"
    table = Table(title=title, title_justify="left")
    for axis in axes:
        table.add_column(axis.partition(".")[2], justify="right")
    for heading in ("greedy success", "greedy steps", "steps at the end of training (95 %)"):
        table.add_column(heading, justify="right")
    for i in best:
        values = [short(summary[axis][rows[i]][0]) for axis in axes]
        low, high = iqm_interval(summary["steps"][rows[i]].astype(float))
        table.add_row(*values, f"{success[i]:.1%}", f"{steps[i]:.1f}", f"{learning[i]:.2f} ({low:.2f} to {high:.2f})")
    console.print(table)


def show_info(config: str | None, overrides: Sequence[str]) -> None:
    """`humanoid-mjx info`."""
    runtime.start()
    from humanoid_mjx.learners import LEARNERS
    from humanoid_mjx.tasks import TASKS
    from humanoid_mjx.training.plan import make_plan, resolved, run_bytes

    if config is not None:
        plan = make_plan(load(config, overrides))
        console.print(dump_yaml(resolved(plan.config)).rstrip(), markup=False)
        size = sum(run_bytes(group) * len(group.runs) for group in plan.groups)
        console.print(
            f"\n{len(plan.points):,} points x {plan.config.seeds} seeds = {plan.num_runs:,} runs "
            f"in {len(plan.groups)} compiled program{'s' * (len(plan.groups) > 1)}; "
            f"training state {size / 2**20:,.1f} MiB if all were held at once"
        )
        return
    for name, value in (runtime.machine() | runtime.versions()).items():
        console.print(f"{name:13} {value}")
    for kind, known in (("tasks", TASKS), ("learners", LEARNERS), ("configs", names("configs", ".yaml"))):
        console.print(f"{kind:13} {', '.join(known)}")
