# pyright: reportAttributeAccessIssue=false, reportCallIssue=false
"""The tree written out: MuJoCo's models of hinges, balls and capsules at many times the speed of MJX.

It computes what native MuJoCo does, contacts included (`mechanics.tree`), in plain jax, of which kernels make numbers.
On a CPU it is fastest after `humanoid_mjx.start()` in a `jax.jit` with `compute.compiler_options("tree")`, in batches
of some 1,000 worlds for each core.
"""

from functools import lru_cache, partial
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float
from pydantic import model_validator

from humanoid_mjx.compute import Arithmetic
from humanoid_mjx.compute.ways import ways
from humanoid_mjx.control.stages import Contacts, Stages, jacobian_of, no_contacts
from humanoid_mjx.kernels import fallback
from humanoid_mjx.kernels.worlds import one_kernel, one_world
from humanoid_mjx.mechanics.tree import sensing
from humanoid_mjx.mechanics.tree import step as mechanics
from humanoid_mjx.mechanics.tree.folding import fold
from humanoid_mjx.mechanics.tree.reading import read_tree
from humanoid_mjx.mechanics.tree.refusing import sensors_of
from humanoid_mjx.mechanics.tree.structure import Tree
from humanoid_mjx.physics.base import MAX_SPEED, Controller, Once, Poses, Sensed, Velocities, World
from humanoid_mjx.physics.model import MujocoPhysics
from humanoid_mjx.robot.description import IMU, ground_points
from humanoid_mjx.types import AnyArray, BoolScalar

UNROLL, WHOLE = 4, 10
"""Time steps in one pass of a loop on a GPU, which copies what a loop carries, each part by a kernel of its own; up to
how many there is no loop."""


class _AsksMore(Exception):
    """A controller asks for more than angles and velocities."""


class TreePhysics(MujocoPhysics):
    """A tree of hinges, fixed or free, on the ground."""

    arithmetic: ClassVar[Arithmetic] = "tree"
    terrains: ClassVar[tuple[tuple[str, ...], ...]] = (("rough", "stairs"),)

    @model_validator(mode="after")
    def _is_a_tree(self) -> "TreePhysics":
        _ = self.tree
        return self

    @property
    def tree(self) -> Tree:
        """Static part of the model, fixed while a program is compiled."""
        tree = _tree(self.model, sensors_of(self.model, IMU))
        return on_stairs(tree) if self.terrain and self.terrain.stairs is not None else tree

    def step(self, world: World, controller: Controller) -> tuple[World, Float[Array, " joints"]]:
        """A world that diverges in the step, or whose contacts were not found, stays where it was."""
        torque = self._ask(world, controller)
        return World(*self._move(_advance, world, torque)), torque

    def run(self, world: World, controller: Controller, cycles: int) -> World:
        return super().run(_batched(world, world), controller, cycles)

    def run_sensed(self, world: World, controller: Controller, cycles: int) -> tuple[World, Sensed]:
        def cycle(carry: tuple[World, Any], last: BoolScalar) -> tuple[tuple[World, Any], None]:
            now = carry[0]
            torque = self._ask(now, controller)
            parts, seen = self._move(_advance_sensed, now, torque, last)
            return (World(*parts), (now.qpos[self.joint_qpos], torque, seen)), None

        last, unroll = jnp.arange(cycles) == cycles - 1, self._unroll(controller, cycles)
        (world, sensed), _ = jax.lax.scan(cycle, _batched((world, self._nothing()), world), last, unroll=unroll)
        return world, self._seen(*jax.tree.map(lambda part: jnp.where(world.diverged, 0.0, part), sensed))

    def sense(self, world: World, torque: Float[AnyArray, " joints"]) -> Sensed:
        torque = self._within(torque)
        seen = self._move(_advance_sensed, world, torque, jnp.bool_(True))[1]
        return self._seen(world.qpos[self.joint_qpos], torque, seen)

    def _seen(self, encoders: Any, torque: Any, seen: tuple[Any, ...]) -> Sensed:
        turning, felt, position, rotation, linear, angular, forces = seen
        poses, velocities = Poses(position, rotation), Velocities(linear, angular)
        return self._sensed(encoders, turning, felt, poses, velocities, forces, torque)

    def _nothing(self) -> tuple[Any, ...]:
        """Return zeros in the shapes of what is sensed, for the start of a loop."""
        bodies, points, joints = self.model.nbody, len(ground_points(self.model)[0]), len(self.tree.motors)
        shapes = (bodies, 3), (bodies, 3, 3), (bodies, 3), (bodies, 3), (points,)
        sensors = (3 * len(self.tree.gyroscopes),), (3 * len(self.tree.accelerometers),)
        return jnp.zeros(joints), jnp.zeros(joints), tuple(jnp.zeros(shape) for shape in (*sensors, *shapes))

    def _values(self) -> mechanics.Values:
        ground, shaped = self.terrain, self.terrain is not None and self.terrain.shaped
        return mechanics.Values(
            mass=self.mass_factors(self.mass),
            friction=jnp.asarray(self.friction, float),
            damping=jnp.asarray(self.damping, float),
            gravity=self.gravity if ground else None,
            push=jnp.stack([jnp.asarray(part, float) for part in self.push]) if self.free else None,
            terrain=jax.tree.map(lambda x: jnp.asarray(x, float), ground) if shaped else None,
        )

    def _state(self, world: World) -> mechanics.State:
        return one_world(_state, self.tree)(self._values(), world.qpos, world.qvel)

    def _move(self, function: Any, world: World, *given: Any) -> Any:
        """`_advance` or `_advance_sensed`, of float32 in one kernel."""
        tree = self.tree
        move = one_kernel(function, tree, lanes=tree.lanes) if _kernels_run() else one_world(function, tree)
        return move(self._values(), tuple(world), *given)

    def _unroll(self, controller: Controller, cycles: int) -> int:
        """Time steps in one pass of a loop; one where the controller is long to compile, and on a CPU."""
        if not ways().steps_unrolled or not _kernels_run() or not self._asks_little(controller):
            return 1
        return cycles if cycles <= WHOLE else UNROLL

    def _asks_little(self, controller: Controller) -> bool:
        """True if the controller asks for no more than angles and velocities."""

        def more(*_: Any) -> Any:
            raise _AsksMore

        state = jax.ShapeDtypeStruct((len(self.joint_names),), jnp.float32)
        try:
            jax.eval_shape(lambda *at: controller(Stages(*at, more, more, more, self.joint_dofs)), state, state)
        except _AsksMore:
            return False
        return True

    def _ask(self, world: World, controller: Controller) -> Float[Array, " joints"]:
        """Return the torque that the controller commands."""
        state = Once(partial(self._state, world))
        dynamics = one_world(sensing.dynamics, self.tree)

        def contacts() -> Contacts:
            if not self.tree.feet:
                return no_contacts(len(world.qvel))
            motion, drifts, *poses = one_world(sensing.moving, self.tree)(state())
            link, arm = self._corners(Poses(*poses))
            position, (spin, rate, linear) = poses[0][link] + arm, jnp.unstack(drifts[link], axis=1)
            drift = linear + jnp.cross(rate, arm) + jnp.cross(spin, jnp.cross(spin, arm))
            origin = world.qpos[:3] if self.free else np.zeros(3)
            jacobian = jacobian_of(position, ground_points(self.model)[1], motion, origin)
            return Contacts(position, jacobian, drift, position[:, 2] <= 0.0)

        return self._within(
            controller(
                self._stages(world, lambda: dynamics(state()), lambda other: dynamics(other._state(world)), contacts)
            )
        )


def _kernels_run() -> bool:
    """True where a kernel computes time steps: in float32 on a CPU or a GPU."""
    return fallback.why_none() is None and not jax.config.read("jax_enable_x64")


def _batched(tree: Any, world: World) -> Any:
    """The same values, each with the axis of worlds under `jax.vmap`: else a loop that carries them is traced twice."""
    same = world.qpos[-1] == world.qpos[-1]
    return jax.tree.map(lambda part: jnp.where(same, part, part), tree)


# The functions below compute one world, in arrays whose last axis has length 1.

Parts = tuple[Any, ...]
"""The parts of `World`, in its order."""


def _state(tree: Tree, values: mechanics.Values, qpos: Any, qvel: Any) -> mechanics.State:
    positions = mechanics.folded(qpos[:, None], tree.coordinates)
    return mechanics.make_state(tree, values, positions, mechanics.folded(qvel[:, None], tree.dofs))


def _stepped(tree: Tree, values: mechanics.Values, world: Parts, torque: Any) -> tuple[Parts, tuple[Any, ...]]:
    """The parts of the world after a time step, which stay where it diverges or its contacts were not found; its state,
    its contact problem and the solution before."""
    *old, diverged = world
    state = _state(tree, values, *old[:2])
    motor, near = mechanics.motor_forces(tree, torque), mechanics.folded(old[2][:, None], tree.dofs)
    problem, solution = mechanics.accelerate(tree, values, state, motor, near, diverged)
    after, settled = mechanics.advance(tree, values, state, solution, motor)
    stays = diverged | ~settled
    stays = stays | ~jnp.isfinite(after[0]).all(axis=0) | ~(jnp.abs(after[1]) <= MAX_SPEED).all(axis=0)
    kept = [jnp.where(stays, before, part) for before, part in zip(old, after, strict=True)]
    return (*kept, stays), (state, problem, solution)


def _advance(*given: Any) -> Parts:
    """One time step."""
    return _stepped(*given)[0]


def _advance_sensed(
    tree: Tree, values: mechanics.Values, world: Parts, torque: Any, last: Any
) -> tuple[Parts, tuple[Any, ...]]:
    """One time step, and what is true at its beginning; where it is not the `last` one, zeros, which cost little."""
    parts, step = _stepped(tree, values, world, torque)

    def seen() -> tuple[Any, ...]:
        found = sensing.sensed(tree, tree.gravity if values.gravity is None else values.gravity, *step)
        return tuple(jnp.broadcast_to(x, (*jnp.shape(x)[:-1], *last.shape)) for x in found)

    nothing = jax.tree.map(jnp.zeros_like, jax.eval_shape(seen))
    return parts, jax.lax.cond(last.any(), seen, lambda: nothing)


@lru_cache
def on_stairs(tree: Tree) -> Tree:
    """The tree with each ground point twice: once for each of the two steps that it may touch at a time."""
    count = sum(len(points.order) for points in tree.ground)
    upper = (p._replace(upper=True, order=tuple(count + index for index in p.order)) for p in tree.ground)
    feet = tuple((*foot, *(count + index for index in foot)) for foot in tree.feet)
    return tree._replace(ground=(*tree.ground, *upper), feet=feet)


@lru_cache
def _tree(model: mujoco.MjModel, sensors: tuple[str, ...]) -> Tree:
    with jax.ensure_compile_time_eval():
        return fold(read_tree(model, sensors, ground_points(model)[0].tolist()))
