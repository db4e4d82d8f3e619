"""The methods of `tabular_q` against the book and against each other, in a quarter of an hour on one core.

python experiments/methods.py            # writes docs/bench/methods.json and docs/methods.png
python experiments/methods.py --draw     # the figure alone, from the record

`prove` compares tables of 4,096 seeds with `textbook.py`, from the same random numbers and from others. `walk` goes
along the cliff of R. Sutton and A. Barto, "Reinforcement Learning" (2018), Example 6.6, `overestimate` through the grid
of H. van Hasselt, "Double Q-learning" (2010). `compare` learns the thesis's tasks: half of the seeds choose the
settings of each method, the other half compare the methods. `drive` drives the mountain car by tiles.
"""

import argparse
import json
import sys
import tempfile
from collections import Counter
from itertools import product
from pathlib import Path
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import parity
import textbook
from matplotlib.ticker import StrMethodFormatter

import humanoid_mjx
from humanoid_mjx import compute, make_learner
from humanoid_mjx.compute import rng
from humanoid_mjx.report.style import COLORS, figure, label_lines
from humanoid_mjx.runs import statistics
from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.continuous import ContinuousTask, State, begin
from humanoid_mjx.tasks.finite import FiniteTask

ROOT = Path(__file__).parent.parent
RECORD = ROOT / "docs/bench/methods.json"

METHODS = ("q_learning", "sarsa", "expected_sarsa", "double_q", "n_step", "q_lambda")
PROVED, DECISIONS, MOST, OBEYED = 4096, 60, 12, 0.875
"""Seeds, their decisions, the length of an episode, and the probability that a choice is carried out."""

SEEDS, POINTS = 128, 50


def proof() -> list[dict[str, Any]]:
    """All methods with all explorations; step sizes and decays by turns."""
    decays = {"episode": 0.75, "step": 0.96875, "visit": 0.96875}
    found = []
    for number, (method, exploration) in enumerate(product(METHODS, ("epsilon_greedy", "boltzmann", "ucb"))):
        decay = list(decays)[(number + number // 3) % 3]
        own = {"decay": decay, "epsilon_decay": decays[decay], "epsilon_min": 0.125, "discount": 0.75}
        step_size = ("constant", "visits")[number % 2]
        found.append({"method": method, "exploration": exploration, "step_size": step_size, **own})
    return found


def numbers_of(key: Any, decisions: int) -> Any:
    """The uniform numbers of an agent's decisions, and of those that end its last episode: (decisions + 17, 4)."""

    steps = jnp.arange(decisions + 17, dtype=jnp.uint32)
    coins = jax.vmap(rng.uniform, in_axes=(None, 0))(key, ~steps)
    return jnp.column_stack([jax.random.uniform(key, (3 * len(steps),)).reshape(-1, 3), coins])


def process_of(task: Any) -> tuple[np.ndarray, ...]:
    """The tables of a `TableTask`."""
    return tuple(np.asarray(x) for x in (task.next_state, task.reward, task.terminal))


def prove() -> list[dict[str, Any]]:
    """Compare the last tables of all seeds with the textbook's, and their means with its from other numbers."""
    sys.path.append(str(ROOT / "tests"))
    from finite_mdp import random_task  # pyright: ignore[reportMissingImports]

    task = random_task(3, 6, 3, 6, max_episode_steps=MOST, success_rate=OBEYED)
    process, rows = process_of(task), np.asarray(task.rows)
    keys = jax.vmap(jax.random.fold_in, in_axes=(None, 0))(rng.key(0), jnp.arange(PROVED))
    shared = np.asarray(jax.jit(jax.vmap(lambda key: numbers_of(key, DECISIONS)))(keys))
    own = np.random.default_rng(0).random(shared.shape, np.float32)

    def table(values: dict[str, Any], numbers: np.ndarray) -> np.ndarray:
        agent = textbook.Textbook(process, textbook.Settings(**values), numbers.__getitem__, OBEYED, MOST)
        agent.play(DECISIONS)
        return agent.values()

    found = []
    for values in proof():
        learner: Any = make_learner("tabular_q", task, episodes=1000, **values)

        def train(key: Any, learner: Any = learner) -> Any:
            steps = jax.lax.scan(
                lambda carry, _: (learner.train_step(carry)[0], None), learner.init(key), length=DECISIONS
            )
            return learner.policy(steps[0])

        tables = np.asarray(jax.jit(jax.vmap(train))(keys))[:, rows]
        same = np.stack([table(values, numbers) for numbers in shared])
        others = np.stack([table(values, numbers) for numbers in own])
        errors = np.abs(tables - same).max(axis=(1, 2))
        spread = np.sqrt((tables.var(axis=0) + others.var(axis=0)) / PROVED)
        moved = spread > 1e-6
        far = np.abs(tables.mean(axis=0) - others.mean(axis=0))[moved] / spread[moved]
        found.append({
            **values, "seeds": PROVED, "seeds that differ by more than 1e-5": int((errors > 1e-5).sum()),
            "median error": float(np.median(errors)), "cells": int(moved.sum()),
            "largest z of a cell's mean": float(far.max()),
        })  # fmt: skip
        print(*(f"{key}: {value}" for key, value in found[-1].items()), sep="  ", flush=True)
    return found


class Grid(FiniteTask):
    """3 x 3 cells; a step earns -12 or 10 by chance, a step in the goal's cell earns 5 and ends the episode."""

    num_states: ClassVar[int] = 9
    num_actions: ClassVar[int] = 4

    max_episode_steps: int = traced(1000)

    def reset(self, key):
        return jnp.int32(6)

    def step(self, state, action, key):
        down, right = jnp.asarray(parity.MOVES)[action]
        cell = jnp.clip(state // 3 + down, 0, 2) * 3 + jnp.clip(state % 3 + right, 0, 2)
        ends = state == 2
        return cell, jnp.where(ends, 5.0, jnp.where(jax.random.bernoulli(key), -12.0, 10.0)), ends


def learn(task: dict[str, Any], learner: dict[str, Any], axes: dict[str, list], episodes: int, seeds: int) -> Any:
    """Sweep: the points, and (points, seeds, ...) of each curve and of each greedy score."""
    config = {"name": "methods", "task": task, "learner": {"name": "tabular_q", **learner}, "episodes": episodes}
    config |= {"seeds": seeds, "record": POINTS} | ({"sweep": {"axes": axes}} if axes else {})
    with tempfile.TemporaryDirectory() as folder:
        run = humanoid_mjx.sweep(config, Path(folder) / "run", quiet=True)
        results, summary = run.results, run.summary
        count = len(summary["point"]) // seeds
        points = [{axis: summary[axis].reshape(count, seeds)[i, 0].item() for axis in axes} for i in range(count)]
        curves = {name: results[name].reshape(count, seeds, POINTS).astype(float) for name in ("return", "steps")}
        greedy = {name: summary[f"greedy_{name}"].reshape(count, seeds).astype(float) for name in ("return", "steps")}
    return points, curves, greedy


def best_on_the_cliff(epsilon: float) -> float:
    """The mean return of the best epsilon-greedy policy, which Sarsa's and expected Sarsa's tables stand for."""
    cells, key = np.arange(parity.ROWS * parity.COLUMNS), jax.random.key(0)
    steps = [jax.vmap(lambda cell, a=a: parity.CliffWalking().step(cell, a, key))(cells) for a in range(4)]
    following, reward, over = (np.stack([np.asarray(step[i]) for step in steps], axis=1) for i in range(3))
    value = np.zeros(len(cells))
    for _ in range(5000):
        q = reward + np.where(over, 0.0, value[following])
        value = (1 - epsilon) * q.max(axis=1) + epsilon * q.mean(axis=1)
    return float(value[parity.START])


def walk() -> dict[str, Any]:
    """Example 6.6 by all methods: its epsilon of 0.1, a step size of 0.5, 500 episodes."""
    found: dict[str, Any] = {
        "exact return of Q-learning's policy while exploring": parity.expected_on_the_cliff(0.1),
        "exact return of the best policy while exploring": best_on_the_cliff(0.1),
    }
    for method in METHODS:
        learner = {"method": method, "epsilon": 0.1, "learning_rate": 0.5, "discount": 0.99999}
        _, curves, greedy = learn({"name": "parity:CliffWalking"}, learner, {}, 500, SEEDS)
        returns = curves["return"][0]
        found[method] = {
            "return while learning, last fifth": statistics.estimate(returns[:, -POINTS // 5 :].mean(axis=1)),
            "greedy return": statistics.estimate(greedy["return"][0]),
            "seeds by greedy return": {str(int(x)): n for x, n in Counter(greedy["return"][0].tolist()).items()},
            "curve": [round(x, 1) for x in returns.mean(axis=0)],
        }  # fmt: skip
        print(
            method,
            found[method]["return while learning, last fifth"],
            found[method]["seeds by greedy return"],
            flush=True,
        )
    return found


def overestimate() -> dict[str, Any]:
    """The value of the grid's start: steps of 1 / N(s, a), epsilon 0.1, discount 0.95, 2,000 episodes."""
    found: dict[str, Any] = {"exact value of the start": 5 * 0.95**4 - sum(0.95**k for k in range(4))}
    for method in ("q_learning", "double_q"):
        task: Any = Grid()
        learner = make_learner(
            "tabular_q", task, method=method, step_size="visits", epsilon=0.1, discount=0.95, episodes=2000
        )

        def train(key: Any, learner: Any = learner) -> Any:
            first = learner.init(key)
            last = jax.lax.while_loop(lambda c: c.agents.episode < 2000, lambda c: learner.train_step(c)[0], first)
            return learner.policy(last)[6].max()

        keys = jax.vmap(jax.random.fold_in, in_axes=(None, 0))(rng.key(0), jnp.arange(SEEDS))
        found[method] = statistics.estimate(np.asarray(jax.jit(jax.vmap(train))(keys)))
        print(method, found[method], flush=True)
    return found


class MountainCar(ContinuousTask):
    """A car too weak for the hill swings up: the mountain car of Example 10.1; every step costs 1."""

    observation_size: ClassVar[int] = 2
    action_bins: ClassVar[tuple[int, ...]] = (3,)
    observation_bounds: ClassVar[Any] = (np.array([-1.2, -0.07]), np.array([0.5, 0.07]))

    def reset(self, key):
        obs = jnp.stack([jax.random.uniform(key, minval=-0.6, maxval=-0.4), 0.0])
        return begin(obs, obs, ())

    def step(self, state, action, key):
        place, speed = state.data
        speed = jnp.clip(speed + 0.001 * (action[0] - 1.0) - 0.0025 * jnp.cos(3.0 * place), -0.07, 0.07)
        place = jnp.clip(place + speed, -1.2, 0.5)
        obs, there = jnp.stack([place, jnp.where(place == -1.2, 0.0, speed)]), place >= 0.5
        return State(obs, obs, jnp.float32(-1.0), there, jnp.bool_(False), there, obs, {})


def car_lengths(step_size: float, episodes: int, seeds: int, steps: int) -> np.ndarray:
    """Steps of each episode, (seeds, episodes), of `linear_q` with the settings of `textbook.mountain_car`.

    `steps` is the length of each training.
    """
    values = {"envs": 1, "rollout": 1, "trace_decay": 0.0, "epsilon": 0.0, "epsilon_min": 0.0, "discount": 0.999999}
    learner = make_learner("linear_q", MountainCar(), learning_rate=step_size, total_steps=steps, **values)

    def train(key: Any) -> Any:
        def step(carry: Any, _: None) -> Any:
            carry, outcome = learner.train_step(carry)
            return carry, (outcome.totals["steps"].astype(jnp.int16))

        return jax.lax.scan(step, learner.init(key), length=steps)[1]

    keys = jax.vmap(jax.random.fold_in, in_axes=(None, 0))(rng.key(0), jnp.arange(seeds))
    ended = np.asarray(jax.jit(jax.vmap(train))(keys))
    return np.stack([row[row > 0][:episodes] for row in ended])


CAR_EPISODES, CAR_SEEDS, CAR_STEPS = 500, 100, 150_000
CAR_PARTS = {"1": slice(0, 1), "2 to 10": slice(1, 10), "11 to 100": slice(10, 100), "401 to 500": slice(400, 500)}


def drive() -> dict[str, Any]:
    """Figure 10.2: steps of an episode on the mountain car, by `linear_q` and by the textbook's two rules."""
    found: dict[str, Any] = {"episodes": CAR_EPISODES, "seeds": CAR_SEEDS}
    for step_size in (0.1, 0.2, 0.5):
        made = {
            "linear_q": car_lengths(step_size, CAR_EPISODES, CAR_SEEDS, CAR_STEPS),
            "textbook, Q-learning": textbook.mountain_car(step_size, CAR_EPISODES, CAR_SEEDS, sarsa=False),
            "textbook, Sarsa": textbook.mountain_car(step_size, CAR_EPISODES, CAR_SEEDS),
        }
        found[f"{step_size:g} / 8"] = {
            name: {part: statistics.estimate(steps[:, of].mean(axis=1)) for part, of in CAR_PARTS.items()}
            | {"curve": np.round(steps.mean(axis=0).reshape(-1, 10).mean(axis=1), 1).tolist()}
            for name, steps in made.items()
        }
        for name, parts in found[f"{step_size:g} / 8"].items():
            print(f"{step_size:g} / 8", name, *(f"{part}: {parts[part].value:.1f}" for part in CAR_PARTS), flush=True)
    return found


TASKS: dict[str, Any] = {
    "joint_reach": ({"name": "joint_reach", "joint": 1, "action": 5, "states": 24, "max_episode_steps": 100}, 0.9, 100),
    "navigate": ({"name": "navigate", "max_episode_steps": 300}, 0.9, 200),
    "navigate, a fifth of the moves astray": (
        {"name": "navigate", "success_rate": 0.8, "step_reward": -1, "bonus": 0, "max_episode_steps": 300}, 0.95, 200,
    ),
}  # fmt: skip
"""Task, discount and episodes."""

EPSILONS, RATES = [0.05, 0.1, 0.2, 0.4], [0.1, 0.3, 0.6, 1.0]
WAYS: dict[str, Any] = {
    "q_learning": ({}, {"epsilon": EPSILONS, "learning_rate": RATES}),
    "sarsa": ({"method": "sarsa"}, {"epsilon": EPSILONS, "learning_rate": RATES}),
    "expected_sarsa": ({"method": "expected_sarsa"}, {"epsilon": EPSILONS, "learning_rate": RATES}),
    "double_q": ({"method": "double_q"}, {"epsilon": EPSILONS, "learning_rate": RATES}),
    "n_step": ({"method": "n_step"}, {"epsilon": EPSILONS, "learning_rate": RATES, "steps": [2, 4, 8]}),
    "q_lambda": (
        {"method": "q_lambda"},
        {"epsilon": EPSILONS, "learning_rate": RATES, "trace_decay": [0.5, 0.8, 0.95]},
    ),
    "q_learning, boltzmann": (
        {"exploration": "boltzmann"},
        {"temperature": [0.01, 0.1, 1.0, 10.0], "learning_rate": RATES},
    ),
    "q_learning, ucb": ({"exploration": "ucb"}, {"confidence": [0.01, 0.1, 1.0, 10.0], "learning_rate": RATES}),
    "q_learning, optimistic": ({"epsilon": 0.0}, {"initial_value": [1.0, 10.0, 100.0], "learning_rate": RATES}),
    "q_learning, 1 / N": ({"step_size": "visits"}, {"epsilon": EPSILONS}),
}
"""By name: keys of the learner, and the axes from which half of the seeds choose."""


def compare() -> dict[str, Any]:
    """Mean steps of an episode over the training, and of a greedy one after it."""
    found: dict[str, Any] = {}
    for name, (task, discount, episodes) in TASKS.items():
        ways, judged = {}, {}
        for way, (learner, axes) in WAYS.items():
            axes = {f"learner.{key}": values for key, values in axes.items()}
            points, curves, greedy = learn(task, {**learner, "discount": discount}, axes, episodes, SEEDS)
            steps, half = curves["steps"].mean(axis=2), SEEDS // 2
            best = int(steps[:, :half].mean(axis=1).argmin())
            judged[way] = steps[best, half:]
            ways[way] = {
                "chosen": {key.partition(".")[2]: value for key, value in points[best].items()}, "points": len(points),
                "steps while learning": statistics.estimate(judged[way]),
                "beside q_learning": statistics.difference(judged[way], judged["q_learning"]),
                "greedy steps": statistics.estimate(greedy["steps"][best, half:]),
                "curve": [round(x, 2) for x in curves["steps"][best, half:].mean(axis=0)],
            }  # fmt: skip
            print(name, way, ways[way]["chosen"], *list(ways[way].values())[2:5], sep="  ", flush=True)
        good = statistics.not_worse(-np.stack(list(judged.values())))
        found[name] = {"episodes": episodes, "seeds": SEEDS // 2, "ways": ways}
        found[name]["not worse than the best"] = [way for way, flag in zip(ways, good, strict=True) if flag]
    return found


def draw(record: dict[str, Any]) -> None:
    """Curves on the cliff and in the maze, and how much longer episodes are than those of Q-learning."""
    walked, maze = record["walk"]["found"], record["compare"]["found"][list(TASKS)[2]]
    with figure(ROOT / "docs/methods.png", 1, 3, (4.4, 3.2)) as (fig, ((cliff, steps, beside),)):
        for method, color in zip(METHODS, COLORS, strict=False):
            curve, other = walked[method]["curve"], maze["ways"][method]["curve"]
            cliff.plot(10.0 * np.arange(1, POINTS + 1), curve, color=color, label=method)
            steps.plot(4.0 * np.arange(1, POINTS + 1), other, color=color, label=method)
        label_lines(cliff)
        cliff.set(
            title="Cliff walking", xlabel="episodes", ylabel="return of an episode while learning", ylim=(-120, 0)
        )
        steps.set(title="navigate, a fifth of the moves astray", xlabel="episodes", ylim=(0, 120))
        steps.set_ylabel("steps of an episode while learning")
        ways = [way for way in WAYS if way != "q_learning"]
        for number, (name, color) in enumerate(zip(TASKS, COLORS, strict=False)):
            found = record["compare"]["found"][name]["ways"]
            scale = 100.0 / found["q_learning"]["steps while learning"][0]
            middle, low, high = scale * np.array([found[way]["beside q_learning"] for way in ways]).T
            place = np.arange(len(ways)) + 0.22 * (number - 1)
            beside.errorbar(middle, place, xerr=(middle - low, high - middle), fmt="o", ms=4, color=color, label=name)
        beside.axvline(0, color="black", linewidth=0.8)
        beside.set_yticks(range(len(ways)), [way.removeprefix("q_learning, ") for way in ways])
        beside.xaxis.set_major_formatter(StrMethodFormatter("{x:+.0f} %"))
        beside.invert_yaxis()
        beside.set(title="More steps while learning than Q-learning", xlabel="median over 64 seeds, 95 % interval")
        fig.legend(loc="outside lower right", ncols=3, frameon=False, handles=beside.containers)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draw", action="store_true", help="draw the figure of the record")
    parser.add_argument(
        "--only", choices=("prove", "walk", "overestimate", "compare", "drive"), help="measure one part anew"
    )
    given = parser.parse_args()
    record = json.loads(RECORD.read_text()) if (given.draw or given.only) and RECORD.is_file() else {}
    if not given.draw:
        compute.start()
        parts = {"prove": prove, "walk": walk, "overestimate": overestimate, "compare": compare, "drive": drive}
        for name in [given.only] if given.only else parts:
            record[name] = {"commit": compute.commit(), "found": parts[name]()}
        record |= {**compute.made_by(), "command": "python experiments/methods.py"}
        RECORD.write_text(json.dumps(record, indent=1) + "\n")
    if {"walk", "compare"} <= record.keys():
        draw(record)


if __name__ == "__main__":
    main()
