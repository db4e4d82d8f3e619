# pyright: reportAttributeAccessIssue=false, reportCallIssue=false
"""The tree written out: MuJoCo's models of hinges, balls and capsules at many times the speed of MJX.

It computes what native MuJoCo does, contacts included (`mechanics.tree`), in plain jax operations on scalars. On a CPU
it is fastest after `runtime.start()` in a `jax.jit` with `compiler_options=runtime.SHARED_KERNELS`, in batches of some
128 worlds for each core.
"""

from collections.abc import Sequence
from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
from jaxtyping import Array, Float

from humanoid_mjx.mechanics.contacts import Contacts, no_contacts
from humanoid_mjx.mechanics.scalars import Scalar, Vector, stack, unstack
from humanoid_mjx.mechanics.tree import sensing
from humanoid_mjx.mechanics.tree import step as tree_step
from humanoid_mjx.mechanics.tree.algebra import vector, velocity_at
from humanoid_mjx.mechanics.tree.kinematics import Kinematics, make_kinematics, to_local
from humanoid_mjx.mechanics.tree.reading import read_tree
from humanoid_mjx.mechanics.tree.solver import Problem, Solution
from humanoid_mjx.mechanics.tree.structure import GroundPoint, Tree
from humanoid_mjx.physics.base import (
    MAX_SPEED,
    Controller,
    GroundContacts,
    Poses,
    Readings,
    Sensed,
    Stages,
    Velocities,
    World,
)
from humanoid_mjx.physics.model import MujocoPhysics
from humanoid_mjx.types import AnyArray, IntScalar, MassFactor


class TreePhysics(MujocoPhysics):
    """A tree of hinges, fixed or free, on the ground."""

    @property
    def tree(self) -> Tree:
        """What is fixed while a program is compiled."""
        return _tree(self.model)

    def step(self, world: World, controller: Controller, substeps: int = 1) -> tuple[World, Float[Array, " joints"]]:
        if substeps == 1:
            state = self._state(world)
            torque = self._ask(state, world, controller)
            return self._advance(state, world, torque), torque

        def substep(carry: tuple[World, Any], index: IntScalar) -> tuple[tuple[World, Any], None]:
            world, torque = carry
            state = self._state(world)
            ask = partial(self._ask, state, world, controller)
            torque = jax.lax.cond(index == 0, ask, lambda: torque)
            return (self._advance(state, world, torque), torque), None

        held = jnp.zeros(len(self.tree.motors))
        return jax.lax.scan(substep, (world, held), jnp.arange(substeps))[0]

    def run(self, world: World, controller: Controller, cycles: int, substeps: int = 1) -> World:
        # The state is carried as separate scalars: a batch of them is contiguous, and few kernels compute them all.
        def cycle(carry: list[list[Array]], _: None) -> tuple[list[list[Array]], None]:
            *parts, (diverged,) = carry
            now = World(*(jnp.stack(part) for part in parts), diverged)
            now = self.step(now, controller, substeps)[0]
            return [list(now.qpos), list(now.qvel), list(now.warmstart), [now.diverged]], None

        start = [list(world.qpos), list(world.qvel), list(world.warmstart), [world.diverged]]
        *parts, (diverged,) = jax.lax.scan(cycle, start, length=cycles)[0]
        return World(*(jnp.stack(part) for part in parts), diverged)

    def run_sensed(self, world: World, controller: Controller, cycles: int) -> tuple[World, Sensed]:
        # Scalar by scalar, as in `run`; what is sensed is stacked after the last cycle.
        def cycle(carry: tuple[Any, Any], _: None) -> tuple[tuple[Any, Any], None]:
            now = World(*(jnp.stack(part) for part in carry[0][:-1]), carry[0][-1])
            state = self._state(now)
            torque = self._ask(state, now, controller)
            problem, solution = self._accelerate(state, now, torque)
            after = self._integrated(state, now, solution)
            sensed = self._sensed(state, problem, solution, now, torque)
            sensed = jax.tree.map(lambda new, old: jnp.where(after.diverged, old, new), sensed, carry[1])
            return ((list(after.qpos), list(after.qvel), list(after.warmstart), after.diverged), sensed), None

        start = list(world.qpos), list(world.qvel), list(world.warmstart), world.diverged
        (parts, sensed), _ = jax.lax.scan(cycle, (start, self._nothing(world.qpos)), length=cycles)
        return World(*(jnp.stack(part) for part in parts[:-1]), parts[-1]), _stacked(sensed)

    def sense(self, world: World, torque: Float[AnyArray, " joints"]) -> Sensed:
        state = self._state(world)
        problem, solution = self._accelerate(state, world, torque)
        return _stacked(self._sensed(state, problem, solution, world, torque))

    def poses(self, world: World) -> Poses:
        return _stacked(_poses(make_kinematics(self.tree, unstack(world.qpos)), world.qpos))

    def _sensed(
        self,
        state: tree_step.State,
        problem: Problem,
        solution: Solution,
        world: World,
        torque: Float[AnyArray, " joints"],
    ) -> Any:
        """A `Sensed` whose arrays are nested lists of scalars."""
        tree, like, gravity = self.tree, world.qpos, vector(self.tree.gravity)
        pushes, moved = sensing.pushes_of(tree, problem, solution), sensing.velocities_of(tree, state)
        feet = tree.touch_sensors[: len(tree.touch_sensors) - len(tree.ground)]
        felt = [
            sensing.accelerometer(tree, state, solution.acceleration, gravity, site) for site in tree.accelerometers
        ]
        readings = Readings(
            encoders=[like[motor.qpos] for motor in tree.motors],
            gyroscope=_values([x for site in tree.gyroscopes for x in sensing.gyroscope(state, site)], like),
            accelerometer=_values([x for reading in felt for x in reading], like),
            foot_contact=_values([sensing.touch_sensor(state, pushes, site) for site in feet], like),
        )
        lowest = [(point.body, self._lowest(state, point)) for point in tree.ground]
        contacts = GroundContacts(
            position=[_values(_in_world(state.kinematics, place), like) for _, place in lowest],
            velocity=[_values(velocity_at(state.motions[body], place), like) for body, place in lowest],
            normal_force=_values([push.pressure for push in pushes[: len(lowest)]], like),
        )
        velocities = Velocities(
            [_values(motion.linear, like) for motion in moved], [_values(motion.angular, like) for motion in moved]
        )
        return Sensed(readings, _poses(state.kinematics, like), velocities, contacts, list(torque))

    def _nothing(self, like: Float[Array, " nq"]) -> Any:
        """What is sensed before anything is, in the structure of `_sensed`."""
        bodies, points, joints = self.model.nbody, len(self.tree.ground), len(self.tree.motors)
        zero, triple = jnp.zeros((), like.dtype), [jnp.zeros((), like.dtype)] * 3
        feet = len(self.tree.touch_sensors) - points
        return Sensed(
            Readings([zero] * joints, triple, triple, [zero] * feet),
            Poses([triple] * bodies, [[triple] * 3] * bodies),
            Velocities([triple] * bodies, [triple] * bodies),
            GroundContacts([triple] * points, [triple] * points, [zero] * points),
            [zero] * joints,
        )

    def _values(self) -> tree_step.Values:
        push = self.push if self.torso == "free" else None
        return tree_step.Values(self.mass_factors(self.mass), self.friction, self.damping, push=push)

    def _state(self, world: World) -> tree_step.State:
        return tree_step.make_state(self.tree, self._values(), unstack(world.qpos), unstack(world.qvel))

    def _accelerate(
        self, state: tree_step.State, world: World, torque: Float[AnyArray, " joints"]
    ) -> tuple[Problem, Solution]:
        limit = jnp.asarray(self.torque_limit, float)
        told = [Scalar(jnp.clip(part, -limit, limit)) for part in jnp.asarray(torque, float)]
        motor = tree_step.motor_forces(self.tree, state, told)
        return tree_step.accelerate(self.tree, self._values(), state, motor, unstack(world.warmstart))

    def _advance(self, state: tree_step.State, world: World, torque: Float[Array, " joints"]) -> World:
        """One time step."""
        return self._integrated(state, world, self._accelerate(state, world, torque)[1])

    def _integrated(self, state: tree_step.State, world: World, solution: Solution) -> World:
        """The world after a time step; one that diverges in it, or whose contacts were not found, stays as it was."""
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

    def _ask(self, state: tree_step.State, world: World, controller: Controller) -> Float[Array, " joints"]:
        limit = jnp.asarray(self.torque_limit, float)
        torque = jnp.asarray(controller(self._stages(state, world)), float)
        return jnp.stack([jnp.clip(part, -limit, limit) for part in torque])

    def _stages(self, state: tree_step.State, world: World) -> Stages:
        tree, joints, like = self.tree, self.model.nu, world.qpos
        matrix = jnp.stack([_join(row, like) for row in sensing.full_matrix(tree, state)])
        bias = [b - p for b, p in zip(state.bias, state.passive, strict=True)]
        full = _join(to_local(tree, state.kinematics, bias), like)

        def model_for(mass: MassFactor) -> tuple[Float[Array, "nv nv"], Float[Array, " nv"]]:
            other = self.replace(mass=mass)._state(world)
            believed = jnp.stack([_join(row, like) for row in sensing.full_matrix(tree, other)])
            held = [b - p for b, p in zip(other.bias, other.passive, strict=True)]
            return believed, _join(to_local(tree, other.kinematics, held), like)

        def torque_for(qacc: Float[Array, " joints"], mass: MassFactor) -> Float[Array, " joints"]:
            believed, held = model_for(mass)
            return believed[-joints:, -joints:] @ qacc + held[-joints:]

        contacts = partial(self._contacts, state, like)
        return Stages(world, world.qpos[-joints:], world.qvel[-joints:], matrix, full, torque_for, contacts, model_for)

    def _lowest(self, state: tree_step.State, point: GroundPoint) -> Vector:
        """The point of a ball that is nearest to the ground, against the origin."""
        center = state.kinematics.place(point.body, point.center)
        return Vector(*(c - Scalar(point.radius * n) for c, n in zip(center, point.normal, strict=True)))

    def _contacts(self, state: tree_step.State, like: Float[Array, " nq"]) -> Contacts:
        """The lowest points of what the ground can push."""
        tree, places, jacobians, drifts = self.tree, [], [], []
        for point in tree.ground:
            place = self._lowest(state, point)
            places.append(_in_world(state.kinematics, place))
            columns = sensing.point_jacobian(tree, state, point.body, place)
            jacobians.append(jnp.stack([_join([column[i] for column in columns], like) for i in range(3)]))
            drifts.append(sensing.drift_at(state, point.body, place))
        if not places:
            return no_contacts(tree.nv)
        position = _rows(places, like)
        return Contacts(position, jnp.stack(jacobians), _rows(drifts, like), position[:, 2] <= 0.0)


def _poses(at: Kinematics, like: Float[Array, " nq"]) -> Any:
    """`Poses` whose arrays are nested lists of scalars."""
    rotations = [[_values([axis[i] for axis in pose.axes], like) for i in range(3)] for pose in at.poses]
    return Poses([_values(_in_world(at, pose.position), like) for pose in at.poses], rotations)


def _values(scalars: Sequence[Scalar], like: Float[Array, " _"]) -> list[Any]:
    """The scalars as arrays of jax."""
    return [jnp.asarray(scalar.value, like.dtype) for scalar in scalars]


def _stacked(tree: Any) -> Any:
    """Nested lists of scalars, in whatever holds them, as arrays."""
    if isinstance(tree, list):
        return jnp.stack([_stacked(part) for part in tree]) if tree else jnp.zeros(0)
    return type(tree)(*map(_stacked, tree)) if isinstance(tree, tuple) else tree


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
