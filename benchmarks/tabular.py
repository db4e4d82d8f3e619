"""Training steps and episodes a second of tabular Q-learning on joint 1.

All subjects train the same agents by the same rules: 24 states, 2 actions, ties broken at random, every transition
learned from, episodes of at most 500 steps, epsilon decayed per episode and different for every agent, and the
outcome of every episode added to one of 100 points of a learning curve.

    scan         this package: the learner vmapped, the cheap generator, table accesses promised to be in bounds;
                 on a CPU one program per core
    fused        the same in one kernel, as a sweep runs it

`other_tables.py` adds other ways to write it.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np
from timing import Record, Subject, on_devices, record, time_in_turn

from humanoid_mjx import compute, make_learner, make_task
from humanoid_mjx.compute import rng
from humanoid_mjx.learners.tabular import TabularQ
from humanoid_mjx.training.program import begin
from humanoid_mjx.training.program import train as by_scan
from humanoid_mjx.training.programs import TRAIN

MOVES, CAP, POINTS, EPISODES = 23, 500, 100, 100_000
DECAY, RATE, DISCOUNT, BONUS = 0.999, 0.5, 0.9, 100.0

AT_ONCE = 2**26
"""Agents times steps in a call, as far as `STEPS` allows: a tenth of a second on two cores. A sweep's calls take a
fifth; starting a call of 5 ms takes two more."""

STEPS = {"cpu": (1024, 2**17), "gpu": (1024, 8192)}
"""The fewest and the most steps in a call; a kernel on a GPU makes the most. A sweep makes as many as fit into a fifth
of a second: in calls of 8,192 steps, two fifths of the time of one agent on a CPU would be their start."""

CPU_BLOCK = 1024
"""Agents whose state the cache of a core holds."""


class Made(NamedTuple):
    """A training to time."""

    call: Callable[[], Any]
    episodes: Callable[[Any], float]
    """Counts the episodes in what the call returns."""
    other: Mapping[str, Any] = {}
    """Fields of its `Subject` that differ: it trains fewer agents, or elsewhere."""


def time_trainings(
    say: Callable[[str], None],
    batch: int,
    makers: Mapping[str, Callable[[np.ndarray, int], Made]],
) -> list[Record]:
    """Time trainings of `batch` agents in turn. On a GPU `fused` makes the most steps a call."""
    records: list[Record] = []
    epsilon = np.linspace(0.1, 0.9, batch, dtype=np.float32)
    least, most = STEPS[jax.default_backend()]
    made: dict[str, Made] = {}
    subjects: dict[str, Subject] = {}
    for name, make in makers.items():
        at_once = name == "fused" and jax.default_backend() == "gpu"
        steps = most if at_once else min(max(AT_ONCE // batch, least), most)
        made[name] = make(epsilon, steps)
        own = {"call": made[name].call, "work": batch * steps, "batch": batch}
        subjects[name] = Subject(**(own | dict(made[name].other)))
    for name, timing in time_in_turn(subjects).items():
        episodes = made[name].episodes(timing.result)
        records.append(record("tabular", name, subjects[name], timing, "steps/s"))
        records.append(record("tabular", name, subjects[name], timing, "episodes/s", episodes))
        say(f"{name:16} {subjects[name].batch:9,} agents  {records[-2].value:10.3e} steps/s"
            f"  {records[-1].value:10.3e} episodes/s  compiled in {timing.compile_s:4.1f} s")  # fmt: skip
    return records


def own_learner() -> TabularQ:
    task = make_task("joint_reach", joint=1, states=MOVES + 1, action=115.0 / MOVES, max_episode_steps=CAP)
    values = {"epsilon_decay": DECAY, "learning_rate": RATE, "discount": DISCOUNT}
    return make_learner("tabular_q", task, episodes=EPISODES, record=POINTS, **values)


def scan(epsilon: np.ndarray, steps: int) -> Made:
    """This package's learner in a scan: a thread for each device, blocks that fit the cache of a CPU."""
    learner = own_learner()
    options = compute.compiler_options(learner.task.arithmetic, learner.program, every_device=True)
    train = jax.vmap(by_scan, in_axes=(0, 0, None))
    return _shared_out(learner, epsilon, steps, train, options, CPU_BLOCK if jax.default_backend() == "cpu" else None)


def fused(epsilon: np.ndarray, steps: int) -> Made:
    """This package's learner in one kernel."""
    return _shared_out(own_learner(), epsilon, steps, jax.vmap(TRAIN, in_axes=(0, 0, None)))


def _shared_out(
    learner: TabularQ,
    epsilon: np.ndarray,
    steps: int,
    train: Callable[..., Any],
    options: dict[str, Any] | None = None,
    block: int | None = None,
) -> Made:
    """Agents in equal shares on all devices, in blocks of about `block` where it is given."""
    first = jax.jit(jax.vmap(begin))

    @partial(jax.jit, donate_argnums=1, compiler_options=options)
    def further(learners: Any, state: Any, steps: Any) -> tuple[Any, jax.Array]:
        state = train(learners, state, steps)
        return state, state.carry.agents.episode.sum()

    def start(device: Any, share: np.ndarray) -> tuple[Any, list[Any]]:
        learners = jax.tree.map(lambda x: np.full(len(share), x, np.result_type(np.float32, x)), learner)
        learners = jax.device_put(learners.replace(epsilon=share), device)
        keys = jax.device_put(jax.random.split(rng.key(device.id), len(share)), device)
        return learners, [first(learners, keys)]

    def go_on(learners: Any, state: list[Any]) -> jax.Array:
        """Train on from where the last call ended; as in a sweep, states change in their place."""
        state[0], episodes = further(learners, state[0], steps)
        return episodes

    devices = jax.local_devices()[: len(epsilon)]
    blocks = max(1, len(epsilon) // (block * len(devices))) if block else 1
    shares = np.array_split(epsilon, len(devices) * blocks)
    states = [[start(device, share) for share in shares[i :: len(devices)]] for i, device in enumerate(devices)]
    return Made(on_devices(go_on, states), lambda done: sum(float(share) for mine in done for share in mine))


SUBJECTS: dict[str, Callable[..., Made]] = {"scan": scan, "fused": fused}
