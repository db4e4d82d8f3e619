"""The command `evaluate`."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rich.table import Column, Table
from typer import Argument, Option

from humanoid_mjx.commands import POLICIES, Physics, Point, Trust, Unmodified, World, console, start_for, trusting
from humanoid_mjx.training.progress import Bar

if TYPE_CHECKING:
    from humanoid_mjx.evaluation.policy import StoredPolicy
    from humanoid_mjx.runs.statistics import Evaluation


def evaluate(
    policies: Annotated[
        list[str],
        Argument(metavar="RUN|POLICY...", help="Run folders, policy files, shipped policies.", autocompletion=POLICIES),
    ],
    gait: Annotated[bool, Option("--gait", help="Measure the gait under constant commands.")] = False,
    point: Point = None,
    set_: World = None,
    physics: Physics = None,
    unmodified: Unmodified = False,
    episodes: Annotated[
        int | None, Option(min=1, max=1_000_000, help="Episodes: 1024 of each agent; with --gait 64 of each command.")
    ] = None,
    json: Annotated[Path | None, Option(metavar="FILE", help="Write the results as JSON.")] = None,
    trust: Trust = False,
) -> None:
    """Evaluate policies on held-out episodes, beside a zero and a random agent."""
    from humanoid_mjx import compute
    from humanoid_mjx.evaluation.evaluate import HELD_OUT_WORDS
    from humanoid_mjx.files import write_json
    from humanoid_mjx.spec import InputError, check_folder

    if unmodified and physics not in (None, "mujoco"):
        raise InputError(f"--physics {physics}: --unmodified plays in native MuJoCo; leave one of them out.")
    if json is not None:
        check_folder(json, "--json")
    start_for(physics, set_ or [])
    number = episodes or (64 if gait else 1024)
    worlds = ("mujoco", "unmodified") if unmodified else (physics,)
    with trusting(trust, *policies):
        found = (_gaits if gait else _successes)(policies, point, worlds, set_ or [], number)
    if json is not None:
        result = compute.made_by() | {"episodes": number, "held_out": HELD_OUT_WORDS, "physics": worlds[0]} | found
        write_json(json, result, indent=None if gait else 2)
        console.print(f"{json}", soft_wrap=True)


def _successes(
    names: Sequence[str], point: int | None, worlds: Sequence[str | None], overrides: Sequence[str], episodes: int
) -> dict[str, Any]:
    """Print how often policies and other agents succeed; the same as plain values."""
    from humanoid_mjx.evaluation.evaluate import evaluate_all
    from humanoid_mjx.evaluation.policy import find_policy, in_worlds, played_by

    policies = [find_policy(name, point, overrides) for name in names]
    if len({policy.name for policy in policies}) < len(policies):
        policies = [policy._replace(name=name) for name, policy in zip(names, policies, strict=True)]
    policies = in_worlds(policies, worlds, overrides)
    with Bar(console) as bar:
        bar.phase("compiling and playing")
        evaluations = evaluate_all(policies, episodes)
    title = f"{episodes:,} episodes that no training has seen{_changes(worlds[0], overrides)}"
    remarks = [*words_on_returns(policies, evaluations), *played_by(policies)]
    native = {each.name for each in policies if getattr(each.learner.task, "physics", "") in ("mujoco", "unmodified")}
    advice = "; single precision misses contacts on slippery ground, --physics mujoco does not"
    remarks += [
        f"{each.policy} ({each.agent}): the physics gave up in {each.lost:.1%} of episodes, which are no success"
        f"{'' if each.policy in native else advice}."
        for each in evaluations
        if each.lost > 0.0
    ]
    if any(getattr(each.learner.task, "command", None) for each in policies):
        remarks.append("success is to stay upright; evaluate --gait says whether a robot also goes as it is told.")
    console.print(evaluation_table(title, evaluations), *remarks, sep="\n")
    parts = {"evaluations": evaluations, "policies": policies}
    return {"set": list(overrides)} | {name: [each.as_json() for each in part] for name, part in parts.items()}


def _gaits(
    names: Sequence[str], point: int | None, worlds: Sequence[str | None], overrides: Sequence[str], episodes: int
) -> dict[str, Any]:
    """Print how policies walk under commands; the same as plain values."""
    from humanoid_mjx.evaluation.gait.figures import FIGURES
    from humanoid_mjx.evaluation.gait.scenarios import measure, settings_of, trained_seeds
    from humanoid_mjx.evaluation.policy import in_worlds, played_by
    from humanoid_mjx.report.gaits import gait_table, meanings, remarks

    settings = settings_of(overrides)
    policies = in_worlds(trained_seeds(names, point, overrides), worlds, settings)
    with Bar(console) as bar:
        bar.phase("compiling and walking")
        measured = measure(policies, episodes, bar.count)
    for each in measured:
        seeds = len(each.policies)
        whose = each.policies[0].name + (f", {seeds} training seeds" if seeds > 1 else "")
        title = f"{whose}: {episodes:,} episodes a command that no training has seen{_changes(worlds[0], settings)}"
        console.print(gait_table(title, each.gaits, each.beyond), *remarks(each.gaits, each.beyond), sep="\n")
    words = "; ".join(f"{name}: {meaning}" for name, meaning in meanings().items())
    console.print(*played_by(policies), f"{words}.", sep="\n")
    figures = {name: figure._asdict() for name, figure in FIGURES.items()}
    return {"set": settings, "figures": figures, "results": [each.as_json() for each in measured]}


def evaluation_table(title: str, evaluations: Sequence["Evaluation"]) -> Table:
    """A table with a row for each evaluation, the intervals beside the numbers."""
    numbers = (Column(f"{name} (95 %)", justify="right") for name in ("success", "return", "steps"))
    table = Table("agent", *numbers, title=title, title_justify="left")
    many = len({each.policy for each in evaluations if each.agent == "zero"}) > 1
    for evaluation in evaluations:
        success, total, steps = evaluation.success, evaluation.episode_return, evaluation.steps
        agent = f"{evaluation.agent} agent" + f" in the task of {evaluation.policy}" * many
        table.add_row(
            f"{evaluation.policy} (greedy)" if evaluation.agent == "greedy" else agent,
            f"{success.value:.1%} ({success.low:.1%} to {success.high:.1%})",
            *(f"{x.value:.4g} ({x.low:.4g} to {x.high:.4g})" for x in (total, steps)),
        )
    return table


def words_on_returns(policies: Sequence["StoredPolicy"], evaluations: Sequence["Evaluation"]) -> list[str]:
    """A sentence for each policy that has a lower return than another agent, but only because that one waits: it
    succeeds no more often, and its discounted return is lower. An untrained policy is none."""
    found = []
    for policy in policies:
        names = policy.name, policy.config.task["name"]
        own = {e.agent: e for e in evaluations if e.policy in names[: 1 if e.agent == "greedy" else 2]}
        greedy = own["greedy"]
        waits = any(
            each.success.value <= greedy.success.value
            and each.episode_return.value > greedy.episode_return.value
            and each.discounted_return < greedy.discounted_return
            for each in own.values()
        )
        beaten = any(each.success.low > greedy.success.high for each in own.values())
        if waits and not beaten and greedy.success.value > 0:
            returns = ", ".join(f"{agent} {each.discounted_return:.4g}" for agent, each in own.items())
            found.append(
                f"{policy.name} has a lower return than an agent that succeeds no more often: the task pays for every "
                f"step, so that waiting adds up. Training discounts later rewards. Discounted returns: {returns}."
            )
    return found


def _changes(physics: str | None, overrides: Sequence[str]) -> str:
    """Differences from training, for a title."""
    changes = [f"physics {physics}"] * (physics is not None) + list(overrides)
    return "".join(f", {change}" for change in changes)
