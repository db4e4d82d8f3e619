# pyright: reportAttributeAccessIssue=false
"""Native MuJoCo over threads, behind host callbacks: a reference for the other physics, its solver run to convergence.

It computes in float64 and returns the precision of jax. A batch of worlds reaches MuJoCo as one call. A program that
uses it runs wherever jax has its CPU backend, but each control cycle waits for the host.
"""

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float
from mujoco.rollout import Rollout

from humanoid_mjx.mechanics.contacts import Contacts
from humanoid_mjx.physics.base import Controller, Poses, Readings, Sensed, Stages, Velocities, World
from humanoid_mjx.physics.model import MujocoPhysics, below, freeze_if_diverged
from humanoid_mjx.types import AnyArray, MassFactor

MODELS_BYTES = 1 << 27
"""Bytes that the models kept of one robot may take, at about 0.1 MB each. Worlds of more distinct traced values take
turns."""

CONTROL = int(mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_QFRC_APPLIED)
"""Control of each step: the motors' torques, then the forces on all degrees of freedom."""

_LOCK = threading.Lock()
"""MuJoCo's data and its handler of warnings belong to one callback at a time; each uses all processors."""


class Native(MujocoPhysics):
    """Native MuJoCo. Worlds may differ in their traced values: each distinct set of them has a model of its own."""

    def step(self, world: World, controller: Controller, substeps: int = 1) -> tuple[World, Float[Array, " joints"]]:
        limit = jnp.asarray(self.torque_limit, float)
        torque = jnp.clip(jnp.asarray(controller(self._stages(world)), float), -limit, limit)
        shapes = world.qpos.shape, world.qvel.shape, world.qvel.shape
        state = world.qpos, world.qvel, world.warmstart
        control = jnp.concatenate([torque, self.pushes()])
        qpos, qvel, warmstart = _on_host(partial(self._advance, substeps), shapes, self._values(), *state, control)
        return freeze_if_diverged(world, World(qpos, qvel, warmstart, jnp.bool_(False))), torque

    def sense(self, world: World, torque: Float[AnyArray, " joints"]) -> Sensed:
        shapes = ((self.model.nsensordata,),)
        torque = jnp.asarray(torque, float)
        control = jnp.concatenate([torque, self.pushes()])
        state = world.qpos, world.qvel, world.warmstart
        (sensordata,) = _on_host(self._sense, shapes, self._values(), *state, control)
        poses, velocities = self._motion(world)
        contacts = self._ground_contacts(poses, velocities, self._corner_forces(sensordata))
        return Sensed(self._readings(sensordata), poses, velocities, contacts, torque)

    def poses(self, world: World) -> Poses:
        return self._motion(world)[0]

    def _motion(self, world: World) -> tuple[Poses, Velocities]:
        bodies = self.model.nbody
        shapes = (bodies, 3), (bodies, 3, 3), (bodies, 6), (bodies, 3)
        position, rotation, cvel, com = _on_host(self._locate, shapes, self._values(), world.qpos, world.qvel)
        return Poses(position, rotation), self._velocities(cvel, position, com)

    def rollout(
        self, world: World, torque: Float[AnyArray, "*worlds steps joints"]
    ) -> tuple[Float[np.ndarray, "*worlds steps nq"], Float[np.ndarray, "*worlds steps nv"], Readings]:
        """Replay torques, one each time step, outside jax: numpy in and out, any number of leading axes, the same
        traced values in all worlds.

        Returns:
          `qpos` and `qvel` after every step, and the readings of the sensors before it.
        """
        worlds = world.qpos.shape[:-1]
        values = np.asarray(self._values(), np.float64)
        torque = np.clip(np.asarray(torque, np.float64), -values[-1], values[-1])
        state = world.qpos, world.qvel, world.warmstart
        qpos, qvel, warmstart = (np.asarray(x, np.float64).reshape(-1, x.shape[-1]) for x in state)
        pushes = np.broadcast_to(self.pushes(), (*torque.shape[:-1], self.model.nv))
        control = np.concatenate([torque, pushes], axis=-1)
        control = control.reshape(-1, *control.shape[-2:])
        with _alone():
            values = np.broadcast_to(values, (len(control), len(values)))
            states, sensordata = self._simulate(values, qpos, qvel, warmstart, control, control.shape[1])
        states = states.reshape(*worlds, *states.shape[1:])
        readings = self._readings(sensordata.reshape(*worlds, *sensordata.shape[1:]))
        return (*self._split(states), readings)

    def _values(self) -> Float[Array, " values"]:
        """The traced values of a model: the mass factors of the bodies, friction, damping, and the torque limit."""
        factors = self.mass_factors(self.mass)
        others = self.friction, self.damping, self.torque_limit
        return jnp.concatenate([factors, jnp.stack([jnp.asarray(value, factors.dtype) for value in others])])

    def _stages(self, world: World) -> Stages:
        joints, nv = self.model.nu, self.model.nv

        def dynamics(physics: Native) -> tuple[Array, Array]:
            shapes = (nv, nv), (nv,)
            matrix, bias = _on_host(self._dynamics, shapes, physics._values(), world.qpos, world.qvel)
            return matrix, bias

        def model_for(mass: MassFactor) -> tuple[Array, Array]:
            if jnp.ndim(mass) == jnp.ndim(self.mass) == 0:
                return self.rescaled(mass / self.mass, matrix, bias, world.qvel)
            return dynamics(self.replace(mass=mass))

        def torque_for(qacc: Float[Array, " joints"], mass: MassFactor) -> Float[Array, " joints"]:
            believed, bias_of = model_for(mass)
            return believed[-joints:, -joints:] @ qacc + bias_of[-joints:]

        matrix, bias = dynamics(self)
        joint_state = world.qpos[-joints:], world.qvel[-joints:]
        return Stages(world, *joint_state, matrix, bias, torque_for, partial(self._contacts, world), model_for)

    def _contacts(self, world: World) -> Contacts:
        points, nv = len(self.ground_points[0]), self.model.nv
        shapes = (points, 3), (points, 3, nv), (points, 3)
        position, jacobian, drift = _on_host(self._touch, shapes, world.qpos, world.qvel)
        return Contacts(position, jacobian, drift, position[:, 2] <= 0.0)

    def _advance(
        self,
        steps: int,
        values: np.ndarray,
        qpos: np.ndarray,
        qvel: np.ndarray,
        warmstart: np.ndarray,
        control: np.ndarray,
    ) -> tuple[np.ndarray, ...]:
        """State and acceleration after so many steps under the same control."""
        states, _ = self._simulate(values, qpos, qvel, warmstart, control[:, None], steps)
        moved, speed = self._split(states[:, -1])
        before = self._split(states[:, -2])[1] if steps > 1 else qvel
        return moved, speed, (speed - before) / self.step_s

    def _sense(
        self, values: np.ndarray, qpos: np.ndarray, qvel: np.ndarray, warmstart: np.ndarray, control: np.ndarray
    ) -> tuple[np.ndarray]:
        return (self._simulate(values, qpos, qvel, warmstart, control[:, None], 1)[1][:, 0],)

    def _dynamics(self, values: np.ndarray, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mass matrix and bias of each world."""
        matrix, bias = np.empty((*qvel.shape, qvel.shape[-1])), np.empty(qvel.shape)
        for i, (model, data) in enumerate(_team(self.model).bare(values)):
            data.qpos, data.qvel = qpos[i], qvel[i]
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
            mujoco.mj_fullM(model, data, matrix[i])
            bias[i] = data.qfrc_bias - data.qfrc_passive
        return matrix, bias

    def _touch(self, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, ...]:
        """Places, Jacobians and drifts of the feet's corners in each world."""
        model, (corners, _) = self.model, self.ground_points
        data, rate, points = mujoco.MjData(model), np.empty((3, model.nv)), len(corners)
        position, jacobian = np.empty((len(qpos), points, 3)), np.empty((len(qpos), points, 3, model.nv))
        drift = np.empty_like(position)
        for i in range(len(qpos)):
            data.qpos, data.qvel = qpos[i], qvel[i]
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
            for k, corner in enumerate(corners):
                position[i, k] = data.geom_xpos[corner] - (0.0, 0.0, model.geom_size[corner, 0])
                body = model.geom_bodyid[corner]
                mujoco.mj_jac(model, data, jacobian[i, k], None, position[i, k], body)
                mujoco.mj_jacDot(model, data, rate, None, position[i, k], body)
                drift[i, k] = rate @ qvel[i]
        return position, jacobian, drift

    def _locate(self, values: np.ndarray, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, ...]:
        """`xpos`, `xmat`, `cvel` and `subtree_com` of each world."""
        worlds, bodies = len(qpos), self.model.nbody
        found = [np.empty((worlds, bodies, *shape)) for shape in ((3,), (3, 3), (6,), (3,))]
        for i, (model, data) in enumerate(_team(self.model).bare(values)):
            data.qpos, data.qvel = qpos[i], qvel[i]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_comVel(model, data)
            parts = data.xpos, data.xmat.reshape(-1, 3, 3), data.cvel, data.subtree_com
            for rows, part in zip(found, parts, strict=True):
                rows[i] = part
        return tuple(found)

    def _simulate(
        self,
        values: Float[np.ndarray, "worlds values"],
        qpos: Float[np.ndarray, "worlds nq"],
        qvel: Float[np.ndarray, "worlds nv"],
        warmstart: Float[np.ndarray, "worlds nv"],
        control: Float[np.ndarray, "worlds held controls"],
        steps: int,
    ) -> tuple[Float[np.ndarray, "worlds steps nstate"], Float[np.ndarray, "worlds steps sensors"]]:
        """States (time, positions, velocities) after every step and sensors before it, in groups of few models.

        `control` is of every step, or one for all.
        """
        team = _team(self.model)
        initial = np.concatenate([np.zeros((len(qpos), 1)), qpos, qvel], axis=-1)
        states = np.empty((len(qpos), steps, initial.shape[-1]))
        sensordata = np.empty((len(qpos), steps, self.model.nsensordata))
        distinct, kind = np.unique(values, axis=0, return_inverse=True)
        for first in range(0, len(distinct), team.room):
            models = [team.tuned(row) for row in distinct[first : first + team.room]]
            rows = np.flatnonzero((kind >= first) & (kind < first + team.room))
            states[rows], sensordata[rows] = team.rollout.rollout(
                [models[i - first] for i in kind[rows]],
                team.data,
                initial[rows],
                control[rows],
                control_spec=CONTROL,
                nstep=steps,
                initial_warmstart=warmstart[rows],
            )
        return states, sensordata

    def _split(self, states: Float[np.ndarray, "*batch nstate"]) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities."""
        nq = self.model.nq
        return states[..., 1 : 1 + nq], states[..., 1 + nq :]


class _Team:
    """The threads that compute with one robot, and the models and data that they compute in."""

    def __init__(self, base: mujoco.MjModel):
        threads = os.cpu_count() or 1
        self.base = base
        self.rollout = Rollout(nthread=threads)
        self.data = [mujoco.MjData(base) for _ in range(threads)]
        self.room = max(1, MODELS_BYTES // base.nbuffer)
        self._damped = base.dof_damping > 0
        self._tuned: dict[bytes, mujoco.MjModel] = {}
        self._bare = copy(base)
        self._bare.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT

    def tuned(self, values: Float[np.ndarray, " values"]) -> mujoco.MjModel:
        """The model with these values in it, evicting the least recently used where there is no room."""
        key = values.tobytes()
        model = self._tuned.pop(key, None)
        if model is None:
            full = len(self._tuned) >= self.room
            model = self._tuned.pop(next(iter(self._tuned))) if full else copy(self.base)
            model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
            self._tune(model, values)
        self._tuned[key] = model
        return model

    def bare(self, values: Float[np.ndarray, "worlds values"]) -> Iterator[tuple[mujoco.MjModel, mujoco.MjData]]:
        """A model without contacts and limits, and data, for each row of values; valid until the next."""
        before = None
        for row in values:
            if before is None or (row != before).any():
                self._tune(self._bare, row)
                before = row
            yield self._bare, self.data[0]

    def _tune(self, model: mujoco.MjModel, values: Float[np.ndarray, " values"]) -> None:
        base, factors, (friction, damping, torque_limit) = self.base, values[:-3], values[-3:]
        mass = factors * base.body_mass
        model.body_mass[:] = mass
        model.body_inertia[:] = factors[:, None] * base.body_inertia
        model.body_subtreemass[:] = below(base) @ mass
        model.dof_damping[self._damped] = damping
        model.pair_friction[:, :2] = friction
        model.actuator_ctrlrange[:] = -torque_limit, torque_limit


@lru_cache
def _team(base: mujoco.MjModel) -> _Team:
    return _Team(base)


def _on_host(
    function: Callable[..., tuple[np.ndarray, ...]], shapes: Sequence[tuple[int, ...]], *vectors: Any
) -> list[Array]:
    """Call a numpy function that takes vectors and gives arrays of `shapes`, all with a leading axis of worlds."""
    dtype = jnp.result_type(float)

    def call(*arrays: Any) -> tuple[np.ndarray, ...]:
        rows = [np.asarray(x, np.float64) for x in arrays]
        worlds = rows[0].shape[:-1]
        with _alone():
            results = function(*(x.reshape(-1, x.shape[-1]) for x in rows))
            return tuple(x.astype(dtype).reshape(*worlds, *x.shape[1:]) for x in results)

    wanted = [jax.ShapeDtypeStruct(shape, dtype) for shape in shapes]
    return jax.pure_callback(call, wanted, *vectors, vmap_method="broadcast_all")


@contextmanager
def _alone() -> Iterator[None]:
    """One caller at a time, without warnings: worlds that diverge are flagged, but MuJoCo would report them on the
    terminal and in a file, and numpy would warn of numbers too large for float32."""
    with _LOCK, np.errstate(over="ignore", invalid="ignore"):
        handler = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(lambda message: None)
        try:
            yield
        finally:
            mujoco.set_mju_user_warning(handler)
