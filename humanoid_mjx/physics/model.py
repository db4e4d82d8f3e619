# pyright: reportAttributeAccessIssue=false
"""What the physics built on MuJoCo's models have in common: which robot, its model, its traced values."""

from functools import lru_cache
from typing import Literal

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int
from pydantic import Field

from humanoid_mjx.physics.base import MAX_SPEED, GroundContacts, Physics, Poses, Readings, Velocities, World
from humanoid_mjx.robot import lower_body as body
from humanoid_mjx.robot import robot_spec
from humanoid_mjx.robot.ranges import TORQUE_LIMIT
from humanoid_mjx.spec import traced
from humanoid_mjx.types import AnyArray, BoolScalar, FloatScalar, MassFactor


class MujocoPhysics(Physics):
    """A robot as a MuJoCo model."""

    robot: Literal["lower_body", "legs", "leg"] = "lower_body"
    torso: body.Torso = "free"
    ranges: body.Ranges = "proposed"
    timestep: float | None = Field(None, gt=0, le=0.02, description="s; by default the robot's own")
    mass: float = traced(1.0, gt=0, description="factor on the mass and the inertia of every link")
    friction: float = traced(body.FRICTION, ge=0, description="of the feet on the ground")
    damping: float = traced(body.DAMPING, ge=0, description="of the lower body's joints, N m s/rad")
    torque_limit: float = traced(TORQUE_LIMIT, gt=0, description="of the motors, N m")
    push: tuple[float, float, float] = traced((0.0, 0.0, 0.0), description="steady force on a free torso, N, world")

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model with its own values in place of the traced ones. It is shared: change copies only."""
        return _model(self.robot, self.torso, self.ranges, self.timestep)

    @property
    def step_s(self) -> float:
        return float(self.model.opt.timestep)

    @property
    def joint_names(self) -> tuple[str, ...]:
        return tuple(self.model.joint(joint).name for joint in self.model.actuator_trnid[:, 0])

    @property
    def body_names(self) -> tuple[str, ...]:
        return tuple(self.model.body(index).name for index in range(self.model.nbody))

    @property
    def joint_ranges(self) -> Float[np.ndarray, "joints 2"]:
        return self.model.jnt_range[self.model.actuator_trnid[:, 0]]

    @property
    def qpos0(self) -> Float[np.ndarray, " nq"]:
        return self.model.qpos0.copy()

    @property
    def ground_points(self) -> tuple[Int[np.ndarray, " points"], Bool[np.ndarray, "points nv"]]:
        """The balls of the feet that can touch the ground, z = 0: their geoms, and which velocities move them."""
        return ground_points(self.model)

    def mass_factors(self, mass: MassFactor) -> Float[AnyArray, " bodies"]:
        """The factor on each body's mass and inertia. Factors of links leave the torso as it is."""
        if np.ndim(mass) == 0:
            return jnp.full(self.model.nbody, mass, float)
        links = self.model.jnt_bodyid[self.model.actuator_trnid[:, 0]]
        return jnp.ones(self.model.nbody).at[links].set(mass)

    def rescaled(
        self,
        factor: FloatScalar,
        mass_matrix: Float[AnyArray, "nv nv"],
        bias: Float[AnyArray, " nv"],
        qvel: Float[AnyArray, " nv"],
    ) -> tuple[Float[AnyArray, "nv nv"], Float[AnyArray, " nv"]]:
        """Mass matrix and bias with all links `factor` times as heavy; the motors' armature and the joints' damping
        stay as they are."""
        armature, damped = self.model.dof_armature, self.model.dof_damping > 0
        resistance = jnp.where(damped, self.damping, 0.0) * qvel
        others = 1 - factor
        return factor * mass_matrix + others * np.diag(armature), factor * bias + others * resistance

    def pushes(self) -> Float[AnyArray, " nv"]:
        """The forces on the degrees of freedom other than the motors'."""
        none = jnp.zeros(self.model.nv)
        return none.at[:3].set(jnp.stack(list(self.push))) if self.torso == "free" else none

    def _readings(self, sensordata: Float[AnyArray, "*worlds sensors"]) -> Readings:
        """MuJoCo's sensor array, in the order in which the robot declares its sensors."""
        joints, points = self.model.nu, len(self.ground_points[0])
        return Readings(
            encoders=sensordata[..., :joints],
            gyroscope=sensordata[..., joints : joints + 3],
            accelerometer=sensordata[..., joints + 3 : joints + 6],
            foot_contact=sensordata[..., joints + 6 : sensordata.shape[-1] - points],
        )

    def _corner_forces(self, sensordata: Float[AnyArray, "*worlds sensors"]) -> Float[AnyArray, "*worlds points"]:
        """Normal forces on the corners of the feet, N: the last of the sensors."""
        return sensordata[..., sensordata.shape[-1] - len(self.ground_points[0]) :]

    def _velocities(
        self, cvel: Float[AnyArray, "bodies 6"], position: Float[AnyArray, "bodies 3"], com: Float[AnyArray, "bodies 3"]
    ) -> Velocities:
        """Velocities of the bodies from MuJoCo's `cvel`, which is about the centre of mass of a body's tree, `com`
        (`subtree_com`)."""
        angular = cvel[:, :3]
        arm = position - com[self.model.body_rootid]
        return Velocities(cvel[:, 3:] + jnp.cross(angular, arm), angular)

    def _ground_contacts(
        self, poses: Poses, velocities: Velocities, forces: Float[AnyArray, " points"]
    ) -> GroundContacts:
        """Where the corners of the feet are, and how they move with their bodies."""
        balls, _ = self.ground_points
        link = self.model.geom_bodyid[balls]
        arm = jnp.einsum("pij,pj->pi", poses.rotation[link], jnp.asarray(self.model.geom_pos[balls], float))
        arm = arm - self.model.geom_size[balls, :1] * np.array([0.0, 0.0, 1.0])
        velocity = velocities.linear[link] + jnp.cross(velocities.angular[link], arm)
        return GroundContacts(poses.position[link] + arm, velocity, forces)

    def start(self, qpos: Float[AnyArray, " nq"], qvel: Float[AnyArray, " nv"]) -> World:
        qvel = jnp.array(qvel, float)
        return World(jnp.array(qpos, float), qvel, jnp.zeros_like(qvel), jnp.bool_(False))

    def reset(
        self, world: World, mask: BoolScalar, qpos: Float[AnyArray, " nq"], qvel: Float[AnyArray, " nv"]
    ) -> World:
        return _where(mask, self.start(qpos, qvel), world)


def freeze_if_diverged(old: World, new: World) -> World:
    """`new`; where it has diverged, `old` with the flag set."""
    sound = jnp.isfinite(new.qpos).all() & (jnp.abs(new.qvel) <= MAX_SPEED).all() & ~new.diverged
    stays = old.diverged | ~sound
    return _where(stays, old._replace(diverged=jnp.bool_(True)), new)


def _where(mask: BoolScalar, chosen: World, other: World) -> World:
    return jax.tree.map(lambda a, b: jnp.where(mask, a, b), chosen, other)


@lru_cache
def below(model: mujoco.MjModel) -> Float[np.ndarray, "bodies bodies"]:
    """1 where the column's body is the row's, or hangs on it."""
    rows = np.eye(model.nbody, dtype=np.float32)
    for index in range(model.nbody - 1, 0, -1):
        rows[model.body_parentid[index]] += rows[index]
    return rows


@lru_cache
def _model(robot: str, torso: str, ranges: str, timestep: float | None) -> mujoco.MjModel:
    with jax.ensure_compile_time_eval():
        return robot_spec(robot, torso=torso, ranges=ranges, timestep=timestep).compile()


@lru_cache
def ground_points(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """As `MujocoPhysics.ground_points`, of a model."""
    pairs = np.stack([model.pair_geom1, model.pair_geom2], axis=1)
    balls = pairs[model.geom_type[pairs[:, 0]] == mujoco.mjtGeom.mjGEOM_PLANE, 1]
    moved_by = np.zeros((len(balls), model.nv), bool)
    for row, link in zip(moved_by, model.geom_bodyid[balls], strict=True):
        while link:
            row[model.dof_bodyid == link] = True
            link = model.body_parentid[link]
    return balls, moved_by
