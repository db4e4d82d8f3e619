# pyright: reportAttributeAccessIssue=false
"""Robots on the ground, a servo asked at every step: their states, and programs that time a physics.

The torso is free, and the servo of the task `stand` drives the joints at its time step of 4 ms. Robots that stand hold
the task's posture. Those that move are thrown about: each has been pushed and has followed random set-points, from
none to `MOVES` of them, and mostly lies on the ground; native MuJoCo makes these states.
"""

from collections.abc import Callable
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from other_calls import native_rollout, with_servo
from timing import on_all_devices

from humanoid_mjx import compute
from humanoid_mjx.control import at_rest
from humanoid_mjx.physics import make_physics
from humanoid_mjx.tasks import make_task
from humanoid_mjx.tasks.legged import Stand
from humanoid_mjx.tasks.legged.body import START_SPREAD

BLOCK = {"cpu": 1024, "gpu": 32_768}
"""Robots at once on a device. Some need more Newton steps than others: the more robots a call of the tree has, the
fuller are the blocks into which its solver gathers those."""

MOVES, MOVE_STEPS = 10, 50
"""Set-points that a robot that is thrown about has had at most, and time steps of each, 0.2 s."""

DISTINCT = 1024
"""The most robots that are thrown about one by one; more start where these do, to set-points of their own."""

OFFSET = 0.35
"""Largest distance of a random set-point from the posture, rad: that of a choice of `walk`, 20 degrees."""

THROWN = (0.3, 1.5)
"""Standard deviations of the torso's velocity, m/s and rad/s, before a robot's first set-point: a push."""

COUNTED, COUNTED_STEPS = 256, 20
"""Robots and time steps over which `contacts` counts."""

States = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Positions, velocities and set-points, by robot."""


@cache
def native_model(robot: str) -> Any:
    """Return MuJoCo's model of a robot with the servo of `stand` as its own, its solver run to convergence."""
    task: Any = make_task("stand", robot=robot, physics="mujoco")
    servo = task.control.of(task.robot)
    gains = np.broadcast_arrays(servo.stiffness, servo.damping, np.zeros(len(task.robot.posture)))[:2]
    return with_servo(task.simulator.model, np.stack(gains, axis=-1))


def states_of(batch: int, moving: bool = False, robot: str = "lower_body") -> States:
    """Return robots that stand in nearly the posture and are to hold it, or such as are thrown about."""
    if moving:
        return _thrown(batch, robot)
    made: Any = make_task("stand", robot=robot).robot
    spread = START_SPREAD * np.random.default_rng(0).uniform(-1.0, 1.0, (batch, len(made.posture)))
    torso = np.tile([0.0, 0.0, made.start_height, 1.0, 0.0, 0.0, 0.0], (batch, 1))
    qpos = np.concatenate([torso, made.posture + spread], axis=1).astype(np.float32)
    setpoint = np.tile(made.posture, (batch, 1)).astype(np.float32)
    return qpos, np.zeros((batch, qpos.shape[1] - 1), np.float32), setpoint


@cache
def _thrown(batch: int, robot: str) -> States:
    random, model = np.random.default_rng(1), native_model(robot)
    qpos, qvel, posture = states_of(min(batch, DISTINCT), robot=robot)
    qvel[:, :6] = random.normal(0.0, np.repeat(THROWN, 3), (len(qvel), 6))
    ages = random.integers(0, MOVES, len(qpos), endpoint=True)[:, None]

    def setpoints(count: int) -> np.ndarray:
        return (posture[:1] + random.uniform(-OFFSET, OFFSET, (count, posture.shape[1]))).astype(np.float32)

    for move in range(MOVES):
        after = native_rollout(model, qpos, qvel, MOVE_STEPS, setpoints(len(qpos)))().astype(np.float32)
        moved = (move < ages) & np.isfinite(after).all(axis=1, keepdims=True)
        qpos, qvel = np.where(moved, after[:, : model.nq], qpos), np.where(moved, after[:, model.nq :], qvel)
    return np.resize(qpos, (batch, qpos.shape[1])), np.resize(qvel, (batch, qvel.shape[1])), setpoints(batch)


def contacts(robot: str) -> dict[str, float]:
    """Return the contacts of a robot that is thrown about, and iterations of native MuJoCo's solver, by time step."""
    model, found = native_model(robot), []
    data = mujoco.MjData(model)
    for data.qpos, data.qvel, data.ctrl in zip(*states_of(COUNTED, True, robot), strict=True):
        data.qacc_warmstart = 0.0
        for _ in range(COUNTED_STEPS):
            mujoco.mj_step(model, data)
            found.append((data.ncon, data.solver_niter.sum()))
    mean, most = np.mean(found, axis=0), np.max(found, axis=0)
    names = "contacts", "solver iterations"
    pairs = zip(names, mean, most, strict=True)
    return {name: value for n, m, x in pairs for name, value in ((n, round(float(m), 2)), (f"most {n}", float(x)))}


def compiled(subject: str, states: States, steps: int, robot: str = "lower_body", again: int = 1) -> Callable[[], Any]:
    """Return a call of a physics: positions and velocities of all robots after so many steps, `again` times."""
    devices, batch = jax.local_devices(), len(states[0])
    block = BLOCK.get(devices[0].platform, batch)
    at_once = -(-batch // (max(1, batch // (block * len(devices))) * len(devices)))
    return on_all_devices(_program(subject, robot, steps, at_once), states, block, again)


@cache
def _program(subject: str, robot: str, steps: int, worlds: int) -> Callable[..., Any]:
    task: Stand = make_task("stand", robot=robot)
    room = {"worlds": worlds} if subject == "mjx-warp" else {}
    simulator = make_physics(subject, robot=task.robot, timestep=task.timestep, **room)
    law: Any = task.control

    def simulate(qpos: jax.Array, qvel: jax.Array, setpoint: jax.Array) -> tuple[jax.Array, ...]:
        controller = law.of(task.robot).follow(at_rest(setpoint))
        world = simulator.run(simulator.start(qpos, qvel), controller, steps)
        return tuple(jnp.where(world.diverged, jnp.nan, part) for part in (world.qpos, world.qvel))

    return jax.jit(jax.vmap(simulate), compiler_options=compute.compiler_options(simulator.arithmetic))
