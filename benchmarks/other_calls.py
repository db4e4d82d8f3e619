"""Calls that `bench` times beside the package: MuJoCo's own rollout, and programs in another process."""

import itertools
import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from copy import copy
from functools import cache
from typing import Any

import jax
import mujoco
import numpy as np
from mujoco.rollout import Rollout
from timing import Subject

from humanoid_mjx import compute


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
    """MuJoCo's own `rollout` from these states on one thread a core, under control that is held, (batch, controls).

    Returns:
      a call that gives the positions and velocities of each world after the last step, side by side.
    """
    mj: Any = mujoco

    full, data = mj.mjtState.mjSTATE_FULLPHYSICS, mj.MjData(model)
    states = np.zeros((len(qpos), mj.mj_stateSize(model, full)))
    for row, data.qpos[:], data.qvel[:] in zip(states, qpos, qvel, strict=True):
        mj.mj_getState(model, data, row, full)
    threads = compute.cores()
    simulate, per_thread = Rollout(nthread=threads), [mj.MjData(model) for _ in range(threads)]
    after = np.zeros((len(qpos), steps, states.shape[1]))
    control = None if held is None else np.repeat(held[:, None], steps, axis=1)

    def call() -> np.ndarray:
        simulate.rollout(model, per_thread, states, control, nstep=steps, state=after)
        return after[:, -1, 1 : 1 + model.nq + model.nv]  # the time comes first

    return call


def with_servo(base: Any, gains: np.ndarray) -> Any:
    """Return a copy of a model in which each torque motor is a servo within the same limits, its control the set-point.

    `gains`: stiffness, N m/rad, and damping, N m s/rad, (2,) or (motors, 2).
    """
    mj: Any = mujoco
    model = copy(base)
    model.opt.disableflags |= mj.mjtDisableBit.mjDSBL_AUTORESET
    model.actuator_ctrllimited[:], model.actuator_forcelimited[:] = 0, 1
    model.actuator_forcerange[:] = base.actuator_ctrlrange
    model.actuator_biastype[:] = mj.mjtBias.mjBIAS_AFFINE
    model.actuator_gainprm[:, 0], model.actuator_biasprm[:, 1:3] = gains[..., 0], -gains
    return model


_numbers = itertools.count()
_calls: dict[int, Callable[[], Any]] = {}
"""The calls that the other process keeps, by number."""


def with_room(make: Callable[..., Callable[[], Any]], *arguments: Any) -> Callable[[], Any]:
    """The call `make(*arguments)` where MJX has room for its threads: elsewhere on a CPU, here on a GPU."""
    return elsewhere(make, *arguments) if jax.default_backend() == "cpu" else make(*arguments)


def elsewhere(make: Callable[..., Callable[[], Any]], *arguments: Any, plain: bool = False) -> Callable[[], Any]:
    """The call `make(*arguments)`, made and kept in another process; it returns numpy arrays.

    On a CPU, MJX needs more of XLA's threads than all else is fastest with. The process is a child of this program,
    begun when it is first asked, and waits while others are timed.

    Args:
      plain: with XLA's default flags, without `compute.XLA_FLAGS`.
    """
    process, number = _process(plain), next(_numbers)
    made = process.submit(_make, number, make, *arguments)

    def call() -> Any:
        made.result()
        return process.submit(_call, number).result()

    return call


@cache
def _process(plain: bool) -> ProcessPoolExecutor:
    pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), initializer=_start, initargs=(plain,))
    pool.submit(jax.device_count).result()
    return pool


def _start(plain: bool) -> None:
    compute.start(mjx=True)
    if plain:
        os.environ["XLA_FLAGS"] = os.environ["XLA_FLAGS"].replace(compute.XLA_FLAGS, "")


def _make(number: int, make: Callable[..., Callable[[], Any]], *arguments: Any) -> None:
    _calls[number] = make(*arguments)


def _call(number: int) -> Any:
    return jax.device_get(_calls[number]())
