"""Tabular Q-learning on joint 1 as others would write it, by the rules of `tabular.py`."""

import jax
import jax.numpy as jnp
import numpy as np
from tabular import BONUS, CAP, DECAY, DISCOUNT, EPISODES, MOVES, POINTS, RATE, Made
from timing import on_devices


def naive_scan(epsilon: np.ndarray, steps: int) -> Made:
    """Q-learning in a scan as one would first write it."""
    angles = jnp.linspace(-15.0, 100.0, MOVES + 1) * 0.1

    def step(carry, _):
        q, state, eps, episode, length, total, key, curve = carry
        key, explore, choice, tie = jax.random.split(key, 4)
        stay, move = q[state]
        greedy = jnp.where(stay == move, jax.random.bernoulli(tie), move > stay).astype(jnp.int32)
        action = jnp.where(jax.random.uniform(explore) < eps, jax.random.randint(choice, (), 0, 2), greedy)
        following = jnp.minimum(state + action, MOVES)
        ended = following == MOVES
        reward = angles[following] + BONUS * ended
        target = reward + DISCOUNT * jnp.where(ended, 0.0, q[following].max())
        q = q.at[state, action].add(RATE * (target - q[state, action]))
        length, total = length + 1, total + reward
        over = ended | (length >= CAP)
        outcome = jnp.stack([1.0, length, ended, total])
        curve = curve.at[episode * POINTS // EPISODES].add(jnp.where(over, outcome, 0.0))
        state, eps = jnp.where(over, 0, following), jnp.where(over, eps * DECAY, eps)
        length, total = jnp.where(over, 0, length), jnp.where(over, 0.0, total)
        return (q, state, eps, episode + over, length, total, key, curve), None

    @jax.jit
    @jax.vmap
    def train(eps, key):
        q = jnp.stack([angles, angles], axis=1)
        zero = jnp.int32(0)
        start = q, zero, eps, zero, zero, jnp.float32(0), key, jnp.zeros((POINTS, 4))
        return jax.lax.scan(step, start, length=steps)[0]

    keys = jax.random.split(jax.random.key(0), len(epsilon))
    return Made(on_devices(train, [[(epsilon, keys)]]), lambda result: float(result[0][0][3].sum()))


PYTHON_STEPS = 100_000


def python(epsilon: np.ndarray, _: int) -> Made:
    """One agent in plain Python, for `PYTHON_STEPS`."""
    import random

    def train() -> int:
        draw, eps = random.Random(0).random, float(epsilon[len(epsilon) // 2])
        angles = [(-15.0 + 5.0 * s) * 0.1 for s in range(MOVES + 1)]
        q = [[x, x] for x in angles]
        curve = [[0.0] * 4 for _ in range(POINTS)]
        state = episode = length = 0
        total = 0.0
        for _ in range(PYTHON_STEPS):
            stay, move = q[state]
            action = int(draw() * 2) if draw() < eps or stay == move else int(move > stay)
            following = min(state + action, MOVES)
            ended = following == MOVES
            reward = angles[following] + BONUS * ended
            target = reward if ended else reward + DISCOUNT * max(q[following])
            q[state][action] += RATE * (target - q[state][action])
            length, total, state = length + 1, total + reward, following
            if ended or length >= CAP:
                point = curve[episode * POINTS // EPISODES]
                for i, x in enumerate((1.0, length, ended, total)):
                    point[i] += x
                episode, state, length, total, eps = episode + 1, 0, 0, 0.0, eps * DECAY
        return episode

    return Made(train, float, {"work": PYTHON_STEPS, "batch": 1, "repeats": 3, "device": "cpu"})


def numba(epsilon: np.ndarray, steps: int) -> Made:
    """One agent a thread, compiled by numba with fastmath, on all cores."""
    import numba as nb  # pyright: ignore[reportMissingImports]

    @nb.njit(parallel=True, fastmath=True)
    def train(epsilon, steps):
        finished = np.zeros(len(epsilon), np.int32)
        curves = np.zeros((len(epsilon), POINTS, 4), np.float32)
        for agent in nb.prange(len(epsilon)):
            q = np.empty((MOVES + 1, 2), np.float32)
            for s in range(MOVES + 1):
                q[s, 0] = q[s, 1] = np.float32((-15.0 + 5.0 * s) * 0.1)
            word = np.uint32(agent * 2654435761 + 7) | np.uint32(1)
            eps, total = epsilon[agent], np.float32(0)
            state = length = episode = 0
            for _ in range(steps):
                # numba widens integers in arithmetic, so every shift is cut back to 32 bits.
                word = np.uint32(word ^ np.uint32(word << np.uint32(13)))
                word = np.uint32(word ^ np.uint32(word >> np.uint32(17)))
                word = np.uint32(word ^ np.uint32(word << np.uint32(5)))
                if np.float32(word >> np.uint32(8)) * np.float32(2**-24) < eps or q[state, 0] == q[state, 1]:
                    action = np.int64(word & np.uint32(1))
                else:
                    action = np.int64(q[state, 1] > q[state, 0])
                following = min(state + action, MOVES)
                reward = np.float32((-15.0 + 5.0 * following) * 0.1)
                if following == MOVES:
                    reward += np.float32(BONUS)
                    target = reward
                else:
                    target = reward + np.float32(DISCOUNT) * max(q[following, 0], q[following, 1])
                q[state, action] += np.float32(RATE) * (target - q[state, action])
                length, total, state = length + 1, total + reward, following
                if following == MOVES or length >= CAP:
                    point = curves[agent, episode * POINTS // EPISODES]
                    point[0] += 1
                    point[1] += length
                    point[2] += following == MOVES
                    point[3] += total
                    episode, state, length, total = episode + 1, 0, 0, np.float32(0)
                    eps *= np.float32(DECAY)
            finished[agent] = episode
        return finished

    return Made(lambda: train(epsilon, steps), lambda result: float(result.sum()), {"device": "cpu"})
