"""Compare the learners with the literature on tasks that everybody has: ten seeds each, in some minutes.

python experiments/parity.py                        # writes docs/bench/parity.json and prints its table
python experiments/parity.py --published purejaxql  # also runs that checkout's own script, beside `deep_q`

`tabular_q` walks along the cliff of R. Sutton and A. Barto, "Reinforcement Learning" (2018), Example 6.6. `linear_q`
drives the mountain car of Example 10.1. `deep_q` balances CartPole with the settings of purejaxql
(github.com/mttga/purejaxql at 47af6d7, purejaxql/config/alg/pqn_cartpole.yaml). `--published` needs gymnax and what
else that script imports: hydra-core, omegaconf, safetensors, wandb.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

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

ROWS, COLUMNS = 4, 12
START, GOAL = (ROWS - 1) * COLUMNS, ROWS * COLUMNS - 1
MOVES = np.array([[-1, 0], [0, 1], [1, 0], [0, -1]])


class CliffWalking(FiniteTask):
    """Example 6.6: every step costs 1; one off the cliff between start and goal costs 100 and leads to the start."""

    max_episode_steps: int = traced(10_000)

    @property
    def num_states(self):
        return ROWS * COLUMNS

    @property
    def num_actions(self):
        return len(MOVES)

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

    max_episode_steps: int = traced(10_000)

    @property
    def observation_size(self):
        return 2

    @property
    def observation_bounds(self):
        return np.array([-1.2, -0.07]), np.array([0.5, 0.07])

    @property
    def action_bins(self):
        return (3,)

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

    reward: float = traced(1.0, description="for each step")

    @property
    def observation_size(self):
        return 4

    @property
    def action_bins(self):
        return (2,)

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
"""The `cart pole` differs from purejaxql's script in four things: epsilon falls by the episode and not by the update,
observations are normalised, an episode that is cut off after 500 steps has a value beyond them, and evaluations are of
one whole episode in each of 128 environments."""


def interval(values: np.ndarray) -> list[float]:
    """Return mean and bounds of its interval of 95% by Student's t."""
    half = stats.t.ppf(0.975, len(values) - 1) * stats.sem(values) if len(values) > 1 else 0.0
    return [round(float(x), 2) for x in (values.mean(), values.mean() - half, values.mean() + half)]


def last(results: dict[str, np.ndarray], name: str, share: float) -> np.ndarray:
    """Return the mean over the last part of each seed's curve."""
    curve = results[name].reshape(SEEDS, -1)
    return np.nanmean(curve[:, -round(share * curve.shape[1]) :], axis=1)


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


def ours(name: str) -> dict[str, Any]:
    """Train ten seeds by the config of this name; its figures."""
    with tempfile.TemporaryDirectory() as folder:
        began = time.monotonic()
        run = humanoid_mjx.sweep({"name": "parity", "seeds": SEEDS, **CONFIGS[name]}, Path(folder) / "run")
        results, summary, wall_s = run.results, run.summary, time.monotonic() - began
    scale = CONFIGS[name]["task"].get("reward", 1.0)
    return {
        "return while learning, last fifth": interval(last(results, "return", 0.2) / scale),
        "return of the greedy policy": interval(summary["greedy_return"].astype(float) / scale),
        "wall_s, compiling in it": round(wall_s, 1),
    }


def published(checkout: Path) -> dict[str, Any]:
    """Run purejaxql's script with its own settings for CartPole; the same figures."""
    sys.path.insert(0, str(checkout))
    from purejaxql.pqn_gymnax import make_train  # pyright: ignore[reportMissingImports]

    config = yaml.safe_load((checkout / "purejaxql/config/alg/pqn_cartpole.yaml").read_text())
    config |= {name: int(float(config[name])) for name in ("TOTAL_TIMESTEPS", "TOTAL_TIMESTEPS_DECAY")}
    config |= {name: float(config[name]) for name in ("LR", "GAMMA", "LAMBDA")} | {"WANDB_MODE": "disabled"}
    began = time.monotonic()
    found = jax.jit(jax.vmap(make_train(config)))(jax.random.split(jax.random.PRNGKey(0), SEEDS))["metrics"]
    found = {name: np.asarray(value) for name, value in found.items()}
    fifth = found["returned_episode_returns"].shape[1] // 5
    return {
        "return while learning, last fifth": interval(found["returned_episode_returns"][:, -fifth:].mean(axis=1)),
        "return of the greedy policy": interval(found["test/returned_episode_returns"][:, -1]),
        "wall_s, compiling in it": round(time.monotonic() - began, 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--published", type=Path, help="a checkout of purejaxql")
    parser.add_argument("--out", type=Path, default=ROOT / "docs/bench/parity.json")
    given = parser.parse_args()
    compute.start()
    record: dict[str, Any] = compute.made_by()
    record["expected while learning on the cliff"] = round(expected_on_the_cliff(0.1), 2)
    record["found"] = {name: ours(name) for name in CONFIGS}
    if given.published:
        record["found"]["cart pole, purejaxql"] = published(given.published)
    given.out.write_text(json.dumps(record, indent=1) + "\n")
    for name, found in record["found"].items():
        print(name, *(f"{key}: {value}" for key, value in found.items()), sep="\n  ")


if __name__ == "__main__":
    main()
