"""Figures 7.11 to 7.16: the way of a joint to its goal, and the random numbers drawn on it. Only the text is at hand,
which names two places and an average for each joint; one run is not reproducible, its distribution is."""

from functools import partial

import numpy as np

from humanoid_mjx.report.style import COLORS, figure
from humanoid_mjx.reproduction.findings import Experiment, Finding, Setting, in_words, judge
from humanoid_mjx.thesis import q_learning as thesis

RUNS, STEPS = 2000, 400

PRINTED = thesis.PSEUDO_CODE

CONFIG = {
    "task": {"action": thesis.FIGURES_ACTION, "states": PRINTED["states"]},
    "learner": {
        "epsilon": thesis.FIGURES_EPSILON,
        "learning_rate": PRINTED["learning_rate"],
        "discount": PRINTED["discount"],
    },
}


def way(number: int, joint: int, setting: Setting) -> list[Finding]:
    """Figures 7.11, 7.13, 7.15: the printed marks against the middle 95 % of many runs."""
    from humanoid_mjx.reproduction.traces import printed_run

    run = printed_run(joint, setting.config, RUNS, STEPS)
    start, goal = thesis.JOINT_RANGES[joint]
    arrived = np.cumsum(run.terminated, axis=1)[:, :-1] > 0
    angle = start + setting.config["task"]["action"] * run.state[:, :-1]
    angle[:, 1:][arrived] = goal
    low, high = np.quantile(angle, (0.025, 0.975), axis=0)
    used = setting.config["task"] | setting.config["learner"]
    lengths = np.where(run.terminated.any(axis=1), run.terminated.argmax(axis=1) + 1, STEPS)
    findings = []
    for (first, last), mark in thesis.FIGURE_MARKS[joint]:
        middle = (first + last) // 2
        findings.append(
            Finding(
                name=f"figure-7.{number}",
                quantity=f"angle in episode {middle}, degrees",
                printed=mark,
                reproduced=[round(float(low[middle]), 3), round(float(high[middle]), 3)],
                tolerance=None,
                verdict=judge(bool(low[middle] <= mark <= high[middle]), used, PRINTED),
                why=f"{in_words(used, PRINTED)}; the middle 95 % of {RUNS} runs, which take "
                f"{np.quantile(lengths, 0.05):.0f} to {np.quantile(lengths, 0.95):.0f} episodes to the goal",
            )
        )
    with figure(setting.out / f"figure-7.{number}.png", 1, 1, size=(6.0, 3.6)) as (_, axes):
        panel = axes[0, 0]
        shown = int(np.quantile(lengths, 0.95)) + 5
        panel.fill_between(range(shown), low[:shown], high[:shown], color=COLORS[0], alpha=0.15, step="mid")
        for i in range(5):
            panel.step(range(shown), angle[i, :shown], where="mid", color=COLORS[0], linewidth=0.8, alpha=0.8)
        for (first, last), mark in thesis.FIGURE_MARKS[joint]:
            panel.plot([first, last], [mark, mark], color=COLORS[1], linewidth=4, solid_capstyle="butt")
            panel.annotate("printed", (last, mark), (6, -10), textcoords="offset points", color=COLORS[1])
        panel.set_title(f"Joint {joint} by the printed rules: 5 of {RUNS} runs and their middle 95 %")
        panel.set_xlabel("episode (one step of the pseudo-code)")
        panel.set_ylabel("angle, degrees")
    return findings


def random_numbers(number: int, joint: int, setting: Setting) -> list[Finding]:
    """Figures 7.12, 7.14, 7.16: the printed average against the distribution of averages of single runs."""
    from humanoid_mjx.reproduction.traces import printed_run

    run = printed_run(joint, setting.config, RUNS, STEPS)
    over = run.terminated.any(axis=1)
    lengths = run.terminated.argmax(axis=1) + 1
    means = np.array([draws[:n].mean() for draws, n in zip(run.explore[over], lengths[over], strict=True)])
    low, high = np.quantile(means, (0.025, 0.975))
    printed = thesis.AVERAGE_RANDOM_NUMBER[joint]
    used = setting.config["task"] | setting.config["learner"]
    with figure(setting.out / f"figure-7.{number}.png", 1, 1, size=(5.0, 3.2)) as (_, axes):
        panel = axes[0, 0]
        panel.hist(means, bins=40, color=COLORS[0], alpha=0.6)
        panel.axvline(printed, color=COLORS[1], linewidth=2)
        panel.annotate("printed", (printed, panel.get_ylim()[1]), (4, -12), textcoords="offset points", color=COLORS[1])
        panel.set_title(f"Joint {joint}: average random number of each of {over.sum()} runs")
        panel.set_xlabel("average of the numbers drawn until the goal")
        panel.set_ylabel("runs")
    return [
        Finding(
            name=f"figure-7.{number}",
            quantity="average random number",
            printed=printed,
            reproduced=[round(float(low), 4), round(float(high), 4)],
            tolerance=None,
            verdict=judge(bool(low <= printed <= high), used, PRINTED),
            why=f"{in_words(used, PRINTED)}; the middle 95 % of {over.sum()} runs: the average of one run's draws is "
            "chance and says nothing of the learning",
        )
    ]


EXPERIMENTS = [
    experiment
    for i, joint in enumerate((1, 4, 5))
    for experiment in (
        Experiment(
            f"figure-7.{11 + 2 * i}", f"Way of joint {joint} to its goal", partial(way, 11 + 2 * i, joint), CONFIG
        ),
        Experiment(
            f"figure-7.{12 + 2 * i}",
            f"Random numbers of joint {joint}",
            partial(random_numbers, 12 + 2 * i, joint),
            CONFIG,
        ),
    )
]
