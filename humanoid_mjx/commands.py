"""What the commands of the command line do, and what they print."""

import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import typer
from rich.table import Table

from humanoid_mjx import runtime
from humanoid_mjx.config import dump_yaml, load
from humanoid_mjx.data import names
from humanoid_mjx.runs.disk import in_words
from humanoid_mjx.runs.folder import read_provenance
from humanoid_mjx.spec import InputError, check_folder
from humanoid_mjx.training.progress import Bar, PatientConsole

console = PatientConsole(highlight=False, width=None if sys.stdout.isatty() else 120)

RATES = ("episodes", "steps")

BEST_POINTS = 10
"""Rows of the summary that is printed."""


def run_sweep(config: str, out: Path | None, overrides: Sequence[str], resume: bool, tensorboard: bool) -> None:
    """`humanoid-mjx sweep`."""
    runtime.start()
    from humanoid_mjx.report.figures import sweep_figures
    from humanoid_mjx.training.sweep import sweep

    with Bar(console) as bar:
        try:
            run = sweep(config, out, resume=resume, overrides=overrides, reporter=bar, tensorboard=tensorboard)
        except KeyboardInterrupt:
            console.print("Stopped. What is finished is stored; the same command with --resume completes it.")
            raise typer.Exit(130) from None
        bar.phase("drawing figures")
        axes = list(run.config.sweep.axes) if run.config.sweep else []
        summary = run.summary
        paths = sweep_figures(run.path / "figures", run.config.name, axes, run.results, summary)
    print_summary(axes, summary, read_provenance(run.path))
    for path in (run.path / "results.parquet", run.path / "summary.parquet", *paths):
        console.print(f"{path}", soft_wrap=True)
    if tensorboard:
        console.print(f"tensorboard --logdir {run.path / 'tensorboard'}", soft_wrap=True)


def print_summary(axes: Sequence[str], summary: Mapping[str, np.ndarray], provenance: Mapping[str, Any]) -> None:
    """The best points of a sweep: those that succeed most often, and among them the quickest; how fast it trained."""
    from humanoid_mjx.report.style import short
    from humanoid_mjx.runs.ranking import ranked, ties, training_interval

    points, seeds = ranked(axes, summary), len(np.unique(summary["seed"]))
    best = points[:BEST_POINTS]
    title = f"{len(points)} points; the best {len(best)}" if len(points) > 1 else "1 point"
    if (equals := ties(points)) > len(best):
        title += f" of {equals} that act equally well"
    rates = [f"{provenance[f'{unit}_per_s']:,.0f} {unit}/s" for unit in RATES if f"{unit}_per_s" in provenance]
    caption = f"training made {' and '.join(rates)}, without compiling" if rates else None
    table = Table(title=title, title_justify="left", caption=caption, caption_justify="left")
    for axis in axes:
        table.add_column(axis.partition(".")[2], justify="right")
    for heading in ("greedy success", "greedy steps", "steps at the end of training (95 %)"):
        table.add_column(heading, justify="right")
    diverged = {point.point: int(np.sum(summary["diverged"][summary["point"] == point.point])) for point in points}
    if any(diverged.values()):
        table.add_column("diverged", justify="right")
    for point in best:
        low, high = training_interval(summary, point.point)
        steps = f"{point.steps:.2f} ({low:.2f} to {high:.2f})"
        broken = [f"{diverged[point.point]} of {seeds}"] if any(diverged.values()) else []
        table.add_row(*map(short, point.values), f"{point.success:.1%}", f"{point.greedy_steps:.1f}", steps, *broken)
    console.print(table)
    if stopped := sum(diverged.values()):
        console.print(f"{stopped} runs stopped at numbers that were not finite; the summary marks them.")


def run_reproduce(names: Sequence[str], list_names: bool, overrides: Sequence[str], out: Path) -> None:
    """`humanoid-mjx reproduce`."""
    runtime.start()
    from humanoid_mjx.reproduction import Experiment, Finding, load_experiments, reproduce

    if list_names:
        for experiment in load_experiments().values():
            console.print(f"{experiment.name:24} {experiment.title}")
        return

    def say(experiment: Experiment, findings: list[Finding], seconds: float) -> None:
        console.print(f"\n{experiment.name}: {experiment.title} ({seconds:.1f} s)")
        for finding in findings:
            console.print(f"  {finding.verdict:16} {finding.quantity}")
            console.print(f"  {'':16} printed {_shown(finding.printed)}, reproduced {_shown(finding.reproduced)}")
            console.print(f"  {'':16} {finding.why}")

    def tell(experiment: Experiment, words: str) -> None:
        status.update(f"{experiment.name}: {words}")

    with console.status("reproducing") as status:
        findings = reproduce(names, out, overrides, say, tell)
    counts = Counter(finding.verdict for finding in findings)
    console.print(f"\n{', '.join(f'{count} {verdict}' for verdict, count in counts.items())}\n{out / 'reproduce.json'}")


def _shown(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name} {_shown(inner)}" for name, inner in value.items() if inner != "")
    if isinstance(value, (list, tuple)):
        return ", ".join(map(_shown, value))
    return "nothing" if value is None else str(value)


def run_play(name: str, physics: str | None, out: Path | None, view: bool) -> None:
    """`humanoid-mjx play`."""
    from humanoid_mjx.report.video import check_file

    if view and out is not None:
        raise InputError("play: --view shows the motion in the browser and --out writes a file; choose one.")
    if out is not None:
        check_file(out)
    runtime.start()
    from humanoid_mjx.report.player import serve
    from humanoid_mjx.report.rendering import render_film
    from humanoid_mjx.report.showing import show
    from humanoid_mjx.training.policy import find_policy, on_physics

    with Bar(console) as bar:
        bar.phase("loading")
        trained = find_policy(name)
        if physics is not None:
            trained = on_physics(trained, physics)
        shown = show(trained, bar)
        if not view:
            target = out or _play_file(name, trained.name)
            bar.phase("rendering")
            render_film(shown.film, target, tell=bar.count)
    console.print(shown.outcome)
    if not view:
        console.print(f"{target}", soft_wrap=True)
        return

    def told(address: str) -> None:
        console.print(f"{address}  (Ctrl-C ends it)", soft_wrap=True)

    with suppress(KeyboardInterrupt):
        serve(shown.film, told)


def _play_file(name: str, policy: str) -> Path:
    """Default place of a motion: in the run folder, or for a policy in the working directory."""
    if not Path(name).is_dir():
        return Path(f"{policy}.gif")
    folder = Path(name) / "figures"
    folder.mkdir(exist_ok=True)
    return folder / "play.gif"


def run_export(what: str, file: Path) -> None:
    """`humanoid-mjx export`."""
    if file.suffix not in (".xml", ".npz"):
        raise InputError(f"{file}: the file must end in .xml, for a robot, or in .npz, for the policy of a run.")
    check_folder(file)
    if file.suffix == ".npz":
        from humanoid_mjx.training.policy import find_policy, save_policy

        save_policy(find_policy(what), file)
    else:
        from humanoid_mjx.robot import robot_spec

        spec = robot_spec(what)
        spec.compile()
        file.write_text(spec.to_xml())
    console.print(f"{file}", soft_wrap=True)


def show_keys(name: str) -> None:
    """`humanoid-mjx info NAME --keys`: of a task, a learner, or both of a config."""
    from humanoid_mjx.keys import keys_of
    from humanoid_mjx.learners import LEARNERS, Learner
    from humanoid_mjx.spec import find
    from humanoid_mjx.tasks import TASKS
    from humanoid_mjx.tasks.base import Task

    chosen: list[tuple[str, Any]] = []
    if name in TASKS or name in LEARNERS or ":" in name:
        kind, registry, base = ("learner", LEARNERS, Learner) if name in LEARNERS else ("task", TASKS, Task)
        chosen.append((kind, find(kind, registry, base, name)))
    else:
        config = load(name)
        chosen.append(("task", find("task", TASKS, Task, config.task["name"])))
        chosen.append(("learner", find("learner", LEARNERS, Learner, config.learner["name"])))
    table = Table(title=f"{name}: keys of its config", title_justify="left")
    for heading in ("key", "default", "values", "", "meaning"):
        table.add_column(heading, overflow="fold")
    for kind, cls in chosen:
        for key in keys_of(cls, kind):
            table.add_row(key.name, key.default, key.allowed, "traced" if key.traced else "static", key.meaning)
    console.print(table)
    console.print("Sweeping a traced value compiles nothing; points that differ in static ones compile apart.")


def show_info(config: str | None, overrides: Sequence[str]) -> None:
    """`humanoid-mjx info`."""
    runtime.start()
    import jax

    from humanoid_mjx.learners import LEARNERS
    from humanoid_mjx.tasks import TASKS
    from humanoid_mjx.training.disk import disk_bytes
    from humanoid_mjx.training.fused import why_not
    from humanoid_mjx.training.memory import run_bytes, runs_that_fit, slots, training_bytes
    from humanoid_mjx.training.plan import make_plan, resolved

    if config is not None:
        plan = make_plan(load(config, overrides))
        console.print(dump_yaml(resolved(plan.config)).rstrip(), markup=False)
        size = sum(run_bytes(group) * len(group.runs) for group in plan.groups)
        most = max(training_bytes(group) for group in plan.groups)
        together = [1] * len(plan.groups)
        with suppress(InputError):  # that memory cannot hold a run is for training to say
            together = [slots(group, runs_that_fit(group, jax.local_devices()[0])) for group in plan.groups]
        console.print(
            f"\n{len(plan.points):,} points x {plan.config.seeds} seeds = {plan.num_runs:,} runs "
            f"in {len(plan.groups)} compiled program{'s' * (len(plan.groups) > 1)}; "
            f"training state {size / 2**20:,.1f} MiB if all were held at once, "
            f"a run that trains an estimated {most / 2**20:,.1f} MiB"
        )
        console.print(f"on disk an estimated {in_words(disk_bytes(plan, together))}, without figures")
        for reason in dict.fromkeys(why_not(group.learner()) for group in plan.groups):
            console.print("trained by one fused kernel" if reason is None else f"no fused kernel: {reason}")
        return
    for name, value in (runtime.machine() | runtime.versions()).items():
        console.print(f"{name:13} {value}")
    shipped = {"configs": names("configs", ".yaml"), "policies": names("policies", ".npz")}
    for kind, all_names in {"tasks": TASKS, "learners": LEARNERS, **shipped}.items():
        console.print(f"{kind:13} {', '.join(all_names)}")
