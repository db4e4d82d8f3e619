# pyright: reportAttributeAccessIssue=false, reportCallIssue=false
"""The tree written out: MuJoCo's models of hinges, balls and capsules at many times the speed of MJX.

It computes what native MuJoCo does, contacts included (`mechanics.tree`), in plain jax operations on scalars. On a CPU
it is fastest after `runtime.start()` in a `jax.jit` with `compiler_options=runtime.SHARED_KERNELS`, in batches of some
128 worlds for each core.
"""

from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
from jaxtyping import Array, Bool, Float

from humanoid_mjx.mechanics.contacts import Contacts, no_contacts
from humanoid_mjx.mechanics.scalars import Scalar, Vector, stack, unstack
from humanoid_mjx.mechanics.tree import sensing
from humanoid_mjx.mechanics.tree import step as tree_step
from humanoid_mjx.mechanics.tree.algebra import vector
from humanoid_mjx.mechanics.tree.kinematics import Kinematics, make_kinematics, to_local
from humanoid_mjx.mechanics.tree.reading import read_tree
from humanoid_mjx.mechanics.tree.solver import Problem, Solution
from humanoid_mjx.mechanics.tree.structure import Tree
from humanoid_mjx.physics.base import MAX_SPEED, Controller, Poses, Readings, Stages, World
from humanoid_mjx.physics.model import MujocoPhysics
from humanoid_mjx.types import AnyArray, IntScalar, MassFactor


class Velocities(NamedTuple):
    """How the bodies move, in the world."""

    linear: Float[AnyArray, "*worlds bodies 3"]
    """Of their origins, m/s."""
    angular: Float[AnyArray, "*worlds bodies 3"]
    """rad/s"""


class ContactForces(NamedTuple):
    """What the contacts do: those with the ground, then those of pairs of bodies; the forces act on the second body."""

    position: Float[AnyArray, "*worlds contacts 3"]
    """m, world; midway between the surfaces."""
    normal: Float[AnyArray, "*worlds contacts"]
    """N"""
    tangential: Float[AnyArray, "*worlds contacts 3"]
    """N, world."""
    active: Bool[AnyArray, "*worlds contacts"]
    """Whether it pushes."""


class TreePhysics(MujocoPhysics):
    """A tree of hinges, fixed or free, on the ground."""

    @property
    def tree(self) -> Tree:
        """What is fixed while a program is compiled."""
        return _tree(self.model)

    def step(
        self, params: Any, world: World, controller: Controller, substeps: int = 1
    ) -> tuple[World, Float[Array, " joints"]]:
        if substeps == 1:
            state = self._state(params, world)
            torque = self._ask(params, state, world, controller)
            return self._advance(params, state, world, torque), torque

        def substep(carry: tuple[World, Any], index: IntScalar) -> tuple[tuple[World, Any], None]:
            world, torque = carry
            state = self._state(params, world)
            ask = partial(self._ask, params, state, world, controller)
            torque = jax.lax.cond(index == 0, ask, lambda: torque)
            return (self._advance(params, state, world, torque), torque), None

        held = jnp.zeros(len(self.tree.motors))
        return jax.lax.scan(substep, (world, held), jnp.arange(substeps))[0]

    def run(self, params: Any, world: World, controller: Controller, cycles: int, substeps: int = 1) -> World:
        # The state is carried as separate scalars: a batch of them is contiguous, and few kernels compute them all.
        def cycle(carry: list[list[Array]], _: None) -> tuple[list[list[Array]], None]:
            *parts, (diverged,) = carry
            now = World(*(jnp.stack(part) for part in parts), diverged)
            now = self.step(params, now, controller, substeps)[0]
            return [list(now.qpos), list(now.qvel), list(now.warmstart), [now.diverged]], None

        start = [list(world.qpos), list(world.qvel), list(world.warmstart), [world.diverged]]
        *parts, (diverged,) = jax.lax.scan(cycle, start, length=cycles)[0]
        return World(*(jnp.stack(part) for part in parts), diverged)

    def sensors(self, params: Any, world: World, torque: Float[AnyArray, " joints"]) -> Readings:
        tree, state = self.tree, self._state(params, world)
        problem, solution = self._accelerate(params, state, world, torque)
        pushes, gravity = sensing.pushes_of(tree, problem, solution), vector(tree.gravity)
        felt = [sensing.touch_sensor(state, pushes, site) for site in tree.touch_sensors]
        accelerations = [
            sensing.accelerometer(tree, state, solution.acceleration, gravity, site) for site in tree.accelerometers
        ]
        like = world.qpos
        return Readings(
            encoders=like[jnp.array([motor.qpos for motor in tree.motors])],
            gyroscope=_join([part for site in tree.gyroscopes for part in sensing.gyroscope(state, site)], like),
            accelerometer=_join([part for reading in accelerations for part in reading], like),
            foot_contact=_join(felt, like),
        )

    def poses(self, params: Any, world: World) -> Poses:
        at = make_kinematics(self.tree, unstack(world.qpos))
        position = [_in_world(at, pose.position) for pose in at.poses]
        columns = jnp.stack([_rows(list(pose.axes), world.qpos) for pose in at.poses])
        return Poses(_rows(position, world.qpos), jnp.swapaxes(columns, -1, -2))

    def velocities(self, params: Any, world: World) -> Velocities:
        """How the bodies move."""
        found = sensing.velocities_of(self.tree, self._state(params, world))
        return Velocities(
            _rows([motion.linear for motion in found], world.qpos),
            _rows([motion.angular for motion in found], world.qpos),
        )

    def contact_forces(self, params: Any, world: World, torque: Float[AnyArray, " joints"]) -> ContactForces:
        """What the contacts do while `torque` acts."""
        state = self._state(params, world)
        pushes = sensing.pushes_of(self.tree, *self._accelerate(params, state, world, torque))
        normal = _join([push.pressure for push in pushes], world.qpos)
        return ContactForces(
            position=_rows([push.place for push in pushes], world.qpos),
            normal=normal,
            tangential=_rows([push.friction for push in pushes], world.qpos),
            active=normal > 0.0,
        )

    def _values(self, params: Any) -> tree_step.Values:
        push = params.push if self.torso == "free" else None
        return tree_step.Values(self.mass_factors(params.mass), params.friction, params.damping, push=push)

    def _state(self, params: Any, world: World) -> tree_step.State:
        return tree_step.make_state(self.tree, self._values(params), unstack(world.qpos), unstack(world.qvel))

    def _accelerate(
        self, params: Any, state: tree_step.State, world: World, torque: Float[AnyArray, " joints"]
    ) -> tuple[Problem, Solution]:
        limit = jnp.asarray(params.torque_limit, float)
        told = [Scalar(jnp.clip(part, -limit, limit)) for part in jnp.asarray(torque, float)]
        motor = tree_step.motor_forces(self.tree, state, told)
        return tree_step.accelerate(self.tree, self._values(params), state, motor, unstack(world.warmstart))

    def _advance(self, params: Any, state: tree_step.State, world: World, torque: Float[Array, " joints"]) -> World:
        """One time step; a world that diverges in it, or whose contacts were not found, stays where it was."""
        _, solution = self._accelerate(params, state, world, torque)
        parts = tree_step.integrate(self.tree, state, solution.acceleration)
        # Scalar by scalar, as a check of whole arrays would be a kernel of its own between those of the step.
        stays = world.diverged | ~solution.settled
        for value in parts[0]:
            stays = stays | ~jnp.isfinite(value.value)
        for value in parts[1]:
            stays = stays | ~(jnp.abs(value.value) <= MAX_SPEED)
        kept = [
            jnp.stack([jnp.where(stays, old, new.value) for old, new in zip(before, after, strict=True)])
            for before, after in zip((world.qpos, world.qvel, world.warmstart), parts, strict=True)
        ]
        return World(*kept, stays)

    def _ask(
        self, params: Any, state: tree_step.State, world: World, controller: Controller
    ) -> Float[Array, " joints"]:
        limit = jnp.asarray(params.torque_limit, float)
        torque = jnp.asarray(controller(self._stages(params, state, world)), float)
        return jnp.stack([jnp.clip(part, -limit, limit) for part in torque])

    def _stages(self, params: Any, state: tree_step.State, world: World) -> Stages:
        tree, joints, like = self.tree, self.model.nu, world.qpos
        matrix = jnp.stack([_join(row, like) for row in sensing.full_matrix(tree, state)])
        bias = [b - p for b, p in zip(state.bias, state.passive, strict=True)]
        full = _join(to_local(tree, state.kinematics, bias), like)

        def torque_for(qacc: Float[Array, " joints"], mass: MassFactor) -> Float[Array, " joints"]:
            other = self._state(params._replace(mass=mass), world)
            believed = jnp.stack([_join(row, like) for row in sensing.full_matrix(tree, other)])
            held = [b - p for b, p in zip(other.bias, other.passive, strict=True)]
            return believed[-joints:, -joints:] @ qacc + _join(held[-joints:], like)

        contacts = partial(self._contacts, state, like)
        return Stages(world, world.qpos[-joints:], world.qvel[-joints:], matrix, full, torque_for, contacts)

    def _contacts(self, state: tree_step.State, like: Float[Array, " nq"]) -> Contacts:
        """The lowest points of what the ground can push."""
        tree, places, jacobians, drifts = self.tree, [], [], []
        for point in tree.ground:
            center = state.kinematics.place(point.body, point.center)
            place = Vector(*(c - Scalar(point.radius * n) for c, n in zip(center, point.normal, strict=True)))
            places.append(_in_world(state.kinematics, place))
            columns = sensing.point_jacobian(tree, state, point.body, place)
            jacobians.append(jnp.stack([_join([column[i] for column in columns], like) for i in range(3)]))
            drifts.append(sensing.drift_at(state, point.body, place))
        if not places:
            return no_contacts(tree.nv)
        position = _rows(places, like)
        return Contacts(position, jnp.stack(jacobians), _rows(drifts, like), position[:, 2] <= 0.0)


def _in_world(at: Kinematics, place: Vector) -> Vector:
    return Vector(*(o + p for o, p in zip(at.origin, place, strict=True)))


def _join(scalars: list[Scalar], like: Float[Array, " _"]) -> Float[Array, " n"]:
    return stack(scalars, like) if scalars else jnp.zeros(0, like.dtype)


def _rows(vectors: list[Vector], like: Float[Array, " _"]) -> Float[Array, "n 3"]:
    return jnp.stack([stack(v, like) for v in vectors]) if vectors else jnp.zeros((0, 3), like.dtype)


@lru_cache
def _tree(model: mujoco.MjModel) -> Tree:
    with jax.ensure_compile_time_eval():
        tree = read_tree(model)
    # The torque limit is traced, in the place of the model's.
    return tree._replace(motors=tuple(motor._replace(control=None) for motor in tree.motors))
