"""Native MuJoCo as the benchmarks time it: its own rollout, without this package between."""

from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np

from humanoid_mjx.bench.measure import Subject
from humanoid_mjx.compute import cores


def native_subject(
    make: Callable[..., Callable[[], Any]], batch: int, most: int, steps: int, **options: Any
) -> Subject:
    """The subject `make(worlds, steps)` beside a batch of others, of at most so many worlds."""
    worlds = min(batch, most)
    beside = batch if worlds < batch else None
    return Subject(make(worlds, steps), worlds * steps, worlds, device="cpu", beside=beside, **options)


def native_rollout(
    model: Any, qpos: np.ndarray, qvel: np.ndarray, steps: int, held: np.ndarray | None = None
) -> Callable[[], np.ndarray]:
    """MuJoCo's own `rollout` from these states on one thread a core, under `held` control, (batch, steps, controls).

    Returns:
      a call that gives the state, `mjSTATE_FULLPHYSICS`, of each world after the last step.
    """
    mj: Any = import_module("mujoco")
    rollout = import_module("mujoco.rollout")

    full, data = mj.mjtState.mjSTATE_FULLPHYSICS, mj.MjData(model)
    states = np.zeros((len(qpos), mj.mj_stateSize(model, full)))
    for row, data.qpos[:], data.qvel[:] in zip(states, qpos, qvel, strict=True):
        mj.mj_getState(model, data, row, full)
    threads = cores()
    simulate, per_thread = rollout.Rollout(nthread=threads), [mj.MjData(model) for _ in range(threads)]
    after = np.zeros((len(qpos), steps, states.shape[1]))

    def call() -> np.ndarray:
        simulate.rollout(model, per_thread, states, held, nstep=steps, state=after)
        return after[:, -1]

    return call
