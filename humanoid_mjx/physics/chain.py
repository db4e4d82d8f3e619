"""The legs of Table 4.1 on a fixed torso as analytic chains: the fastest physics, without ground or contacts.

Both legs have the same equations: the left leg's joints turn so that equal values are a posture that is its own mirror
image, and gravity lies in the plane of symmetry.
"""

from functools import lru_cache, partial
from typing import Annotated, Any, ClassVar, Literal

import jax
import jax.numpy as jnp
import numpy as np
import pydantic
from jaxtyping import Array, Float
from pydantic import Field

from humanoid_mjx.compute import Arithmetic
from humanoid_mjx.control.drives import limited
from humanoid_mjx.control.stages import Stages, no_contacts
from humanoid_mjx.kernels.worlds import kernel_here
from humanoid_mjx.mechanics import dynamics
from humanoid_mjx.mechanics.kinematics import frames
from humanoid_mjx.mechanics.rotations import angular_velocity
from humanoid_mjx.physics.base import (
    Controller,
    GroundContacts,
    Physics,
    Poses,
    Readings,
    Sensed,
    Velocities,
    World,
    freeze_if_diverged,
)
from humanoid_mjx.robot import ROBOTS
from humanoid_mjx.robot.leg import FRAME_0, MIRROR, Leg
from humanoid_mjx.robot.legs import Legs
from humanoid_mjx.spec import make, traced, written
from humanoid_mjx.thesis.leg import GRAVITY, JOINT_NAMES
from humanoid_mjx.types import AnyArray, MassFactor

LEG = len(JOINT_NAMES)

ChainRobot = Annotated[pydantic.SerializeAsAny[Legs], written("robot", partial(make, "robot", ROBOTS, Legs))]


class ChainPhysics(Physics):
    """Both legs in the air, or the right one alone; joints in the order right leg, left leg."""

    arithmetic: ClassVar[Arithmetic] = "scalars"

    robot: ChainRobot = Field(Legs(), description="both legs, or the right one")
    parameters: Literal["physical", "thesis", "matlab_script"] = "physical"
    timestep: float = Field(0.002, ge=1e-6, le=0.02, description="s")
    mass: float = traced(1.0, gt=0, description="factor on the mass and the inertia of every link")
    torque_limit: float = traced(1.0, gt=0, description="factor on that of each motor")

    @property
    def step_s(self) -> float:
        return self.timestep

    @property
    def body_names(self) -> tuple[str, ...]:
        return ("torso", *(f"{side}_link{i + 1}" for side in self.robot.sides for i in range(LEG)))

    @property
    def qpos0(self) -> Float[np.ndarray, " nq"]:
        return np.zeros(len(self.robot.sides) * LEG)

    @property
    def leg(self) -> Leg:
        """The chain of either leg, its mass factor 1."""
        values, tree = _leg(self.parameters, jax.config.read("jax_enable_x64"))
        return tree.unflatten([jnp.asarray(value) for value in values])

    def start(self, qpos: Float[AnyArray, " nq"], qvel: Float[AnyArray, " nv"]) -> World:
        return World(jnp.array(qpos, float), jnp.array(qvel, float), jnp.zeros(0), jnp.bool_(False))

    def step(self, world: World, controller: Controller) -> tuple[World, Float[Array, " joints"]]:
        new, torque = self._cycle(world, controller)
        return freeze_if_diverged(world, new), torque

    def run(self, world: World, controller: Controller, cycles: int) -> World:
        """`cycles` time steps. A world that diverges in them stands still where it was before the first."""

        def cycle(carry: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], None]:
            now = self._cycle(world._replace(qpos=carry[0], qvel=carry[1]), controller)[0]
            return (now.qpos, now.qvel), None

        def all_cycles(*state: Any) -> Any:
            return jax.lax.scan(cycle, state, length=cycles)[0]

        qpos, qvel = kernel_here(all_cycles, world.qpos, world.qvel)
        return freeze_if_diverged(world, world._replace(qpos=qpos, qvel=qvel))

    def sense(self, world: World, torque: Float[AnyArray, " joints"]) -> Sensed:
        still, nowhere = jnp.zeros(3, world.qpos.dtype), jnp.zeros((0, 3), world.qpos.dtype)
        readings = Readings(world.qpos, still, still.at[2].set(GRAVITY), still[: len(self.robot.sides)])
        poses, rates = jax.jvp(self._poses, (world.qpos,), (world.qvel,))
        angular = angular_velocity(poses.rotation, rates.rotation)
        nothing = GroundContacts(nowhere, nowhere, nowhere[:, 0])
        return Sensed(readings, poses, Velocities(rates.position, angular), nothing, jnp.asarray(torque))

    def _poses(self, qpos: Float[AnyArray, " nq"]) -> Poses:
        position, rotation = [jnp.zeros(3)], [jnp.eye(3)]
        for mirror, q in zip((np.eye(3), MIRROR), _by_leg(qpos), strict=False):
            for pose in frames(self.leg, q)[1:]:
                position.append(mirror @ FRAME_0 @ pose[:3, 3])
                rotation.append(mirror @ FRAME_0 @ pose[:3, :3] @ mirror)
        return Poses(jnp.stack(position), jnp.stack(rotation))

    def _cycle(self, world: World, controller: Controller) -> tuple[World, Float[Array, " joints"]]:
        limits = [self.torque_limit * limit for limit in self.robot.torque_limits.tolist()]
        torque = limited(controller(self._stages(world)), limits)
        dt = jnp.asarray(self.timestep, world.qpos.dtype)
        legs = [
            dynamics.semi_implicit_euler(leg, dynamics.State(qpos, qvel), held, dt)
            for leg, qpos, qvel, held in self._each_leg(self.mass, world.qpos, world.qvel, torque)
        ]
        qpos, qvel = (jnp.concatenate(parts) for parts in zip(*legs, strict=True))
        return world._replace(qpos=qpos, qvel=qvel), torque

    def _stages(self, world: World) -> Stages:
        def inverse_dynamics(qacc: Float[Array, " joints"], mass: MassFactor) -> Float[Array, " joints"]:
            # One factor for all links: the torque grows with it, and the leg's own values stay constants.
            factor, each = (1.0, mass) if jnp.ndim(mass) else (mass, 1.0)
            legs = self._each_leg(each, world.qpos, world.qvel, qacc)
            # Joint by joint, as for the limit in `_cycle`.
            return jnp.stack([factor * x for leg in legs for x in dynamics.inverse_dynamics(*leg)])

        def model_for(mass: MassFactor) -> tuple[Float[Array, "nv nv"], Float[Array, " nv"]]:
            parts = [dynamics.mass_matrix_and_bias(*leg) for leg in self._each_leg(mass, world.qpos, world.qvel)]
            matrices, biases = zip(*parts, strict=True)
            return jax.scipy.linalg.block_diag(*matrices), jnp.concatenate(biases)

        own, contacts = partial(model_for, self.mass), partial(no_contacts, len(world.qvel))
        return Stages(world.qpos, world.qvel, own, contacts, model_for, slice(None), inverse_dynamics)

    def _each_leg(self, mass: MassFactor, *joints: Float[Array, " joints"]) -> list[tuple[Any, ...]]:
        """For each leg: its chain, and its own part of the arrays."""
        factors = _by_leg(mass) if jnp.ndim(mass) else [mass] * len(self.robot.sides)
        chains = [self.leg.scaled(factor) for factor in factors]
        return list(zip(chains, *map(_by_leg, joints), strict=True))


def _by_leg(x: Float[Array, " joints"]) -> list[Float[Array, " leg"]]:
    return jnp.split(x, x.shape[0] // LEG)


@lru_cache
def _leg(parameters: str, x64: bool) -> tuple[list[np.ndarray], Any]:
    """The leg's values as numpy arrays, outside any trace, and its structure."""
    with jax.ensure_compile_time_eval():
        values, tree = jax.tree.flatten(getattr(Leg, parameters)())
    return [np.asarray(value) for value in values], tree
