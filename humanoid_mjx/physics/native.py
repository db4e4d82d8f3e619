# pyright: reportAttributeAccessIssue=false
"""Native MuJoCo over threads, for replay and comparison: numpy in and out, float64, its solver run to convergence.

It is not for use inside jit. Its methods take any number of leading axes in the place of `jax.vmap`, and a controller
sees all worlds at once.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from copy import copy
from functools import lru_cache
from typing import Any, NamedTuple

import mujoco
import numpy as np
from jaxtyping import Bool, Float
from mujoco.rollout import Rollout

from humanoid_mjx.physics.base import MAX_SPEED, Controller, Poses, Readings, Stages, World
from humanoid_mjx.physics.model import MujocoPhysics
from humanoid_mjx.types import AnyArray, FloatScalar


class Native(MujocoPhysics):
    """Native MuJoCo. Its `params` are numbers: all worlds have the same."""

    def start(self, params: Any, qpos: Float[AnyArray, "*worlds nq"], qvel: Float[AnyArray, "*worlds nv"]) -> World:
        qpos, qvel = np.array(qpos, np.float64), np.array(qvel, np.float64)
        return World(qpos, qvel, np.zeros_like(qvel), np.zeros(qvel.shape[:-1], bool))

    def reset(
        self,
        params: Any,
        world: World,
        mask: Bool[AnyArray, "*worlds"],
        qpos: Float[AnyArray, "*#worlds nq"],
        qvel: Float[AnyArray, "*#worlds nv"],
    ) -> World:
        qpos, qvel = np.broadcast_to(qpos, world.qpos.shape), np.broadcast_to(qvel, world.qvel.shape)
        return _where(np.asarray(mask), self.start(params, qpos, qvel), world)

    def step(
        self, params: Any, world: World, controller: Controller, substeps: int = 1
    ) -> tuple[World, Float[np.ndarray, "*worlds joints"]]:
        torque = np.asarray(controller(self._stages(params, world)), np.float64)
        torque = np.clip(torque, -params.torque_limit, params.torque_limit)
        held = np.broadcast_to(torque[..., None, :], (*torque.shape[:-1], substeps, torque.shape[-1]))
        qpos, qvel, _ = self.rollout(params, world, held)
        qpos, qvel = qpos[..., -1, :], qvel[..., -1, :]
        sound = np.isfinite(qpos).all(-1) & (np.abs(qvel) <= MAX_SPEED).all(-1)
        stays = world.diverged | ~sound
        return _where(stays, world, World(qpos, qvel, world.warmstart, stays))._replace(diverged=stays), torque

    def rollout(
        self, params: Any, world: World, torque: Float[AnyArray, "*worlds steps joints"]
    ) -> tuple[Float[np.ndarray, "*worlds steps nq"], Float[np.ndarray, "*worlds steps nv"], Readings]:
        """Replay torques, one each time step.

        Returns:
          `qpos` and `qvel` after every step, and what the sensors said before it.
        """
        torque = np.clip(np.asarray(torque, np.float64), -params.torque_limit, params.torque_limit)
        worlds, steps, nq = world.qpos.shape[:-1], torque.shape[-2], self.model.nq
        states = np.concatenate([np.zeros((*worlds, 1)), world.qpos, world.qvel], axis=-1)
        pool = _pool(self.model)
        with _no_warnings():
            states, sensordata = pool.rollout.rollout(
                self._tuned(params),
                list(pool.data),
                states.reshape(-1, states.shape[-1]),
                torque.reshape(-1, steps, torque.shape[-1]),
            )
        states = states.reshape(*worlds, steps, -1)
        readings = self._readings(sensordata.reshape(*worlds, steps, -1))
        return states[..., 1 : 1 + nq], states[..., 1 + nq :], readings

    def sensors(self, params: Any, world: World, torque: Float[AnyArray, "*worlds joints"]) -> Readings:
        _, _, readings = self.rollout(params, world, np.asarray(torque)[..., None, :])
        return Readings(*(x[..., 0, :] for x in readings))

    def poses(self, params: Any, world: World) -> Poses:
        model, data = self._tuned(params), _pool(self.model).data[0]
        position = np.empty((*world.qpos.shape[:-1], model.nbody, 3))
        rotation = np.empty((*world.qpos.shape[:-1], model.nbody, 3, 3))
        for index in np.ndindex(world.qpos.shape[:-1]):
            data.qpos = world.qpos[index]
            mujoco.mj_kinematics(model, data)
            position[index], rotation[index] = data.xpos, data.xmat.reshape(-1, 3, 3)
        return Poses(position, rotation)

    def _tuned(self, params: Any) -> mujoco.MjModel:
        """The model with the traced values in it."""
        return _tuned(self.model, *(float(value) for value in params))

    def _stages(self, params: Any, world: World) -> Stages:
        model, data = self._tuned(params), _pool(self.model).data[0]
        mass_matrix = np.empty((*world.qvel.shape, model.nv))
        bias = np.empty(world.qvel.shape)
        with _no_warnings():
            for index in np.ndindex(world.qvel.shape[:-1]):
                data.qpos, data.qvel = world.qpos[index], world.qvel[index]
                mujoco.mj_fwdPosition(model, data)
                mujoco.mj_fwdVelocity(model, data)
                mujoco.mj_fullM(model, data, mass_matrix[index])
                bias[index] = data.qfrc_bias - data.qfrc_passive
        joints = model.nu
        inner = mass_matrix[..., -joints:, -joints:]

        def torque_for(qacc: np.ndarray, mass: FloatScalar) -> np.ndarray:
            return (mass / params.mass) * ((inner @ qacc[..., None])[..., 0] + bias[..., -joints:])

        return Stages(world, world.qpos[..., -joints:], world.qvel[..., -joints:], mass_matrix, bias, torque_for)


class _Pool(NamedTuple):
    """A thread for each processor, and what each computes in."""

    rollout: Any
    data: tuple[mujoco.MjData, ...]


@lru_cache
def _pool(model: mujoco.MjModel) -> _Pool:
    threads = os.cpu_count() or 1
    return _Pool(Rollout(nthread=threads), tuple(mujoco.MjData(model) for _ in range(threads)))


@lru_cache
def _tuned(model: mujoco.MjModel, mass: float, friction: float, damping: float, torque_limit: float) -> mujoco.MjModel:
    model = copy(model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    model.body_mass *= mass
    model.body_inertia *= mass
    model.body_subtreemass *= mass
    model.dof_damping[model.dof_damping > 0] = damping
    model.pair_friction[:, :2] = friction
    model.actuator_ctrlrange[:] = -torque_limit, torque_limit
    return model


@contextmanager
def _no_warnings() -> Iterator[None]:
    """Worlds that diverge are flagged; MuJoCo would write of them to the terminal and to a file, too."""
    handler = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(handler)


def _where(mask: Any, chosen: World, other: World) -> World:
    def pick(a: Any, b: Any) -> np.ndarray:
        return np.where(mask.reshape(mask.shape + (1,) * (a.ndim - mask.ndim)), a, b)

    return World(*(pick(a, b) for a, b in zip(chosen, other, strict=True)))
