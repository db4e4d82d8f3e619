"""What the commands of the command line do, and what they print."""

import json
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import jax
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
from humanoid_mjx.spec import InputError, known
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
    if diverged := int(np.sum(summary["diverged"])):
        console.print(f"{diverged} runs stopped at numbers that were not finite; the summary marks them.")


def run_reproduce(names: Sequence[str], list_names: bool, overrides: Sequence[str], out: Path) -> None:
    """`humanoid-mjx reproduce`."""
    runtime.start()
    from humanoid_mjx.reproduction import Experiment, Finding, load_experiments, reproduce

    if list_names:
        for experiment in load_experiments().values():
            console.print(f"{experiment.name:24} {experiment.title}")
        return

    def say(experiment: Experiment, findings: list[Finding]) -> None:
        console.print(f"\n{experiment.name}: {experiment.title}")
        for finding in findings:
            console.print(f"  {finding.verdict:16} {finding.quantity}")
            console.print(f"  {'':16} printed {_shown(finding.printed)}, reproduced {_shown(finding.reproduced)}")
            console.print(f"  {'':16} {finding.why}")

    findings = reproduce(names, out, overrides, say)
    counts = Counter(finding.verdict for finding in findings)
    console.print(f"\n{', '.join(f'{count} {verdict}' for verdict, count in counts.items())}\n{out / 'reproduce.json'}")


def _shown(value: Any) -> str:
    return "nothing" if value is None else str(value)


def run_bench(chosen: Sequence[str], file: Path | None) -> None:
    """`humanoid-mjx bench`."""
    from humanoid_mjx.bench import BENCHES

    if chosen[0] == "compare":
        compare_benches(chosen[1:])
        return
    if odd := [name for name in chosen if name not in (*BENCHES, "all") and chosen != ["guard"]]:
        names = (*BENCHES, "all", "guard", "compare")
        raise InputError(f"bench: unknown benchmark {odd[0]!r}; {known(odd[0], names)}.")
    if file is not None and not file.parent.is_dir():
        raise InputError(f"--json {file}: there is no folder {file.parent}.")
    if chosen == ["guard"]:
        guard_benches(file)
        return
    runtime.start()
    records: list[dict[str, Any]] = []
    for name in BENCHES if "all" in chosen else chosen:
        module = import_module(f"humanoid_mjx.bench.{name}")
        console.print(f"{name}:")
        records += [record.as_json() for record in module.run(lambda line: console.print("  " + line))]
    if file is not None:
        result = {"machine": runtime.machine(), "versions": runtime.versions(), "commit": runtime.commit()}
        file.write_text(json.dumps(result | {"records": records}, indent=2) + "\n")
        console.print(f"{file}")


def compare_benches(files: Sequence[str]) -> None:
    """`humanoid-mjx bench compare`."""
    from humanoid_mjx.bench.compare import changes, read_result, table, verdict, warnings

    if len(files) != 2:
        raise InputError("bench compare: give two files that `bench --json` wrote, the older first.")
    before, after = (read_result(Path(name)) for name in files)
    found = changes(before, after)
    if not found:
        raise InputError(f"bench compare: {files[0]} and {files[1]} have no figure in common.")
    console.print(table(found))
    for line in (*warnings(before, after), verdict(found)):
        console.print(line, soft_wrap=True)
    if any(change.regressed for change in found):
        raise typer.Exit(1)


def guard_benches(file: Path | None) -> None:
    """`humanoid-mjx bench guard`."""
    runtime.start()
    jax.config.update("jax_platforms", "cpu")
    from humanoid_mjx.bench import guard

    recorded = guard.read_record(guard.record_path()) if file is None or guard.record_path().is_file() else {}
    found = guard.run(lambda line: console.print("  " + line, soft_wrap=True), recorded)
    if file is not None:
        file.write_text(json.dumps(guard.as_json(found), indent=2) + "\n")
        console.print(f"{file}")
    console.print(guard.verdict(found), soft_wrap=True)
    if any(ratio.fell for ratio in found):
        raise typer.Exit(1)


def run_evaluate(names: Sequence[str], physics: str | None, episodes: int, file: Path | None, out: Path | None) -> None:
    """`humanoid-mjx evaluate`."""
    if file is not None and not file.parent.is_dir():
        raise InputError(f"--json {file}: there is no folder {file.parent}.")
    runtime.start()
    from humanoid_mjx.results.comparison import compare_curves, curve_of_run
    from humanoid_mjx.results.evaluations import evaluation_table
    from humanoid_mjx.training.evaluation import HELD_OUT_WORDS, evaluate_all
    from humanoid_mjx.training.policy import find_policy, on_physics

    policies = [find_policy(name) for name in names]
    if len({policy.name for policy in policies}) < len(policies):
        policies = [policy._replace(name=name) for name, policy in zip(names, policies, strict=True)]
    if physics is not None:
        policies = [on_physics(policy, physics) for policy in policies]
    evaluations = evaluate_all(policies, episodes)
    title = f"{episodes:,} episodes that no training has seen" + (f", physics {physics}" if physics else "")
    console.print(evaluation_table(title, evaluations))
    if file is not None:
        result = {
            "machine": runtime.machine(),
            "versions": runtime.versions(),
            "episodes": episodes,
            "held_out": HELD_OUT_WORDS,
            "evaluations": [evaluation.as_json() for evaluation in evaluations],
            "policies": [policy.as_json() for policy in policies],
        }
        file.write_text(json.dumps(result, indent=2) + "\n")
        console.print(f"{file}", soft_wrap=True)
    runs = [(Path(name), policy) for name, policy in zip(names, policies, strict=True) if Path(name).is_dir()]
    if len(runs) > 1:
        curves = [curve_of_run(path, policy) for path, policy in runs]
        target = out or runs[0][0] / "figures" / "comparison.png"
        compare_curves(target, curves, [e for e in evaluations if e.agent != "greedy"])
        console.print(f"{target}", soft_wrap=True)


def run_play(name: str, physics: str | None, out: Path | None) -> None:
    """`humanoid-mjx play`."""
    runtime.start()
    from humanoid_mjx.results.rendering import render_motion
    from humanoid_mjx.training.episode import play, robot_of, rows_of
    from humanoid_mjx.training.policy import find_policy, on_physics

    trained = find_policy(name)
    if physics is not None:
        trained = on_physics(trained, physics)
    model, is_run = robot_of(trained), Path(name).is_dir()
    played = play(trained)
    qpos, step_s = rows_of(trained, played)
    target = out or (Path(name) / "figures" / "play.gif" if is_run else Path(f"{trained.name}.gif"))
    path = render_motion(model, qpos, step_s, target)
    decisions, period = len(played.actions), trained.learner.task.period  # pyright: ignore[reportAttributeAccessIssue]
    outcome = "succeeds" if played.success else "does not succeed"
    console.print(
        f"point {trained.point}, seed {trained.seed}: {outcome} in {decisions} decisions, {decisions * period:g} s; "
        f"return {played.episode_return:.4g}"
    )
    console.print(f"{path}", soft_wrap=True)


def run_export(what: str, file: Path) -> None:
    """`humanoid-mjx export`."""
    if file.suffix not in (".xml", ".npz"):
        raise InputError(f"{file}: the file must end in .xml, for a robot, or in .npz, for the policy of a run.")
    if not file.parent.is_dir():
        raise InputError(f"{file}: there is no folder {file.parent}.")
    if file.suffix == ".npz":
        from humanoid_mjx.training.policy import find_policy, save_policy

        save_policy(find_policy(what), file)
    else:
        from humanoid_mjx.robot import robot_spec

        spec = robot_spec(what)
        spec.compile()
        file.write_text(spec.to_xml())
    console.print(f"{file}", soft_wrap=True)


def show_info(config: str | None, overrides: Sequence[str]) -> None:
    """`humanoid-mjx info`."""
    runtime.start()
    from humanoid_mjx.learners import LEARNERS
    from humanoid_mjx.tasks import TASKS
    from humanoid_mjx.training.plan import make_plan, resolved, run_bytes, training_bytes

    if config is not None:
        plan = make_plan(load(config, overrides))
        console.print(dump_yaml(resolved(plan.config)).rstrip(), markup=False)
        size = sum(run_bytes(group) * len(group.runs) for group in plan.groups)
        most = max(training_bytes(group) for group in plan.groups)
        console.print(
            f"\n{len(plan.points):,} points x {plan.config.seeds} seeds = {plan.num_runs:,} runs "
            f"in {len(plan.groups)} compiled program{'s' * (len(plan.groups) > 1)}; "
            f"training state {size / 2**20:,.1f} MiB if all were held at once, "
            f"a run that trains an estimated {most / 2**20:,.1f} MiB"
        )
        return
    for name, value in (runtime.machine() | runtime.versions()).items():
        console.print(f"{name:13} {value}")
    shipped = {"configs": names("configs", ".yaml"), "policies": names("policies", ".npz")}
    for kind, all_names in {"tasks": TASKS, "learners": LEARNERS, **shipped}.items():
        console.print(f"{kind:13} {', '.join(all_names)}")
