"""MuJoCo's own rollout, and its model of a robot under a servo."""

from collections.abc import Callable
from copy import copy
from typing import Any

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from humanoid_mjx import compute


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
