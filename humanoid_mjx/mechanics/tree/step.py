"""A tree in one state, and one time step of it: what MuJoCo computes, for models that `reading` takes."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp

from humanoid_mjx.mechanics.scalars import HALF, ONE, ZERO, Scalar, Vector, dot
from humanoid_mjx.mechanics.tree.algebra import Spatial, in_lanes, lane, number, vector
from humanoid_mjx.mechanics.tree.bias import Drift, bias_forces, drifts_of
from humanoid_mjx.mechanics.tree.contacts import (
    Friction,
    friction_of,
    ground_touches,
    pair_touches,
    stop_of,
)
from humanoid_mjx.mechanics.tree.inertia import Mass, Matrix, factor, mass_matrix, masses_of, product
from humanoid_mjx.mechanics.tree.kinematics import Kinematics, make_kinematics, motions_of, to_local, to_world, unit
from humanoid_mjx.mechanics.tree.search import Problem
from humanoid_mjx.mechanics.tree.solver import Solution, solve
from humanoid_mjx.mechanics.tree.structure import FRICTIONLESS, Number, Surface, Tree


class Values(NamedTuple):
    """What of a tree may be traced, one value for each world if need be. None: the model's own, known while tracing."""

    mass: Any = None
    """(bodies,) factors on each body's mass and inertia, the world's being of no use."""
    friction: Any = None
    """Factor on the coefficients of friction of all contacts that have any."""
    damping: Any = None
    """Factor on the joints' damping."""
    armature: Any = None
    """Factor on the joints' armature."""
    gravity: Any = None
    """(3,) m/s^2"""
    push: Any = None
    """(3,) N, at the origin of the free body, in the world."""


class State(NamedTuple):
    """A tree's state as scalars, and what depends on position and velocity alone."""

    qpos: list[Scalar]
    qvel: list[Scalar]
    kinematics: Kinematics
    velocity: list[Scalar]
    """As `qvel`, the free body's angular velocity in the world's axes."""
    motions: list[Spatial]
    """Velocities of the bodies, about the origin."""
    masses: list[Mass]
    drifts: list[Drift]
    matrix: Matrix
    bias: list[Scalar]
    """Velocity terms and gravity, in the world's axes."""
    damping: list[Scalar]
    passive: list[Scalar]
    """Forces of the joints' damping and springs."""


def make_state(tree: Tree, values: Values, qpos: Sequence[Scalar], qvel: Sequence[Scalar]) -> State:
    """The stages of position and velocity."""
    kinematics = make_kinematics(tree, qpos)
    velocity = to_world(tree, kinematics, qvel)
    masses = masses_of(tree, kinematics, _factors(tree, values.mass))
    drifts = drifts_of(tree, kinematics, velocity)
    gravity = vector(tree.gravity if values.gravity is None else values.gravity)
    damping = _joint_values(tree, [hinge.damping for hinge in tree.hinges], values.damping)
    armature = _joint_values(tree, [hinge.armature for hinge in tree.hinges], values.armature)
    passive = [-(damping[dof] * qvel[dof]) for dof in range(tree.nv)]
    for hinge in tree.hinges:
        stretch = qpos[hinge.coordinate] - number(hinge.spring)
        passive[hinge.dof] = passive[hinge.dof] - number(hinge.stiffness) * stretch
    return State(
        list(qpos),
        list(qvel),
        kinematics,
        velocity,
        motions_of(tree, kinematics, velocity),
        masses,
        drifts,
        mass_matrix(tree, kinematics, masses, armature),
        bias_forces(tree, kinematics, masses, drifts, gravity),
        damping,
        passive,
    )


def folded(scalars: Sequence[Scalar], places: Sequence[tuple[int, ...]]) -> list[Scalar]:
    """The tree's coordinates or degrees of freedom, those of lanes together, from `qpos` or `qvel`."""
    return [in_lanes([scalars[index] for index in lanes]) for lanes in places]


def unfolded(scalars: Sequence[Scalar], places: Sequence[tuple[int, ...]]) -> list[Scalar]:
    """The inverse of `folded`."""
    found = {index: lane(s, i) for s, lanes in zip(scalars, places, strict=True) for i, index in enumerate(lanes)}
    return [found[index] for index in range(len(found))]


def motor_forces(tree: Tree, qpos: Sequence[Scalar], qvel: Sequence[Scalar], control: Sequence[Scalar]) -> list[Scalar]:
    """Forces of all motors on the degrees of freedom of `qvel`, N m; `control` is what each motor is told."""
    forces = [ZERO] * len(qvel)
    for motor, told in zip(tree.motors, control, strict=True):
        gear = Scalar(motor.gear)
        force = Scalar(motor.gain) * _within(motor.control, told) + Scalar(motor.bias[0])
        force = force + Scalar(motor.bias[1]) * gear * qpos[motor.qpos]
        force = force + Scalar(motor.bias[2]) * gear * qvel[motor.dof]
        forces[motor.dof] = forces[motor.dof] + gear * _within(motor.force, force)
    return forces


def accelerate(
    tree: Tree, values: Values, state: State, motor: Sequence[Scalar], warmstart: Sequence[Scalar]
) -> tuple[Problem, Solution]:
    """The accelerations, and the problem that they solve; both with the free body's in the world's axes.

    Args:
      motor: what acts on the degrees of freedom, N m.
      warmstart: accelerations near the solution, in the axes of `qvel`.
    """
    force = [m + p - b for m, p, b in zip(motor, state.passive, state.bias, strict=True)]
    if values.push is not None and tree.free is not None:
        force[:3] = [f + p for f, p in zip(force[:3], vector(values.push), strict=True)]
    start = to_world(tree, state.kinematics, warmstart)
    problem = make_problem(tree, values, state, force)
    if not (problem.ground or problem.pairs or problem.stops):
        return problem, Solution(factor(tree, state.matrix).solve(force), jnp.bool_(True))
    return problem, solve(tree, problem, start)


def make_problem(tree: Tree, values: Values, state: State, force: list[Scalar]) -> Problem:
    """The contacts and limits of a state, and the forces that meet them."""
    at = state.kinematics
    ground = ground_touches(tree, at, state.motions, _frictions([p.surface for p in tree.ground], values.friction))
    pairs = pair_touches(tree, at, state.motions, _frictions([p.surface for p in tree.pairs], values.friction))
    stops = {
        hinge.dof: stop_of(hinge.limit, state.qpos[hinge.coordinate], state.qvel[hinge.dof])
        for hinge in tree.hinges
        if hinge.limit is not None
    }
    return Problem(state.matrix, force, at, ground, pairs, stops)


def integrate(
    tree: Tree, state: State, acceleration: Sequence[Scalar]
) -> tuple[list[Scalar], list[Scalar], list[Scalar]]:
    """One step of semi-implicit Euler: the new `qpos` and `qvel`, and the accelerations in the axes of `qvel`.

    Where the model takes its joints' damping at the end of the step, `(M + timestep B) change = timestep M qacc`.
    """
    local = moved = to_local(tree, state.kinematics, acceleration)
    dt = Scalar(tree.timestep)
    if tree.implicit_damping:
        matrix = [list(row) for row in state.matrix]
        for dof in range(tree.nv):
            matrix[dof][dof] = matrix[dof][dof] + dt * state.damping[dof]
        slowed = factor(tree, matrix).solve(product(tree, state.matrix, acceleration))
        moved = to_local(tree, state.kinematics, slowed)
    qvel = [v + dt * a for v, a in zip(state.qvel, moved, strict=True)]
    qpos = list(state.qpos)
    if tree.free is not None:
        qpos[:3] = [x + dt * v for x, v in zip(qpos[:3], qvel[:3], strict=True)]
        qpos[3:7] = turned(unit(qpos[3:7]), Vector(*qvel[3:6]), dt)
    for hinge in tree.hinges:
        qpos[hinge.coordinate] = qpos[hinge.coordinate] + dt * qvel[hinge.dof]
    return qpos, qvel, local


def turned(quaternion: Sequence[Scalar], velocity: Vector, time: Scalar) -> list[Scalar]:
    """A unit quaternion after turning at `velocity` rad/s, in its own frame, for so long.

    Cosine and sine of half the angle by their series, which need no division: their error is 1e-17 of an angle below
    0.3 rad, and below that of float32 up to 1.5 rad.
    """
    half = HALF * time
    square = dot(velocity, velocity) * half * half
    cosine, sine = _series(square, (2, 4, 6, 8, 10, 12)), half * _series(square, (3, 5, 7, 9, 11, 13))
    x, y, z = (sine * part for part in velocity)
    a, b, c, d = quaternion
    return [
        a * cosine - b * x - c * y - d * z,
        b * cosine + a * x + c * z - d * y,
        c * cosine + a * y + d * x - b * z,
        d * cosine + a * z + b * y - c * x,
    ]


def _series(square: Scalar, factorials: Sequence[int]) -> Scalar:
    """1 - square / f0! + square^2 / f1! - ..., nested."""
    found = ONE
    for upper, lower in zip(reversed(factorials), [*reversed(factorials[:-1]), factorials[0] - 2], strict=True):
        found = ONE - square * Scalar(math.factorial(lower) / math.factorial(upper)) * found
    return found


def _factors(tree: Tree, mass: Any) -> list[Scalar]:
    if mass is None:
        return [ONE] * len(tree.bodies)
    return [in_lanes([number(mass[i]) for i in places]) for places in tree.body_places]


def _joint_values(tree: Tree, own: Sequence[Number], given: Any) -> list[Scalar]:
    """By degree of freedom: the model's, times the factor that is given."""
    found, factor = [ZERO] * tree.nv, ONE if given is None else number(given)
    products = {value: number(value) * factor for value in own}
    for hinge, value in zip(tree.hinges, own, strict=True):
        found[hinge.dof] = products[value]
    return found


def _frictions(surfaces: Sequence[Surface], given: Any) -> list[Friction]:
    if given is None:
        return [friction_of(surface) for surface in surfaces]
    own = {value for surface in surfaces for value in surface.friction or ()}
    values = {value: Scalar(jnp.maximum((number(value) * number(given)).value, FRICTIONLESS)) for value in own}
    return [surface.friction and (values[surface.friction[0]], values[surface.friction[1]]) for surface in surfaces]


def _within(bounds: tuple[float, float] | None, value: Scalar) -> Scalar:
    return value if bounds is None else Scalar(jnp.clip(value.value, *bounds))
