"""What `humanoid-mjx info` prints."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rich.table import Table

from humanoid_mjx import compute
from humanoid_mjx.commands import console
from humanoid_mjx.config import dump_yaml, load
from humanoid_mjx.files import names
from humanoid_mjx.runs.disk import in_words
from humanoid_mjx.spec import InputError
from humanoid_mjx.training.progress import Bar

if TYPE_CHECKING:
    from humanoid_mjx.training.plan import Plan


def show_keys(name: str) -> None:
    """`humanoid-mjx info NAME --keys`: of a task, a learner, or both of a config."""
    from humanoid_mjx.keys import keys_of
    from humanoid_mjx.learners import LEARNERS, Learner
    from humanoid_mjx.spec import find, modules_in
    from humanoid_mjx.tasks import TASKS
    from humanoid_mjx.tasks.base import Task

    chosen: list[tuple[str, Any]] = []
    if name in TASKS or name in LEARNERS or ":" in name:
        kind, registry, base = ("learner", LEARNERS, Learner) if name in LEARNERS else ("task", TASKS, Task)
        chosen.append((kind, find(kind, registry, base, name)))
    else:
        config = load(name)
        with modules_in(config.modules):
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


def show_robot(path: str) -> bool:
    """`humanoid-mjx info ROBOT.xml`; whether `physics: tree` takes it."""
    from humanoid_mjx.physics.survey import read_model, survey

    lines, taken = survey(read_model(path))
    for line in lines:
        console.print(line, markup=False, highlight=False)
    return taken


def show_info(config: str | None, overrides: Sequence[str], timed: bool) -> None:
    """`humanoid-mjx info`."""
    compute.start()
    if config is not None:
        _show_plan(config, overrides, timed)
        return
    if timed:
        raise InputError("info --time: name the config whose sweep to time.")
    from humanoid_mjx.learners import LEARNERS
    from humanoid_mjx.tasks import TASKS

    for name, value in (compute.machine() | compute.versions()).items():
        console.print(f"{name:13} {value}")
    shipped = {"configs": names("configs", ".yaml"), "policies": names("policies", ".npz")}
    for kind, all_names in {"tasks": TASKS, "learners": LEARNERS, **shipped}.items():
        console.print(f"{kind:13} {', '.join(all_names)}")


def _show_plan(config: str, overrides: Sequence[str], timed: bool) -> None:
    """A config in full, and what its sweep will take; where `timed` also how long."""
    from humanoid_mjx.training.cost import disk_bytes, run_bytes, runs_at_once, slots, training_bytes
    from humanoid_mjx.training.fused import why_not
    from humanoid_mjx.training.plan import make_plan, resolved

    plan = make_plan(load(config, overrides))
    console.print(dump_yaml(resolved(plan.config)).rstrip())
    size = sum(run_bytes(group) * len(group.runs) for group in plan.groups)
    most = max(training_bytes(group) for group in plan.groups)
    together = [1] * len(plan.groups)
    refusal = None
    try:
        together = [slots(group, runs_at_once(group)) for group in plan.groups]
    except InputError as error:
        refusal = error
    console.print(
        f"\n{len(plan.points):,} points x {plan.config.seeds} seeds = {plan.num_runs:,} runs "
        f"in {len(plan.groups)} compiled program{'s' * (len(plan.groups) > 1)}; "
        f"training state {in_words(size)} if all were held at once, "
        f"a run that trains an estimated {in_words(most)}"
    )
    console.print(f"on disk an estimated {in_words(disk_bytes(plan, together))}, without figures")
    if refusal:
        console.print(f"sweep refuses it here: {refusal}")
    for reason in dict.fromkeys(why_not(group.learner()) for group in plan.groups):
        console.print("trained by one fused kernel" if reason is None else f"no fused kernel: {reason}")
    if timed:
        _show_time(plan)
    else:
        console.print(f"how long it takes here: humanoid-mjx info {config} --time measures a piece of it")


def _show_time(plan: "Plan") -> None:
    """How long a sweep will take."""
    from humanoid_mjx.training.cost import runs_at_once
    from humanoid_mjx.training.pace import MEASURED_S, estimate, time_in_words

    with Bar(console) as bar:
        bar.phase("compiling and training a piece of it")
        found = estimate(plan, [runs_at_once(group) for group in plan.groups])
    parts = {"compiling (less once it is cached)": found.compile_s, "training": found.train_s}
    parts |= {"evaluating": found.evaluate_s} if found.evaluate_s > 0 else {}
    words = ", ".join(f"{time_in_words(seconds)} of {part}" for part, seconds in parts.items())
    how = f"by {MEASURED_S:g} s of its training"
    how += f" in each of {found.measured} programs" if len(plan.groups) > 1 else ""
    console.print(f"about {time_in_words(found.total_s)} on this machine, without figures: {words}; estimated {how}")
