# pyright: reportAttributeAccessIssue=false
"""Native MuJoCo over threads, behind host callbacks: a reference for the other physics, its solver run to convergence.

It computes in float64 and returns the precision of jax. A batch of worlds reaches MuJoCo as one call. A program that
uses it runs wherever jax has its CPU backend, but each control cycle waits for the host.
"""

import threading
from collections.abc import Callable, Sequence
from copy import copy
from functools import lru_cache, partial
from itertools import product
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float
from mujoco.rollout import Rollout

from humanoid_mjx.compute import cores
from humanoid_mjx.control.stages import Contacts
from humanoid_mjx.mechanics.terrain import Terrain
from humanoid_mjx.physics.base import Controller, Once, Poses, Sensed, Velocities, World, freeze_if_diverged
from humanoid_mjx.physics.model import MujocoPhysics
from humanoid_mjx.physics.terrain import add_terrain, follow
from humanoid_mjx.robot import Robot
from humanoid_mjx.robot.description import IMU, below, ground_points, sensing_spec
from humanoid_mjx.robot.mjcf import checked, heard, name_bodies
from humanoid_mjx.robot.touching import FLAGS
from humanoid_mjx.types import AnyArray

MODELS_BYTES = 1 << 27
"""Memory for the cached models of one robot, bytes; a model takes about 0.1 MB. If a batch has more distinct traced
values than fit, its groups of worlds are simulated one after another."""

CONTROL = int(mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_QFRC_APPLIED)
"""Control of each step: the motors' torques, then the forces on all degrees of freedom."""

FRAMES = (
    *(mujoco.mjtSensor.mjSENS_FRAMEPOS, mujoco.mjtSensor.mjSENS_FRAMEXAXIS, mujoco.mjtSensor.mjSENS_FRAMEYAXIS),
    *(mujoco.mjtSensor.mjSENS_FRAMEZAXIS, mujoco.mjtSensor.mjSENS_FRAMELINVEL, mujoco.mjtSensor.mjSENS_FRAMEANGVEL),
)
"""Sensors of where each body is and how it moves, so that MuJoCo's threads compute it with the step."""

_LOCK = threading.Lock()
"""MuJoCo's data and its handler of warnings belong to one callback at a time; each uses all processors."""


class Native(MujocoPhysics):
    """Native MuJoCo. Worlds may differ in their traced values: each distinct set of them has a model of its own."""

    batch: ClassVar[int] = 256
    terrains: ClassVar[tuple[tuple[str, ...], ...]] = (("rough",), ("stairs",))
    host_call: ClassVar[Any] = staticmethod(partial(jax.pure_callback, vmap_method="broadcast_all"))
    """Call of the host for a time step, which jax may drop or repeat."""

    def step(self, world: World, controller: Controller) -> tuple[World, Float[Array, " joints"]]:
        return self._cycle(world, controller, sensed=False)[:2]

    def run_sensed(self, world: World, controller: Controller, cycles: int) -> tuple[World, Sensed]:
        def cycle(carry: tuple[World, Any], _: None) -> tuple[tuple[World, Any], None]:
            world, *seen = self._cycle(carry[0], controller, sensed=True)
            return (world, (carry[0].qpos, *seen)), None

        nothing = world.qpos, jnp.zeros(self.model.nu), jnp.zeros(self._team.base.nsensordata)
        (world, seen), _ = jax.lax.scan(cycle, (world, nothing), length=cycles)
        return world, self._seen(*seen)

    def sense(self, world: World, torque: Float[AnyArray, " joints"]) -> Sensed:
        return self._seen(world.qpos, *self._cycle(world, lambda _: torque, sensed=True)[1:])

    def _cycle(self, world: World, controller: Controller, sensed: bool) -> tuple[World, Array, Array]:
        """Return the world after a time step, the torque that acted, and the sensors' readings before it."""
        motion = Once(partial(self._motion, world))

        def contacts() -> Contacts:
            _, _, centers, cdof, cdof_dot, origin = motion()
            return self._contacts(centers, cdof, cdof_dot, world.qvel, origin)

        stages = self._stages(world, lambda: motion()[:2], lambda other: other._motion(world)[:2], contacts)
        torque = self._within(controller(stages))
        qpos, qvel, warmstart, sensordata = self._moved(world, torque, sensed)
        return freeze_if_diverged(world, World(qpos, qvel, warmstart, ~jnp.isfinite(torque).all())), torque, sensordata

    def _moved(self, world: World, torque: Float[Array, " joints"], sensed: bool) -> list[Array]:
        """Return position, velocity and acceleration after a time step, and the sensors' readings before it: none
        unless `sensed`."""
        state = world.qpos, world.qvel, world.warmstart
        control = self._control(world, torque)
        shapes = *(x.shape for x in state), (self._team.base.nsensordata * sensed,)
        return _on_host(partial(self._advance, sensed), shapes, self._values(), *state, control, by=self.host_call)

    def _control(self, world: World, torque: Float[Array, " joints"]) -> Float[Array, " controls"]:
        """The controls of the motors, then the forces on all degrees of freedom."""
        return jnp.concatenate([self.controls_for(torque), self.pushes()])

    def _seen(self, qpos: Float[Array, " nq"], torque: Float[Array, " joints"], sensordata: Array) -> Sensed:
        """Convert the sensors' array of a model of `_Team`."""
        own, frames = sensordata[: self.model.nsensordata], sensordata[self.model.nsensordata :]
        poses, velocities = self._framed(frames)
        turning, felt = (self._read(own, (name,)) for name in IMU)
        forces = self._read(own, self.robot.point_sensors)
        return self._sensed(qpos[self.joint_qpos], turning, felt, poses, velocities, forces, torque)

    def _framed(self, frames: Array) -> tuple[Poses, Velocities]:
        """Convert the readings of `FRAMES`."""
        position, *axes, linear, angular = frames.reshape(len(FRAMES), self.model.nbody, 3)
        return Poses(position, jnp.stack(axes, axis=-1)), Velocities(linear, angular)

    @property
    def _team(self) -> "_Team":
        return _team(self.robot, self.timestep, jax.tree.structure(self.terrain))

    def _values(self) -> Float[Array, " values"]:
        """The traced values of a model: factors on the bodies' masses, friction, damping, torque limits, terrain."""
        factors = self.mass_factors(self.mass)
        others = self.friction, self.damping, self.torque_limit, *jax.tree.leaves(self.terrain)
        return jnp.concatenate([factors, jnp.stack([jnp.asarray(value, factors.dtype) for value in others])])

    def _motion(self, world: World) -> tuple[Any, ...]:
        """Mass matrix and bias, and what the contacts follow from (`_contacts`)."""
        nv, points = self.model.nv, len(ground_points(self.model)[0])
        shapes = (nv, nv), (nv,), (points, 3), (nv, 6), (nv, 6), (3,)
        return tuple(_on_host(self._look, shapes, self._values(), world.qpos, world.qvel))

    def _advance(
        self,
        sensed: bool,
        values: Float[np.ndarray, "worlds values"],
        qpos: Float[np.ndarray, "worlds nq"],
        qvel: Float[np.ndarray, "worlds nv"],
        warmstart: Float[np.ndarray, "worlds nv"],
        control: Float[np.ndarray, "worlds controls"],
    ) -> tuple[np.ndarray, ...]:
        """Return the results of `_moved` for worlds in groups of few models."""
        team, nq, waves = self._team, qpos.shape[-1], self.terrain is not None and self.terrain.rough is not None
        if waves:  # what a model's ground is depends on where the world is
            values = np.concatenate([values, np.arange(len(values))[:, None]], axis=-1)
        initial = np.concatenate([np.zeros((len(qpos), 1)), qpos, qvel], axis=-1)
        states = np.empty((len(qpos), 1, initial.shape[-1]))
        sensordata = np.empty((len(qpos), 1, team.base.nsensordata))
        distinct, kind = np.unique(values, axis=0, return_inverse=True)
        for first in range(0, len(distinct), team.room):
            models = [team.tuned(row.tobytes(), sensed) for row in distinct[first : first + team.room]]
            rows = np.flatnonzero((kind >= first) & (kind < first + team.room))
            if waves:
                for model, row in zip(models, distinct[first : first + team.room], strict=True):
                    follow(model, team.data[0], qpos[int(row[-1])], team.terrain_of(row))
            options = {"control_spec": CONTROL, "nstep": 1, "initial_warmstart": warmstart[rows]}
            given = [models[i - first] for i in kind[rows]], team.data, initial[rows], control[rows, None]
            states[rows], sensordata[rows] = team.rollout.rollout(*given, **options)
        moved, speed = np.split(states[:, 0, 1:], [nq], axis=-1)  # without the time
        return moved, speed, (speed - qvel) / self.step_s, sensordata[:, 0, : sensordata.shape[-1] * sensed]

    def _look(self, values: np.ndarray, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return the results of `_motion` for each world."""
        rows, corners = [], ground_points(self.model)[0]
        team = _team(self.robot, self.timestep, jax.tree.structure(self.terrain))
        data = team.data[0]
        for i, row in enumerate(values):
            model = team.tuned(row.tobytes(), False)
            data.qpos, data.qvel = qpos[i], qvel[i]
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
            matrix = np.empty((model.nv, model.nv))
            mujoco.mj_fullM(model, data, matrix)
            places = data.geom_xpos[corners], data.cdof.copy(), data.cdof_dot.copy(), data.subtree_com[1].copy()
            rows.append((matrix, data.qfrc_bias - data.qfrc_passive, *places))
        return tuple(np.array(part) for part in zip(*rows, strict=True))


class _Team:
    """The threads that compute with one robot, and the models and data that they compute in."""

    def __init__(self, robot: Robot, timestep: float | None, terrain: Any):
        threads = cores()
        self._robot, self._timestep, self._terrain = robot, timestep, terrain
        self.base = base = self._shaped(terrain.unflatten([1.0] * terrain.num_leaves))
        self.rollout = Rollout(nthread=threads)
        self.data = [mujoco.MjData(base) for _ in range(threads)]
        self.room = max(1, MODELS_BYTES // base.nbuffer)
        self.tuned = lru_cache(self.room)(self._tuned)

    def _tuned(self, values: bytes, sensed: bool) -> mujoco.MjModel:
        """The model with these values in it, its sensors on or off."""
        numbers, base = np.frombuffer(values), self.base
        terrain = self.terrain_of(numbers)
        model = self._shaped(terrain) if terrain and terrain.stairs is not None else copy(base)
        model.opt.disableflags &= ~int(FLAGS.mjDSBL_SENSOR)
        model.opt.disableflags |= int(FLAGS.mjDSBL_AUTORESET | (0 if sensed else FLAGS.mjDSBL_SENSOR))
        self.tune(model, numbers)
        return model

    def tune(self, model: mujoco.MjModel, numbers: np.ndarray) -> None:
        """Put these values into a model."""
        base, terrain = self.base, self.terrain_of(numbers)
        factors, (friction, damping, torque_limit) = numbers[: base.nbody], numbers[base.nbody : base.nbody + 3]
        mass = factors * base.body_mass
        model.body_mass[:] = mass
        model.body_inertia[:] = factors[:, None] * base.body_inertia
        model.body_subtreemass[:] = below(base) @ mass
        model.dof_damping[:] = damping * base.dof_damping
        model.pair_friction[:, :2] = friction * base.pair_friction[:, :2]
        model.geom_friction[:, 0] = friction * base.geom_friction[:, 0]
        torques = base.actuator_biastype == mujoco.mjtBias.mjBIAS_NONE
        model.actuator_ctrlrange[torques] = torque_limit * base.actuator_ctrlrange[torques]
        model.actuator_forcerange[:] = torque_limit * base.actuator_forcerange
        model.jnt_actfrcrange[:] = torque_limit * base.jnt_actfrcrange
        if terrain:
            model.opt.gravity[:] = np.linalg.norm(base.opt.gravity) * -terrain.up(np)

    def terrain_of(self, values: Float[np.ndarray, " values"]) -> Any:
        """The terrain among the values of a model."""
        return self._terrain.unflatten(values[self.base.nbody + 3 :][: self._terrain.num_leaves].tolist())

    def _shaped(self, terrain: Terrain | None) -> mujoco.MjModel:
        """The robot on ground of this shape, with `FRAMES` on every body, behind its own sensors."""
        with jax.ensure_compile_time_eval():
            spec = sensing_spec(self._robot, self._timestep)
            add_frames(spec)
            if terrain is not None and terrain.shaped:
                add_terrain(spec, terrain)
            return checked(spec.compile)[0]


_team = lru_cache(_Team)


def add_frames(spec: mujoco.MjSpec) -> None:
    """Add sensors of `FRAMES` to every body, kind by kind."""
    name_bodies(spec)
    for kind, body in product(FRAMES, spec.bodies):
        spec.add_sensor(type=kind, objtype=mujoco.mjtObj.mjOBJ_XBODY, objname=body.name)


def _on_host(
    function: Callable[..., tuple[np.ndarray, ...]],
    shapes: Sequence[tuple[int, ...]],
    *vectors: Any,
    by: Any = Native.host_call,
) -> list[Array]:
    """Call a numpy function that takes vectors and gives arrays of `shapes`, all with a leading axis of worlds.

    One caller at a time, without warnings: worlds that diverge are flagged, but MuJoCo would report them on the
    terminal and in a file, and numpy would warn of numbers too large for float32.
    """
    dtype = jnp.result_type(float)

    def call(*arrays: Any) -> tuple[np.ndarray, ...]:
        rows = [np.asarray(x, np.float64) for x in arrays]
        worlds = rows[0].shape[:-1]
        with _LOCK, np.errstate(over="ignore", invalid="ignore"), heard():
            results = function(*(x.reshape(-1, x.shape[-1]) for x in rows))
            return tuple(x.astype(dtype).reshape(*worlds, *x.shape[1:]) for x in results)

    wanted = [jax.ShapeDtypeStruct(shape, dtype) for shape in shapes]
    return by(call, wanted, *vectors)
