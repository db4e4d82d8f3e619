# pyright: reportAttributeAccessIssue=false
"""A robot as its file has it, in native MuJoCo: its own actuators, contacts, solver, integrator and time step.

Sensors are the package's, which change no motion. Worlds run on threads one step at a time, since a solver that stops
early depends on the exact warm start, which `mujoco.rollout` does not return.
"""

from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from humanoid_mjx.physics.base import Sensed, World
from humanoid_mjx.physics.native import Native, _Team, add_frames
from humanoid_mjx.robot import Robot
from humanoid_mjx.robot.description import IMU
from humanoid_mjx.robot.mjcf import checked
from humanoid_mjx.robot.motors import controls_of
from humanoid_mjx.robot.touching import GROUND, word
from humanoid_mjx.spec import InputError
from humanoid_mjx.types import AnyArray

STATE = mujoco.mjtState
REST = int(STATE.mjSTATE_FULLPHYSICS | STATE.mjSTATE_WARMSTART) & ~int(STATE.mjSTATE_QPOS | STATE.mjSTATE_QVEL)
"""MuJoCo's state beside positions and velocities: time, activations, delayed values, warm start. `World.warmstart`."""

FORCES = [1 << 1 | 1 << 4, 2, SLOTS := 16]
"""Parameters of a contact sensor: forces and places of the `SLOTS` contacts with the largest forces."""

MISFIT = 0.1
"""Largest difference of a decision from the task's period, as a share of it."""


class Unmodified(Native):
    """The model of a robot's file. Position actuators take set-points, the other joints the torques of the law."""

    terrains: ClassVar[tuple[tuple[str, ...], ...]] = ()

    @property
    def step_s(self) -> float:
        return float(self._team.base.opt.timestep)

    def substeps(self, period: float) -> int:
        """Return the number of the file's time steps that comes nearest to a period, s.

        Raises:
          InputError: it misses the period by more than `MISFIT`.
        """
        steps = max(round(period / self.step_s), 1)
        if abs(steps * self.step_s - period) > MISFIT * period:
            raise InputError(
                f"the file's time step of {self.step_s:g} s does not fit decisions of {period:g} s; change it there."
            )
        return steps

    def start(self, qpos: Float[AnyArray, " nq"], qvel: Float[AnyArray, " nv"]) -> World:
        return super().start(qpos, qvel)._replace(warmstart=jnp.asarray(self._team.rest, float))

    def words(self, period: float) -> str:
        """Describe in a sentence what moves the robot; `period`, s, is that of decisions."""
        (_, _, aimed, applied), m = self._team.controls, self._team.base
        solver = word(mujoco.mjtIntegrator, m.opt.integrator), word(mujoco.mjtCone, m.opt.cone)
        ways = {"set-points by position actuators": aimed, "the servo's torques by actuators": ~aimed & ~applied}
        ways |= {"the servo's torques without actuators": applied}
        parts = [f"time steps of {self.step_s:g} s, {solver[0]}, {solver[1]} cone"]
        parts += [f"{joints.sum()} joints take {how}" for how, joints in ways.items() if joints.any()]
        parts += [f"decisions of {self.substeps(period) * self.step_s:g} s"]
        bare = GROUND in [m.geom(number).name for number in range(m.ngeom)]
        return "; ".join([*parts, "a plane z = 0 in place of a ground"] if bare else parts)

    @property
    def _team(self) -> "_File":
        return _file(self.robot)

    def _control(self, world: World, torque: Float[Array, " joints"]) -> Float[Array, " controls"]:
        file, angles, rates = self._team, world.qpos[self.joint_qpos], world.qvel[self.joint_dofs]
        setpoint = jnp.asarray(self.setpoint if len(self.setpoint) else self.robot.posture, float)
        applied = self.pushes().at[self.joint_dofs].add(jnp.where(file.controls.applied, torque, 0.0))
        return jnp.concatenate([file.controls(setpoint, torque, angles, rates), applied])

    def _seen(self, qpos: Float[Array, " nq"], torque: Float[Array, " joints"], sensordata: Array) -> Sensed:
        file, feet = self._team, len(self.robot.feet)
        ends = np.cumsum([len(torque), 6 * SLOTS * feet, 18 * self.model.nbody])
        others, frames, touches, acting = jnp.split(sensordata, len(sensordata) - ends[::-1])
        poses, velocities = self._framed(frames)
        link, arm = self._corners(poses)
        corners = (poses.position[link] + arm).reshape(feet, -1, 1, 3)
        force, place = jnp.split(touches.reshape(feet, 1, SLOTS, 6), [3], axis=-1)
        nearest = jnp.linalg.norm(corners - place, axis=-1).argmin(axis=1)[:, None]
        forces = jnp.where(nearest == jnp.arange(corners.shape[1])[:, None], jnp.abs(force[..., 0]), 0.0).sum(axis=-1)
        turning, felt = (others[adr : adr + 3] for adr in file.imu)
        torque = acting + jnp.where(file.controls.applied, torque, 0.0)
        return self._sensed(qpos[self.joint_qpos], turning, felt, poses, velocities, forces.reshape(-1), torque)

    def _advance(self, sensed: bool, values: Float[np.ndarray, "worlds _"], *state: Any) -> tuple[np.ndarray, ...]:
        """Return the state of worlds, qpos, qvel and `REST`, after a time step of the file, and the sensors' readings
        before it. Behind the state are the controls and the forces on all degrees of freedom."""
        *before, controls = state
        file, (qpos, qvel, rest) = self._team, map(np.empty_like, before)
        read = np.empty((len(qpos), file.base.nsensordata * sensed))

        def move(rows: np.ndarray, data: mujoco.MjData) -> None:
            for row in rows:
                model = file.tuned(values[row].tobytes(), sensed)
                data.qpos, data.qvel = before[0][row], before[1][row]
                mujoco.mj_setState(model, data, before[2][row], REST)
                data.ctrl, data.qfrc_applied = np.split(controls[row], [model.nu])
                mujoco.mj_step(model, data)
                qpos[row], qvel[row], read[row] = data.qpos, data.qvel, data.sensordata[: read.shape[1]]
                mujoco.mj_getState(model, data, rest[row], REST)

        list(file.pool.map(move, np.array_split(np.arange(len(qpos)), len(file.data)), file.data))
        return qpos, qvel, rest, read


class _File(_Team):
    """The model of a robot's file, and the threads that compute with it."""

    def __init__(self, robot: Robot):
        super().__init__(robot, None, jax.tree.structure(None))
        base, data, pool = self.base, self.data[0], ThreadPoolExecutor(len(self.data))
        self.pool, self.imu = pool, [int(base.sensor(name).adr[0]) for name in IMU]
        self.controls = controls_of(base, robot.joints, base.key(self.key).ctrl if self.key else np.zeros(base.nu))
        mujoco.mj_resetData(base, data)
        held = self.controls(robot.posture, 0.0 * robot.posture, robot.posture, 0.0 * robot.posture)
        for motor in np.flatnonzero(base.actuator_actnum == 1):
            data.act[base.actuator_actadr[motor]] = held[base.actuator_ctrladr[motor]]
        self.rest = np.empty(mujoco.mj_stateSize(base, REST))
        mujoco.mj_getState(base, data, self.rest, REST)

    def _shaped(self, terrain: None) -> mujoco.MjModel:
        """The file's model with sensors of the bodies' frames, the feet's contacts and the joints' torques."""
        if not self._robot.points:
            raise InputError(
                f"unmodified: the robot {self._robot.name} has no foot on the ground; take physics mujoco."
            )
        kinds, sensor = mujoco.mjtObj, mujoco.mjtSensor
        with jax.ensure_compile_time_eval():
            spec, self.key = self._robot.in_file()
            add_frames(spec)
            for foot in self._robot.feet:
                both = {"objtype": kinds.mjOBJ_BODY, "objname": foot, "reftype": kinds.mjOBJ_BODY, "refname": "world"}
                spec.add_sensor(type=sensor.mjSENS_CONTACT, intprm=FORCES, **both)
            for joint in self._robot.joints:
                spec.add_sensor(type=sensor.mjSENS_JOINTACTFRC, objtype=kinds.mjOBJ_JOINT, objname=joint)
            return checked(spec.compile)[0]


_file = lru_cache(_File)
