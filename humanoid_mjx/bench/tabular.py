"""Training steps and episodes a second of tabular Q-learning on joint 1, against other ways to write it.

All subjects train the same agents by the same rules: 24 states, 2 actions, ties broken at random, every transition
learned from, episodes of at most 500 steps, epsilon decayed per episode and different for every agent, and the
outcome of every episode added to one of 100 points of a learning curve.

    scan         this package: the learner vmapped, the cheap generator, table accesses promised to be in bounds;
                 on a CPU one program per core
    fused        the same in one kernel, as a sweep runs it
    naive_scan   the same as one would first write it: jax.random's own keys split in every step, plain indexing
    python       one agent at a time in plain Python
    numba        one agent a thread, compiled, fastmath, all cores (where numba is installed)
"""

from collections.abc import Callable, Mapping
from importlib.util import find_spec
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx import compute, make_learner, make_task
from humanoid_mjx.bench.measure import Record, Subject, on_devices, record, time_in_turn
from humanoid_mjx.compute import rng
from humanoid_mjx.learners.tabular import TabularQ
from humanoid_mjx.training.program import begin
from humanoid_mjx.training.program import train as by_scan
from humanoid_mjx.training.programs import TRAIN, why_no_kernel

MOVES, CAP, POINTS, EPISODES = 23, 500, 100, 100_000
DECAY, RATE, DISCOUNT, BONUS = 0.999, 0.5, 0.9, 100.0
BATCHES = {"cpu": (1, 1024, 4096, 65_536), "gpu": (1, 256, 4096, 65_536, 1_048_576)}

AT_ONCE = 2**24
"""Agents times steps in a call, as far as `STEPS` allows: starting a call of 5 ms takes two more."""

STEPS = 1024, 8192
"""The fewest and the most steps in a call; a kernel makes the most. A sweep makes as many as fit into a fifth of a
second."""

CPU_BLOCK = 1024
"""Agents whose state the cache of a core holds."""


Made = tuple[Callable[[], Any], Callable[[Any], float]]
"""A training to time, and a function that counts the episodes in what it returns."""


def run(say: Callable[[str], None]) -> list[Record]:
    """Time all subjects over several numbers of agents."""
    absent, records = _absent(say), []
    for batch in BATCHES.get(jax.default_backend(), BATCHES["gpu"]):
        makers = {name: make for name, make in SUBJECTS.items() if name not in absent}
        records += time_trainings(say, batch, makers)
        absent.add("python")
    return records


def time_trainings(
    say: Callable[[str], None],
    batch: int,
    makers: Mapping[str, Callable[[np.ndarray, int], Made]],
    kernels: tuple[str, ...] = ("fused",),
) -> list[Record]:
    """Time trainings of `batch` agents in turn. Names that begin with one of `kernels` make the most steps a call."""
    records: list[Record] = []
    epsilon = np.linspace(0.1, 0.9, batch, dtype=np.float32)
    least, most = STEPS
    made: dict[str, Made] = {}
    subjects: dict[str, Subject] = {}
    for name, make in makers.items():
        steps = most if name.startswith(kernels) else min(max(AT_ONCE // batch, least), most)
        made[name] = make(epsilon, steps)
        subjects[name] = Subject(made[name][0], batch * steps, batch, device="cpu" if name == "numba" else "")
    if "python" in made:
        subjects["python"] = Subject(made["python"][0], PYTHON_STEPS, 1, 3, "cpu")
    for name, timing in time_in_turn(subjects).items():
        episodes = made[name][1](timing.result)
        records.append(record("tabular", name, subjects[name], timing, "steps/s"))
        records.append(record("tabular", name, subjects[name], timing, "episodes/s", episodes))
        say(f"{name:16} {subjects[name].batch:9,} agents  {records[-2].value:10.3e} steps/s"
            f"  {records[-1].value:10.3e} episodes/s  compiled in {timing.compile_s:4.1f} s")  # fmt: skip
    return records


def _absent(say: Callable[[str], None]) -> set[str]:
    """The subjects that cannot be measured here, once it is said why."""
    numba = None if find_spec("numba") else "it is not installed; pip install 'humanoid-mjx[bench]' brings it"
    why = {"numba": numba, "fused": why_no_kernel(_learner())}
    for name, reason in why.items():
        if reason:
            say(f"{name}: not measured, for {reason}")
    return {name for name, reason in why.items() if reason}


def _learner(moves: int = MOVES) -> TabularQ:
    task = make_task("joint_reach", joint=1, states=moves + 1, action=115.0 / moves, max_episode_steps=CAP)
    values = {"epsilon_decay": DECAY, "learning_rate": RATE, "discount": DISCOUNT}
    return make_learner("tabular_q", task, episodes=EPISODES, record=POINTS, **values)


def scan(epsilon: np.ndarray, steps: int) -> Made:
    """This package's learner in a scan: a thread for each device, blocks that fit the cache of a CPU."""
    learner = _learner()
    options = compute.compiler_options(learner.task.arithmetic, learner.program, every_device=True)
    train = jax.jit(jax.vmap(by_scan, in_axes=(0, 0, None)), compiler_options=options)
    return _shared_out(learner, epsilon, steps, train, CPU_BLOCK if jax.default_backend() == "cpu" else None)


def fused(epsilon: np.ndarray, steps: int, moves: int = MOVES) -> Made:
    """This package's learner in one kernel."""
    return _shared_out(_learner(moves), epsilon, steps, jax.jit(jax.vmap(TRAIN, in_axes=(0, 0, None))))


def _shared_out(
    learner: TabularQ, epsilon: np.ndarray, steps: int, train: Callable[..., Any], block: int | None = None
) -> Made:
    """Agents in equal shares on all devices, in blocks of about `block` where it is given."""
    first = jax.jit(jax.vmap(begin))

    def start(device: Any, share: np.ndarray) -> tuple[Any, Any, int]:
        learners = jax.tree.map(lambda x: np.full(len(share), x, np.result_type(np.float32, x)), learner)
        learners = jax.device_put(learners.replace(epsilon=share), device)
        keys = jax.device_put(jax.random.split(rng.key(device.id), len(share)), device)
        return learners, first(learners, keys), steps

    devices = jax.local_devices()[: len(epsilon)]
    blocks = max(1, len(epsilon) // (block * len(devices))) if block else 1
    shares = np.array_split(epsilon, len(devices) * blocks)
    states = [[start(device, share) for share in shares[i :: len(devices)]] for i, device in enumerate(devices)]
    call = on_devices(train, states)
    return call, lambda result: sum(float(state.carry.agents.episode.sum()) for mine in result for state in mine)


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
    return on_devices(train, [[(epsilon, keys)]]), lambda result: float(result[0][0][3].sum())


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

    return train, float


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

    return lambda: train(epsilon, steps), lambda result: float(result.sum())


SUBJECTS: dict[str, Callable[..., Made]] = {make.__name__: make for make in (scan, fused, naive_scan, python, numba)}
