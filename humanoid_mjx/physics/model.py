# pyright: reportAttributeAccessIssue=false
"""Base of the physics built on MuJoCo's models: the robot, its model, its traced values."""

import math
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Float, Int
from pydantic import Field, model_validator

from humanoid_mjx.control.drives import limited
from humanoid_mjx.control.stages import Contacts, Stages, jacobian_of
from humanoid_mjx.mechanics.terrain import Terrain
from humanoid_mjx.mechanics.tree.refusing import robot_faults
from humanoid_mjx.physics.base import GroundContacts, Once, Physics, Poses, Readings, Sensed, Velocities, World
from humanoid_mjx.robot import RobotKey, make_robot
from humanoid_mjx.robot.description import compiled, ground_points, lowest
from humanoid_mjx.robot.motors import bounds, motors_on
from humanoid_mjx.spec import InputError, shown, traced
from humanoid_mjx.types import AnyArray, MassFactor


class MujocoPhysics(Physics):
    """A robot as a MuJoCo model."""

    terrains: ClassVar[tuple[tuple[str, ...], ...]] = ()
    """Supported combinations of ground shapes, each also with a slope; empty: level plane only."""

    robot: RobotKey = Field(make_robot("lower_body"), description="the robot that moves")
    timestep: float | None = Field(None, ge=1e-6, le=0.02, description="s; by default the robot's own")
    mass: float = traced(1.0, gt=0, description="factor on every link's mass and inertia; contacts stay as soft")
    friction: float = traced(1.0, ge=0, description="factor on that of all contacts that have any")
    damping: float = traced(1.0, ge=0, description="factor on that of the joints")
    torque_limit: float = traced(1.0, gt=0, description="factor on that of each motor")
    push: tuple[float, float, float] = traced((0.0, 0.0, 0.0), description="steady force on a free torso, N, world")
    setpoint: tuple[float, ...] = traced((), description="set-points of the joints, rad, for motors that take such")
    terrain: Terrain | None = Field(None, description="shape of the ground; none: a level plane")

    @model_validator(mode="after")
    def _driven_by_torques(self) -> "MujocoPhysics":
        if found := robot_faults(self.model):
            faults = "; ".join(f"{fault.what} (take {fault.change})" for fault in found)
            raise ValueError(f"robot: no physics takes {faults}")
        return self

    @model_validator(mode="after")
    def _terrain_must_be_known(self) -> "MujocoPhysics":
        shapes = {name for name in ("rough", "stairs") if getattr(self.terrain, name, None) is not None}
        if self.terrain and not any(shapes <= set(known) for known in self.terrains):
            known = " or ".join(" with ".join(("slope", *names)) for names in self.terrains) or "none"
            got = " with ".join(sorted(shapes or {"slope"}))
            raise ValueError(f"terrain: this physics takes {known}, got {got}")
        return self

    @property
    def gravity(self) -> Float[AnyArray, "3"]:
        """m/s^2, in the world, whose z axis is normal to a slope."""
        gravity = self.model.opt.gravity
        return -np.linalg.norm(gravity) * self.terrain.up() if self.terrain else gravity

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model with its own values in place of the traced ones. It is shared: change copies only."""
        return compiled(self.robot, self.timestep)

    @property
    def step_s(self) -> float:
        return float(self.model.opt.timestep)

    @property
    def body_names(self) -> tuple[str, ...]:
        return tuple(self.model.body(index).name for index in range(self.model.nbody))

    @property
    def qpos0(self) -> Float[np.ndarray, " nq"]:
        return self.model.qpos0.copy()

    @property
    def free(self) -> bool:
        """True if the torso is free to move."""
        return bool((self.model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).any())

    @property
    def joint_qpos(self) -> Any:
        """Index of the joints that motors drive in `qpos`."""
        return places(self.model.jnt_qposadr[self.model.actuator_trnid[:, 0]])

    @property
    def joint_dofs(self) -> Any:
        """Index of the same joints in `qvel`."""
        return places(self.model.jnt_dofadr[self.model.actuator_trnid[:, 0]])

    def _within(self, torque: Any) -> Float[AnyArray, " joints"]:
        """The torques that the motors give of these, N m: each within its limit, all of a joint within the joint's."""
        m, factor, torque = self.model, jnp.asarray(self.torque_limit, float), jnp.asarray(torque, float)
        own = [float(bounds(m, motor, alone=True)[1]) for motor in range(len(m.actuator_trntype))]
        scaled = {limit: factor * limit for limit in own}
        if jnp.shape(torque) != (len(own),):
            raise InputError(f"the controller must return a torque of each of {len(own)} joints, got {shown(torque)}.")
        parts = list(limited(torque, [scaled[limit] for limit in own]))
        for joint in np.flatnonzero(m.jnt_actfrclimited).tolist():
            motors = motors_on(m, joint).tolist()
            total = sum(parts[motor] for motor in motors)
            most = jnp.clip(total, *(factor * end for end in m.jnt_actfrcrange[joint].tolist()))
            for motor in motors:  # of one motor its share is all
                parts[motor] = most * (parts[motor] / jnp.where(total == 0.0, 1.0, total) if len(motors) > 1 else 1.0)
        return jnp.stack(parts) if parts else jnp.zeros(0)

    def controls_for(self, torque: Float[AnyArray, "*worlds joints"]) -> Float[AnyArray, "*worlds joints"]:
        """Return the motors' controls for these torques of their joints, N m."""
        return torque / self._motor_scale

    @property
    def _motor_scale(self) -> Float[np.ndarray, " joints"]:
        return self.model.actuator_gainprm[:, 0] * self.model.actuator_gear[:, 0]

    def mass_factors(self, mass: MassFactor) -> Float[AnyArray, " bodies"]:
        """The factor on each body's mass and inertia. Factors of links leave the torso as it is."""
        if np.ndim(mass) == 0:
            return jnp.full(self.model.nbody, mass, float)
        links = self.model.jnt_bodyid[self.model.actuator_trnid[:, 0]]
        return jnp.ones(self.model.nbody).at[links].set(mass)

    def _stages(
        self,
        world: World,
        dynamics: Callable[[], tuple[Any, Any]],
        dynamics_of: Callable[[Any], tuple[Any, Any]],
        contacts: Callable[[], Contacts],
    ) -> Stages:
        """The stages of a state from its mass matrix and bias, those of another physics in the same state, and its
        contacts."""
        own = Once(dynamics)

        def model_for(mass: MassFactor) -> tuple[Any, Any]:
            if jnp.ndim(mass) or jnp.ndim(self.mass):
                return dynamics_of(self.replace(mass=mass))
            # The motors' armature and the joints' damping do not grow with the links.
            factor = mass / self.mass
            others, resistance = 1 - factor, self.damping * self.model.dof_damping * world.qvel
            matrix, bias = own()
            return factor * matrix + others * np.diag(self.model.dof_armature), factor * bias + others * resistance

        joints = self.joint_dofs
        return Stages(world.qpos[self.joint_qpos], world.qvel[joints], own, contacts, model_for, joints)

    def pushes(self) -> Float[AnyArray, " nv"]:
        """The forces on the degrees of freedom other than the motors'."""
        none = jnp.zeros(self.model.nv)
        return none.at[:3].set(jnp.stack(list(self.push))) if self.free else none

    def _sensed(
        self,
        encoders: Float[AnyArray, " joints"],
        gyroscope: Float[AnyArray, "3"],
        accelerometer: Float[AnyArray, "3"],
        poses: Poses,
        velocities: Velocities,
        forces: Float[AnyArray, " points"],
        torque: Float[AnyArray, " joints"],
    ) -> Sensed:
        """Everything about a state in which the ground pushes the corners of the feet by `forces`."""
        (link, arm), feet = self._corners(poses), (len(self.robot.feet), self.robot.points)
        velocity = velocities.linear[link] + jnp.cross(velocities.angular[link], arm)
        contacts = GroundContacts(poses.position[link] + arm, velocity, forces)
        on_feet = forces[: math.prod(feet)].reshape(feet).sum(axis=1)
        return Sensed(Readings(encoders, gyroscope, accelerometer, on_feet), poses, velocities, contacts, torque)

    def _corners(self, poses: Poses) -> tuple[Any, Any]:
        """The bodies of the feet's corners, and the way from there to the corners' lowest points, m, world."""
        balls, _ = ground_points(self.model)
        link = self.model.geom_bodyid[balls]
        return link, lowest(
            self.model, jnp.einsum("pij,pj->pi", poses.rotation[link], jnp.asarray(self.model.geom_pos[balls], float))
        )

    def _contacts(
        self,
        centers: Float[AnyArray, "points 3"],
        cdof: Float[AnyArray, "nv 6"],
        cdof_dot: Float[AnyArray, "nv 6"],
        qvel: Float[AnyArray, " nv"],
        origin: Float[AnyArray, "3"],
    ) -> Contacts:
        """The corners of the feet from the middles of their balls and MuJoCo's spatial motions about `origin`."""
        _, moved_by = ground_points(self.model)
        position = lowest(self.model, centers)
        jacobian = jacobian_of(position, moved_by, cdof, origin)
        speeds = jnp.where(moved_by, qvel, 0.0)
        rate, spin = speeds @ cdof_dot, speeds @ cdof[:, :3]
        drift = rate[:, 3:] + jnp.cross(rate[:, :3], position - origin) + jnp.cross(spin, jacobian @ qvel)
        return Contacts(position, jacobian, drift, position[:, 2] <= 0.0)

    def _read(self, sensordata: Float[AnyArray, " sensors"], names: Sequence[str]) -> Float[AnyArray, " values"]:
        """Readings of these sensors in MuJoCo's array of all."""
        sensors = [self.model.sensor(name) for name in names]
        return sensordata[places(np.array([a for s in sensors for a in range(s.adr[0], s.adr[0] + s.dim[0])], int))]

    def start(self, qpos: Float[AnyArray, " nq"], qvel: Float[AnyArray, " nv"]) -> World:
        shapes, wanted = (jnp.shape(qpos), jnp.shape(qvel)), ((self.model.nq,), (self.model.nv,))
        if shapes != wanted:
            raise InputError(f"start: qpos and qvel of one world have the shapes {wanted}, got {shapes}.")
        qvel = jnp.array(qvel, float)
        return World(jnp.array(qpos, float), qvel, jnp.zeros_like(qvel), jnp.bool_(False))


def places(rows: Int[np.ndarray, " rows"]) -> Any:
    """Rows as an index: a slice where they follow one another, which compiles to less."""
    one_by_one = len(rows) and (np.diff(rows) == 1).all()
    return slice(int(rows[0]), int(rows[-1]) + 1) if one_by_one else rows
