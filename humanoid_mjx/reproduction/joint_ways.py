"""Tables 7.1 to 7.3 and Figures 7.11 to 7.16: what a joint learns by the pseudo-code of section 6.3, its way to the
goal, and the random numbers drawn on it.

Of the figures only the text is at hand, which names two places and an average for each joint; one run is not
reproducible, its distribution is.
"""

import math
from collections.abc import Iterator
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy.stats import binomtest

from humanoid_mjx.compute import rng
from humanoid_mjx.learners import make_learner
from humanoid_mjx.report.style import COLORS
from humanoid_mjx.reproduction.findings import Finding, Setting, check, experiment, in_words
from humanoid_mjx.tasks import make_task
from humanoid_mjx.thesis import q_learning as thesis


class Trace(NamedTuple):
    """Runs of one learner, step by step."""

    state: np.ndarray
    """(runs, steps + 1) The task's state before each step and after the last."""
    terminated: np.ndarray
    """(runs, steps) True where the step ended the trajectory."""
    explore: np.ndarray
    """(runs, steps) The random number that decided between exploring and the greedy action."""
    q_table: np.ndarray
    """(runs, num_states, num_actions) The table at the end."""


def printed_run(joint: int, config: dict[str, Any], runs: int, steps: int) -> Trace:
    """Runs of `joint_reach` by the printed rules; `config` holds values of task and learner."""
    task = make_task("joint_reach", joint=joint, rules="printed", max_episode_steps=steps, **config["task"])
    learner = make_learner("tabular_q", task, episodes=steps, record=1, **config["learner"])

    def one(learner: Any, key: Any) -> Any:
        def step(carry: Any, _: None) -> Any:
            explore = rng.uniform(key, 3 * carry.step.astype("uint32"))
            seen = carry.agents.terminated, carry.agents.state, explore
            return learner.train_step(carry)[0], seen

        first = learner.init(key)
        start = learner.task.reset(jax.random.fold_in(key, 0))
        return start, *jax.lax.scan(step, first, length=steps)

    keys = jax.vmap(jax.random.fold_in, in_axes=(None, 0))(rng.key(0), np.arange(runs, dtype=np.uint32))
    start, last, (terminated, after, explore) = jax.jit(jax.vmap(one, in_axes=(None, 0)))(learner, keys)
    state = np.concatenate([np.asarray(start)[:, None], np.asarray(after)], axis=1)
    return Trace(state, np.asarray(terminated), np.asarray(explore), np.asarray(last.q_table))


RUNS, STEPS = 2000, 400
PRINTED = thesis.PSEUDO_CODE
LEARNER = {name: PRINTED[name] for name in ("epsilon", "learning_rate", "discount")}
CONFIG = {"task": {"action": thesis.FIGURES_ACTION, "states": PRINTED["states"]}, "learner": LEARNER}
TABLES_CONFIG = {
    "task": {"action": PRINTED["action"], "states": thesis.TABLES_STATES, "bonus": PRINTED["bonus"]},
    "learner": LEARNER | {"learning_rate": thesis.TABLES_LEARNING_RATE},
}

TABLES_TOLERANCE = 5e-4
"""Half of the last digit of the tables' longest numbers."""

CONFIDENCE = 0.95
EPISODE = "episode (one step of the pseudo-code)"


def q_table(joint: int, setting: Setting) -> Iterator[Finding]:
    """Tables 7.1 to 7.3: what the table of Q holds when a joint has reached its goal."""
    run = printed_run(joint, setting.config, runs=16, steps=2000)
    reached = run.q_table[run.terminated.any(axis=1)]
    printed = np.array(thesis.TABLES[joint]).T
    comparable = len(reached) > 0 and reached.shape[1:] == printed.shape
    error = float(np.abs(reached - printed).max()) if comparable else float("inf")
    quantity, values = "Q after the goal: for each row, staying and moving", _values(setting.config)
    found = np.round(reached[0].astype(float), 4).tolist() if len(reached) else None
    why = f"{in_words(*values)}; {len(reached)} of {len(run.terminated)} runs reached the goal, "
    why += f"the largest difference of any run is {error:.2g}" if comparable else "the table has another shape"
    yield check(quantity, printed.tolist(), found, error <= TABLES_TOLERANCE, why, TABLES_TOLERANCE, values)


def _values(config: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The values in use and the printed ones, by name."""
    return config["task"] | config["learner"], PRINTED


def way(joint: int, setting: Setting) -> Iterator[Finding]:
    """Figures 7.11, 7.13, 7.15: the printed marks against the middle 95 % of many runs."""
    run, (start, goal) = printed_run(joint, setting.config, RUNS, STEPS), thesis.JOINT_RANGES[joint]
    angle = start + setting.config["task"]["action"] * run.state[:, :-1]
    angle[:, 1:][np.cumsum(run.terminated, axis=1)[:, :-1] > 0] = goal
    low, high = np.quantile(angle, (0.025, 0.975), axis=0)
    values = _values(setting.config)
    lengths = np.where(run.terminated.any(axis=1), run.terminated.argmax(axis=1) + 1, STEPS)
    for (first, last), mark in thesis.FIGURE_MARKS[joint]:
        middle = (first + last) // 2
        least, most = round(float(low[middle]), 3), round(float(high[middle]), 3)
        why = f"{in_words(*values)}; the middle 95 % of {RUNS} runs, which take {np.quantile(lengths, 0.05):.0f} to "
        why += f"{np.quantile(lengths, 0.95):.0f} episodes to the goal; a single mark tells no epsilon from another, "
        why += "and is no evidence for this one: epsilon-7e asks all together"
        agrees = low[middle] <= mark <= high[middle]
        yield check(f"angle in episode {middle}, degrees", mark, [least, most], agrees, why, values=values)
    with setting.figure(1, 1, size=(6.0, 3.6)) as (_, axes):
        panel = axes[0, 0]
        shown = int(np.quantile(lengths, 0.95)) + 5
        panel.fill_between(range(shown), low[:shown], high[:shown], color=COLORS[0], alpha=0.15, step="mid")
        for i in range(5):
            panel.step(range(shown), angle[i, :shown], where="mid", color=COLORS[0], linewidth=0.8, alpha=0.8)
        for (first, last), mark in thesis.FIGURE_MARKS[joint]:
            (bar,) = panel.plot([first, last], [mark, mark], color=COLORS[1], linewidth=4, solid_capstyle="butt")
        panel.legend([bar], ["printed"], loc="lower right", frameon=False)
        words = f"epsilon {setting.config['learner']['epsilon']:g}: 5 of {RUNS} runs, their middle 95 %"
        panel.set(title=f"Joint {joint} by the printed rules, {words}", xlabel=EPISODE, ylabel="angle, degrees")


def random_numbers(joint: int, setting: Setting) -> Iterator[Finding]:
    """Figures 7.12, 7.14, 7.16: the printed average against the distribution of averages of single runs."""
    run = printed_run(joint, setting.config, RUNS, STEPS)
    over = run.terminated.any(axis=1)
    lengths = run.terminated.argmax(axis=1) + 1
    drawn = [draws[:n] for draws, n in zip(run.explore[over], lengths[over], strict=True)]
    means = np.array([draws.mean() for draws in drawn])
    low, high = np.quantile(means, (0.025, 0.975))
    printed = thesis.AVERAGE_RANDOM_NUMBER[joint]
    values = _values(setting.config)
    why = f"{in_words(*values)}; the middle 95 % of {over.sum()} runs: the average of one run's draws is chance and "
    why += "says nothing of the learning"
    ends = np.round((low, high), 4).tolist()
    yield check("average random number", printed, ends, low <= printed <= high, why, values=values)
    nearest = drawn[int(np.abs(means - printed).argmin())]
    episodes = np.arange(1, len(nearest) + 1)
    with setting.figure(1, 1, size=(6.4, 3.4)) as (_, axes):
        panel = axes[0, 0]
        panel.plot(episodes, nearest, "o-", color=COLORS[0], markersize=3, linewidth=0.6, label="drawn")
        panel.plot(episodes, np.cumsum(nearest) / episodes, color=COLORS[2], linewidth=1.6, label="average so far")
        panel.axhline(printed, color=COLORS[1], linewidth=1.6, linestyle="--", label=f"printed average, {printed:g}")
        panel.set(xlabel=EPISODE, ylabel="random number", ylim=(0, 1))
        panel.set_title(f"Joint {joint}: the run whose average is nearest to the printed one")
        panel.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=3, frameon=False)


@experiment("epsilon-7e", "The epsilon behind Figures 7.11 to 7.16 together", CONFIG)
def pooled_epsilon(setting: Setting) -> list[Finding]:
    """The epsilon behind the late marks of Figures 7.11, 7.13 and 7.15 together, and the averages together.

    By the printed rules a joint moves with probability epsilon / 2 in a step and otherwise stays, whatever it has
    learned: the moves up to a step are binomial. The late mark of a figure says how many moves were made before its
    first step.
    """
    start = {joint: low for joint, (low, _) in thesis.JOINT_RANGES.items()}
    late = {joint: marks[-1] for joint, marks in thesis.FIGURE_MARKS.items()}
    action = setting.config["task"]["action"]
    moves = {joint: round((mark - start[joint]) / action) for joint, (_, mark) in late.items()}
    steps = {joint: first for joint, ((first, _), _) in late.items()}
    return [_epsilon(moves, steps, setting.config), _averages(thesis.AVERAGE_RANDOM_NUMBER, steps)]


def _epsilon(moves: dict[int, int], steps: dict[int, int], config: dict[str, Any]) -> Finding:
    made, of = sum(moves.values()), sum(steps.values())
    low, high = (2 * share for share in binomtest(made, of).proportion_ci(CONFIDENCE, method="exact"))
    epsilon = config["learner"]["epsilon"]
    values = _values(config)
    counts = ", ".join(f"{moves[joint]} of {steps[joint]} (joint {joint})" for joint in moves)
    off = (made - of * epsilon / 2) / math.sqrt(of * epsilon / 2 * (1 - epsilon / 2)) if 0 < epsilon < 2 else math.inf
    quantity = "epsilon behind the late marks of Figures 7.11, 7.13 and 7.15, pooled: between"
    why = f"{in_words(*values)}: {made} moves in {of} steps, {counts}, estimate {2 * made / of:.2f} and its "
    why += f"{CONFIDENCE:.0%} interval (Clopper and Pearson); epsilon {epsilon:g} is {abs(off):.1f} standard "
    why += "deviations away"
    between, agrees = [round(low, 3), round(min(high, 1.0), 3)], low <= epsilon <= high
    return check(quantity, PRINTED["epsilon"], between, agrees, why, values=values)


def _averages(averages: dict[int, float], steps: dict[int, int]) -> Finding:
    """The finding that the three averages are those of uniform numbers, weighted with how many were drawn at least."""
    weights = np.array([steps[joint] for joint in averages], float)
    pooled = float(np.average(list(averages.values()), weights=weights))
    half = 1.96 * math.sqrt(1 / 12 / weights.sum())
    quantity = "average random number of Figures 7.12, 7.14 and 7.16 together: of uniform numbers between"
    why = f"the middle {CONFIDENCE:.0%} of averages of {weights.sum():.0f} uniform numbers, as many as the late marks "
    why += "say were drawn at least"
    between = [round(0.5 - half, 4), round(0.5 + half, 4)]
    return check(quantity, round(pooled, 4), between, abs(pooled - 0.5) <= half, why)


for _number, _joint in enumerate((1, 4, 5)):
    experiment(f"table-7.{1 + _number}", f"Q after learning of joint {_joint}", TABLES_CONFIG)(partial(q_table, _joint))
    experiment(f"figure-7.{11 + 2 * _number}", f"Way of joint {_joint} to its goal", CONFIG)(partial(way, _joint))
    experiment(f"figure-7.{12 + 2 * _number}", f"Random numbers of joint {_joint}", CONFIG)(
        partial(random_numbers, _joint)
    )
