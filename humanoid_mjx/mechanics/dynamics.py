"""The motion of a serial chain: `mass_matrix(q) qdd + coriolis(q, qd) + gravity(q) = torque`.

All functions take one chain at one state; `jax.vmap` batches both. They are plain arithmetic of arrays, which
`kernels.numbers.scalarised` writes out: what vanishes in the chain's structure is left out, and XLA makes few kernels
without loops or matrices. On a CPU they are fastest after `humanoid_mjx.start()` in a `jax.jit` with
`compute.compiler_options("scalars")`, in batches of some 500 for each core.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from humanoid_mjx.kernels.numbers import scalarised
from humanoid_mjx.mechanics.links import composite_inertia, gravity_vector, make_links, newton_euler, solve
from humanoid_mjx.robot.chain import Chain
from humanoid_mjx.types import FloatScalar, IntScalar

Joints = Float[Array, " joints"]
Matrix = Float[Array, "joints joints"]


@scalarised
def mass_matrix(leg: Chain, qpos: Joints) -> Matrix:
    """The mass matrix, kg m^2: symmetric and positive definite."""
    return composite_inertia(make_links(leg, qpos))


@scalarised
def joint_inertias(leg: Chain, qpos: Joints) -> Joints:
    """The diagonal of the mass matrix, kg m^2: what each joint moves while the others stand still."""
    return jnp.stack([row[joint] for joint, row in enumerate(composite_inertia(make_links(leg, qpos)))])


@scalarised
def coriolis(leg: Chain, qpos: Joints, qvel: Joints) -> Joints:
    """The whole velocity term, N m: centrifugal and Coriolis torques."""
    return newton_euler(make_links(leg, qpos), jnp.zeros(3, qpos.dtype), qvel, jnp.zeros_like(qpos))


@scalarised
def gravity(leg: Chain, qpos: Joints) -> Joints:
    """The torques that hold the chain against gravity, N m."""
    return newton_euler(make_links(leg, qpos), gravity_vector(leg), jnp.zeros_like(qpos), jnp.zeros_like(qpos))


@scalarised
def bias(leg: Chain, qpos: Joints, qvel: Joints) -> Joints:
    """`coriolis` plus `gravity`, N m."""
    return newton_euler(make_links(leg, qpos), gravity_vector(leg), qvel, jnp.zeros_like(qpos))


@scalarised
def mass_matrix_and_bias(leg: Chain, qpos: Joints, qvel: Joints) -> tuple[Matrix, Joints]:
    """`mass_matrix` and `bias` at once."""
    links = make_links(leg, qpos)
    return composite_inertia(links), newton_euler(links, gravity_vector(leg), qvel, jnp.zeros_like(qpos))


@scalarised
def inverse_dynamics(leg: Chain, qpos: Joints, qvel: Joints, qacc: Joints) -> Joints:
    """The torques of a motion, N m."""
    return newton_euler(make_links(leg, qpos), gravity_vector(leg), qvel, qacc)


@scalarised
def forward_dynamics(leg: Chain, qpos: Joints, qvel: Joints, torque: Joints) -> Joints:
    """The joint accelerations under given torques, rad/s^2."""
    links = make_links(leg, qpos)
    held = newton_euler(links, gravity_vector(leg), qvel, jnp.zeros_like(qpos))
    return solve(composite_inertia(links), torque - held)


@scalarised
def energy(leg: Chain, qpos: Joints, qvel: Joints) -> Float[Array, ""]:
    """Kinetic plus potential energy, J; the potential is that of the links' masses against the origin of frame 0."""
    links = make_links(leg, qpos)
    everything = jnp.zeros_like(links[0].inertia)
    for link in reversed(links):
        everything = link.inward_body(everything + link.inertia)
    return 0.5 * (composite_inertia(links) @ qvel) @ qvel - gravity_vector(leg) @ everything[:3, 3]


class State(NamedTuple):
    """Position and velocity of a chain: rad and rad/s, by joint."""

    qpos: Joints
    qvel: Joints


Controller = Callable[[FloatScalar, Joints, Joints], Joints]
"""(time in s, qpos, qvel) -> torque, N m."""

Integrator = Callable[..., State]
"""(chain, state, torque held over the step, length of the step in s) -> the state after it."""


def semi_implicit_euler(leg: Chain, state: State, torque: Joints, dt: FloatScalar) -> State:
    """One step of first order that moves with the new velocity, as MuJoCo's does."""
    qacc = forward_dynamics(leg, *state, torque)
    qvel = _after(state.qvel, qacc, dt)
    return State(_after(state.qpos, qvel, dt), qvel)


def midpoint(leg: Chain, state: State, torque: Joints, dt: FloatScalar) -> State:
    """One step of the midpoint rule, of second order, which takes the dynamics twice."""
    middle = _along(state, State(state.qvel, forward_dynamics(leg, *state, torque)), dt / 2)
    return _along(state, State(middle.qvel, forward_dynamics(leg, *middle, torque)), dt)


def runge_kutta(
    leg: Chain, state: State, torque: Joints | Callable[[FloatScalar, State], Joints], dt: FloatScalar
) -> State:
    """One step of the classical method of fourth order.

    A torque that is not held is a function: (share of the step that has passed, state) -> torque, N m.
    """
    acting = torque if callable(torque) else lambda share, state: torque

    # A loop over the four stages compiles the dynamics once.
    def stage(carry: tuple[State, State], share_and_weight: Array) -> tuple[tuple[State, State], None]:
        rate, mean = carry
        share, weight = share_and_weight
        at = _along(state, rate, share * dt)
        rate = State(at.qvel, forward_dynamics(leg, *at, acting(share, at)))
        return (rate, jax.tree.map(lambda m, r: m + weight * r, mean, rate)), None

    stages = jnp.array([[0, 1 / 6], [1 / 2, 1 / 3], [1 / 2, 1 / 3], [1, 1 / 6]], state.qpos.dtype)
    zero = jax.tree.map(jnp.zeros_like, state)
    return _along(state, jax.lax.scan(stage, (zero, zero), stages)[0][1], dt)


def rollout(
    leg: Chain,
    qpos: Joints,
    qvel: Joints,
    controller: Controller,
    dt: FloatScalar,
    steps: int,
    integrator: Integrator = semi_implicit_euler,
    unroll: int = 1,
    cycle: IntScalar | None = 1,
) -> tuple[State, State]:
    """The motion of a chain under a controller whose torque is held over each cycle, or not at all.

    Args:
      controller: (time in s, qpos, qvel) -> torque, N m.
      dt: length of a step, s; may be traced.
      steps: how many.
      unroll: steps in one pass of the compiled loop. On a GPU 4 are twice as fast as 1 and take 4 times as long to
        compile; on a CPU they gain nothing.
      cycle: steps from one torque to the next; may be traced, so that each robot of a batch has its own. None for a
        torque that is not held, as from an analog controller: only `runge_kutta` can do that.

    Returns:
      The state after the last step, and the states after each: (steps, joints). What is not used costs nothing
      inside jit.
    """

    always = cycle is None or (isinstance(cycle, int) and cycle == 1)

    # The carry is of separate scalars, so that a batch of them is contiguous and one kernel computes them all.
    def step(carry: tuple[list[Array], ...], index: Array) -> tuple[tuple[list[Array], ...], State]:
        state = State(jnp.stack(carry[0]), jnp.stack(carry[1]))

        def acting(share: FloatScalar, state: State) -> Joints:
            return controller((index + share) * jnp.asarray(dt, qpos.dtype), *state)

        torque: Any = acting if cycle is None else acting(0.0, state)
        if cycle is not None and not always:
            torque = jnp.where(index % cycle == 0, torque, jnp.stack(carry[2]))
        state = integrator(leg, state, torque, dt)
        return (list(state.qpos), list(state.qvel), [] if always else list(torque)), state

    start = (list(qpos), list(qvel), [] if always else list(jnp.zeros_like(qpos)))
    final, states = jax.lax.scan(step, start, jnp.arange(steps), unroll=unroll)
    return State(jnp.stack(final[0]), jnp.stack(final[1])), states


def _along(state: State, rate: State, time: FloatScalar) -> State:
    """The state after a time in which its parts change at constant rates."""
    return State(_after(state.qpos, rate.qpos, time), _after(state.qvel, rate.qvel, time))


def _after(value: Joints, rate: Joints, time: FloatScalar) -> Joints:
    """`value + rate * time`, by element: the compiler then sees through the stacking."""
    return jnp.stack([x + v * time for x, v in zip(value, rate, strict=True)])
