"""The legs of Table 4.1 on a fixed torso as analytic chains: the fastest physics, without ground or contacts.

Both legs have the same equations: the left leg's joints turn so that equal values are a posture that is its own mirror
image, and gravity lies in the plane of symmetry.
"""

from functools import lru_cache
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from pydantic import Field

from humanoid_mjx.mechanics import dynamics
from humanoid_mjx.mechanics.contacts import no_contacts
from humanoid_mjx.mechanics.forward import frames
from humanoid_mjx.physics.base import MAX_SPEED, Controller, Physics, Poses, Readings, Stages, World
from humanoid_mjx.robot.leg import FRAME_0, MIRROR, Leg
from humanoid_mjx.robot.ranges import TORQUE_LIMIT, joint_ranges
from humanoid_mjx.thesis.leg import GRAVITY, JOINT_NAMES
from humanoid_mjx.types import AnyArray, BoolScalar, FloatScalar

SIDES = ("right", "left")
LEG = len(JOINT_NAMES)


class ChainPhysics(Physics):
    """Both legs in the air; joints in the order right leg, left leg."""

    robot: Literal["legs"] = "legs"
    parameters: Literal["physical", "thesis", "matlab_script"] = "physical"
    ranges: Literal["proposed", "human"] = "proposed"
    timestep: float = Field(0.002, gt=0, le=0.02, description="s")
    mass: float = Field(1.0, gt=0, description="factor on the mass and the inertia of every link")
    torque_limit: float = Field(TORQUE_LIMIT, gt=0, description="of the motors, N m")

    class Params(NamedTuple):
        mass: FloatScalar
        torque_limit: FloatScalar

    @property
    def step_s(self) -> float:
        return self.timestep

    @property
    def joint_names(self) -> tuple[str, ...]:
        return tuple(f"{side}_{joint}" for side in SIDES for joint in JOINT_NAMES)

    @property
    def body_names(self) -> tuple[str, ...]:
        return ("torso", *(f"{side}_link{i + 1}" for side in SIDES for i in range(LEG)))

    @property
    def joint_ranges(self) -> Float[np.ndarray, "joints 2"]:
        return np.tile(np.asarray(joint_ranges(self.ranges)), (2, 1))

    @property
    def qpos0(self) -> Float[np.ndarray, " nq"]:
        return np.zeros(2 * LEG)

    @property
    def leg(self) -> Leg:
        """The chain of either leg, its mass factor 1."""
        values, tree = _leg(self.parameters, jax.config.read("jax_enable_x64"))
        return tree.unflatten([jnp.asarray(value) for value in values])

    def start(self, params: Any, qpos: Float[AnyArray, " nq"], qvel: Float[AnyArray, " nv"]) -> World:
        return World(jnp.array(qpos, float), jnp.array(qvel, float), jnp.zeros(0), jnp.bool_(False))

    def reset(
        self, params: Any, world: World, mask: BoolScalar, qpos: Float[AnyArray, " nq"], qvel: Float[AnyArray, " nv"]
    ) -> World:
        return jax.tree.map(lambda new, old: jnp.where(mask, new, old), self.start(params, qpos, qvel), world)

    def step(
        self, params: Any, world: World, controller: Controller, substeps: int = 1
    ) -> tuple[World, Float[Array, " joints"]]:
        new, torque = self._cycle(params, world, controller, substeps)
        return _freeze_if_diverged(world, new), torque

    def run(self, params: Any, world: World, controller: Controller, cycles: int, substeps: int = 1) -> World:
        """`cycles` control cycles. A world that diverges in them stands still where it was before the first."""

        # The state is carried as separate scalars: a batch of them is contiguous, and few kernels compute them all.
        def cycle(carry: tuple[list[Array], ...], _: None) -> tuple[tuple[list[Array], ...], None]:
            now = world._replace(qpos=jnp.stack(carry[0]), qvel=jnp.stack(carry[1]))
            now = self._cycle(params, now, controller, substeps)[0]
            return (list(now.qpos), list(now.qvel)), None

        qpos, qvel = jax.lax.scan(cycle, (list(world.qpos), list(world.qvel)), length=cycles)[0]
        return _freeze_if_diverged(world, world._replace(qpos=jnp.stack(qpos), qvel=jnp.stack(qvel)))

    def sensors(self, params: Any, world: World, torque: Float[AnyArray, " joints"]) -> Readings:
        still = jnp.zeros(3, world.qpos.dtype)
        return Readings(world.qpos, still, still.at[2].set(GRAVITY), still[:2])

    def poses(self, params: Any, world: World) -> Poses:
        right, left = (frames(self.leg, q)[1:] for q in jnp.split(world.qpos, 2))
        position = [FRAME_0 @ pose[:3, 3] for pose in right] + [MIRROR @ FRAME_0 @ pose[:3, 3] for pose in left]
        rotation = [FRAME_0 @ pose[:3, :3] for pose in right]
        rotation += [MIRROR @ FRAME_0 @ pose[:3, :3] @ MIRROR for pose in left]
        return Poses(jnp.stack([jnp.zeros(3), *position]), jnp.stack([jnp.eye(3), *rotation]))

    def _cycle(
        self, params: Any, world: World, controller: Controller, substeps: int
    ) -> tuple[World, Float[Array, " joints"]]:
        leg, limit = self.leg.scaled(params.mass), params.torque_limit
        torque = jnp.clip(controller(self._stages(params, world)), -limit, limit)
        dt = jnp.asarray(self.timestep, world.qpos.dtype)

        def move(world: World) -> World:
            legs = [
                dynamics.semi_implicit_euler(leg, dynamics.State(qpos, qvel), held, dt)
                for qpos, qvel, held in zip(*map(_halves, (world.qpos, world.qvel, torque)), strict=True)
            ]
            qpos, qvel = (jnp.concatenate(parts) for parts in zip(*legs, strict=True))
            return world._replace(qpos=qpos, qvel=qvel)

        new = move(world) if substeps == 1 else jax.lax.fori_loop(0, substeps, lambda _, world: move(world), world)
        return new, torque

    def _stages(self, params: Any, world: World) -> Stages:
        def torque_for(qacc: Float[Array, " joints"], mass: FloatScalar) -> Float[Array, " joints"]:
            leg = self.leg.scaled(mass)
            parts = zip(*map(_halves, (world.qpos, world.qvel, qacc)), strict=True)
            return jnp.concatenate([dynamics.inverse_dynamics(leg, *part) for part in parts])

        leg = self.leg.scaled(params.mass)
        both = [dynamics.mass_matrix_and_bias(leg, q, v) for q, v in zip(*map(_halves, world[:2]), strict=True)]
        (right, right_bias), (left, left_bias) = both
        matrix, bias = jax.scipy.linalg.block_diag(right, left), jnp.concatenate([right_bias, left_bias])
        return Stages(world, world.qpos, world.qvel, matrix, bias, torque_for, lambda: no_contacts(2 * LEG))


def _freeze_if_diverged(old: World, new: World) -> World:
    sound = jnp.isfinite(new.qpos).all() & (jnp.abs(new.qvel) <= MAX_SPEED).all()
    stays = old.diverged | ~sound
    frozen = old._replace(diverged=jnp.bool_(True))
    return jax.tree.map(lambda old, new: jnp.where(stays, old, new), frozen, new)


def _halves(x: Float[Array, " joints"]) -> list[Float[Array, " leg"]]:
    return jnp.split(x, 2)


@lru_cache
def _leg(parameters: str, x64: bool) -> tuple[list[np.ndarray], Any]:
    """The leg's values in numpy, which belong to no trace, and its structure."""
    with jax.ensure_compile_time_eval():
        values, tree = jax.tree.flatten(getattr(Leg, parameters)())
    return [np.asarray(value) for value in values], tree
