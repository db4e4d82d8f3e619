"""A tree in one state, and one time step of it: what MuJoCo computes, for models that `reading` takes."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx.mechanics.terrain import Terrain
from humanoid_mjx.mechanics.tree.algebra import column, cross, dot, folded, numbers, unfolded
from humanoid_mjx.mechanics.tree.cones import Cone
from humanoid_mjx.mechanics.tree.contacts import Friction, ground_touch, pair_gap_at, slip_of, stop_of
from humanoid_mjx.mechanics.tree.inertia import (
    Drift,
    Mass,
    Matrix,
    bias_forces,
    drifts_of,
    factor,
    mass_matrix,
    masses_of,
    product,
    with_diagonal,
)
from humanoid_mjx.mechanics.tree.kinematics import Kinematics, make_kinematics, motions_of, to_local, to_world, unit
from humanoid_mjx.mechanics.tree.problem import Problem, Solution
from humanoid_mjx.mechanics.tree.search import search
from humanoid_mjx.mechanics.tree.structure import FRICTIONLESS, Surface, Tree


class Values(NamedTuple):
    """Parameters of a tree that may be traced, one value a world if need be. None: the model's own constant."""

    mass: Any = None
    """(bodies,) factors on each body's mass and inertia, the world's being of no use."""
    friction: Any = None
    """Factor on the coefficients of friction of all contacts that have any."""
    damping: Any = None
    """Factor on the joints' damping."""
    gravity: Any = None
    """(3,) m/s^2"""
    push: Any = None
    """(3,) N, at the origin of the free body, in the world."""
    terrain: Terrain | None = None
    """Waves and steps of the ground, which is level plane without; a slope is for `gravity`."""


class State(NamedTuple):
    """A tree's state by coordinate and degree of freedom, and what depends on position and velocity alone."""

    qpos: list[Any]
    qvel: list[Any]
    kinematics: Kinematics
    velocity: list[Any]
    """As `qvel`, the free body's angular velocity in the world's axes."""
    motions: list[Any]
    """Velocities of the bodies, about the origin."""
    masses: list[Mass]
    drifts: list[Drift]
    matrix: Matrix
    bias: list[Any]
    """Velocity terms and gravity, in the world's axes."""
    damping: list[Any]
    passive: list[Any]
    """Forces of the joints' damping and springs."""


def make_state(tree: Tree, values: Values, qpos: list[Any], qvel: list[Any]) -> State:
    """The stages of position and velocity."""
    kinematics = make_kinematics(tree, qpos)
    velocity = to_world(tree, kinematics, qvel)
    factors = [1.0] * len(tree.bodies) if values.mass is None else folded(values.mass[:, None], tree.body_places)
    masses = masses_of(tree, kinematics, factors)
    drifts = drifts_of(tree, kinematics, velocity)
    gravity = numbers(tree.gravity) if values.gravity is None else values.gravity[:, None]
    damping, armature, passive = ([np.zeros((1, 1))] * tree.nv for _ in range(3))
    for joint in tree.joints:
        dof, stretch = joint.dof, qpos[joint.coordinate] - numbers(joint.spring)
        armature[dof] = numbers(joint.armature)
        damping[dof] = numbers(joint.damping) * (1.0 if values.damping is None else values.damping)
        passive[dof] = -(damping[dof] * qvel[dof]) - numbers(joint.stiffness) * stretch
    if tree.drag:
        armature[:6] = [numbers(tree.drag.armature)] * 6
        damping[:6] = [numbers(tree.drag.damping) * (1.0 if values.damping is None else values.damping)] * 6
        passive[:6] = [-(each * speed) for each, speed in zip(damping[:6], velocity[:6], strict=True)]
    moving = velocity, motions_of(tree, kinematics, velocity), masses, drifts
    matrix = mass_matrix(tree, kinematics, masses, armature)
    bias = bias_forces(tree, kinematics, masses, drifts, gravity)
    return State(qpos, qvel, kinematics, *moving, matrix, bias, damping, passive)


def motor_forces(tree: Tree, torque: Any) -> list[Any]:
    """Forces of all motors on the degrees of freedom, N m, from the torque of each motor's joint."""
    forces = [jnp.zeros((1,), torque.dtype)] * sum(map(len, tree.dofs))
    for dof, one in zip(tree.motors, torque, strict=True):
        forces[dof] = forces[dof] + one
    return folded(jnp.stack(forces)[:, None], tree.dofs)


def advance(
    tree: Tree, values: Values, state: State, solution: Solution, motor: Sequence[Any]
) -> tuple[list[Any], Any]:
    """One time step by the model's integrator: `qpos`, `qvel` and the accelerations of its beginning in the axes of
    `qvel`, and whether the solver settled."""
    settled = solution.settled
    if tree.integrator == "RK4":
        parts, settled = _runge_kutta(tree, values, state, solution, motor)
    else:
        parts = integrate(tree, state, solution.acceleration)
    places = tree.coordinates, tree.dofs, tree.dofs
    return [jnp.concatenate(unfolded(part, where)) for part, where in zip(parts, places, strict=True)], settled


def _runge_kutta(
    tree: Tree, values: Values, state: State, solution: Solution, motor: Sequence[Any]
) -> tuple[tuple[list[Any], list[Any], list[Any]], Any]:
    """Runge and Kutta's step of order 4, as MuJoCo 4 takes it; three more states are solved in a loop."""
    step, local = tree.timestep, to_local(tree, state.kinematics, solution.acceleration)

    def full(parts: Sequence[Any]) -> list[Any]:
        whole = (tree.lanes if tree.laned(dof) else 1 for dof in range(tree.nv))
        return [jnp.broadcast_to(part, (lanes, 1)) for part, lanes in zip(parts, whole, strict=True)]

    def stage(carry: tuple[Any, ...], at: tuple[Any, Any]) -> tuple[tuple[Any, ...], None]:
        rate, change, *sums, settled = carry
        time, weight = at
        qpos = moved_by(tree, state.qpos, rate, time)
        qvel = [v + time * value for v, value in zip(state.qvel, change, strict=True)]
        now = make_state(tree, values, qpos, qvel)
        found = accelerate(tree, values, now, motor, change)[1]
        rate = full(_at_start(tree, qvel, [time * value for value in rate]))
        change = full(to_local(tree, now.kinematics, found.acceleration))
        sums = [[a + weight * b for a, b in zip(*both, strict=True)] for both in zip(sums, (rate, change), strict=True)]
        return (rate, change, *sums, settled & found.settled), None

    first = full(state.qvel), full(local)
    carry = *first, *([value / 6.0 for value in part] for part in first), jnp.broadcast_to(solution.settled, (1,))
    dtype = first[0][0].dtype
    times, weights = tree.timestep * np.array([0.5, 0.5, 1.0]), np.array([2.0, 2.0, 1.0]) / 6.0
    (_, _, rate, change, settled), _ = jax.lax.scan(stage, carry, (times.astype(dtype), weights.astype(dtype)))
    qvel = [v + step * value for v, value in zip(state.qvel, change, strict=True)]
    return (moved_by(tree, state.qpos, rate, step), qvel, local), settled


def _at_start(tree: Tree, qvel: Sequence[Any], way: Sequence[Any]) -> list[Any]:
    """Velocities after a way from the start as rates of that way: those of a free body's turns do not add up as vectors
    (H. Munthe-Kaas, "High order Runge-Kutta methods on manifolds", Applied Numerical Mathematics 29, 1999)."""
    if tree.free is None:
        return list(qvel)
    turn, speed = column(way[3:6]), column(qvel[3:6])
    across, square = cross(turn, speed), dot(turn, turn)
    # (1 - x cot x) / 4 x^2 at half the angle x, by its series.
    share: Any = 0.0
    for term in (1 / 47900160, 1 / 1209600, 1 / 30240, 1 / 720, 1 / 12):
        share = term + square * share
    return [*qvel[:3], *(speed + (0.5 * across + share * cross(turn, across))), *qvel[6:]]


def accelerate(
    tree: Tree, values: Values, state: State, motor: Sequence[Any], warmstart: Sequence[Any], ended: Any = False
) -> tuple[Problem, Solution]:
    """The accelerations, and the problem that they solve; both with the free body's in the world's axes.

    `motor`: forces of the motors on the degrees of freedom, N m. `warmstart`: accelerations near the solution, in the
    axes of `qvel`. `ended`: true where a solution is of no use.
    """
    force = [m + p - b for m, p, b in zip(motor, state.passive, state.bias, strict=True)]
    if values.push is not None and tree.free is not None:
        force[:3] = [f + p for f, p in zip(force[:3], values.push[:, None], strict=True)]
    at, start = state.kinematics, to_world(tree, state.kinematics, warmstart)
    frictions = _frictions([p.surface for p in tree.ground], values.friction)
    each = zip(tree.ground, frictions, strict=True)
    ground = [ground_touch(tree, points, at, state.motions, friction, values.terrain) for points, friction in each]
    each = zip(tree.pairs, _frictions([p.surface for p in tree.pairs], values.friction, (1, 1)), strict=True)
    pairs = [(pair_gap_at(some, at), friction) for some, friction in each]
    stops = {
        joint.dof: stop_of(joint.limit, state.qpos[joint.coordinate], state.qvel[joint.dof])
        for joint in tree.joints
        if joint.limit is not None
    }
    slips = {joint.dof: slip_of(joint.dry, state.qvel[joint.dof]) for joint in tree.joints if joint.dry is not None}
    for part, dry in enumerate(tree.drag.dry if tree.drag else ()):
        slips |= {dof: slip_of(dry, state.qvel[dof]) for dof in range(3 * part, 3 * part + 3)}
    problem = Problem(state.matrix, force, at, state.velocity, ground, pairs, stops, slips, ended)
    if not (ground or pairs or stops or slips):
        return problem, Solution(factor(tree, state.matrix).solve(force), jnp.bool_(True))
    return problem, Solution(*search(tree, problem, start))


def integrate(tree: Tree, state: State, acceleration: Sequence[Any]) -> tuple[list[Any], list[Any], list[Any]]:
    """One step of semi-implicit Euler: the new `qpos` and `qvel`, and the solver's accelerations in the axes of `qvel`.

    Where the damping is taken at the end of the step, `(M + timestep B) change = timestep M qacc`.
    """
    local = moved = to_local(tree, state.kinematics, acceleration)
    dt = tree.timestep
    if tree.integrator == "damped":
        matrix = [with_diagonal(row, dt * more) for row, more in zip(state.matrix, state.damping, strict=True)]
        slowed = factor(tree, matrix).solve(product(tree, state.matrix, acceleration))
        moved = to_local(tree, state.kinematics, slowed)
    qvel = [v + dt * a for v, a in zip(state.qvel, moved, strict=True)]
    return moved_by(tree, state.qpos, qvel, dt), qvel, local


def moved_by(tree: Tree, qpos: Sequence[Any], qvel: Sequence[Any], time: Any) -> list[Any]:
    """The coordinates after moving at these velocities for so long, s."""
    found = list(qpos)
    if tree.free is not None:
        found[:3] = [x + time * v for x, v in zip(qpos[:3], qvel[:3], strict=True)]
        found[3:7] = turned(unit(column(qpos[3:7])), column(qvel[3:6]), time)
    for joint in tree.joints:
        found[joint.coordinate] = qpos[joint.coordinate] + time * qvel[joint.dof]
    return found


def turned(quaternion: Any, velocity: Any, time: Any) -> list[Any]:
    """A unit quaternion after turning at `velocity` rad/s, in its own frame, for so long.

    Cosine and sine of half the angle by their series, which need no division: their error is 1e-17 of an angle below
    0.3 rad, and below that of float32 up to 1.5 rad.
    """
    half = 0.5 * time
    square = dot(velocity, velocity) * half * half
    cosine, sine = _series(square, (2, 4, 6, 8, 10, 12)), half * _series(square, (3, 5, 7, 9, 11, 13))
    x, y, z = jnp.unstack(sine * velocity)
    a, b, c, d = jnp.unstack(quaternion)
    return [
        a * cosine - b * x - c * y - d * z,
        b * cosine + a * x + c * z - d * y,
        c * cosine + a * y + d * x - b * z,
        d * cosine + a * z + b * y - c * x,
    ]


def _series(square: Any, factorials: Sequence[int]) -> Any:
    """1 - square / f0! + square^2 / f1! - ..., nested."""
    found: Any = 1.0
    for upper, lower in zip(reversed(factorials), [*reversed(factorials[:-1]), factorials[0] - 2], strict=True):
        found = 1.0 - square * (math.factorial(lower) / math.factorial(upper)) * found
    return found


def _frictions(surfaces: Sequence[Surface], given: Any, behind: tuple[int, ...] = (1,)) -> list[Friction]:
    """Coefficients of friction of surfaces; equal ones share theirs. `behind`: see `numbers`."""
    factor = 1.0 if given is None else given
    values = {value: factor * numbers(value, behind) for surface in surfaces for value in surface.friction or ()}
    if given is not None:
        values = {value: jnp.maximum(found, FRICTIONLESS) for value, found in values.items()}
    pairs = [surface.friction and (values[surface.friction[0]], values[surface.friction[1]]) for surface in surfaces]
    each = zip(surfaces, pairs, strict=True)
    return [Cone.of(*pair, surface.impratio) if pair and surface.elliptic else pair for surface, pair in each]
