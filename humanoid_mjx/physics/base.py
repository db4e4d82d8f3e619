"""The protocol of physics: pure functions that move one world, and what they pass around."""

import math
from collections.abc import Callable
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import get_opaque_trace_state
from jaxtyping import Bool, Float
from pydantic import Field

from humanoid_mjx.compute import Arithmetic
from humanoid_mjx.compute.ways import ways
from humanoid_mjx.control.stages import Stages
from humanoid_mjx.robot import Robot
from humanoid_mjx.spec import InputError, Spec
from humanoid_mjx.types import AnyArray, BoolScalar

MAX_SPEED = 300.0
"""rad/s and m/s. Beyond it a world counts as diverged: the torque limit against the damping of the lower body spins a
bare joint at 100 rad/s, and contact forces that have blown up soon reach thousands."""


class World(NamedTuple):
    """The state of one world, or with leading axes of many."""

    qpos: Float[AnyArray, "*worlds nq"]
    """Position, m, and quaternion (w x y z) of the torso where it is free; then the joint angles, rad."""
    qvel: Float[AnyArray, "*worlds nv"]
    """Velocity of the torso in the world, m/s, and its angular velocity in its own frame, rad/s, where it is free; then
    those of the joints, rad/s."""
    warmstart: Float[AnyArray, "*worlds nv"]
    """Accelerations of the last step, from which the search for contact forces starts."""
    diverged: Bool[AnyArray, "*worlds"]
    """Set where a step gave a value that is not finite or faster than `MAX_SPEED`. Such a world stands still at its
    last sound state until it is reset."""


T = TypeVar("T")
SomeTree = TypeVar("SomeTree")


class Once(Generic[T]):
    """Lazy value, cached per trace: one made inside a branch or a loop must not leave it, and is made anew outside."""

    def __init__(self, make: Callable[[], T]) -> None:
        self._make, self._trace = make, get_opaque_trace_state()
        self.made: T | None = None

    def __call__(self) -> T:
        if self.made is not None:
            return self.made
        found = self._make()
        if get_opaque_trace_state() == self._trace:
            self.made = found
        return found


class Readings(NamedTuple):
    """Readings of the sensors."""

    encoders: Float[AnyArray, "*worlds joints"]
    """rad"""
    gyroscope: Float[AnyArray, "*worlds 3"]
    """Angular velocity of the torso in its own frame, rad/s."""
    accelerometer: Float[AnyArray, "*worlds 3"]
    """Acceleration that the torso feels, in its own frame, m/s^2; +9.81 upwards at rest."""
    foot_contact: Float[AnyArray, "*worlds feet"]
    """Normal force of the ground on each foot, N."""


class Poses(NamedTuple):
    """Poses of the bodies in the world."""

    position: Float[AnyArray, "*worlds bodies 3"]
    """Positions of the origins of the bodies' frames, m."""
    rotation: Float[AnyArray, "*worlds bodies 3 3"]
    """Rotations from the bodies' frames to the world."""


class Velocities(NamedTuple):
    """Velocities of the bodies in the world."""

    linear: Float[AnyArray, "*worlds bodies 3"]
    """Velocities of the origins of the bodies' frames, m/s."""
    angular: Float[AnyArray, "*worlds bodies 3"]
    """rad/s"""


class GroundContacts(NamedTuple):
    """The corners of the feet that can touch the ground, foot by foot; none where there is no ground."""

    position: Float[AnyArray, "*worlds points 3"]
    """Positions of the corners' lowest points, m, world."""
    velocity: Float[AnyArray, "*worlds points 3"]
    """Velocities of the same points, m/s, world."""
    normal_force: Float[AnyArray, "*worlds points"]
    """Force with which the ground pushes each corner up, N; 0 where it does not touch."""


class Sensed(NamedTuple):
    """Everything about one world at one moment: the readings of its sensors and the true state of its bodies."""

    readings: Readings
    poses: Poses
    velocities: Velocities
    contacts: GroundContacts
    torque: Float[AnyArray, "*worlds joints"]
    """Torques that act on the actuated joints, N m."""


def worlds_in(data: Any) -> list[World]:
    """Return the worlds in the data of a task's state, wherever they are."""
    leaves = jax.tree.leaves(data, is_leaf=lambda leaf: isinstance(leaf, World))
    return [leaf for leaf in leaves if isinstance(leaf, World)]


def freeze_if_diverged(old: World, new: World) -> World:
    """Return `new`; where it has diverged, `old` with the flag set."""
    sound = jnp.isfinite(new.qpos).all() & (jnp.abs(new.qvel) <= MAX_SPEED).all() & ~new.diverged
    return where(old.diverged | ~sound, old._replace(diverged=jnp.bool_(True)), new)


def where(mask: BoolScalar, chosen: SomeTree, other: SomeTree) -> SomeTree:
    """Return the one pytree, such as a world, where `mask` is true, else the other."""
    return jax.tree.map(lambda a, b: jnp.where(mask, a, b), chosen, other)


Controller = Callable[[Stages], Any]
"""From the stages to the torque of each actuated joint, N m."""


class Physics(Spec):
    """Base of physics. All methods are pure; they are written for one world, and `jax.vmap` makes it many.

    `physics.replace(friction=...)` changes a traced value, which may be an array: under `jax.vmap` each world may have
    its own.
    """

    arithmetic: ClassVar[Arithmetic] = "arrays"
    """Kind of the arithmetic, which chooses XLA's options (`compute.options`)."""

    robot: Robot = Field(description="the robot that moves")

    @property
    def batch(self) -> int:
        """Largest number of worlds to move side by side here."""
        return ways().worlds

    @property
    def step_s(self) -> float:
        """The time step, s."""
        raise NotImplementedError

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The actuated joints in their order."""
        return self.robot.joints

    @property
    def body_names(self) -> tuple[str, ...]:
        """The bodies in the order of `Poses`."""
        raise NotImplementedError

    @property
    def qpos0(self) -> Float[np.ndarray, " nq"]:
        """All joints at zero; a free robot stands."""
        raise NotImplementedError

    def substeps(self, period: float) -> int:
        """Return the number of time steps in a period of a task, s.

        Raises:
          InputError: the period is no multiple of the time step.
        """
        steps = round(period / self.step_s) if math.isfinite(period) else 0
        if steps < 1 or not math.isclose(steps * self.step_s, period, rel_tol=1e-6):
            raise InputError(f"a control cycle of {period} s must be a multiple of the time step of {self.step_s} s.")
        return steps

    def start(self, qpos: Any, qvel: Any) -> World:
        """Return a world in the given state."""
        raise NotImplementedError

    def reset(self, world: World, mask: Any, qpos: Any, qvel: Any) -> World:
        """Return `world`, or where `mask` is true one started anew in the given state."""
        return where(mask, self.start(qpos, qvel), world)

    def step(self, world: World, controller: Controller) -> tuple[World, Any]:
        """Ask the controller for a torque, and move by one time step; return the new world, and the torque that acted,
        N m: the controller's within the torque limit."""
        raise NotImplementedError

    def run(self, world: World, controller: Controller, cycles: int) -> World:
        """Return the world after `cycles` time steps."""

        def cycle(world: World, _: None) -> tuple[World, None]:
            return self.step(world, controller)[0], None

        return jax.lax.scan(cycle, world, length=cycles, unroll=self._unroll(controller, cycles))[0]

    def _unroll(self, controller: Controller, cycles: int) -> int:
        """Time steps in one pass of a compiled loop."""
        return 1

    def run_sensed(self, world: World, controller: Controller, cycles: int) -> tuple[World, Sensed]:
        """Return the world after `cycles` time steps, and everything at the beginning of the last.

        A time step computes everything for its beginning only: its end has no forces yet.
        """

        def cycle(carry: tuple[World, World, Any], _: None) -> tuple[tuple[World, World, Any], None]:
            now = carry[0]
            after, torque = self.step(now, controller)
            return (after, now, torque), None

        first = world, world, jnp.zeros(len(self.joint_names))
        (world, before, torque), _ = jax.lax.scan(cycle, first, length=cycles)
        return world, self.sense(before, torque)

    def sense(self, world: World, torque: Any) -> Sensed:
        """Return everything about this state while `torque` acts."""
        raise NotImplementedError
