"""Compare the learners with the literature on tasks that everybody has: ten seeds each, in some minutes.

python experiments/parity.py                        # writes docs/bench/parity.json and prints its table
python experiments/parity.py --published purejaxql  # also runs that checkout's own script, beside `deep_q`

`tabular_q` walks along the cliff of R. Sutton and A. Barto, "Reinforcement Learning" (2018), Example 6.6. `linear_q`
drives the mountain car of Example 10.1. `deep_q` balances CartPole with the settings of purejaxql
(github.com/mttga/purejaxql at 47af6d7, purejaxql/config/alg/pqn_cartpole.yaml). `--published` runs that project's
purejaxql/pqn_gymnax.py, unchanged, with these settings. It needs gymnax 0.0.9 and what else the
script imports: hydra-core, omegaconf, safetensors, wandb.
"""

import argparse
import json
import multiprocessing
import os
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import yaml
from scipy import stats

import humanoid_mjx
from humanoid_mjx import compute
from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.continuous import ContinuousTask, State, begin
from humanoid_mjx.tasks.finite import FiniteTask

ROOT = Path(__file__).parent.parent
SEEDS = 10
Curves = dict[str, np.ndarray]

ROWS, COLUMNS = 4, 12
START, GOAL = (ROWS - 1) * COLUMNS, ROWS * COLUMNS - 1
MOVES = np.array([[-1, 0], [0, 1], [1, 0], [0, -1]])


class CliffWalking(FiniteTask):
    """Example 6.6: every step costs 1; one off the cliff between start and goal costs 100 and leads to the start."""

    num_states: ClassVar[int] = ROWS * COLUMNS
    num_actions: ClassVar[int] = len(MOVES)

    max_episode_steps: int = traced(10_000)

    def reset(self, key):
        return jnp.int32(START)

    def step(self, state, action, key):
        down, right = jnp.asarray(MOVES)[action]
        row = jnp.clip(state // COLUMNS + down, 0, ROWS - 1)
        column = jnp.clip(state % COLUMNS + right, 0, COLUMNS - 1)
        cell = row * COLUMNS + column
        fallen = (cell > START) & (cell < GOAL)
        return jnp.where(fallen, START, cell), jnp.where(fallen, -100.0, -1.0), cell == GOAL


class MountainCar(ContinuousTask):
    """Example 10.1: a car too weak for the hill; every step costs 1."""

    observation_size: ClassVar[int] = 2
    action_bins: ClassVar[tuple[int, ...]] = (3,)

    max_episode_steps: int = traced(10_000)

    @property
    def observation_bounds(self):
        return np.array([-1.2, -0.07]), np.array([0.5, 0.07])

    def reset(self, key):
        obs = jnp.stack([jax.random.uniform(key, minval=-0.6, maxval=-0.4), jnp.float32(0)])
        return begin((obs, jnp.int32(0)), obs, ())

    def step(self, state, action, key):
        (place, speed), steps = state.data
        speed = jnp.clip(speed + 0.001 * (action[0] - 1) - 0.0025 * jnp.cos(3 * place), -0.07, 0.07)
        place = jnp.clip(place + speed, -1.2, 0.5)
        obs = jnp.stack([place, jnp.where(place <= -1.2, 0.0, speed)])
        over, late = place >= 0.5, steps + 1 >= self.max_episode_steps
        return State((obs, steps + 1), obs, jnp.float32(-1), over, ~over & late, over, obs, {})


class CartPole(ContinuousTask):
    """CartPole-v1 as gymnax has it (A. Barto et al., "Neuronlike Adaptive Elements", 1983); `reward` for each step."""

    observation_size: ClassVar[int] = 4
    action_bins: ClassVar[tuple[int, ...]] = (2,)

    reward: float = traced(1.0, description="for each step")

    def reset(self, key):
        obs = jax.random.uniform(key, (4,), minval=-0.05, maxval=0.05)
        return begin((obs, jnp.int32(0)), obs, ())

    def step(self, state, action, key):
        (x, speed, angle, spin), steps = state.data
        force = 10.0 * (2 * action[0] - 1)
        pushed = (force + 0.05 * spin**2 * jnp.sin(angle)) / 1.1
        turning = 9.8 * jnp.sin(angle) - jnp.cos(angle) * pushed
        turning = turning / (0.5 * (4 / 3 - 0.1 * jnp.cos(angle) ** 2 / 1.1))
        driven = pushed - 0.05 * turning * jnp.cos(angle) / 1.1
        obs = jnp.stack([x, speed, angle, spin]) + 0.02 * jnp.stack([speed, driven, spin, turning])
        fallen = (jnp.abs(obs[0]) > 2.4) | (jnp.abs(obs[2]) > 12 * np.pi / 180)
        over = ~fallen & (steps + 1 >= 500)
        reward = jnp.asarray(self.reward, jnp.float32)
        return State((obs, steps + 1), obs, reward, fallen, over, over, obs, {})


CONFIGS: dict[str, dict[str, Any]] = yaml.safe_load("""
cliff walking:
  task: {name: "parity:CliffWalking"}
  learner: {name: tabular_q, epsilon: 0.1, learning_rate: 0.5, discount: 0.99999}
  episodes: 1000
mountain car:
  task: {name: "parity:MountainCar"}
  learner:
    {name: linear_q, tilings: 8, resolution: 8, learning_rate: 0.5, epsilon: 0.0, epsilon_min: 0.0,
     discount: 0.99999, trace_decay: 0.0, envs: 1, rollout: 1, evaluations: 1}
  total_steps: 75_000
cart pole:
  task: {name: "parity:CartPole", reward: 0.1}
  learner:
    {name: deep_q, envs: 32, rollout: 64, width: 256, layers: 2, epochs: 4, minibatches: 16, max_gradient: 10.0,
     learning_rate: 0.0001, learning_rate_end: 0.0, discount: 0.99, trace_decay: 0.95, epsilon: 1.0,
     epsilon_decay: 0.98, epsilon_min: 0.2, evaluations: 20, evaluation_envs: 128}
  total_steps: 500_000
""")
BLOCK = 5
"""Seeds that train side by side where both learners run: they take turns by this number."""


def interval(values: np.ndarray) -> list[float]:
    """Return mean and bounds of its interval of 95% by Student's t."""
    half = stats.t.ppf(0.975, len(values) - 1) * stats.sem(values) if len(values) > 1 else 0.0
    return [round(float(x), 2) for x in (values.mean(), values.mean() - half, values.mean() + half)]


def expected_on_the_cliff(epsilon: float) -> float:
    """Return the exact mean return of the epsilon-greedy policy of the optimal values, equal choices taken equally."""
    cells = np.arange(ROWS * COLUMNS)
    task, key = CliffWalking(), jax.random.key(0)
    steps = [jax.vmap(lambda cell, a=a: task.step(cell, a, key))(cells) for a in range(len(MOVES))]
    following, reward, over = (np.stack([np.asarray(step[i]) for step in steps], axis=1) for i in range(3))
    value = np.zeros(len(cells))
    for _ in cells:
        q = reward + np.where(over, 0.0, value[following])
        value = q.max(axis=1)
    best = np.isclose(q, q.max(axis=1, keepdims=True))
    chance = (1 - epsilon) * best / best.sum(axis=1, keepdims=True) + epsilon / len(MOVES)
    moves = np.zeros((len(cells), len(cells)))
    for action in range(len(MOVES)):
        np.add.at(moves, (cells, following[:, action]), np.where(over[:, action], 0.0, chance[:, action]))
    return float(np.linalg.solve(np.eye(len(cells)) - moves, (chance * reward).sum(axis=1))[START])


def timed(train: Callable[..., Curves], *given: Any) -> Curves:
    """Return the curves of a training with its processor and wall time in s, compiling in both."""
    began, used = time.monotonic(), time.process_time()
    found = train(*given)
    return found | {
        "wall_s": np.array([time.monotonic() - began]),
        "processor_s": np.array([time.process_time() - used]),
    }


def ours(name: str, seeds: int = SEEDS, seed: int = 0) -> Curves:
    """Train by the config of this name: (seeds, points) of each curve, the final greedy return and the steps."""
    compute.start()
    with tempfile.TemporaryDirectory() as folder:
        run = humanoid_mjx.sweep(
            {"name": "parity", "seeds": seeds, "seed": seed, **CONFIGS[name]}, Path(folder) / "run"
        )
        curves = {key: values.reshape(seeds, -1) for key, values in run.results.items() if values.dtype != object}
        final = run.summary["greedy_return"].astype(float)
    scale = CONFIGS[name]["task"].get("reward", 1.0)
    found = {"return": curves["return"].astype(float) / scale, "final": final / scale}
    return found | {key: curves[key] for key in ("step", "episode") if key in curves}


def published(checkout: Path, seed: int) -> Curves:
    """Train a block of seeds by purejaxql's script: as `ours`, and the greedy return by whole episodes, as ours is."""
    sys.path.insert(0, str(checkout))
    import gymnax  # pyright: ignore[reportMissingImports]
    from purejaxql.pqn_gymnax import QNetwork, make_train  # pyright: ignore[reportMissingImports]

    config = yaml.safe_load((checkout / "purejaxql/config/alg/pqn_cartpole.yaml").read_text())
    # YAML 1.1 reads 5e5 as a word.
    config |= {key: int(float(config[key])) for key in ("TOTAL_TIMESTEPS", "TOTAL_TIMESTEPS_DECAY")}
    config["WANDB_MODE"] = "disabled"
    keys = jax.random.split(jax.random.PRNGKey(seed), BLOCK)
    found = jax.jit(jax.vmap(make_train(config)))(keys)
    env, limits = gymnax.make(config["ENV_NAME"])
    network = QNetwork(env.num_actions, config["HIDDEN_SIZE"], config["NUM_LAYERS"])

    def episode(state: Any, key: Any) -> Any:
        """Return the return of one greedy episode."""

        def step(carry: Any, key: Any) -> Any:
            obs, data, over = carry
            variables = {"params": state.params, "batch_stats": state.batch_stats}
            action = jnp.argmax(network.apply(variables, obs.ravel()[None], train=False)[0])
            obs, data, reward, done, _ = env.step_env(key, data, action, limits)
            return (obs, data, over | done), jnp.where(over, 0.0, reward)

        keys = jax.random.split(key, limits.max_steps_in_episode + 1)
        return jax.lax.scan(step, (*env.reset_env(keys[0], limits), jnp.bool_(False)), keys[1:])[1].sum()

    episodes = jax.vmap(jax.vmap(episode, in_axes=(None, 0)), in_axes=(0, None))
    final = jax.jit(episodes)(found["runner_state"][0], jax.random.split(jax.random.key(seed), 128)).mean(axis=1)
    metrics = {key: np.asarray(found["metrics"][key]) for key in ("returned_episode_returns", "env_step")}
    return {"return": metrics["returned_episode_returns"], "final": np.asarray(final), "step": metrics["env_step"]}


def figures(curves: Curves) -> dict[str, Any]:
    """Return the intervals, the steps and the times of curves."""
    learning = curves["return"]
    return {
        "seeds": len(learning),
        "return while learning, last fifth": interval(
            np.nanmean(learning[:, -round(0.2 * learning.shape[1]) :], axis=1)
        ),
        "return of the greedy policy": interval(curves["final"]),
        **{f"{key}s of a seed": int(curves[key].max()) for key in ("step", "episode") if key in curves},
        "wall_s": round(float(np.sum(curves["wall_s"])), 1),
        "processor_s": round(float(np.sum(curves["processor_s"])), 1),
    }


def beside(checkout: Path) -> dict[str, Any]:
    """Train `deep_q` and purejaxql's script by turns, each block of seeds in a process that compiles all it runs."""
    os.environ["JAX_ENABLE_COMPILATION_CACHE"] = "false"
    trains = {"cart pole": partial(ours, "cart pole", BLOCK), "cart pole, purejaxql": partial(published, checkout)}
    parts: dict[str, list[Curves]] = {name: [] for name in trains}
    for block in range(SEEDS // BLOCK):
        for name, train in trains.items():
            with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
                parts[name].append(pool.submit(timed, train, block).result())
    return {
        name: figures({key: np.concatenate([block[key] for block in blocks]) for key in blocks[0]})
        for name, blocks in parts.items()
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--published", type=Path, help="a checkout of purejaxql")
    parser.add_argument("--out", type=Path, default=ROOT / "docs/bench/parity.json")
    given = parser.parse_args()
    found = beside(given.published) if given.published else {"cart pole": figures(timed(ours, "cart pole"))}
    found = {name: figures(timed(ours, name)) for name in ("cliff walking", "mountain car")} | found
    record: dict[str, Any] = compute.made_by()
    record["command"] = " ".join(("python experiments/parity.py", *["--published purejaxql"] * bool(given.published)))
    if given.published:
        record["versions"] |= {name: version(name) for name in ("gymnax", "flax", "optax")}
    record["expected while learning on the cliff"] = round(expected_on_the_cliff(0.1), 2)
    record["found"] = found
    given.out.write_text(json.dumps(record, indent=1) + "\n")
    for name, values in found.items():
        print(name, *(f"{key}: {value}" for key, value in values.items()), sep="\n  ")


if __name__ == "__main__":
    main()
