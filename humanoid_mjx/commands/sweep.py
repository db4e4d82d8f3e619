"""The command `sweep`."""

import shlex
from collections.abc import Callable, Sequence
from contextlib import nullcontext, suppress
from functools import partial
from pathlib import Path
from typing import Any

import jax
import typer
from rich.table import Column, Table

from humanoid_mjx import compute
from humanoid_mjx.commands import console
from humanoid_mjx.compute import kept
from humanoid_mjx.config import Config, load
from humanoid_mjx.runs.folder import THEN, read_provenance
from humanoid_mjx.spec import InputError
from humanoid_mjx.training.progress import Bar

RATES = ("episodes", "steps")

DRAWING_S = 5.0
"""Seconds that the figures of a sweep take, by estimate."""


def run_sweep(
    config: str | Config,
    out: Path | None,
    overrides: Sequence[str],
    resume: bool,
    trackers: Sequence[str],
    view: bool = False,
    ray: str | None = None,
    engine: Callable[..., Any] | None = None,
) -> None:
    """`humanoid-mjx sweep`.

    `ray`: the address of a Ray cluster. `engine`: another way to train (`chunks.EngineOf`) than by this process.
    """
    loaded = config if isinstance(config, Config) else load(config, overrides)
    if ray:
        jax.config.update("jax_platforms", "cpu")  # the GPUs are for the workers
        from humanoid_mjx.training.on_ray import OnRay

        engine = partial(OnRay, address=ray)
    compute.start(mjx="mjx-jax" in loaded.physics)
    from humanoid_mjx.training.chunks import Here
    from humanoid_mjx.training.sweep import check_later, sweep_first  # once a config is there: half a second
    from humanoid_mjx.training.trackers import Tracking

    check_later(loaded)
    with (
        kept.keeping(),
        Bar(console, DRAWING_S) as bar,
        Tracking(trackers, bar.note) as tracking,
        _growing(bar) if view else nullcontext() as growing,
    ):
        try:
            watch = [*tracking.watch, *([growing.watch] if growing else [])]
            run = sweep_first(loaded, out, resume, engine or Here, nullcontext(growing or bar), watch=watch)
        except KeyboardInterrupt:
            console.print("Stopped. What is finished is stored; the same command with --resume completes it.")
            raise typer.Exit(130) from None
        bar.phase("drawing figures")
        from humanoid_mjx.evaluation.replay import remarks
        from humanoid_mjx.report.figures import draw_run  # matplotlib takes a while
        from humanoid_mjx.runs.ranking import BEST_POINTS, best_table, in_words, ranked

        summary, quickest = run.summary, run.config.episodes is not None
        learning, paths = draw_run(run, summary)
        if trackers:
            from humanoid_mjx.evaluation.policy import find_policy, save_policy

            tracking.files, policy = list(paths), run.path / "policy.npz"
            with suppress(InputError):  # there is none where all runs stopped at numbers that were not finite
                save_policy(find_policy(run.path), policy)
                tracking.files.append(policy)
    axes, provenance = list(learning.axes), read_provenance(run.path)
    points = ranked(axes, summary, quickest)
    headings, rows = best_table(axes, summary, points[:BEST_POINTS], quickest, learning.compared)
    title = f"{len(points)} points; the best {len(rows)}" if len(points) > 1 else "1 point"
    rates = [f"{provenance[f'{unit}_per_s']:,.0f} {unit}/s" for unit in RATES if f"{unit}_per_s" in provenance]
    caption = f"training made {' and '.join(rates)}, without compiling" if rates else None
    columns = (Column(heading.partition(".")[2] or heading, justify="right") for heading in headings)
    table = Table(*columns, title=title, title_justify="left", caption=caption, caption_justify="left")
    for row in rows:
        table.add_row(*row)
    console.print(table)
    lines = remarks(run.path, summary)
    lines += [str(path) for path in (run.path / "results.parquet", run.path / "summary.parquet", *paths)]
    further = f"{growing.file}" if growing else f"next: humanoid-mjx report {shlex.quote(str(run.path))}"
    for line in filter(None, (*lines, in_words(axes, points, learning.compared), further, *tracking.lines)):
        console.print(line, soft_wrap=True)
    if later := run.config.later(run.path):
        place = run.path / THEN
        run_sweep(later, place, (), resume and place.exists(), trackers, view, ray, engine)


def _growing(bar: Bar) -> Any:
    from humanoid_mjx.report.growing import Growing

    return Growing(bar)
